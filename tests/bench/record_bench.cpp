// Two 1280x720 cameras into one recording: how many times faster than their 60 frames a second.
#include <array>
#include <filesystem>
#include <random>
#include <span>
#include <thread>

#include "bench/harness.h"
#include "calib/calib.h"
#include "capture/capture.h"
#include "tests/support/temp_folder.h"

namespace penumbra {
namespace {

constexpr int kFrames = 60;  // a camera: one second
constexpr double kRate = 60;

std::shared_ptr<const FramePixels> studio_picture(std::uint64_t seed) {
  auto world = capture::FloorWorld::make(capture::make_room_environment(512, 256));
  capture::StudioOptions options;
  options.environment_width = 64;
  options.environment_height = 32;
  options.world_from_view = capture::look_at({0, 1, 2.5}, {0, .3, 0});
  options.seed = seed;
  capture::Studio studio(*world, options);
  for (;;) {
    auto frame = studio.next();
    if ((*frame)->camera == 1) return (*frame)->pixels;
  }
}

void record_two_cameras(benchmark::State& state) {
  const auto picture = studio_picture(1);
  std::vector<capture::CameraInfo> cameras(2);
  for (std::size_t i = 0; i < 2; ++i) {
    cameras[i].name = i ? "right" : "left";
    cameras[i].projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 1280, 720);
  }
  const std::array codings{capture::Coding::kRgb8, capture::Coding::kRgb8};
  const test::TempFolder folder;
  std::vector<double> seconds;
  double mb = 0;
  for (auto _ : state) {
    const auto path = folder.path() / "a.mkv";
    std::filesystem::remove(path);
    auto writer = capture::RecordingWriter::create(path, cameras, codings, kRate);
    const auto write = [&](int camera) {
      for (std::uint64_t i = 0; i < kFrames; ++i) {
        const capture::Frame frame{
            camera,         i,  TimestampNs{} + Seconds(static_cast<double>(i) / kRate),
            {Seconds(.01)}, {}, picture};
        if (!writer->write(frame)) state.SkipWithError("cannot be written");
      }
    };
    seconds.push_back(1e-3 * bench::time_ms([&] {
                        if (state.range(0) == 1) {
                          write(0);
                          write(1);
                        } else {
                          const std::jthread left([&] { write(0); });
                          write(1);
                        }
                      }));
    state.SetIterationTime(seconds.back());
    mb = static_cast<double>(writer->bytes()) / 1e6;
  }
  state.counters["times_real_time"] = kFrames / kRate / bench::median(seconds);
  state.counters["MB_per_second"] = mb * kRate / kFrames;
}
BENCHMARK(record_two_cameras)->Name("capture/record")->Apply(bench::one_and_two_threads);

// Maps with the noise of cameras into a light track, a second of them; one thread.
void record_light_track(benchmark::State& state) {
  const auto rows = static_cast<int>(state.range(0));
  capture::CameraInfo track;
  track.name = "light";
  track.gives_maps = true;
  track.projection = *calib::make_projection(calib::ProjectionKind::kLatLong, 2 * rows, rows);
  std::vector<capture::Frame> maps;
  std::mt19937 random(1);
  std::normal_distribution<float> noise(1, .02f);
  for (std::uint64_t i = 0; i < 30; ++i) {
    auto map = std::make_shared<Environment>();
    map->radiance = capture::make_room_environment(2 * rows, rows);
    for (Rgb& p : map->radiance.pixels()) p = p * noise(random);
    capture::Frame frame{.camera = 0,
                         .sequence = i,
                         .time = TimestampNs{} + Seconds(static_cast<double>(i) / 30),
                         .exposure = {Seconds(1), Gain(1)},
                         .world_from_camera = {},
                         .pixels = {}};
    frame.map = std::move(map);
    maps.push_back(std::move(frame));
  }
  const test::TempFolder folder;
  const std::array codings{capture::Coding::kMap};
  std::vector<double> ms;
  double bytes = 0;
  for (auto _ : state) {
    const auto path = folder.path() / "a.mkv";
    std::filesystem::remove(path);
    auto writer = capture::RecordingWriter::create(path, {track}, codings, 0);
    const auto head = writer->bytes();
    // The first one makes room: FFV1 clears 78 MB for a packet of 1024 x 512.
    if (!writer->write(maps.front())) state.SkipWithError("cannot be written");
    ms.push_back(bench::time_ms([&] {
      for (const capture::Frame& map : std::span(maps).subspan(1))
        if (!writer->write(map)) state.SkipWithError("cannot be written");
    }));
    state.SetIterationTime(1e-3 * ms.back());
    bytes = static_cast<double>(writer->bytes() - head);
  }
  state.counters["ms_a_map"] = bench::median(ms) / static_cast<double>(maps.size() - 1);
  state.counters["bytes_a_map"] = bytes / static_cast<double>(maps.size());
}
BENCHMARK(record_light_track)
    ->Name("capture/light_track")
    ->ArgName("rows")
    ->Arg(128)
    ->Arg(256)
    ->Arg(512)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra
