#include "runtime/pipeline/light_track.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "capture/camera_regions.h"
#include "core/conventions.h"
#include "core/threads/stage_times.h"
#include "runtime/pipeline/light_estimation_stage.h"

namespace penumbra::runtime {

namespace {

constexpr std::string_view kTrackName = "light";

// Four pixels to one, by their solid angles; what was not seen does not count.
Environment halved(const Environment& map) {
  const int width = map.radiance.width() / 2, height = map.radiance.height() / 2;
  Environment out;
  out.radiance.reset(width, height);
  if (!map.confidence.empty()) out.confidence.reset(width, height);
  out.time = map.time;
  out.clipped_fraction = map.clipped_fraction;
  out.black_fraction = map.black_fraction;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      Rgb sum;
      float weight = 0, solid = 0;
      for (int k = 0; k < 4; ++k) {
        const int i = 2 * x + k % 2, j = 2 * y + k / 2;
        const auto sr = static_cast<float>(latlong_solid_angle(j, 2 * width, 2 * height));
        const float w = map.confidence.empty() ? sr : sr * map.confidence.at(i, j);
        sum += map.radiance.at(i, j) * w;
        weight += w, solid += sr;
      }
      if (weight > 0) out.radiance.at(x, y) = sum * (1 / weight);
      if (!map.confidence.empty()) out.confidence.at(x, y) = weight / solid;
    }
  for (const std::uint32_t pixel : map.clipped) {
    const auto w = static_cast<std::uint32_t>(map.radiance.width());
    out.clipped.push_back(pixel / w / 2 * static_cast<std::uint32_t>(width) + pixel % w / 2);
  }
  std::ranges::sort(out.clipped);
  const auto doubles = std::ranges::unique(out.clipped);
  out.clipped.erase(doubles.begin(), doubles.end());
  return out;
}

class LightTrackSource final : public capture::FrameSource {
 public:
  LightTrackSource(capture::FrameSource& source, std::unique_ptr<StageTimes> times,
                   LightEstimationStage stage, KeptLight keep, int rows, int halvings);

  const std::vector<capture::CameraInfo>& cameras() const override { return cameras_; }
  double view_rate() const override { return source_.view_rate(); }
  bool is_live() const override { return source_.is_live(); }
  void close() override { source_.close(); }
  std::vector<capture::CameraCounts> counts() const override;
  Result<std::optional<capture::Frame>> next() override;

 private:
  Result<void> measure(const capture::Frame& frame);
  void keep_map(TimestampNs time);

  capture::FrameSource& source_;
  std::unique_ptr<StageTimes> times_;  // the stage's, which nobody reads
  LightEstimationStage stage_;
  std::vector<capture::CameraInfo> cameras_;
  std::vector<std::optional<int>> kept_;  // by the source's cameras: their numbers here
  int halvings_ = 0;
  std::uint64_t maps_ = 0;
  std::optional<capture::Frame> map_;  // comes next
  std::optional<TimestampNs> last_{};  // frame that was merged
  bool ended_ = false;
};

LightTrackSource::LightTrackSource(capture::FrameSource& source, std::unique_ptr<StageTimes> times,
                                   LightEstimationStage stage, KeptLight keep, int rows,
                                   int halvings)
    : source_(source), times_(std::move(times)), stage_(std::move(stage)), halvings_(halvings) {
  for (const capture::CameraInfo& c : source.cameras()) {
    const bool light = c.role == capture::Role::kEnvironment;
    const bool kept = !light || (keep == KeptLight::kBoth && !c.gives_maps);
    kept_.push_back(kept ? std::optional(static_cast<int>(cameras_.size())) : std::nullopt);
    if (kept) cameras_.push_back(c);
  }
  capture::CameraInfo& track = cameras_.emplace_back();
  track.name = kTrackName;
  track.gives_maps = true;
  track.projection = {.kind = calib::ProjectionKind::kLatLong, .width = 2 * rows, .height = rows};
  track.response = calib::Response::linear();
}

std::vector<capture::CameraCounts> LightTrackSource::counts() const {
  const auto all = source_.counts();
  if (all.empty()) return {};
  std::vector<capture::CameraCounts> out;
  capture::CameraCounts track;
  track.frames = maps_;
  for (std::size_t i = 0; i < all.size() && i < kept_.size(); ++i) {
    if (kept_[i]) {
      out.push_back(all[i]);
      continue;
    }
    // What the track is measured from is told with it.
    track.arrived += all[i].arrived, track.lost += all[i].lost;
    track.damaged += all[i].damaged, track.rejected += all[i].rejected;
    track.overrun += all[i].overrun, track.reconnected += all[i].reconnected;
  }
  out.push_back(std::move(track));
  return out;
}

Result<void> LightTrackSource::measure(const capture::Frame& frame) {
  const auto assembled = stage_.assemble(frame);
  if (!assembled && assembled.error().code == ErrorCode::kUndetermined) return {};
  PENUMBRA_TRY(assembled);
  last_ = frame.time;
  if (stage_.ready()) keep_map(frame.time);
  return {};
}

void LightTrackSource::keep_map(TimestampNs time) {
  Environment map = halvings_ > 0 ? halved(stage_.environment()) : stage_.environment();
  for (int i = 1; i < halvings_; ++i) map = halved(map);
  map.time = time;
  capture::Frame& out = map_.emplace();
  out.camera = static_cast<int>(cameras_.size()) - 1;
  out.sequence = maps_++;
  out.time = time;
  out.exposure = {Seconds(1), Gain(1)};
  out.map = std::make_shared<const Environment>(std::move(map));
}

Result<std::optional<capture::Frame>> LightTrackSource::next() {
  for (;;) {
    if (map_) return std::exchange(map_, std::nullopt);
    PENUMBRA_ASSIGN(frame, source_.next());
    if (!frame) {
      // Of one bracket, whose exposures never came again.
      if (maps_ == 0 && last_ && !std::exchange(ended_, true)) {
        lighting::LightEstimate unused;
        PENUMBRA_TRY(stage_.settle(LightEstimationStage::kNoMore, unused));
        keep_map(*last_);
        continue;
      }
      return frame;
    }
    if (!frame->for_light && stage_.takes(frame->camera)) PENUMBRA_TRY(measure(*frame));
    const auto& kept = kept_[static_cast<std::size_t>(frame->camera)];
    if (!kept) continue;
    frame->camera = *kept;
    return frame;
  }
}

// As fine as the finest of the cameras; nothing while no ball is in its picture.
int rows_seen(const std::vector<capture::CameraInfo>& cameras) {
  int rows = 0;
  for (const capture::CameraInfo& c : cameras) {
    if (!capture::shows_surroundings(c)) continue;
    if (const auto regions = capture::camera_regions(c, c.world_from_camera))
      for (const capture::CameraRegion& r : *regions) rows = std::max(rows, r.rows);
  }
  return rows;
}

}  // namespace

Result<KeptLight> kept_light(std::string_view name) {
  if (name == "cameras") return KeptLight::kCameras;
  if (name == "track") return KeptLight::kTrack;
  if (name == "both") return KeptLight::kBoth;
  return fail(ErrorCode::kInvalid, std::string(name), "is none of cameras, track and both");
}

Result<std::unique_ptr<capture::FrameSource>> with_light_track(capture::FrameSource& source,
                                                               KeptLight keep, int max_rows) {
  constexpr int kMin = 16, kMax = 1024;
  if (max_rows < kMin || max_rows > kMax)
    return fail(ErrorCode::kInvalid, "rows of the light track",
                fmt::format("are not within {}..{}", kMin, kMax));
  auto times = std::make_unique<StageTimes>();
  PENUMBRA_ASSIGN(stage, LightEstimationStage::create(source.cameras(), {}, *times));
  const auto& cameras = source.cameras();
  if (std::ranges::any_of(cameras, [](const capture::CameraInfo& c) {
        return c.name == kTrackName && !c.gives_maps;
      }))
    return fail(ErrorCode::kInvalid, std::string(kTrackName),
                "is a camera's name here, and a light track's: rename the camera");
  // A ball that comes nearer must not make the maps larger.
  const int seen = rows_seen(cameras);
  int rows = std::clamp(seen > 0 ? seen : kLightTrackRows, kMin, kMax) / 2 * 2, halvings = 0;
  // A track's maps come with the rows that they have, which only halve where they are even.
  const bool of_track = std::ranges::any_of(cameras, &capture::CameraInfo::gives_maps);
  for (; rows > max_rows && (!of_track || rows % 4 == 0); rows = std::max(kMin, rows / 4 * 2))
    ++halvings;
  stage.fix_rows(rows << halvings);
  return std::make_unique<LightTrackSource>(source, std::move(times), std::move(stage), keep, rows,
                                            halvings);
}

}  // namespace penumbra::runtime
