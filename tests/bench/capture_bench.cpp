#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/photo.hpp>
#include <random>

#include "bench/harness.h"
#include "calib/calib.h"
#include "capture/capture.h"
#include "capture/device/internal/exposure_schedule.h"
#include "capture/ring/internal/table_merger.h"
#include "core/conventions.h"
#include "core/half.h"
#include "core/threads/parallel.h"
#include "tests/support/brackets.h"

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
  CameraInfo camera() const { return test::environment_camera(sensor, kWidth, kHeight); }
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
  auto merger = TableMerger::make(b.exposures, b.camera());
  std::vector<TableMerger::MergeSlot> frames;
  std::vector<cv::Mat> mats;
  std::vector<float> times;
  for (std::size_t k = 0; k < b.frames.size(); ++k) {
    frames.push_back({&b.frames[k], b.exposures[k], 0});
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
      state, [&] { merger->update(frames, nullptr, out); },
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

// What a ring of four exposures does with each new 1920x1080 frame, beside streaming once what it
// may have to touch: all frames and the one that was replaced in, half floats out. Over the given
// fraction of the columns something moves.
void ring(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  constexpr int kWidth = 1920, kHeight = 1080, kRounds = 3;
  const int moving = kWidth * static_cast<int>(state.range(1)) / 100;
  const Bracket& b = bracket();
  std::vector<Frame> frames;
  for (std::uint64_t n = 0; n < 4 * kRounds; ++n) {
    Image<Rgb> shown(kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x)
        shown.at(x, y) =
            b.truth.at(x < moving ? (x + static_cast<int>(n) * 60) % kWidth : x, y / 2);
    Frame f;
    f.exposure = b.exposures[n % 4];
    FramePixels pixels;
    expose(b.sensor, shown, f.exposure, n, pixels);
    f.pixels = std::make_shared<const FramePixels>(std::move(pixels));
    frames.push_back(std::move(f));
  }
  HdrRing ring(test::environment_camera(b.sensor, kWidth, kHeight), 8);
  std::uint64_t count = 0;
  const auto add = [&] {
    Frame f = frames[count % frames.size()];
    f.sequence = count++;
    benchmark::DoNotOptimize(ring.add(f));
  };
  constexpr int kRound = 4;  // exposures cost differently: a round is timed as a whole
  for (int n = 0; n < 2 * kRound; ++n) add();
  const std::size_t area = std::size_t{kWidth} * kHeight;
  // Words of eight bytes; as many different ones in turn as the ring gets, so that no cache holds
  // them.
  const std::size_t words = 3 * area / 8;
  std::vector<std::uint64_t> in(frames.size() * words, 1), out(area);
  std::size_t first = 0;
  const auto stream = [&] {
    first = (first + 1) % (frames.size() - 5);
    parallel_for(std::size_t{0}, words, 1 << 13, [&](const auto& range) {
      for (std::size_t i = range.begin(); i < range.end(); ++i) {
        const std::uint64_t* const word = &in[first * words + i];
        const std::uint64_t all =
            word[0] ^ word[words] ^ word[2 * words] ^ word[3 * words] ^ word[4 * words];
        for (std::size_t k = 0; k < 3 && 3 * i + k < area; ++k) out[3 * i + k] = all + k;
      }
    });
    benchmark::ClobberMemory();
  };
  const auto a_round = [](const auto& one) {
    return [&one] {
      for (int n = 0; n < kRound; ++n) one();
    };
  };
  compare(state, a_round(add), a_round(stream));
  state.counters["ours_ms_a_frame"] = state.counters["ours_ms"] / kRound;
  state.counters["peer_ms_a_frame"] = state.counters["peer_ms"] / kRound;
}
BENCHMARK(ring)
    ->Name("capture/ring_round_of_4x1920x1080_vs_streaming")
    ->ArgsProduct({{1, 2}, {0, 10, 100}})
    ->ArgNames({"threads", "moving_percent"})
    ->Iterations(kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

// A head-mounted fisheye of 1280x720 that turns by a degree a frame: the ring with its three older
// exposures turned, and where each pixel of the map lies now.
void turning_camera(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  constexpr int kWidth = 1280, kHeight = 720, kRows = 640;
  const Bracket& b = bracket();
  CameraInfo camera = test::environment_camera(b.sensor, kWidth, kHeight);
  camera.projection = *calib::make_projection(calib::ProjectionKind::kEquidistant, kWidth, kHeight);
  std::vector<Frame> frames;
  for (std::uint64_t n = 0; n < 4; ++n) {
    Image<Rgb> shown(kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) shown.at(x, y) = b.truth.at(x, y);
    Frame f;
    f.exposure = b.exposures[n];
    FramePixels pixels;
    expose(b.sensor, shown, f.exposure, n, pixels);
    f.pixels = std::make_shared<const FramePixels>(std::move(pixels));
    frames.push_back(std::move(f));
  }
  HdrRing ring(camera, 8);
  std::uint64_t count = 0;
  const auto ms = [](auto since) {
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - since)
        .count();
  };
  double ring_ms = 0, map_ms = 0;
  for (auto _ : state) {
    Frame f = frames[count % frames.size()];
    f.world_from_camera.rotation =
        glm::angleAxis(static_cast<double>(count) / 180 * kPi, glm::dvec3(0, 1, 0));
    f.sequence = count++;
    const auto start = std::chrono::steady_clock::now();
    benchmark::DoNotOptimize(ring.add(f));
    ring_ms += ms(start);
    const auto again = std::chrono::steady_clock::now();
    const EnvironmentAssembler assembler(camera.projection, f.world_from_camera, 2 * kRows, kRows);
    benchmark::DoNotOptimize(&assembler);
    map_ms += ms(again);
  }
  state.counters["ring_ms"] = ring_ms / static_cast<double>(count);
  state.counters["map_ms"] = map_ms / static_cast<double>(count);
}
BENCHMARK(turning_camera)
    ->Name("capture/turning_fisheye_1280x720")
    ->Arg(1)
    ->Arg(2)
    ->ArgName("threads")
    ->Iterations(12)
    ->Unit(benchmark::kMillisecond);

// What an automatic schedule looks at in each frame, beside reading the frame once.
void light_histogram(benchmark::State& state) {
  constexpr int kWidth = 1920, kHeight = 1080;
  const Bracket& b = bracket();
  LightHistogram histogram(test::environment_camera(b.sensor, kWidth, kHeight));
  Image<Rgb> shown(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) shown.at(x, y) = b.truth.at(x, y / 2);
  FramePixels frame;
  expose(b.sensor, shown, b.exposures[1], 1, frame);
  const auto& pixels = std::get<Image<Rgb8>>(frame).pixels();
  const auto* const words = reinterpret_cast<const std::uint64_t*>(pixels.data());
  compare(
      state, [&] { histogram.add(frame, b.exposures[1], 4); },
      [&] {
        std::uint64_t sum = 0;
        for (std::size_t i = 0; i < pixels.size() * 3 / 8; ++i) sum += words[i];
        benchmark::DoNotOptimize(sum);
      });
}
BENCHMARK(light_histogram)
    ->Name("capture/light_histogram_1920x1080_vs_streaming")
    ->Iterations(kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

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
