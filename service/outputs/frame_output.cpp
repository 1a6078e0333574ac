#include "service/outputs/frame_output.h"

#include <cmath>
#include <exception>
#include <numeric>
#include <utility>

#include "core/exceptions.h"
#include "core/io/log.h"
#include "core/threads/processor_time.h"
#include "service/outputs/internal/frame_sink.h"

namespace penumbra::service {

namespace {

constexpr Seconds kBetweenCares(.1);

}  // namespace

Result<FrameRate> FrameRate::from(double rate_hz, const std::string& output) {
  if (rate_hz == 0) return FrameRate{};
  if (!(rate_hz >= .1 && rate_hz <= 1000))
    return fail(ErrorCode::kInvalid, output, "has a rate that is not 0.1 to 1000 frames a second");
  constexpr int kParts = 1000;
  const int thousandths = static_cast<int>(std::lround(rate_hz * kParts));
  const int common = std::gcd(thousandths, kParts);
  return FrameRate{thousandths / common, kParts / common};
}

FrameOutput::FrameOutput(std::string name, std::unique_ptr<FrameSink> sink)
    : name_(std::move(name)),
      sink_(std::move(sink)),
      thread_([this](const std::stop_token& stop) { run(stop); }) {}

FrameOutput::~FrameOutput() {
  thread_.request_stop();
  newest_.close();
}

void FrameOutput::show(std::shared_ptr<const FramePixels> pixels, TimestampNs captured) {
  if (pixels) newest_.put({std::move(pixels), captured});
}

FrameOutput::OutputCounts FrameOutput::counts() const {
  const std::scoped_lock lock(mutex_);
  return {shown_, newest_.dropped()};
}

std::string FrameOutput::trouble() const {
  const std::scoped_lock lock(mutex_);
  return trouble_;
}

bool FrameOutput::ended() const {
  const std::scoped_lock lock(mutex_);
  return ended_;
}

// Each trouble once, however long it lasts.
void FrameOutput::tell(const std::string& trouble) {
  {
    const std::scoped_lock lock(mutex_);
    if (std::exchange(trouble_, trouble) == trouble) return;
  }
  if (trouble.empty())
    log_info("{}: goes on", name_);
  else
    log_warning("{}: {}", name_, trouble);
}

Result<void> FrameOutput::serve(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    PENUMBRA_ASSIGN(waits_for, sink_->tend());
    tell(waits_for);
    const auto frame = newest_.wait(kBetweenCares);
    if (!frame) continue;
    PENUMBRA_ASSIGN(handed_on, sink_->put(*frame->pixels, frame->captured, stop));
    const std::scoped_lock lock(mutex_);
    shown_ += handed_on;
  }
  return {};
}

void FrameOutput::run(const std::stop_token& stop) {
  const SpendingOn spending(ProcessorUse::kEncoding);
  Result<void> done;
  try {
    done = serve(stop);
  } catch (const std::exception& e) {
    done = fail(ErrorCode::kUnavailable, name_, reason_of(e));
  }
  sink_.reset();
  newest_.close();
  if (done) return;
  {
    const std::scoped_lock lock(mutex_);
    trouble_ = done.error().detail;
    ended_ = true;
  }
  log_warning("{}: {}: this output has ended", done.error().where, done.error().detail);
}

}  // namespace penumbra::service
