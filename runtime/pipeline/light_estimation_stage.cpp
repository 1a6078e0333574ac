#include "runtime/pipeline/light_estimation_stage.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <utility>

#include "capture/hdr/merge.h"
#include "capture/warp_grid.h"
#include "core/conventions.h"
#include "core/io/log.h"
#include "lighting/lights/distant_light.h"

namespace penumbra::runtime {

namespace {

constexpr int kRingSlots = capture::HdrRing::kMaxSlots;
constexpr int kLongestSide = 1024;  // rows: above, a light estimate of 9 bands gains nothing
// Frames a camera: then light is shown without those that are silent
constexpr std::uint64_t kPatience = 16;
constexpr double kSameRotation = 1 - 1e-7;  // cosine of half the angle: within .05 degrees
constexpr double kSamePlace_m = 1e-3;

// Far light does not ask where the camera is, but a ball that stands in the world does.
bool stands(const capture::CameraInfo& camera, const Pose& pose) {
  const Pose& before = camera.world_from_camera;
  if (std::abs(glm::dot(pose.rotation, before.rotation)) < kSameRotation) return false;
  return !camera.ball || camera.ball->outline_px ||
         glm::length(pose.translation - before.translation) < kSamePlace_m;
}

// From what the camera shows, by way of the ball if there is one, to the view camera's colours.
glm::dmat3 colour_of(const capture::CameraInfo& camera) {
  if (!camera.ball) return camera.colour;
  const Rgb& r = camera.ball_reflectance;
  return glm::dmat3(1 / double(r.r), 0, 0, 0, 1 / double(r.g), 0, 0, 0, 1 / double(r.b));
}

// The part of the camera that a region is.
capture::CameraInfo camera_of(const capture::CameraInfo& info,
                              const capture::CameraRegion& region) {
  capture::CameraInfo part = info;
  if (region.projection) part.projection = *region.projection;
  part.projection.width = region.width, part.projection.height = region.height;
  return part;
}

// How well each pixel of the map is seen.
Image<float> rims(const capture::CameraRegion& region, const Pose& world_from_camera, int rows) {
  const glm::dquat camera_from_world = glm::conjugate(world_from_camera.rotation);
  Image<float> out(2 * rows, rows);
  // On the rim itself a view counts a little where nothing else sees.
  constexpr double kMin = 1e-3;
  capture::warp_grid(
      2 * rows, rows,
      [&](const glm::dvec2& px) {
        return region.find_pixel(camera_from_world * latlong_direction(px.x, px.y, 2 * rows, rows));
      },
      [&](int x, int y, const capture::PixelHit* seen) {
        out.at(x, y) = seen ? static_cast<float>(std::max(seen->from_rim, kMin)) : 0.f;
      });
  return out;
}

}  // namespace

LightEstimationStage::LightEstimationStage(const std::vector<capture::CameraInfo>& cameras,
                                           const lighting::EstimateOptions& options,
                                           StageTimes& times)
    : cameras_(cameras), estimator_(options), times_(times) {
  for (const capture::CameraInfo& c : cameras) takes_.push_back(capture::shows_surroundings(c));
}

Result<LightEstimationStage> LightEstimationStage::create(
    const std::vector<capture::CameraInfo>& cameras, const lighting::EstimateOptions& options,
    StageTimes& times) {
  LightEstimationStage stage(cameras, options, times);
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    if (!capture::shows_surroundings(cameras[i])) continue;
    const std::size_t count =
        cameras[i].ball ? 1 : std::max<std::size_t>(1, cameras[i].lenses.size());
    for (std::size_t k = 0; k < count; ++k) {
      RegionView& view = stage.views_.emplace_back();
      view.camera = static_cast<int>(i);
      view.is_map = cameras[i].gives_maps;
    }
    const auto posed = stage.set_pose(static_cast<int>(i), cameras[i].world_from_camera);
    // A ball may come into the picture later.
    if (!posed && posed.error().code != ErrorCode::kUndetermined)
      return std::unexpected(posed.error());
  }
  if (stage.views_.empty())
    return fail(ErrorCode::kInvalid, "capture", "has no environment camera");
  if (stage.views_.size() > 1 && std::ranges::any_of(stage.views_, &RegionView::is_map))
    return fail(ErrorCode::kInvalid, "capture",
                "has a light track beside cameras of the surroundings: the light is either's");
  if (stage.views_.size() > 1) stage.blend_.emplace(stage.views_.size());
  stage.lay_out();
  return stage;
}

bool LightEstimationStage::ready() const {
  const bool all = std::ranges::all_of(views_, [&](const RegionView& v) {
    return is_complete(v) || (v.fresh && v.map.clipped_fraction == 0);
  });
  return all || frames_ >= kPatience * cameras_.size();
}

std::size_t LightEstimationStage::exposures() const {
  std::size_t max_count = 0;
  for (const RegionView& v : views_)
    if (v.ring) max_count = std::max(max_count, v.ring->exposures());
  return max_count;
}

// The camera's views anew, from where it stands now.
Result<void> LightEstimationStage::set_pose(int camera, const Pose& world_from_camera) {
  capture::CameraInfo& info = cameras_[static_cast<std::size_t>(camera)];
  info.world_from_camera = world_from_camera;
  auto regions = capture::camera_regions(info, world_from_camera);
  std::size_t next = 0;
  for (RegionView& view : views_) {
    if (view.camera != camera) continue;
    view.assembler.reset();
    view.fresh = false;
    if (!regions) {
      view.region.reset();
      continue;
    }
    capture::CameraRegion& region = (*regions)[next++];
    const bool same_size =
        view.region && view.region->width == region.width && view.region->height == region.height;
    if (!view.is_map && (!same_size || !view.ring))
      view.ring.emplace(camera_of(info, region), kRingSlots);
    view.region = std::move(region);
  }
  return regions ? Result<void>{} : std::unexpected(regions.error());
}

// One map for all views, as fine as the finest has been.
void LightEstimationStage::lay_out() {
  const int before = rows_;
  if (!rows_fixed_) {
    for (const RegionView& v : views_)
      if (v.region) rows_ = std::max(rows_, v.region->rows);
    rows_ = std::clamp(rows_ / 2 * 2, 16, kLongestSide);
  }
  for (std::size_t i = 0; i < views_.size(); ++i) {
    RegionView& v = views_[i];
    if ((v.assembler || v.is_map) && rows_ == before) continue;
    v.map = {};
    v.fresh = false;
    v.assembler.reset();
    const capture::CameraInfo& info = cameras_[static_cast<std::size_t>(v.camera)];
    if (v.region && !v.is_map)
      v.assembler.emplace(*v.region, info.world_from_camera, 2 * rows_, rows_, colour_of(info));
    if (blend_)
      blend_->set_view(i,
                       v.region ? rims(*v.region, info.world_from_camera, rows_) : Image<float>{});
  }
}

Result<void> LightEstimationStage::follow(const capture::Frame& frame) {
  const capture::CameraInfo& info = cameras_[static_cast<std::size_t>(frame.camera)];
  const int w = frame.map ? frame.map->radiance.width() : capture::width(*frame.pixels),
            h = frame.map ? frame.map->radiance.height() : capture::height(*frame.pixels);
  if (w != info.projection.width || h != info.projection.height)
    return fail(ErrorCode::kInvalid, fmt::format("{} frame {}", info.name, frame.sequence),
                fmt::format("has {}x{} pixels instead of {}x{}", w, h, info.projection.width,
                            info.projection.height));
  if (info.gives_maps) return {};
  const auto& view = *std::ranges::find(views_, frame.camera, &RegionView::camera);
  if (stands(info, frame.world_from_camera)) {
    if (view.region) return {};
    return fail(ErrorCode::kUndetermined, info.name,
                "the mirror ball is partly outside the picture");
  }
  const auto posed = set_pose(frame.camera, frame.world_from_camera);
  lay_out();
  return posed;
}

Result<void> LightEstimationStage::merge(RegionView& view, const capture::Frame& frame) {
  if (view.is_map) {
    view.map = *frame.map;
    view.map.time = frame.time;
    view.fresh = true;
    return {};
  }
  capture::Frame part = frame;
  // A ball's picture does not turn with the camera.
  part.world_from_camera = {};
  const capture::CameraRegion& s = *view.region;
  if (s.projection)
    part.world_from_camera.rotation = frame.world_from_camera.rotation * s.camera_from_part;
  if (s.width != capture::width(*frame.pixels) || s.height != capture::height(*frame.pixels))
    part.pixels = std::make_shared<const FramePixels>(capture::cut_out(*frame.pixels, s));
  Result<const capture::MergedImage*> merged = nullptr;
  {
    const StageTimer timer(times_, "merge");
    merged = view.ring->add(part);
  }
  PENUMBRA_TRY(merged);
  const StageTimer timer(times_, "assemble");
  view.assembler->assemble(**merged, view.map);
  view.map.time = frame.time;
  view.fresh = true;
  return {};
}

Environment& LightEstimationStage::whole() {
  if (!blend_) return views_[0].map;
  const StageTimer timer(times_, "blend");
  std::vector<const Environment*> maps;
  std::optional<TimestampNs> oldest;
  for (const RegionView& v : views_) {
    maps.push_back(v.fresh ? &v.map : nullptr);
    if (v.fresh && (!oldest || v.map.time < *oldest)) oldest = v.map.time;
  }
  blend_->blend(maps, environment_);
  environment_.time = *oldest;
  return environment_;
}

void LightEstimationStage::fix_rows(int rows) {
  rows_fixed_ = true;
  rows_ = rows;
  for (RegionView& v : views_) v.assembler.reset();
  lay_out();
}

Result<void> LightEstimationStage::assemble(const capture::Frame& frame) {
  ++frames_;
  settled_ = false;
  // A pause of the camera is no gap of its bracket.
  if (last_) gap_ = std::min(Seconds(1), std::max(gap_, frame.time - *last_));
  last_ = frame.time;
  PENUMBRA_TRY(follow(frame));
  Result<void> failed;
  bool any = false;
  for (RegionView& view : views_) {
    if (view.camera != frame.camera) continue;
    const auto merged = merge(view, frame);
    any |= merged.has_value();
    if (!merged) failed = merged;
    if (!merged && merged.error().code != ErrorCode::kUndetermined)
      return std::unexpected(merged.error());
  }
  if (!any) return std::unexpected(failed.error());
  Environment& environment = whole();
  // What the first exposures saturate a shorter one may still resolve: nothing is read off a floor
  // for it, and nothing is promised.
  const bool waits = frames_ < kPatience * cameras_.size();
  const auto owes = [&](const RegionView& v) { return waits && v.fresh && !is_complete(v); };
  awaits_shorter_ = std::ranges::any_of(views_, owes) && !environment.clipped.empty();
  awaited_.clear();
  if (awaits_shorter_) awaited_.swap(environment.clipped);
  return {};
}

Result<void> LightEstimationStage::process(const capture::Frame& frame,
                                           lighting::LightEstimate& out) {
  PENUMBRA_TRY(assemble(frame));
  return estimate(out);
}

Result<void> LightEstimationStage::settle(TimestampNs now, lighting::LightEstimate& out) {
  constexpr double kGaps = 3;
  constexpr Seconds kOfOneFrame(.5);
  const bool complete =
      std::ranges::all_of(views_, [&](const RegionView& v) { return is_complete(v) || !v.fresh; });
  if (!last_ || complete) return {};
  if (now - *last_ < (gap_ > Seconds(0) ? kGaps * gap_ : kOfOneFrame)) return {};
  settled_ = true;
  if (!std::exchange(awaits_shorter_, false)) return {};
  (blend_ ? environment_ : views_[0].map).clipped.swap(awaited_);
  return renew(out);
}

Result<void> LightEstimationStage::renew(lighting::LightEstimate& out) {
  // None where the last frame showed nothing, of a camera that has moved.
  return environment().radiance.empty() ? Result<void>{} : estimate(out);
}

Result<void> LightEstimationStage::estimate(lighting::LightEstimate& out) {
  const Environment& environment = this->environment();
  {
    const StageTimer timer(times_, "light");
    estimator_.look_for_unseen_sun(ready());
    PENUMBRA_TRY(estimator_.estimate(environment, out));
  }
  if (out.plan && awaits_shorter_) out.plan->lower_bound = true, out.plan->within_budget = false;
  if (awaits_shorter_) out.uncertainty.total.reset();
  warn_once(out);
  return {};
}

void LightEstimationStage::warn_once(const lighting::LightEstimate& estimate) {
  if (!warned_ && std::ranges::any_of(estimate.lights, &lighting::DistantLight::clipped)) {
    const auto clips = std::ranges::find_if(views_, [](const RegionView& v) {
      return v.fresh && v.map.clipped_fraction > 0 && (v.is_map || v.ring->shortest_clips());
    });
    warned_ = clips != views_.end();
    if (warned_)
      log_warning(
          "{}: a light is saturated in every exposure: its power is a lower bound until it is "
          "recovered from a floor of known albedo",
          cameras_[static_cast<std::size_t>(clips->camera)].name);
  }
  const auto sun =
      std::ranges::find(estimate.lights, lighting::kUnseenSun, &lighting::DistantLight::id);
  if (sun != estimate.lights.end() && ready() && !std::exchange(said_sun_, true))
    log_info(
        "no camera sees the sun, {:.0f} degrees above the horizon: its power is read off the floor",
        std::asin(sun->direction.y) * 180 / kPi);
  if (!blend_ || said_gains_ || !ready()) return;
  said_gains_ = true;
  const auto views = gains();
  for (std::size_t i = 1; i < views.size(); ++i) {
    const auto& [camera, g, known] = views[i];
    if (known)
      log_info(
          "{}: view {} of the surroundings has the gain {:.3f} {:.3f} {:.3f} against view 1, by "
          "their overlaps",
          camera, i + 1, g.r, g.g, g.b);
    else
      log_warning("{}: view {} of the surroundings overlaps no other view: its gain counts as 1",
                  camera, i + 1);
  }
}

std::vector<LightEstimationStage::ViewGain> LightEstimationStage::gains() const {
  std::vector<ViewGain> out;
  for (std::size_t i = 0; i < views_.size(); ++i)
    out.push_back({cameras_[static_cast<std::size_t>(views_[i].camera)].name,
                   blend_ ? blend_->gains()[i] : Rgb{1, 1, 1},
                   i == 0 || (blend_ && blend_->has_gain(i))});
  return out;
}

// Once of each light, and of few: what flickers at the edge of being clipped would fill the log.
bool LightEstimationStage::is_news(int source, Told told) {
  constexpr std::size_t kMaxTold = 24;
  if (told_.size() >= kMaxTold) return false;
  return told_.emplace(source, told).second;
}

void LightEstimationStage::add_recoveries(
    std::span<const lighting::SaturationRecovery> recoveries) {
  for (const lighting::SaturationRecovery& c : recoveries) {
    const auto name = c.source == lighting::kUnseenSun
                          ? std::string("the sun that no camera sees")
                          : fmt::format("saturated light {}", c.source);
    const auto added = estimator_.add_recovery(c);
    if (!is_news(c.source, !added ? Told::kRefused : c.is_guess ? Told::kGuess : Told::kKnown))
      continue;
    if (added && c.is_guess)
      log_warning(
          "light: the power of {} is a guess: the floor tells what several saturated lights send "
          "together, no shadow tells how much each does",
          name);
    else if (added)
      log_info("light: the power of {} is recovered from the floor", name);
    else  // it has moved on, or the floor says less than the camera
      log_warning("light: the power of {} is not recovered from the floor: it {}", name,
                  added.error().detail);
  }
}

}  // namespace penumbra::runtime
