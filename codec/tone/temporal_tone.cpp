#include "codec/tone/temporal_tone.h"

#include <cmath>

namespace penumbra::tone {

TemporalTone::TemporalTone(const ToneOptions& options, Seconds time_constant)
    : options_(options), time_constant_(time_constant) {}

Result<ToneMapped> TemporalTone::map(const Image<Rgb>& radiance, TimestampNs time) {
  const double constant_s = time_constant_.count();
  if (!(constant_s >= 0) || !std::isfinite(constant_s))
    return fail(ErrorCode::kInvalid, "time constant", "is not 0 seconds or above");
  if (adaptation_ && time < time_)
    return fail(ErrorCode::kInvalid, "time of a picture", "lies before that of the last one");
  PENUMBRA_ASSIGN(own, measure_tone(radiance));
  ToneStatistics next = own;
  if (adaptation_ && !adaptation_->black) {
    constexpr double kForgotten = 20;  // constants
    const double step_s = (time - time_).count();
    double part = constant_s > 0 ? -std::expm1(-step_s / constant_s) : 1;
    if (step_s > kForgotten * constant_s) part = 1;
    if (own.black) part = 0;
    next = *adaptation_;
    next.negative = own.negative;
    for (double ToneStatistics::*value : {&ToneStatistics::mean, &ToneStatistics::median,
                                          &ToneStatistics::low, &ToneStatistics::high})
      next.*value += part * (own.*value - next.*value);
  }
  PENUMBRA_ASSIGN(mapped, tone_map(radiance, options_, next));
  adaptation_ = next;
  time_ = time;
  return std::move(mapped);
}

}  // namespace penumbra::tone
