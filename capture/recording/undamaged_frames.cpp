#include "capture/recording/undamaged_frames.h"

#include "core/counted.h"
#include "core/io/log.h"

namespace penumbra::capture {

Result<std::unique_ptr<UndamagedFrames>> UndamagedFrames::open(const std::filesystem::path& path,
                                                               RecordedLight light, Seconds from) {
  PENUMBRA_ASSIGN(source, open_capture(path, light, from));
  std::error_code ignored;
  return std::unique_ptr<UndamagedFrames>(new UndamagedFrames(
      std::move(source), path.string(), std::filesystem::is_regular_file(path, ignored)));
}

Result<std::optional<Frame>> UndamagedFrames::next() {
  constexpr std::uint64_t kMaxTogether = 10'000;
  for (std::uint64_t together = 0;; ++together) {
    auto frame = whole_->next();
    if (!is_recording_ || (!frame && frame.error().code != ErrorCode::kUnreadable)) return frame;
    if (frame && !*frame && left_out_ > 1 && !std::exchange(ended_, true) && !quiet_)
      log_warning("{}: frames at {} are left out", name_, counted(left_out_, "damaged place"));
    if (frame || together == kMaxTogether) return frame;
    if (left_out_++ == 0 && !quiet_)
      log_warning("{}: {}; what is whole behind it is taken", frame.error().where,
                  frame.error().detail);
  }
}

}  // namespace penumbra::capture
