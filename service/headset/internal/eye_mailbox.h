// Pictures on their way to the session's thread: the two eyes of one capture time, the newest wins.
// threads: thread-safe
#pragma once

#include <array>
#include <cstdint>
#include <mutex>
#include <optional>

#include "service/headset/headset.h"

namespace penumbra::service {

/// Left and right, of one capture time.
using EyePair = std::array<EyePicture, 2>;

/// Whether a picture can be shown: finite, a rotation of unit length, pixels of the camera's size.
/// errors: kInvalid, kNonFinite, naming the camera's part
Result<void> check_picture(int eye, const EyePicture& picture);

class EyeMailbox {
 public:
  /// eye: as Headset::show()
  void put(int eye, EyePicture picture);
  /// The newest pair; never waits.
  std::optional<EyePair> take();

  struct EyeCounts {
    std::uint64_t overtaken = 0, unmatched = 0;
  };
  EyeCounts counts() const;

 private:
  void make_ready(EyePicture left, EyePicture right);

  mutable std::mutex mutex_;
  std::array<std::optional<EyePicture>, 2> waiting_;  // for the other eye; guarded, as all below
  std::optional<EyePair> ready_;
  EyeCounts counts_;
};

}  // namespace penumbra::service
