#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "capture/merge_math.h"
#include "core/half.h"

namespace penumbra::capture {

namespace {

bool same_exposure(const Exposure& a, const Exposure& b) {
  return std::abs(a.time.count() / b.time.count() - 1) < .01 &&
         std::abs(a.gain.value() / b.gain.value() - 1) < .01;
}

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
    : camera_(std::move(camera)), slots_(static_cast<std::size_t>(std::max(1, slots))) {}

Result<const MergedImage*> HdrRing::add(const Frame& frame) {
  PENUMBRA_TRY(check_exposures({&frame.exposure, 1}));
  const int w = camera_.projection.width, h = camera_.projection.height;
  if (width(*frame.pixels) != w || height(*frame.pixels) != h)
    return fail(
        ErrorCode::kInvalid, fmt::format("{} frame {}", camera_.name, frame.sequence),
        fmt::format("{}x{}, expected {}x{}", width(*frame.pixels), height(*frame.pixels), w, h));
  const auto old = std::ranges::find_if(
      frames_, [&](const Frame& f) { return same_exposure(f.exposure, frame.exposure); });
  came_back_ |= old != frames_.end();
  if (old != frames_.end())
    frames_.erase(old);
  else if (frames_.size() >= slots_)
    frames_.erase(frames_.begin());
  frames_.push_back(frame);
  // An exposure that the schedule has left behind must not go on lighting the scene.
  std::erase_if(frames_,
                [&](const Frame& f) { return f.sequence + 3 * frames_.size() < frame.sequence; });
  PENUMBRA_TRY(merge_now());
  if (merged_.clipped_fraction == 1)
    return fail(ErrorCode::kUndetermined, camera_.name, "every pixel is clipped in every exposure");
  if (merged_.black_fraction == 1)
    return fail(ErrorCode::kUndetermined, camera_.name, "every pixel is black in every exposure");
  return &merged_;
}

Result<void> HdrRing::merge_now() {
  // Sorted by exposure, so that the table does not depend on which frame came last.
  std::vector<const Frame*> sorted;
  for (const Frame& f : frames_) sorted.push_back(&f);
  std::ranges::sort(sorted, [](const Frame* a, const Frame* b) {
    return a->exposure.product() > b->exposure.product();
  });
  const bool bytes = std::ranges::all_of(
      sorted, [](const Frame* f) { return std::holds_alternative<Image<Rgb8>>(*f->pixels); });
  if (bytes) {
    std::vector<Exposure> exposures;
    for (const Frame* f : sorted) exposures.push_back(f->exposure);
    if (!std::ranges::equal(exposures, table_exposures_, [](const Exposure& a, const Exposure& b) {
          return a.product() == b.product() && a.gain == b.gain;
        })) {
      table_ = TableMerger::make(exposures, camera_.response, camera_.noise, camera_.black_level);
      table_exposures_ = exposures;
    }
    if (table_) {
      std::vector<const Image<Rgb8>*> images;
      for (const Frame* f : sorted) images.push_back(&std::get<Image<Rgb8>>(*f->pixels));
      table_->merge(images, merged_);
      return {};
    }
  }
  ExposureStack stack{{}, {}, camera_.response, camera_.noise, camera_.black_level};
  for (const Frame* f : sorted) {
    stack.frames.push_back(f->pixels);
    stack.exposures.push_back(f->exposure);
  }
  auto merged = capture::merge(stack);
  if (!merged) return std::unexpected(merged.error());
  to_half(*merged, sorted.back()->exposure.product(), merged_);
  return {};
}

}  // namespace penumbra::capture
