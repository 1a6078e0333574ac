// Two 1280x720 cameras into one recording: how many times faster than their 60 frames a second.
#include <filesystem>
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

}  // namespace
}  // namespace penumbra
