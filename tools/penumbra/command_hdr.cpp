#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "capture/hdr/merge.h"
#include "capture/hdr/stacks.h"
#include "codec/codec.h"
#include "core/files.h"
#include "tools/common/bracket_files.h"
#include "tools/penumbra/commands.h"
#include "runtime/pipeline/report.h"

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

bool any_unknown(const capture::ExposureStack& stack) {
  return std::ranges::any_of(stack.exposures,
                             [](const Exposure& e) { return e.time == kUnknownTime; });
}

// The picture that is trusted most, then by how near their exposures are to its own.
void trust(capture::ExposureStack& stack, std::size_t reference) {
  const auto stops = [&](std::size_t k) {
    return std::abs(std::log2(stack.exposures[k].time / stack.exposures[reference].time));
  };
  for (std::size_t k = 0; k < stack.frames.size(); ++k) stack.trust.push_back(k);
  std::ranges::stable_sort(stack.trust, {}, stops);
}

std::size_t middle_exposure(const capture::ExposureStack& stack) {
  std::vector<std::size_t> order(stack.exposures.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, {},
                           [&](std::size_t k) { return stack.exposures[k].time.count(); });
  return order[order.size() / 2];
}

// Says what the pictures themselves tell of their exposures.
Result<void> report_times(capture::ExposureStack& stack, const std::vector<std::string>& images) {
  constexpr double kFarOff = .1;
  constexpr double kEnough = .2;  // of the picture: less may be its border, or haze in a lens
  PENUMBRA_ASSIGN(checked, check_times(stack));
  for (const CheckedTime& c : checked) {
    const std::string by_overlap =
        fmt::format("{:.4g} times {} by their overlap (95 %: {:.4g} to {:.4g}, {} blocks)",
                    c.ratio.ratio, images[c.against], c.ratio.low, c.ratio.high, c.ratio.blocks);
    if (c.told == 0)
      spdlog::info("{}: {}: {:.4g} s", images[c.picture], by_overlap,
                   stack.exposures[c.picture].time.count());
    else if (c.ratio.share > kEnough && std::abs(c.ratio.ratio / c.told - 1) > kFarOff &&
             (c.told < c.ratio.low || c.told > c.ratio.high))
      spdlog::warn("{}: {}, but {:.4g} by the given times", images[c.picture], by_overlap, c.told);
  }
  return {};
}

// A stack of pictures as they were taken, made ready for the merge.
Result<capture::ExposureStack> prepare(const HdrMergeOptions& o) {
  PENUMBRA_ASSIGN(stack, read_bracket(o.images, o.times, true));
  if (o.reference > static_cast<int>(o.images.size()))
    return fail(ErrorCode::kInvalid, "--reference",
                fmt::format("{}, but there are {} pictures", o.reference, o.images.size()));
  stack.noise_known = false;
  if (any_unknown(stack) && !o.response)
    return fail(ErrorCode::kUndetermined, "--times",
                "a time of ? needs --response: curve and ratio cannot both be found");
  std::size_t reference = static_cast<std::size_t>(o.reference - 1);
  if (o.align) {
    if (o.reference == 0) reference = any_unknown(stack) ? 0 : middle_exposure(stack);
    PENUMBRA_ASSIGN(alignment, capture::align_stack(stack, reference));
    for (std::size_t k = 0; k < o.images.size(); ++k)
      if (k != reference)
        spdlog::info("{}: moved by {:.1f} px against {}", o.images[k], alignment.moved_px[k],
                     o.images[reference]);
  }
  PENUMBRA_ASSIGN(response, find_response(o, stack));
  stack.response = response;
  if (std::holds_alternative<Image<Rgb8>>(*stack.frames[0]))
    PENUMBRA_TRY(report_times(stack, o.images));
  else if (any_unknown(stack))
    return fail(ErrorCode::kInvalid, "--times", "? is found from pictures of 8 bits alone");
  if (o.align || o.reference > 0) trust(stack, reference);
  return stack;
}

}  // namespace

Result<void> hdr_merge(const HdrMergeOptions& o) {
  PENUMBRA_TRY(check_writable(o.output));
  auto stack = prepare(o);
  if (!stack) return std::unexpected(stack.error());
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
