// What the virtual USB camera looks at, known to the device on the host and to the tests in the
// guest.
#pragma once

#include "capture/capture.h"
#include "core/conventions.h"

namespace penumbra::test {

inline constexpr int kUvcWidth = 320, kUvcHeight = 240;  // emulation is slow
inline constexpr double kUvcUnitGain = 16;

/// The built-in room, mean radiance 20 full scales a second.
inline Image<Rgb> uvc_scene() {
  Image<Rgb> room = capture::make_room_environment(kUvcWidth, kUvcHeight);
  double sum = 0;
  for (const Rgb& p : room.pixels()) sum += luminance(p);
  const auto scale = static_cast<float>(20 * static_cast<double>(room.area()) / sum);
  for (Rgb& p : room.pixels()) p = p * scale;
  return room;
}

/// Values of the device's sharpness control, which picks what goes wrong.
enum UvcFault {
  kNoFault,
  kIgnoresExposure,
  kThreeFramesLate,
  kDropsEveryFifth,  // without a word
  kTruncatesEverySeventh,
  kOneProtocolError,
  kUnplugsForASecond,
  kUvcFaults,
};

}  // namespace penumbra::test
