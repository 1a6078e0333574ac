#include "capture/ring/hdr_ring.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>

#include "calib/camera/lens_vignetting.h"
#include "calib/camera/response_table.h"
#include "capture/hdr/contradiction.h"
#include "capture/hdr/merge_math.h"
#include "capture/hdr/pose_warp.h"
#include "capture/ring/internal/table_merger.h"
#include "capture/watch/frame_watch.h"
#include "core/half.h"
#include "core/io/log.h"
#include "core/threads/background_task.h"
#include "core/threads/scratch.h"

namespace penumbra::capture {

namespace {

// The float merge in the ring's format; its scale keeps the brightest value inside half floats.
void to_half(const MergedFloat& in, double shortest, MergedImage& out) {
  if (!out.pixels.same_size(in.radiance))
    out.pixels = Image<HalfRgba>(in.radiance.width(), in.radiance.height());
  double brightest = 1 / shortest;
  for (const Rgb& c : in.radiance.pixels())
    brightest = std::max({brightest, double(c.r), double(c.g), double(c.b)});
  out.scale = static_cast<float>(brightest / 60000);
  for (std::size_t i = 0; i < in.radiance.area(); ++i) {
    const Rgb v = in.radiance.pixels()[i] * (1 / out.scale);
    const auto half = [](float x) { return half_from_float(std::max(x, -65504.f)); };
    out.pixels.pixels()[i] = {half(v.r), half(v.g), half(v.b),
                              in.clipped.pixels()[i] ? std::uint16_t{0} : kHalfOne};
  }
  out.clipped_fraction = in.clipped_fraction;
  out.black_fraction = in.black_fraction;
}

}  // namespace

HdrRing::HdrRing(CameraInfo camera, int slots)
    : camera_(std::move(camera)),
      max_slots_(static_cast<std::size_t>(std::clamp(slots, 1, kMaxSlots))),
      watch_(std::make_unique<FrameWatch>(camera_)) {}
HdrRing::~HdrRing() = default;
HdrRing::HdrRing(HdrRing&&) noexcept = default;
HdrRing& HdrRing::operator=(HdrRing&&) noexcept = default;

// The slot of this exposure. Flicker moves the gain that a frame is given, by less than half a stop
// around its mean.
HdrRing::RingSlot* HdrRing::slot_of(const Exposure& exposure) {
  constexpr double kHalfStop = .3;
  const auto apart = [&](const RingSlot& s) {
    return std::abs(s.gain_log - std::log(exposure.gain.value()));
  };
  RingSlot* nearest = nullptr;
  for (RingSlot& s : slots_)
    if (std::abs(s.nominal.time.count() / exposure.time.count() - 1) < .01 &&
        apart(s) < (nearest ? apart(*nearest) : kHalfStop))
      nearest = &s;
  return nearest;
}

// A bracket of more exposures than there are slots would push each one out just before it comes
// again, and the light would pulse with it. A camera that seeks its exposure comes back to some as
// well, but not frame after frame for two brackets.
Result<void> HdrRing::make_room(const Frame& frame) {
  if (slots_.size() < max_slots_) return {};
  std::erase_if(left_, [&](const LeftExposure& l) { return l.left + 4 * max_slots_ < taken_; });
  const double product = frame.exposure.product();
  const auto is_this = [&](const LeftExposure& l) {
    return std::abs(l.exposure.product() / product - 1) < .01;
  };
  came_again_ = std::ranges::any_of(left_, is_this) ? came_again_ + 1 : 0;
  if (came_again_ > 2 * max_slots_)
    return fail(ErrorCode::kInvalid, camera_.name,
                fmt::format("takes more than {} exposures in turn, which is as many as are merged",
                            max_slots_));
  if (!std::exchange(said_, true))
    log_warning("{}: takes more than {} different exposures: the oldest are left out", camera_.name,
                max_slots_);
  const auto oldest = std::ranges::min_element(slots_, {}, &RingSlot::placed);
  left_.push_back({oldest->nominal, taken_});
  slots_.erase(oldest);
  return {};
}

Result<const MergedImage*> HdrRing::add(const Frame& given) {
  Frame frame = given;
  PENUMBRA_TRY(check_exposures({&frame.exposure, 1}));
  const int w = camera_.projection.width, h = camera_.projection.height;
  if (width(*frame.pixels) != w || height(*frame.pixels) != h)
    return fail(ErrorCode::kInvalid, fmt::format("{} frame {}", camera_.name, frame.sequence),
                fmt::format("has {}x{} pixels instead of {}x{}", width(*frame.pixels),
                            height(*frame.pixels), w, h));
  const auto shown = watch_->exposure_of(frame);
  if (!shown)
    return fail(ErrorCode::kUndetermined, fmt::format("{} frame {}", camera_.name, frame.sequence),
                "does not show the exposure that it is said to have");
  frame.exposure = *shown;
  std::optional<Frame> replaced;
  const double gain_log = std::log(frame.exposure.gain.value());
  RingSlot* const old = slot_of(frame.exposure);
  const Exposure nominal = old ? old->nominal : frame.exposure;
  const auto shorter = std::ranges::find_if(
      slots_, [&](const RingSlot& s) { return s.nominal.product() < .99 * nominal.product(); });
  Frame steady =
      watch_->steady(frame, nominal, shorter == slots_.end() ? nullptr : &shorter->frame);
  if (old) {
    repeats_ = old->placed + 1 == taken_ ? repeats_ + 1 : 0;
    came_back_ |= repeats_ != 1;
    came_again_ = 0;
    replaced = std::exchange(old->frame, std::move(steady));
    old->placed = taken_++;
    old->gain_log += .1 * (gain_log - old->gain_log);
  } else {
    PENUMBRA_TRY(make_room(frame));
    repeats_ = 0;
    slots_.push_back({std::move(steady), frame.exposure, gain_log, taken_++});
    std::ranges::stable_sort(slots_, [](const RingSlot& a, const RingSlot& b) {
      return a.nominal.product() > b.nominal.product();
    });
  }
  // An exposure that the schedule has left behind must not go on lighting the scene.
  std::erase_if(slots_, [&](const RingSlot& s) { return s.placed + 3 * slots_.size() < taken_; });
  const bool turned = turn_to(frame);
  // What was merged before was seen from elsewhere.
  PENUMBRA_TRY(merge_now(turned || was_turned_ ? std::nullopt : replaced));
  was_turned_ = turned;
  if (merged_.clipped_fraction == 1)
    return fail(ErrorCode::kUndetermined, camera_.name, "every pixel is clipped in every exposure");
  if (merged_.black_fraction == 1)
    return fail(ErrorCode::kUndetermined, camera_.name, "every pixel is black in every exposure");
  return &merged_;
}

bool HdrRing::shortest_clips() const {
  if (slots_.empty()) return false;
  const auto any = [&](const auto& image, unsigned largest) {
    std::array<unsigned, 3> first{};  // code that is clipped, by channel
    for (int c = 0; c < 3; ++c) {
      unsigned& code = first[static_cast<std::size_t>(c)];
      for (unsigned step = (largest + 1) / 2; step > 0; step /= 2)
        if (code + step <= largest &&
            camera_.response.decode(double(code + step) / largest, c) < kClipLevel)
          code += step;
      ++code;
    }
    return std::ranges::any_of(image.pixels(), [&](const auto& p) {
      return p.r >= first[0] || p.g >= first[1] || p.b >= first[2];
    });
  };
  const FramePixels& shortest = *slots_.back().frame.pixels;
  if (const auto* codes8 = std::get_if<Image<Rgb8>>(&shortest)) return any(*codes8, 255);
  if (const auto* codes16 = std::get_if<Image<Rgb16>>(&shortest)) return any(*codes16, 65535);
  return merged_.clipped_fraction > 0;
}

// True when a slot was taken with the camera turned otherwise, by more than a quarter of a pixel.
bool HdrRing::turn_to(const Frame& newest) {
  constexpr double kSeen_px = .25;
  bool any = false;
  for (RingSlot& s : slots_) {
    const glm::dquat before_from_now =
        glm::conjugate(s.frame.world_from_camera.rotation) * newest.world_from_camera.rotation;
    const double angle =
        2 * std::asin(std::min(1., glm::length(glm::dvec3(before_from_now.x, before_from_now.y,
                                                          before_from_now.z))));
    if (angle < kSeen_px * pixel_angle(camera_.projection)) {
      s.turned.reset();
      continue;
    }
    s.turned = turned(*s.frame.pixels, camera_.projection,
                      calib::vignetting_of(camera_.projection, camera_.vignetting), before_from_now,
                      s.valid);
    fill_unseen(s, newest);
    any = true;
  }
  return any;
}

// Tables have no place for what was not seen: there a slot says what the newest frame makes one
// expect, and that it is clipped where that is.
void HdrRing::fill_unseen(RingSlot& slot, const Frame& newest) const {
  const auto* now = std::get_if<Image<Rgb8>>(newest.pixels.get());
  const auto* seen = std::get_if<Image<Rgb8>>(slot.turned.get());
  if (!now || !seen) return;
  const ResponseTable curve = make_response_table(camera_.response, 8, camera_.black_level);
  const double ratio = slot.frame.exposure.product() / newest.exposure.product();
  std::array<std::array<std::uint8_t, 256>, 3> expected{};
  for (int c = 0; c < 3; ++c)
    for (unsigned code = 0; code < 256; ++code)
      expected[static_cast<std::size_t>(c)][code] =
          static_cast<std::uint8_t>(scaled_code(curve, camera_.black_level, c, code, ratio));
  Image<Rgb8> filled = *seen;
  for (std::size_t i = 0; i < filled.area(); ++i) {
    if (slot.valid.pixels()[i]) continue;
    const Rgb8& p = now->pixels()[i];
    filled.pixels()[i] = {expected[0][p.r], expected[1][p.g], expected[2][p.b]};
  }
  slot.turned = std::make_shared<const FramePixels>(std::move(filled));
}

Result<void> HdrRing::merge_now(const std::optional<Frame>& replaced) {
  const auto bytes = [](const FramePixels& p) { return std::get_if<Image<Rgb8>>(&p); };
  if (!std::ranges::all_of(slots_, [&](const RingSlot& s) { return bytes(*s.pixels()); }))
    return merge_all();
  const bool anew = !std::ranges::equal(
      slots_, table_exposures_,
      [](const Exposure& a, const Exposure& b) {
        return a.product() == b.product() && a.gain == b.gain;
      },
      &RingSlot::nominal);
  if (anew) {
    table_exposures_.clear();
    for (const RingSlot& s : slots_) table_exposures_.push_back(s.nominal);
    auto table = TableMerger::make(table_exposures_, camera_);
    table_ = table ? std::make_unique<TableMerger>(std::move(*table)) : nullptr;
  }
  if (!table_) return merge_all();
  const Scratch::Scope scope;
  std::pmr::vector<TableMerger::MergeSlot> slots(scope.memory());
  for (const RingSlot& s : slots_)
    slots.push_back({bytes(*s.pixels()), s.frame.exposure, s.placed});
  if (!anew && replaced && bytes(*replaced->pixels)) {
    const TableMerger::MergeSlot before{bytes(*replaced->pixels), replaced->exposure, 0};
    table_->update(slots, &before, merged_);
  } else {
    table_->update(slots, nullptr, merged_);
  }
  return {};
}

// For frames that tables do not suit: all pixels from all samples, each time.
Result<void> HdrRing::merge_all() {
  ExposureStack stack{
      {}, {}, camera_.response, camera_.noise, camera_.black_level, {}, camera_.noise_known};
  for (const RingSlot& s : slots_) {
    stack.frames.push_back(s.pixels());
    stack.valid.push_back(s.turned ? s.valid : Image<std::uint8_t>{});
    stack.exposures.push_back(s.frame.exposure);
    stack.priority.push_back(stack.priority.size());
  }
  std::ranges::sort(stack.priority, [&](std::size_t a, std::size_t b) {
    return slots_[a].placed > slots_[b].placed;
  });
  PENUMBRA_ASSIGN(merged, capture::merge(stack));
  to_half(merged, slots_.back().frame.exposure.product(), merged_);
  return {};
}

}  // namespace penumbra::capture
