#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/photo.hpp>
#include <random>

#include "bench/harness.h"
#include "capture/capture.h"
#include "core/conventions.h"
#include "core/half.h"

namespace penumbra::bench {
namespace {

using namespace penumbra::capture;

// Four 8-bit sRGB exposures, two stops apart, of a smooth scene of wide range with sensor noise.
struct Bracket {
  static constexpr int kWidth = 2048, kHeight = 1024;
  Image<Rgb> truth{kWidth, kHeight};
  std::vector<Image<Rgb8>> frames;
  std::vector<Exposure> exposures;
  Sensor sensor;

  Bracket() {
    sensor.response = calib::Response::srgb();
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        const double e =
            5.5 * (.5 + .25 * std::sin(x * .013) + .25 * std::cos(y * .021 + x * .002));
        const auto v = static_cast<float>(std::exp2(e) * .6);
        truth.at(x, y) = {v, v * .8f, v * .6f};
      }
    for (int k = 0; k < 4; ++k) {
      exposures.push_back({Seconds(.25 * std::pow(.25, k)), Gain(1)});
      FramePixels pixels;
      expose(sensor, truth, exposures.back(), static_cast<std::uint64_t>(k) + 1, pixels);
      frames.push_back(std::get<Image<Rgb8>>(pixels));
    }
  }
};
const Bracket& bracket() {
  static const Bracket b;
  return b;
}

// Root mean square of the relative error against the truth, over all pixels.
double relative_error(const Image<Rgb>& truth, auto radiance_at) {
  double square = 0;
  for (std::size_t i = 0; i < truth.area(); ++i)
    for (int c = 0; c < 3; ++c) square += std::pow(radiance_at(i, c) / truth.pixels()[i][c] - 1, 2);
  return std::sqrt(square / (3. * static_cast<double>(truth.area())));
}

void merge_against(benchmark::State& state, bool robertson) {
  const Threads threads(static_cast<int>(state.range(0)));
  const Bracket& b = bracket();
  const auto merger = TableMerger::make(b.exposures, b.sensor.response, b.sensor.noise, 0);
  std::vector<const Image<Rgb8>*> frames;
  std::vector<cv::Mat> mats;
  std::vector<float> times;
  for (std::size_t k = 0; k < b.frames.size(); ++k) {
    frames.push_back(&b.frames[k]);
    mats.emplace_back(Bracket::kHeight, Bracket::kWidth, CV_8UC3,
                      const_cast<Rgb8*>(b.frames[k].pixels().data()));
    times.push_back(static_cast<float>(b.exposures[k].time.count()));
  }
  cv::Mat response(256, 1, CV_32FC3), hdr;
  for (int z = 0; z < 256; ++z) {
    const auto v = static_cast<float>(std::max(1e-6, b.sensor.response.decode(z / 255., 0)));
    response.at<cv::Vec3f>(z) = {v, v, v};
  }
  const auto debevec = cv::createMergeDebevec();
  const auto merge_robertson = cv::createMergeRobertson();
  MergedImage out;
  compare(
      state, [&] { merger->merge(frames, out); },
      [&] {
        if (robertson)
          merge_robertson->process(mats, hdr, times, response);
        else
          debevec->process(mats, hdr, times, response);
      });
  // Accuracy over all pixels beside the speed: against the full maximum-likelihood merge.
  ExposureStack stack{{}, b.exposures, b.sensor.response, b.sensor.noise, 0};
  for (const auto& f : b.frames) stack.frames.push_back(std::make_shared<const FramePixels>(f));
  const auto full = merge(stack);
  const double ours = relative_error(b.truth, [&](std::size_t i, int c) {
    const HalfRgba& p = out.pixels.pixels()[i];
    return static_cast<double>(float_from_half(c == 0   ? p.r
                                               : c == 1 ? p.g
                                                        : p.b)) *
           double(out.scale);
  });
  const double best = relative_error(
      b.truth, [&](std::size_t i, int c) { return double(full->radiance.pixels()[i][c]); });
  double scale = 0, count = 0;  // OpenCV's unit is arbitrary
  for (std::size_t i = 0; i < b.truth.area(); i += 97, ++count)
    scale += b.truth.pixels()[i].g /
             std::max(1e-9f,
                      hdr.at<cv::Vec3f>(static_cast<int>(i / 2048), static_cast<int>(i % 2048))[1]);
  scale /= count;
  const double peer = relative_error(b.truth, [&](std::size_t i, int c) {
    return scale *
           double(hdr.at<cv::Vec3f>(static_cast<int>(i / 2048), static_cast<int>(i % 2048))[c]);
  });
  state.counters["rmse_ours"] = ours;
  state.counters["rmse_over_ml"] = ours / best;
  state.counters["rmse_peer"] = peer;
}

void merge_debevec(benchmark::State& state) {
  merge_against(state, false);
}
void merge_robertson(benchmark::State& state) {
  merge_against(state, true);
}
BENCHMARK(merge_debevec)
    ->Name("capture/merge_4x2048x1024_vs_opencv_debevec")
    ->Apply(one_and_two_threads);
BENCHMARK(merge_robertson)
    ->Name("capture/merge_4x2048x1024_vs_opencv_robertson")
    ->Apply(one_and_two_threads);

// A 180-degree fisheye of 1536 pixels across into a 2048x1024 environment.
void warp(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  const auto type = static_cast<int>(state.range(1));  // of the peer's pixels
  constexpr int kSource = 1536;
  const auto projection =
      *calib::make_projection(calib::ProjectionKind::kEquidistant, kSource, kSource);
  EnvironmentAssembler assembler(projection, {}, 2048, 1024);
  MergedImage merged;
  merged.pixels = Image<HalfRgba>(kSource, kSource, {0x3c00, 0x3800, 0x3400, kHalfOne});
  Environment environment;
  cv::Mat map_x(1024, 2048, CV_32F), map_y(1024, 2048, CV_32F), fixed, fraction, warped;
  for (int y = 0; y < 1024; ++y)
    for (int x = 0; x < 2048; ++x) {
      const auto p =
          calib::pixel_from_direction(projection, latlong_direction(x + .5, y + .5, 2048, 1024));
      map_x.at<float>(y, x) = p ? static_cast<float>(p->x - .5) : -10.f;
      map_y.at<float>(y, x) = p ? static_cast<float>(p->y - .5) : -10.f;
    }
  cv::convertMaps(map_x, map_y, fixed, fraction, CV_16SC2);
  const cv::Mat source(kSource, kSource, type, cv::Scalar(9, 8, 7));
  compare(
      state, [&] { assembler.assemble(merged, environment); },
      [&] { cv::remap(source, warped, fixed, fraction, cv::INTER_LINEAR, cv::BORDER_CONSTANT); });
}
BENCHMARK(warp)
    ->Name("capture/warp_fisheye_to_2048x1024_vs_opencv_remap")
    ->ArgNames({"threads", "cv_type"})
    ->Args({1, CV_8UC3})
    ->Args({2, CV_8UC3})
    ->Args({1, CV_16UC4})  // 8 bytes a pixel, as ours
    ->Args({2, CV_16UC4})
    ->Args({1, CV_32FC3})
    ->Args({2, CV_32FC3})
    ->Iterations(kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
