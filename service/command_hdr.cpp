#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>

#include "capture/capture.h"
#include "codec/codec.h"
#include "core/files.h"
#include "service/bracket_files.h"
#include "service/commands.h"
#include "service/report.h"

namespace penumbra::service {

namespace {

Result<calib::Response> find_response(const HdrMergeOptions& o,
                                      const capture::ExposureStack& stack) {
  if (o.response) return calib::parse_response(*o.response);
  if (std::holds_alternative<Image<Rgb>>(*stack.frames[0])) return calib::Response::linear();
  if (!std::holds_alternative<Image<Rgb8>>(*stack.frames[0]))
    return fail(ErrorCode::kUndetermined, o.images[0],
                "the response of 16-bit images is not estimated; give --response");
  const EightBitBracket bracket = eight_bit_bracket(stack);
  auto response = calib::estimate_response(bracket.pictures, bracket.times);
  if (response) spdlog::info("response estimated from the bracket: {}", response->describe());
  return response;
}

}  // namespace

Result<void> hdr_merge(const HdrMergeOptions& o) {
  PENUMBRA_TRY(check_writable(o.output));
  auto stack = read_bracket(o.images, o.times);
  if (!stack) return std::unexpected(stack.error());
  auto response = find_response(o, *stack);
  if (!response) return std::unexpected(response.error());
  stack->response = *response;
  auto merged = capture::merge(*stack);
  if (!merged)
    return fail(merged.error().code, o.images[0] + " and its bracket", merged.error().detail);
  PENUMBRA_TRY(codec::write_hdr(o.output, merged->radiance, codec::Depth::kFloat));
  if (o.json) {
    print_json({{"width", merged->radiance.width()},
                {"height", merged->radiance.height()},
                {"exposures_used", stack->frames.size()},
                {"clipped_fraction", merged->clipped_fraction},
                {"black_fraction", merged->black_fraction}});
  } else {
    fmt::print("{}: {}x{} from {} exposures, {:.3f} % clipped in all, {:.3f} % black in all\n",
               o.output, merged->radiance.width(), merged->radiance.height(), stack->frames.size(),
               100 * merged->clipped_fraction, 100 * merged->black_fraction);
  }
  return {};
}

}  // namespace penumbra::service
