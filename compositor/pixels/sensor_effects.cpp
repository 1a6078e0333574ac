#include "compositor/pixels/sensor_effects.h"

#include <algorithm>
#include <cmath>

namespace penumbra::compositor {

namespace {

constexpr std::size_t kPlanes = 3;

std::uint64_t mix(std::uint64_t z) {  // SplitMix64, Steele et al. 2014
  z += 0x9e3779b97f4a7c15ull;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return z ^ (z >> 31);
}

}  // namespace

std::vector<float> psf_weights(double sigma_px) {
  if (!(sigma_px > 0)) return {1};
  const double t = sigma_px * sigma_px;
  const int radius = static_cast<int>(std::ceil(3 * sigma_px));
  std::vector<double> weight;
  double sum = 0;
  for (int k = -radius; k <= radius; ++k) {
    weight.push_back(std::exp(-t) * std::cyl_bessel_i(std::abs(k), t));
    sum += weight.back();
  }
  std::vector<float> out;
  for (const double w : weight) out.push_back(static_cast<float>(w / sum));
  return out;
}

std::array<std::uint32_t, 2> noise_key(std::uint64_t frame, int y, int channel) {
  const auto row = static_cast<std::uint64_t>(y) * 4 + static_cast<std::uint64_t>(channel);
  const std::uint64_t bits = mix(mix(frame) + row);
  return {static_cast<std::uint32_t>(bits), static_cast<std::uint32_t>(bits >> 32)};
}

void BlurPlanes::prepare(const Rect& rect, double sigma_px, int frame_width, int frame_height) {
  weights_ = psf_weights(sigma_px);
  radius_ = static_cast<int>(weights_.size() / 2);
  rect_ = rect;
  width_ = frame_width;
  height_ = frame_height;
  area_ = rect.empty() ? Rect{}
                       : Rect{std::max(0, rect.x0 - radius_), std::max(0, rect.y0 - radius_),
                              std::min(frame_width, rect.x1 + radius_),
                              std::min(frame_height, rect.y1 + radius_)};
  stride_ = padded_row(area_.width());
  blurred_.resize(kPlanes * stride_ * static_cast<std::size_t>(rect.height()));
  nothing_.assign(kPlanes * stride_, 0.f);
  filled_.assign(static_cast<std::size_t>(rect.height()), 0);
}

// Across. Within the frame nothing lies beside the rectangle; beyond the frame's edge, where nobody
// looked, its last column goes on.
void BlurPlanes::set_row(int y, const float* in, std::size_t stride) {
  const auto at = static_cast<std::size_t>(y - rect_.y0);
  filled_[at] = 1;
  const auto radius = static_cast<std::size_t>(radius_),
             count = static_cast<std::size_t>(rect_.width()),
             left = radius + static_cast<std::size_t>(rect_.x0 - area_.x0);
  thread_local std::vector<float> padding;  // grows once per thread
  thread_local std::vector<const float*> samples;
  samples.resize(weights_.size());
  for (std::size_t p = 0; p < kPlanes; ++p) {
    const float* const plane = in + p * stride;
    padding.assign(stride_ + 2 * radius, 0.f);
    std::copy_n(plane, count, &padding[left]);
    if (rect_.x0 == 0) std::fill_n(padding.begin(), radius, plane[0]);
    if (rect_.x1 == width_) std::fill_n(padding.data() + left + count, radius, plane[count - 1]);
    for (std::size_t k = 0; k < samples.size(); ++k) samples[k] = &padding[k];
    weighted_sum(samples.data(), weights_.data(), samples.size(), stride_,
                 &blurred_[(at * kPlanes + p) * stride_]);
  }
}

// Down.
bool BlurPlanes::load_row(int y, float* out, std::size_t stride) const {
  if (y < area_.y0 || y >= area_.y1) return false;
  thread_local std::vector<const float*> samples;  // grows once per thread
  samples.assign(weights_.size(), nothing_.data());
  bool any = false;
  for (int k = -radius_; k <= radius_; ++k) {
    int from = y + k;
    if (rect_.y0 == 0) from = std::max(from, 0);
    if (rect_.y1 == height_) from = std::min(from, height_ - 1);
    if (from < rect_.y0 || from >= rect_.y1) continue;
    const auto at = static_cast<std::size_t>(from - rect_.y0);
    if (!filled_[at]) continue;
    samples[static_cast<std::size_t>(k + radius_)] = &blurred_[at * kPlanes * stride_];
    any = true;
  }
  if (!any) return false;
  for (std::size_t p = 0; p < kPlanes; ++p) {
    weighted_sum(samples.data(), weights_.data(), samples.size(), stride_, out + p * stride);
    for (const float*& sample : samples) sample += stride_;
  }
  return true;
}

}  // namespace penumbra::compositor
