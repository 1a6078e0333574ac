// Pictures of a board by a camera of 1280 x 720: found near the last place, and in all of it.
#include <glm/gtc/quaternion.hpp>
#include <string>
#include <vector>

#include "bench/harness.h"
#include "calib/calib.h"
#include "calib/track/board_tracker.h"
#include "tests/support/board_pictures.h"

namespace penumbra::bench {
namespace {

void track(benchmark::State& state, const char* text, calib::ProjectionKind kind) {
  calib::CameraModel lens = *calib::make_projection(kind, 1280, 720);
  lens.focal_px = {900, 900};
  const calib::Board board = *calib::parse_board(text);
  const Pose floor = calib::world_from_flat_board(board, calib::BoardOrigin::kMiddle);
  const test::DrawnBoard drawn = test::draw_board(board, floor);
  const test::BoardPainter painter(lens);
  constexpr int kPictures = 12;
  std::vector<FramePixels> pictures;
  for (int i = 0; i < kPictures; ++i)
    pictures.push_back(painter.paint(
        {drawn}, test::looking_at({.004 * i, .55, .42}, {0, 0, 0}),
        {.blur_px = .6, .noise = 2, .covered = {}, .seed = static_cast<unsigned>(i)}));
  std::vector<double> near, searched;
  for (auto _ : state)
    for (int round = 0; round < kRepeats; ++round) {
      auto tracker = calib::BoardTracker::create({{board, floor}}, lens);
      for (int i = 0; i < kPictures; ++i) {
        bool whole = false;
        const double ms = time_ms([&] {
          const auto pose = tracker->track(pictures[static_cast<std::size_t>(i)],
                                           TimestampNs{33'000'000LL * (i + 1)});
          whole = !pose || pose->searched;
        });
        (whole ? searched : near).push_back(ms);
      }
    }
  state.counters["near_ms"] = near.empty() ? 0 : median(near);
  state.counters["searched_ms"] = searched.empty() ? 0 : median(searched);
}

BENCHMARK_CAPTURE(track, charuco_pinhole, "charuco:8x6:0.03:0.022", calib::ProjectionKind::kPinhole)
    ->Iterations(1)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(track, charuco_kb4, "charuco:8x6:0.03:0.022",
                  calib::ProjectionKind::kKannalaBrandt)
    ->Iterations(1)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(track, apriltag_pinhole, "apriltag:5x4:0.036:0.012",
                  calib::ProjectionKind::kPinhole)
    ->Iterations(1)
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
