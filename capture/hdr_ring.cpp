#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "capture/contradiction.h"
#include "capture/table_merger.h"
#include "core/half.h"

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
    : camera_(std::move(camera)), most_slots_(static_cast<std::size_t>(std::max(1, slots))) {}
HdrRing::~HdrRing() = default;
HdrRing::HdrRing(HdrRing&&) noexcept = default;
HdrRing& HdrRing::operator=(HdrRing&&) noexcept = default;

// The slot of this exposure. Flicker moves the gain that a frame is given, by less than half a stop around its mean.
HdrRing::Slot* HdrRing::slot_of(const Exposure& exposure) {
  constexpr double kHalfStop = .3;
  const auto apart = [&](const Slot& s) {
    return std::abs(s.gain_log - std::log(exposure.gain.value()));
  };
  Slot* nearest = nullptr;
  for (Slot& s : slots_)
    if (std::abs(s.nominal.time.count() / exposure.time.count() - 1) < .01 &&
        apart(s) < (nearest ? apart(*nearest) : kHalfStop))
      nearest = &s;
  return nearest;
}

Result<const MergedImage*> HdrRing::add(const Frame& frame) {
  PENUMBRA_TRY(check_exposures({&frame.exposure, 1}));
  const int w = camera_.projection.width, h = camera_.projection.height;
  if (width(*frame.pixels) != w || height(*frame.pixels) != h)
    return fail(
        ErrorCode::kInvalid, fmt::format("{} frame {}", camera_.name, frame.sequence),
        fmt::format("{}x{}, expected {}x{}", width(*frame.pixels), height(*frame.pixels), w, h));
  std::optional<Frame> replaced;
  const double gain_log = std::log(frame.exposure.gain.value());
  if (Slot* const old = slot_of(frame.exposure)) {
    came_back_ = true;
    replaced = std::exchange(old->frame, frame);
    old->placed = taken_++;
    old->gain_log += .1 * (gain_log - old->gain_log);
  } else {
    if (slots_.size() >= most_slots_)
      slots_.erase(std::ranges::min_element(slots_, {}, &Slot::placed));
    slots_.push_back({frame, frame.exposure, gain_log, taken_++});
    std::ranges::stable_sort(slots_, [](const Slot& a, const Slot& b) {
      return a.nominal.product() > b.nominal.product();
    });
  }
  // An exposure that the schedule has left behind must not go on lighting the scene.
  std::erase_if(slots_, [&](const Slot& s) { return s.placed + 3 * slots_.size() < taken_; });
  PENUMBRA_TRY(merge_now(replaced));
  if (merged_.clipped_fraction == 1)
    return fail(ErrorCode::kUndetermined, camera_.name, "every pixel is clipped in every exposure");
  if (merged_.black_fraction == 1)
    return fail(ErrorCode::kUndetermined, camera_.name, "every pixel is black in every exposure");
  return &merged_;
}

Result<void> HdrRing::merge_now(const std::optional<Frame>& replaced) {
  const auto bytes = [](const Frame& f) { return std::get_if<Image<Rgb8>>(f.pixels.get()); };
  if (!std::ranges::all_of(slots_, [&](const Slot& s) { return bytes(s.frame); }))
    return merge_all();
  std::vector<Exposure> exposures;
  for (const Slot& s : slots_) exposures.push_back(s.nominal);
  const bool anew =
      !std::ranges::equal(exposures, table_exposures_, [](const Exposure& a, const Exposure& b) {
        return a.product() == b.product() && a.gain == b.gain;
      });
  if (anew) {
    auto table = TableMerger::make(exposures, camera_);
    table_ = table ? std::make_unique<TableMerger>(std::move(*table)) : nullptr;
    table_exposures_ = exposures;
  }
  if (!table_) return merge_all();
  std::vector<TableMerger::Slot> slots;
  for (const Slot& s : slots_) slots.push_back({bytes(s.frame), s.frame.exposure, s.placed});
  if (!anew && replaced && bytes(*replaced)) {
    const TableMerger::Slot before{bytes(*replaced), replaced->exposure, 0};
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
  for (const Slot& s : slots_) {
    stack.frames.push_back(s.frame.pixels);
    stack.exposures.push_back(s.frame.exposure);
    stack.trust.push_back(stack.trust.size());
  }
  std::ranges::sort(stack.trust, [&](std::size_t a, std::size_t b) {
    return slots_[a].placed > slots_[b].placed;
  });
  auto merged = capture::merge(stack);
  if (!merged) return std::unexpected(merged.error());
  to_half(*merged, slots_.back().frame.exposure.product(), merged_);
  return {};
}

}  // namespace penumbra::capture
