// Frames of a bake as they are done: appended one by one, so that a bake that is killed loses the
// frame under way only.
// threads: thread-bound
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <span>
#include <vector>

#include "core/result.h"

namespace penumbra::prt {

/// A frame's transfer as half floats, stream by stream, and what its bake tells.
struct FrameRecord {
  std::uint32_t frame = 0;  // its position in time
  std::uint64_t rays = 0;
  double seconds = 0;
  double error_variance = 0, mean = 0;  // of t_0, summed over the points that show
  std::uint64_t seen = 0;               // so many
  std::vector<std::uint16_t> values;
};

/// What a journal is of: bakes of another kind are not joined.
struct JournalKey {
  std::uint64_t bake = 0;    // a fingerprint of everything that the result depends on
  std::uint32_t frames = 0;  // positions that one can stand at
  std::uint64_t values = 0;  // in a frame
  friend bool operator==(const JournalKey&, const JournalKey&) = default;
};

class Journal {
 public:
  /// Opens or makes one for adding to; what a kill left half-written is cut off.
  /// errors: kInvalid (of another bake), kUnwritable, kUnreadable
  static Result<Journal> open(const std::filesystem::path& path, const JournalKey& key);
  /// Numbers of the frames that it holds.
  std::span<const std::uint32_t> frames() const { return frames_; }
  /// errors: kUnwritable
  Result<void> add(const FrameRecord& record);

 private:
  std::filesystem::path path_;
  std::ofstream out_;
  std::vector<std::uint32_t> frames_;
};

/// Numbers of the whole frames of a journal, which stays as it is.
/// errors: as read_journal
Result<std::vector<std::uint32_t>> frames_of_journal(const std::filesystem::path& path,
                                                     const JournalKey& key);
/// All whole frames of a journal.
/// errors: kNotFound, kUnreadable, kInvalid (of another bake)
Result<std::vector<FrameRecord>> read_journal(const std::filesystem::path& path,
                                              const JournalKey& key);

}  // namespace penumbra::prt
