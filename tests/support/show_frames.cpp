// Shows a moving picture of known colours by one output of the service, for tests with real
// consumers.
// usage: show_frames pipewire|y4m|v4l2 TARGET SECONDS [WIDTH HEIGHT RATE_HZ]
// Prints on standard error what became of the frames; exit status 1 when the output failed.
#include <fmt/format.h>

#include <chrono>
#include <cstdlib>
#include <ctime>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "service/outputs/frame_output.h"
#include "tests/support/moving_bars.h"

namespace penumbra {
namespace {

using Clock = std::chrono::steady_clock;

double cpu_ms() {
  timespec t{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_nsec) * 1e-6;
}

Result<std::unique_ptr<service::FrameOutput>> open_output(const std::string& kind,
                                                          const std::string& target,
                                                          double rate_hz) {
  if (kind == "pipewire")
    return service::FrameOutput::to_pipewire({target, "Frames of a test", rate_hz});
  if (kind == "y4m") return service::FrameOutput::to_y4m(target, rate_hz);
  if (kind == "v4l2") return service::FrameOutput::to_v4l2(target);
  return fail(ErrorCode::kInvalid, kind, "is none of pipewire, y4m and v4l2");
}

int show(const std::vector<std::string>& words) {
  const double seconds = std::atof(words[2].c_str());
  const bool sized = words.size() == 6;
  const int width = sized ? std::atoi(words[3].c_str()) : 1280;
  const int height = sized ? std::atoi(words[4].c_str()) : 720;
  const double rate_hz = sized ? std::atof(words[5].c_str()) : 30;
  auto output = open_output(words[0], words[1], rate_hz);
  if (!output) {
    fmt::print(stderr, "{}: {}\n", output.error().where, output.error().detail);
    return 1;
  }
  constexpr int kPictures = 16;
  std::vector<std::shared_ptr<const FramePixels>> pictures;
  for (int i = 0; i < kPictures; ++i)
    pictures.push_back(std::make_shared<const FramePixels>(test::moving_bars(width, height, i)));
  const double before_ms = cpu_ms();
  double longest_ms = 0;
  const auto start = Clock::now();
  const auto period = std::chrono::duration_cast<Clock::duration>(Seconds(1 / rate_hz));
  int count = 0;
  for (auto due = start; Clock::now() - start < Seconds(seconds); due += period, ++count) {
    std::this_thread::sleep_until(due);
    const auto begun = Clock::now();
    (*output)->show(pictures[static_cast<std::size_t>(count % kPictures)],
                    {begun.time_since_epoch().count()});
    longest_ms = std::max(longest_ms, Seconds(Clock::now() - begun).count() * 1e3);
  }
  std::this_thread::sleep_for(2 * period);
  const auto counts = (*output)->counts();
  const bool ended = (*output)->ended();
  fmt::print(stderr, "offered {} shown {} overtaken {} cpu_ms {:.2f} longest_show_ms {:.3f} {}\n",
             count, counts.shown, counts.overtaken, (cpu_ms() - before_ms) / count, longest_ms,
             (*output)->trouble());
  return ended ? 1 : 0;
}

}  // namespace
}  // namespace penumbra

int main(int count, char** words) {
  if (count != 4 && count != 7) {
    fmt::print(stderr,
               "usage: show_frames pipewire|y4m|v4l2 TARGET SECONDS [WIDTH HEIGHT RATE_HZ]\n");
    return 2;
  }
  return penumbra::show({words + 1, words + count});
}
