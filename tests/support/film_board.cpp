// Films a printed board with a simulated webcam in the hand: film_board FILE.mkv
#include <cstdio>
#include <vector>

#include "calib/calib.h"
#include "calib/track/board_tracker.h"
#include "capture/recording/recording.h"
#include "tests/support/board_pictures.h"

int main(int argc, char** argv) {
  using namespace penumbra;
  constexpr int kFrames = 60;
  constexpr double kFps = 30;
  if (argc != 2) return 2;
  const auto board = calib::parse_board("charuco:8x6:0.03:0.022");
  const auto drawn =
      test::draw_board(*board, calib::world_from_flat_board(*board, calib::BoardOrigin::kMiddle));
  capture::CameraInfo webcam;
  webcam.name = "webcam";
  webcam.role = capture::Role::kView;
  webcam.projection = {calib::ProjectionKind::kPinhole, 640, 480, {520, 520}, {323, 236},
                       {-.18, .05, .001, 0, 0}};
  webcam.response = calib::Response::srgb();
  const std::vector codings{capture::Coding::kRgb8};
  auto writer = capture::RecordingWriter::create(argv[1], {webcam}, codings, kFps);
  const test::BoardPainter painter(webcam.projection);
  for (int i = 0; writer && i < kFrames; ++i) {
    const double t = i / kFps;
    test::PictureFaults faults;
    faults.seed = static_cast<unsigned>(i);
    capture::Frame frame;
    frame.sequence = static_cast<std::uint64_t>(i);
    frame.exposure = {Seconds(1), Gain(1)};
    frame.time = TimestampNs{7'000'000'000} + Seconds(t);
    // There and back, so that it plays in a loop without a jump.
    const double there = .1 * std::sin(3.14159265 * t);
    frame.pixels = std::make_shared<FramePixels>(
        painter.paint({drawn}, test::looking_at({there, .42, .36}, {0, .01, 0}), faults));
    if (const auto written = writer->write(frame); !written) {
      std::fprintf(stderr, "%s: %s\n", argv[1], written.error().detail.c_str());
      return 1;
    }
  }
  if (!writer || !writer->finish()) return 1;
  return 0;
}
