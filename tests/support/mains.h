// A camera whose rows open one after another, under lamps on the mains.
#pragma once

#include <cmath>
#include <vector>

#include "capture/capture.h"
#include "core/conventions.h"
#include "tests/support/brackets.h"

namespace penumbra::test {

struct Mains {
  double frequency_hz = 100, swell = .2;  // of the light, up and down
  double readout_s = .024;                // from the first row to the last
  double fps = 29.7;
  /// Of a row from 0 to 1, in the mean of its exposure.
  double light(std::uint64_t frame, double row, double time_s) const {
    const double opens = static_cast<double>(frame) / fps + row * readout_s,
                 half = kPi * frequency_hz * time_s;
    return 1 + swell * std::sin(half) / half * std::cos(2 * kPi * frequency_hz * opens + half);
  }
};

/// The built-in room in the mean radiance 20, so that .016 s show its walls and .001 s its lamps.
inline Image<Rgb> room_on_mains(int width, int height) {
  Image<Rgb> out = capture::make_room_environment(width, height);
  double sum = 0;
  for (const Rgb& p : out.pixels()) sum += double(luminance(p));
  const auto scale = static_cast<float>(20 / (sum / static_cast<double>(out.area())));
  for (Rgb& p : out.pixels()) p = p * scale;
  return out;
}

/// Frame n of a bracket, with light of this colour.
inline capture::Frame film_on_mains(const capture::Sensor& sensor, const Image<Rgb>& scene,
                                    std::uint64_t n, const std::vector<double>& times_s,
                                    const Mains& mains, Rgb colour = {1, 1, 1}) {
  capture::Frame out;
  out.sequence = n;
  out.time = TimestampNs{} + Seconds(static_cast<double>(n) / mains.fps);
  out.exposure = {Seconds(times_s[n % times_s.size()]), Gain(1)};
  Image<Rgb> lit = scene;
  for (int y = 0; y < lit.height(); ++y) {
    const auto light =
        static_cast<float>(mains.light(n, (y + .5) / lit.height(), out.exposure.time.count()));
    for (int x = 0; x < lit.width(); ++x) lit.at(x, y) = lit.at(x, y) * colour * light;
  }
  out.pixels = shot(sensor, lit, out.exposure, 91 * n + 7);
  return out;
}

/// RMS of the change from one to the next over the mean.
inline double flicker_of(const std::vector<double>& series) {
  double squares = 0, sum = series[0];
  for (std::size_t i = 1; i < series.size(); ++i)
    squares += std::pow(series[i] - series[i - 1], 2), sum += series[i];
  const auto count = static_cast<double>(series.size());
  return std::sqrt(squares / (count - 1)) / (sum / count);
}

}  // namespace penumbra::test
