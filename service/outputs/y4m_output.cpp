// YUV4MPEG2 on a descriptor, see yuv4mpeg(5). Its frames have no times: the n-th stands at n over
// the rate.
#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cmath>
#include <cstring>
#include <string_view>
#include <utility>
#include <vector>

#include "capture/unique_fd.h"
#include "core/io/log.h"
#include "service/outputs/colour_conversion.h"
#include "service/outputs/frame_output.h"
#include "service/outputs/internal/frame_sink.h"

namespace penumbra::service {

namespace {

// A longer gap is not filled, nor is one backwards: a source that played on elsewhere.
constexpr double kLongestGap_s = 10;

class Y4mSink : public FrameSink {
 public:
  Y4mSink(std::string name, std::string path, FrameRate rate)
      : name_(std::move(name)), path_(std::move(path)), rate_(rate) {}

  Result<void> open_standard_output();
  Result<void> open_path();

  Result<std::string> tend() override;
  Result<bool> put(const FramePixels& pixels, TimestampNs captured,
                   const std::stop_token& stop) override;

 private:
  Result<bool> write_picture(const FramePixels& pixels, TimestampNs captured,
                             const std::stop_token& stop);
  bool is_fifo() const;
  Result<void> begin(const Image<Rgb8>& picture, TimestampNs captured, const std::stop_token& stop);
  Result<std::int64_t> place_of(TimestampNs captured);
  Result<void> write_frame(const std::stop_token& stop);
  Result<void> write(std::string_view bytes, const std::stop_token& stop);

  const std::string name_, path_;
  const FrameRate rate_;
  capture::UniqueFd file_;
  std::size_t most_bytes_ = std::size_t{1} << 20;  // of one write, which then does not block
  bool signal_blocked_ = false;
  int width_ = 0, height_ = 0;
  TimestampNs first_;  // time of place 0
  std::int64_t last_ = -1;
  std::vector<std::uint8_t> planes_;  // of the frame written last
};

Error unwritable(const std::string& name, const char* what, int number) {
  return {ErrorCode::kUnwritable, name, fmt::format("{}: {}", what, std::strerror(number))};
}

Result<void> Y4mSink::open_standard_output() {
  // A descriptor of its own, but of the same open file: others write to that, so it cannot be told
  // not to block. Once poll() lets through, a pipe takes this much without.
  most_bytes_ = PIPE_BUF;
  file_ = capture::UniqueFd(::fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 0));
  if (!file_) return std::unexpected(unwritable(name_, "cannot be used", errno));
  return {};
}

// Leaves file_ empty where a FIFO has no reader yet.
Result<void> Y4mSink::open_path() {
  constexpr int kFlags = O_WRONLY | O_CREAT | O_TRUNC | O_NONBLOCK | O_CLOEXEC;
  file_ = capture::UniqueFd(::open(path_.c_str(), kFlags, 0666));
  if (file_) return {};
  struct stat node {};
  const int e = errno;
  if (e == ENXIO && ::stat(path_.c_str(), &node) == 0 && S_ISFIFO(node.st_mode)) return {};
  return std::unexpected(unwritable(name_, "cannot be opened", e));
}

// For the output's thread alone: the program keeps its own ways with the signal.
void block_pipe_signal() {
  sigset_t pipe;
  sigemptyset(&pipe);
  sigaddset(&pipe, SIGPIPE);
  ::pthread_sigmask(SIG_BLOCK, &pipe, nullptr);
}

Result<std::string> Y4mSink::tend() {
  if (!std::exchange(signal_blocked_, true)) block_pipe_signal();
  if (!file_) PENUMBRA_TRY(open_path());
  return file_ ? std::string() : std::string("waits for a reader of the pipe");
}

bool Y4mSink::is_fifo() const {
  struct stat node {};
  return ::fstat(file_.get(), &node) == 0 && S_ISFIFO(node.st_mode) && path_ != "-";
}

// A reader of a FIFO may go and another one come, for whom the film begins.
Result<bool> Y4mSink::put(const FramePixels& pixels, TimestampNs captured,
                          const std::stop_token& stop) {
  if (!file_) return false;
  auto put = write_picture(pixels, captured, stop);
  if (put || put.error().code != ErrorCode::kClosed || !is_fifo()) return put;
  log_info("{}: its reader has gone: it waits for another one", name_);
  file_ = {};
  last_ = -1;
  return false;
}

Result<bool> Y4mSink::write_picture(const FramePixels& pixels, TimestampNs captured,
                                    const std::stop_token& stop) {
  const DisplayPicture picture(pixels);
  if (last_ < 0) PENUMBRA_TRY(begin(*picture, captured, stop));
  if ((*picture).width() != width_ || (*picture).height() != height_)
    return fail(ErrorCode::kInvalid, name_, "gets frames of different sizes");
  PENUMBRA_ASSIGN(place, place_of(captured));
  if (place <= last_) return false;
  for (; last_ + 1 < place && !stop.stop_requested(); ++last_) PENUMBRA_TRY(write_frame(stop));
  to_yuv420(*picture, planes_);
  PENUMBRA_TRY(write_frame(stop));
  last_ = place;
  return true;
}

Result<void> Y4mSink::begin(const Image<Rgb8>& picture, TimestampNs captured,
                            const std::stop_token& stop) {
  if (picture.empty()) return fail(ErrorCode::kInvalid, name_, "gets an empty picture");
  width_ = picture.width(), height_ = picture.height();
  planes_.resize(yuv420_bytes(width_, height_));
  first_ = captured;
  return write(fmt::format("YUV4MPEG2 W{} H{} F{}:{} Ip A1:1 C420mpeg2 XCOLORRANGE=LIMITED\n",
                           width_, height_, rate_.numerator, rate_.denominator),
               stop);
}

// The place that is nearest to the frame's time.
Result<std::int64_t> Y4mSink::place_of(TimestampNs captured) {
  const double rate_hz = static_cast<double>(rate_.numerator) / rate_.denominator;
  const double since = (captured - first_).count() * rate_hz;
  const double ahead = since - static_cast<double>(last_);
  const double most = kLongestGap_s * rate_hz;
  if (last_ >= 0 && (ahead > most || ahead < -most)) {
    first_ = captured + Seconds(-static_cast<double>(last_ + 1) / rate_hz);
    return last_ + 1;
  }
  return std::llround(since);
}

Result<void> Y4mSink::write_frame(const std::stop_token& stop) {
  PENUMBRA_TRY(write("FRAME\n", stop));
  return write({reinterpret_cast<const char*>(planes_.data()), planes_.size()}, stop);
}

Result<void> Y4mSink::write(std::string_view bytes, const std::stop_token& stop) {
  while (!bytes.empty() && !stop.stop_requested()) {
    pollfd ready{file_.get(), POLLOUT, 0};
    if (::poll(&ready, 1, kPatience_ms) <= 0) continue;
    const ssize_t n = ::write(file_.get(), bytes.data(), std::min(bytes.size(), most_bytes_));
    if (n >= 0)
      bytes.remove_prefix(static_cast<std::size_t>(n));
    else if (errno == EPIPE)
      return fail(ErrorCode::kClosed, name_, "its reader has gone");
    else if (errno != EAGAIN && errno != EINTR)
      return std::unexpected(unwritable(name_, "cannot be written", errno));
  }
  return {};
}

}  // namespace

Result<std::unique_ptr<FrameOutput>> FrameOutput::to_y4m(const std::string& target,
                                                         double rate_hz) {
  const bool standard = target == "-";
  const std::string name = standard ? "standard output" : target;
  PENUMBRA_ASSIGN(rate, FrameRate::from(rate_hz, name));
  auto sink = std::make_unique<Y4mSink>(name, target, rate);
  PENUMBRA_TRY(standard ? sink->open_standard_output() : sink->open_path());
  return std::make_unique<FrameOutput>(name, std::move(sink));
}

}  // namespace penumbra::service
