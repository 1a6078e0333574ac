#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numeric>
#include <vector>

#include "calib/camera/response_table.h"
#include "calib/camera/vignetting.h"
#include "capture/frames.h"
#include "capture/hdr/merge.h"
#include "capture/studio/sensor.h"
#include "core/normal_quantiles.h"
#include "core/threads/parallel.h"

namespace penumbra::capture {

namespace {

constexpr std::uint64_t kGolden = 0x9e3779b97f4a7c15ull;

std::uint64_t mix(std::uint64_t z) {  // SplitMix64, Steele et al. 2014
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return z ^ (z >> 31);
}

const std::vector<float>& quantiles() {
  static const std::vector<float> table = normal_quantiles(std::size_t{1} << 16);
  return table;
}

// Exact for few photons, where a normal distribution would be skewed wrongly.
double small_poisson(double mean, std::uint64_t state) {
  const double limit = std::exp(-mean);
  double product = 1;
  int count = -1;
  do {
    state += kGolden;
    product *= static_cast<double>((mix(state) >> 11) + 1) * 0x1p-53;
    ++count;
  } while (product > limit);
  return count;
}

struct Exposer {
  const Sensor& sensor;
  const ResponseTable curve;
  float signal_per_radiance, shot_variance, read_variance, electrons;
  std::uint64_t seed;
  const float* normal = quantiles().data();

  /// Few photons, whose noise no normal distribution has.
  static constexpr float kFewPhotons = 30;

  // Signal after noise, in fractions of full scale, without black level, where there are few
  // photons. `bits` are the pixel's, 16 a channel.
  float noisy_in_the_dark(float signal, std::uint64_t bits, int channel) const {
    const float photons = signal * electrons;
    const float read = normal[bits >> (16 * channel) & 0xffff] * std::sqrt(read_variance);
    if (photons <= 0) return signal + read;
    const auto own = mix(bits + static_cast<std::uint64_t>(channel));
    return static_cast<float>(small_poisson(photons, own)) / electrons + read;
  }

  template <class Code>
  Code encode(int channel, float signal) const {
    if constexpr (sizeof(Code) == 1)
      return curve.encode8(channel, signal);
    else
      return static_cast<Code>(
          (curve.encode(channel, signal) * 0xffffu + curve.largest_code() / 2) /
          curve.largest_code());
  }
};

float light_left(const Sensor& sensor, int x, int y, int width, int height) {
  const glm::dvec2 size(width, height);
  const Vignetting v{{-sensor.vignetting, 0, 0}, size / 2., glm::length(size) / 2};
  return static_cast<float>(v.at({x + .5, y + .5}));
}

// One row, in passes that a compiler turns into vectors. Planes of red, green and blue.
struct RowNoise {
  std::vector<std::uint64_t> bits;
  std::vector<float> signal[3], deviate[3];
  void resize(std::size_t width) {
    bits.resize(width);
    for (auto* planes : {&signal, &deviate})
      for (auto& plane : *planes) plane.resize(width);
  }
};

void load_row(const Exposer& e, const Image<Rgb>& radiance, int y, RowNoise& row) {
  const int width = radiance.width();
  for (int x = 0; x < width; ++x) {
    const float kept =
        e.sensor.vignetting > 0 ? light_left(e.sensor, x, y, width, radiance.height()) : 1;
    const Rgb signal = radiance.at(x, y) * (kept * e.signal_per_radiance);
    // Far above full scale the noise cannot matter and floats would lose it anyway.
    for (int c = 0; c < 3; ++c)
      row.signal[c][static_cast<std::size_t>(x)] = std::clamp(signal[c], 0.f, 4.f);
  }
}

void add_noise(const Exposer& e, std::uint64_t first, RowNoise& row) {
  const std::size_t width = row.bits.size();
  for (std::size_t x = 0; x < width; ++x) row.bits[x] = mix((e.seed + first + x) * kGolden);
  for (std::size_t x = 0; x < width; ++x)
    for (std::size_t c = 0; c < 3; ++c)
      row.deviate[c][x] = e.normal[row.bits[x] >> (16 * c) & 0xffff];
  for (std::size_t c = 0; c < 3; ++c) {
    float* const signal = row.signal[c].data();
    float darkest = e.kFewPhotons + 1;
    for (std::size_t x = 0; x < width; ++x) darkest = std::min(darkest, signal[x] * e.electrons);
    if (darkest <= e.kFewPhotons)
      for (std::size_t x = 0; x < width; ++x) {
        if (signal[x] * e.electrons > e.kFewPhotons) continue;
        signal[x] = e.noisy_in_the_dark(signal[x], row.bits[x], static_cast<int>(c));
        row.deviate[c][x] = 0;  // it has its noise
      }
    const float* const deviate = row.deviate[c].data();
    for (std::size_t x = 0; x < width; ++x)
      signal[x] +=
          deviate[x] * std::sqrt(std::max(0.f, e.shot_variance * signal[x] + e.read_variance));
  }
}

template <class Pixel>
void expose_rows(const Exposer& e, const Image<Rgb>& radiance, Image<Pixel>& out) {
  using Code = decltype(out.at(0, 0).r);
  const int width = out.width();
  parallel_for(0, out.height(), 16, [&](const auto& rows) {
    thread_local RowNoise row;  // grows once per thread
    row.resize(static_cast<std::size_t>(width));
    for (int y = rows.begin(); y < rows.end(); ++y) {
      load_row(e, radiance, y, row);
      if (e.sensor.noisy)
        add_noise(e, static_cast<std::uint64_t>(y) * static_cast<std::uint64_t>(width), row);
      for (int x = 0; x < width; ++x) {
        const auto i = static_cast<std::size_t>(x);
        out.at(x, y) = {e.encode<Code>(0, row.signal[0][i]), e.encode<Code>(1, row.signal[1][i]),
                        e.encode<Code>(2, row.signal[2][i])};
      }
    }
  });
}

}  // namespace

// source: discrete Gaussian exp(-t) I_n(t), t = sigma^2, of variance exactly t; Lindeberg 1990
void blur(Image<Rgb>& picture, double sigma_px) {
  if (!(sigma_px > 0)) return;
  const double t = sigma_px * sigma_px;
  const int radius = static_cast<int>(std::ceil(4 * sigma_px));
  std::vector<double> weight;  // from the middle on
  for (int k = 0; k <= radius; ++k) weight.push_back(std::exp(-t) * std::cyl_bessel_i(k, t));
  const double sum = 2 * std::accumulate(weight.begin() + 1, weight.end(), weight[0] / 2);
  const int width = picture.width(), height = picture.height();
  const auto pass = [&](int step_x, int step_y) {
    const Image<Rgb> in = picture;
    parallel_for(0, height, [&](int y) {
      for (int x = 0; x < width; ++x) {
        Rgb mean;
        for (int k = -radius; k <= radius; ++k)
          mean += in.at(std::clamp(x + k * step_x, 0, width - 1),
                        std::clamp(y + k * step_y, 0, height - 1)) *
                  static_cast<float>(weight[static_cast<std::size_t>(std::abs(k))] / sum);
        picture.at(x, y) = mean;
      }
    });
  };
  pass(1, 0);
  pass(0, 1);
}

void expose(const Sensor& sensor, const Image<Rgb>& radiance, Exposure exposure, std::uint64_t seed,
            FramePixels& out) {
  if (sensor.psf_sigma_px > 0) {
    Image<Rgb> blurred = radiance;
    blur(blurred, sensor.psf_sigma_px);
    Sensor sharp = sensor;
    sharp.psf_sigma_px = 0;
    return expose(sharp, blurred, exposure, seed, out);
  }
  const double gain = exposure.gain.value();
  const Exposer e{sensor,
                  make_response_table(sensor.response, sensor.bits, sensor.black_level),
                  static_cast<float>(exposure.product()),
                  static_cast<float>(gain / sensor.noise.full_well_electrons),
                  static_cast<float>(std::pow(gain * sensor.noise.read_noise, 2)),
                  static_cast<float>(sensor.noise.full_well_electrons / gain),
                  mix(seed)};
  const auto into = [&]<class Pixel>(Image<Pixel>*) {
    auto* image = std::get_if<Image<Pixel>>(&out);
    if (image == nullptr || !image->same_size(radiance))
      image = &out.template emplace<Image<Pixel>>(radiance.width(), radiance.height());
    expose_rows(e, radiance, *image);
  };
  if (sensor.bits > 8)
    into(static_cast<Image<Rgb16>*>(nullptr));
  else
    into(static_cast<Image<Rgb8>*>(nullptr));
}

}  // namespace penumbra::capture
