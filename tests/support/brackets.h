// Simulated brackets of known radiance.
#pragma once

#include <cmath>
#include <memory>
#include <random>
#include <span>
#include <vector>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/half.h"

namespace penumbra::test {

/// Every channel of every pixel at random, evenly spread in the logarithm.
inline Image<Rgb> log_uniform_radiance(int width, int height, double low, double high,
                                       unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> exponent(std::log(low), std::log(high));
  Image<Rgb> out(width, height);
  for (Rgb& p : out.pixels())
    for (int c = 0; c < 3; ++c) p[c] = static_cast<float>(std::exp(exponent(rng)));
  return out;
}

/// One that sees the whole sphere through this sensor.
inline capture::CameraInfo environment_camera(const capture::Sensor& sensor, int width,
                                              int height) {
  capture::CameraInfo c;
  c.name = "fisheye";
  c.projection = {calib::ProjectionKind::kLatLong, width, height, {}, {}};
  c.response = sensor.response;
  c.noise = sensor.noise;
  c.noise_known = true;
  c.black_level = sensor.black_level;
  return c;
}

inline Rgb radiance_of(const capture::MergedImage& image, std::size_t i) {
  const HalfRgba& p = image.pixels.pixels()[i];
  return image.scale * Rgb{float_from_half(p.r), float_from_half(p.g), float_from_half(p.b)};
}

inline std::vector<Exposure> exposures_of(std::span<const double> times, double gain = 1) {
  std::vector<Exposure> out;
  for (double t : times) out.push_back({Seconds(t), Gain(gain)});
  return out;
}

inline std::shared_ptr<const FramePixels> shot(const capture::Sensor& sensor,
                                               const Image<Rgb>& radiance, Exposure exposure,
                                               std::uint64_t seed) {
  FramePixels pixels;
  capture::expose(sensor, radiance, exposure, seed, pixels);
  return std::make_shared<const FramePixels>(std::move(pixels));
}

inline capture::ExposureStack bracket(const capture::Sensor& sensor, const Image<Rgb>& radiance,
                                      std::span<const Exposure> exposures, std::uint64_t seed) {
  capture::ExposureStack stack;
  stack.response = sensor.response;
  stack.noise = sensor.noise;
  stack.black_level = sensor.black_level;
  for (const Exposure& e : exposures) {
    stack.frames.push_back(shot(sensor, radiance, e, ++seed * 7919));
    stack.exposures.push_back(e);
  }
  return stack;
}

/// Variance of the linear signal y as the sensor delivers it: shot, read, and the step of one code.
inline double signal_variance(const capture::Sensor& s, double y, double gain) {
  const double codes = std::pow(2, s.bits) - 1, at = y + s.black_level, h = .5 / codes;
  const double code = s.response.encode(at, 1);
  const double step =
      s.response.decode(std::min(1., code + h), 1) - s.response.decode(std::max(0., code - h), 1);
  return s.noise.variance(y, gain) + step * step / 12;
}

/// The Cramer-Rao bound of a radiance from every exposure that does not clip it: 1/var = sum
/// e^2/var_k. 0 where an exposure is so near its clip level that chance decides.
inline double radiance_bound(const capture::Sensor& s, std::span<const Exposure> exposures,
                             double x) {
  double information = 0;
  for (const Exposure& e : exposures) {
    const double y = e.product() * x, variance = signal_variance(s, y, e.gain.value());
    const double room = .95 - (y + s.black_level), sigma = std::sqrt(variance);
    if (std::abs(room) < 5 * sigma) return 0;
    if (room > 0) information += e.product() * e.product() / variance;
  }
  return information > 0 ? 1 / information : 0;
}

}  // namespace penumbra::test
