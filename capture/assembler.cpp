#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>

#include "capture/capture.h"
#include "capture/gather_kernel.h"
#include "core/conventions.h"

namespace penumbra::capture {

static_assert(sizeof(HalfRgba) == 8);

namespace {

bool is_identity_latlong(const calib::Projection& p, const Pose& pose, int width, int height) {
  return p.kind == calib::ProjectionKind::kLatLong && p.width == width && p.height == height &&
         std::abs(std::abs(pose.rotation.w) - 1) < 1e-9;
}

}  // namespace

EnvironmentAssembler::EnvironmentAssembler(const calib::Projection& projection, const Pose& world_from_camera,
                                           int width, int height)
    : source_width_(projection.width), source_height_(projection.height), width_(width), height_(height) {
  if (is_identity_latlong(projection, world_from_camera, width, height)) return;
  const glm::dquat camera_from_world = glm::conjugate(world_from_camera.rotation);
  taps_.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const glm::dvec3 d = camera_from_world * latlong_direction(x + .5, y + .5, width, height);
      const auto pixel = calib::pixel_from_direction(projection, d);
      if (!pixel) {
        taps_.push_back({-1, 0, 0});
        complete_ = false;
        continue;
      }
      // From pixel centres; the border repeats its last pixel.
      const double px = std::clamp(pixel->x - .5, 0., source_width_ - 1.);
      const double py = std::clamp(pixel->y - .5, 0., source_height_ - 1.);
      const int ix = std::min(static_cast<int>(px), source_width_ - 2);
      const int iy = std::min(static_cast<int>(py), source_height_ - 2);
      taps_.push_back({iy * source_width_ + ix, static_cast<std::uint16_t>(std::lround((px - ix) * 32768)),
                       static_cast<std::uint16_t>(std::lround((py - iy) * 32768))});
    }
}

EnvironmentAssembler::~EnvironmentAssembler() = default;
EnvironmentAssembler::EnvironmentAssembler(EnvironmentAssembler&&) noexcept = default;
EnvironmentAssembler& EnvironmentAssembler::operator=(EnvironmentAssembler&&) noexcept = default;

void EnvironmentAssembler::assemble(const MergedImage& merged, Environment& out) const {
  if (out.radiance.width() != width_ || out.radiance.height() != height_) {
    out.radiance = Image<Rgb>(width_, height_);
    out.confidence = {};
    if (!complete_) {
      out.confidence = Image<float>(width_, height_);
      for (std::size_t i = 0; i < taps_.size(); ++i) out.confidence.pixels()[i] = taps_[i].offset < 0 ? 0.f : 1.f;
    }
  }
  std::vector<double> lost(static_cast<std::size_t>(height_));  // solid angle per row, summed in order
  const auto* source = &merged.pixels.pixels()[0].r;
  tbb::parallel_for(tbb::blocked_range<int>(0, height_, 16), [&](const auto& rows) {
    for (int y = rows.begin(); y < rows.end(); ++y) {
      float* const target = &out.radiance.row(y)[0].r;
      float alpha = 0;
      int seen = width_;
      if (taps_.empty()) {
        alpha = convert_row(source + 4 * static_cast<std::ptrdiff_t>(y) * width_, width_, merged.scale, target);
      } else {
        const auto* taps =
            &taps_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_)];
        alpha = gather_row(source, source_width_, taps, width_, merged.scale, target);
        if (!complete_)
          seen = static_cast<int>(std::count_if(taps, taps + width_, [](const GatherTap& t) { return t.offset >= 0; }));
      }
      lost[static_cast<std::size_t>(y)] =
          (seen - double(alpha)) * latlong_solid_angle(y, width_, height_);
    }
  });
  double total = 0;
  for (double v : lost) total += std::max(0., v);
  out.clipped_fraction = total / (4 * kPi);
  out.black_fraction = merged.black_fraction;
}

}  // namespace penumbra::capture
