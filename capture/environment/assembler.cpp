#include <algorithm>
#include <atomic>
#include <cmath>

#include "capture/camera_regions.h"
#include "capture/environment/assembler.h"
#include "capture/environment/internal/gather_kernel.h"
#include "capture/frames.h"
#include "capture/hdr/merge.h"
#include "capture/warp_grid.h"
#include "core/conventions.h"
#include "core/threads/parallel.h"

namespace penumbra::capture {

static_assert(sizeof(HalfRgba) == 8);

namespace {

constexpr int kRowsAtOnce = 16;

bool is_identity_latlong(const calib::CameraModel& p, const Pose& pose, int width, int height) {
  return p.kind == calib::ProjectionKind::kLatLong && p.width == width && p.height == height &&
         std::abs(std::abs(pose.rotation.w) - 1) < 1e-9;
}

void carry_colour(const glm::mat3& colour, std::span<Rgb> row) {
  for (Rgb& p : row) {
    const glm::vec3 v = colour * glm::vec3(p.r, p.g, p.b);
    p = {v.r, v.g, v.b};
  }
}

}  // namespace

EnvironmentAssembler::EnvironmentAssembler(const CameraRegion& region,
                                           const Pose& world_from_camera, int width, int height,
                                           const glm::dmat3& colour)
    : colour_(colour),
      source_width_(region.width),
      source_height_(region.height),
      width_(width),
      height_(height),
      seen_(static_cast<std::size_t>(height)),
      alpha_(static_cast<std::size_t>(height)) {
  if (region.projection && !region.vignetted &&
      is_identity_latlong(*region.projection, world_from_camera, width, height))
    std::ranges::fill(seen_, width);
  else
    make_samples(region.find_pixel, glm::conjugate(world_from_camera.rotation));
}

EnvironmentAssembler::EnvironmentAssembler(const calib::CameraModel& projection,
                                           const Pose& world_from_camera, int width, int height,
                                           const glm::dmat3& colour)
    : EnvironmentAssembler(plain_region(projection), world_from_camera, width, height, colour) {}

void EnvironmentAssembler::make_samples(const PixelLookup& find_pixel,
                                        const glm::dquat& camera_from_world) {
  samples_.assign(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_), {-1, 0, 0});
  std::vector<float> gains(samples_.size(), 1.f);
  std::atomic<bool> vignetted = false;
  const auto where = [&](const glm::dvec2& px) {
    return find_pixel(camera_from_world * latlong_direction(px.x, px.y, width_, height_));
  };
  warp_grid(width_, height_, where, [&](int x, int y, const PixelHit* seen) {
    if (!seen) return;
    const auto i = static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
                   static_cast<std::size_t>(x);
    gains[i] = static_cast<float>(1 / seen->light_left);
    if (seen->light_left != 1) vignetted = true;
    // From pixel centres; the border repeats its last pixel.
    const double px = std::clamp(seen->px.x - .5, 0., source_width_ - 1.);
    const double py = std::clamp(seen->px.y - .5, 0., source_height_ - 1.);
    const int ix = std::min(static_cast<int>(px), source_width_ - 2);
    const int iy = std::min(static_cast<int>(py), source_height_ - 2);
    samples_[i] = {iy * source_width_ + ix, static_cast<float>(px - ix),
                   static_cast<float>(py - iy)};
  });
  if (vignetted) gains_ = std::move(gains);
  list_seen();
}

void EnvironmentAssembler::list_seen() {
  const GatherSample* sample = samples_.data();
  for (int y = 0; y < height_; ++y) {
    ColumnSpan span{width_, 0};
    for (int x = 0; x < width_; ++x, ++sample) {
      if (sample->offset < 0) {
        complete_ = false;
        continue;
      }
      span = {std::min(span.first, x), x + 1};
      ++seen_[static_cast<std::size_t>(y)];
    }
    spans_.push_back({std::min(span.first, span.last), span.last});
  }
}

EnvironmentAssembler::~EnvironmentAssembler() = default;
EnvironmentAssembler::EnvironmentAssembler(EnvironmentAssembler&&) noexcept = default;
EnvironmentAssembler& EnvironmentAssembler::operator=(EnvironmentAssembler&&) noexcept = default;

// What is not seen stays black from the allocation on.
void EnvironmentAssembler::gather_rows(int first_row, int last_row, const std::uint16_t* source,
                                       float scale, Image<Rgb>& out) {
  for (int y = first_row; y < last_row; ++y) {
    const auto row = static_cast<std::size_t>(y);
    const auto& [first, last] = spans_[row];
    alpha_[row] = 0;
    if (first >= last) continue;
    alpha_[row] = double(gather_row(
        source, source_width_,
        &samples_[row * static_cast<std::size_t>(width_) + static_cast<std::size_t>(first)],
        last - first, scale, &out.row(y)[static_cast<std::size_t>(first)].r));
  }
}

// Only rows that lack confidence are looked at: without clipping their sums are exact.
void EnvironmentAssembler::list_clipped(const Image<HalfRgba>& source,
                                        std::vector<std::uint32_t>& out) const {
  out.clear();
  const auto width = static_cast<std::size_t>(width_);
  const HalfRgba* const pixels = source.pixels().data();
  const auto takes_part = [&](const GatherSample& sample) {
    if (sample.offset < 0) return false;
    const HalfRgba *const upper = pixels + sample.offset, *const lower = upper + source_width_;
    const auto in_row = [&](const HalfRgba* p) {
      return (sample.right < 1 && p[0].a == 0) || (sample.right > 0 && p[1].a == 0);
    };
    return (sample.down < 1 && in_row(upper)) || (sample.down > 0 && in_row(lower));
  };
  for (std::size_t y = 0; y < seen_.size(); ++y) {
    if (alpha_[y] == seen_[y]) continue;
    for (std::size_t i = y * width; i < (y + 1) * width; ++i)
      if (samples_.empty() ? pixels[i].a == 0 : takes_part(samples_[i]))
        out.push_back(static_cast<std::uint32_t>(i));
  }
}

void EnvironmentAssembler::assemble(const MergedImage& merged, Environment& out) {
  if (out.radiance.width() != width_ || out.radiance.height() != height_) {
    out.radiance = Image<Rgb>(width_, height_);
    out.confidence = {};
    if (!complete_) {
      out.confidence = Image<float>(width_, height_);
      for (std::size_t i = 0; i < samples_.size(); ++i)
        out.confidence.pixels()[i] = samples_[i].offset < 0 ? 0.f : 1.f;
    }
  }
  const auto* source = &merged.pixels.pixels()[0].r;
  parallel_for(0, height_, kRowsAtOnce, [&](const auto& rows) {
    if (samples_.empty()) {
      for (int y = rows.begin(); y < rows.end(); ++y)
        alpha_[static_cast<std::size_t>(y)] =
            double(convert_row(source + 4 * static_cast<std::ptrdiff_t>(y) * width_, width_,
                               merged.scale, &out.radiance.row(y)[0].r));
    } else {
      gather_rows(rows.begin(), rows.end(), source, merged.scale, out.radiance);
    }
    for (int y = rows.begin(); y < rows.end() && !gains_.empty(); ++y) {
      const float* gain = &gains_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_)];
      for (Rgb& p : out.radiance.row(y)) p = p * *gain++;
    }
    if (colour_ != glm::mat3(1))
      for (int y = rows.begin(); y < rows.end(); ++y) carry_colour(colour_, out.radiance.row(y));
  });
  double total = 0;
  for (int y = 0; y < height_; ++y) {
    const auto row = static_cast<std::size_t>(y);
    total += std::max(0., seen_[row] - alpha_[row]) * latlong_solid_angle(y, width_, height_);
  }
  out.clipped_fraction = total / (4 * kPi);
  list_clipped(merged.pixels, out.clipped);
  out.black_fraction = merged.black_fraction;
}

}  // namespace penumbra::capture
