#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "calib/camera/response.h"
#include "calib/estimate/estimate_response.h"
#include "capture/hdr/merge.h"
#include "capture/hdr/stacks.h"
#include "codec/codec.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "runtime/pipeline/report.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/penumbra/commands.h"
#include "tools/pictures/bracket_files.h"

namespace penumbra::tools {

namespace {

struct HdrMergeOptions {
  std::vector<std::string> images;
  std::string times;                    // seconds, separated by commas
  std::optional<std::string> response;  // estimated from the bracket when absent
  bool align = false;
  // Picture that is trusted most, from 1; 0: none, or with `align` the middle one
  int reference = 0;
  std::string output;
  bool json = false;
};

Result<calib::Response> find_response(const HdrMergeOptions& o,
                                      const capture::ExposureStack& stack) {
  if (o.response) return calib::parse_response(*o.response);
  if (std::holds_alternative<Image<Rgb>>(*stack.frames[0])) return calib::Response::linear();
  if (!std::holds_alternative<Image<Rgb8>>(*stack.frames[0]))
    return fail(ErrorCode::kUndetermined, o.images[0],
                "has 16 bits, for which the response is not estimated: give --response");
  const EightBitBracket bracket = eight_bit_bracket(stack);
  auto response = calib::estimate_response(bracket.pictures, bracket.times);
  if (response) log_info("response estimated from the bracket: {}", response->describe());
  return response;
}

bool any_unknown(const capture::ExposureStack& stack) {
  return std::ranges::any_of(stack.exposures,
                             [](const Exposure& e) { return e.time == kUnknownTime; });
}

// The picture that is trusted most, then by how near their exposures are to its own.
void priority(capture::ExposureStack& stack, std::size_t reference) {
  const auto stops = [&](std::size_t k) {
    return std::abs(std::log2(stack.exposures[k].time / stack.exposures[reference].time));
  };
  for (std::size_t k = 0; k < stack.frames.size(); ++k) stack.priority.push_back(k);
  std::ranges::stable_sort(stack.priority, {}, stops);
}

std::size_t middle_exposure(const capture::ExposureStack& stack) {
  std::vector<std::size_t> order(stack.exposures.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, {},
                           [&](std::size_t k) { return stack.exposures[k].time.count(); });
  return order[order.size() / 2];
}

// Says what the pictures themselves tell of their exposures.
Result<std::vector<CheckedTime>> report_times(const HdrMergeOptions& o,
                                              capture::ExposureStack& stack) {
  constexpr double kEnough = .2;  // of the picture
  const std::vector<std::string>& images = o.images;
  const bool linear = std::holds_alternative<Image<Rgb>>(*stack.frames[0]);
  PENUMBRA_ASSIGN(checked,
                  check_times(stack, o.response || linear ? 0 : capture::kEstimatedExponentSigma));
  for (const CheckedTime& c : checked) {
    const std::string by_overlap = fmt::format(
        "{:.4g} times the exposure of {}, by their overlap (95 % within {:.4g} to {:.4g}, {} "
        "blocks)",
        c.ratio.ratio, images[c.against], c.ratio.low, c.ratio.high, c.ratio.blocks);
    if (c.labelled_ratio == 0)
      log_info("{}: {}: {:.4g} s", images[c.picture], by_overlap,
               stack.exposures[c.picture].time.count());
    else if (c.contradicts_label(kEnough))
      log_warning("{}: {}, but {:.4g} by the given times", images[c.picture], by_overlap,
                  c.labelled_ratio);
  }
  for (std::size_t k = 0; k < images.size(); ++k)
    if (images.size() > 1 && std::ranges::none_of(checked, [&](const CheckedTime& c) {
          return c.picture == k || c.against == k;
        }))
      log_info(
          "{}: no other picture exposes well what it does: nothing tells whether its time is right",
          images[k]);
  return checked;
}

// Nobody asked what moved, and all pictures count everywhere.
void warn_of_motion(const HdrMergeOptions& o, const std::vector<CheckedTime>& checked) {
  constexpr double kVisible = .005;
  const auto worst = std::ranges::max_element(
      checked, {}, [](const CheckedTime& c) { return c.ratio.moved_fraction; });
  if (worst == checked.end() || worst->ratio.moved_fraction < kVisible) return;
  log_warning(
      "{} and {}: {:.1f} % of what both expose well is not the same: something moved, or the "
      "camera did; --reference NUMBER leaves out what moved, --align also brings the pictures "
      "together",
      o.images[worst->against], o.images[worst->picture], 100 * worst->ratio.moved_fraction);
}

struct ReadyStack {
  capture::ExposureStack stack;
  std::vector<CheckedTime> checked;
};

// A stack of pictures as they were taken, made ready for the merge.
Result<ReadyStack> prepare(const HdrMergeOptions& o) {
  PENUMBRA_ASSIGN(stack, read_bracket(o.images, o.times, true));
  if (o.reference > static_cast<int>(o.images.size()))
    return fail(ErrorCode::kInvalid, "--reference",
                fmt::format("{} is not the number of a picture: there are {} pictures", o.reference,
                            o.images.size()));
  stack.noise_known = false;
  if (any_unknown(stack) && !o.response)
    return fail(ErrorCode::kUndetermined, "--times",
                "a time of ? needs --response: the response and the time cannot both be estimated");
  std::size_t reference = static_cast<std::size_t>(o.reference - 1);
  if (o.align) {
    if (o.reference == 0) reference = any_unknown(stack) ? 0 : middle_exposure(stack);
    PENUMBRA_ASSIGN(alignment, capture::align_stack(stack, reference));
    for (std::size_t k = 0; k < o.images.size(); ++k)
      if (k != reference)
        log_info("{}: moved by {:.1f} px against {}", o.images[k], alignment.moved_px[k],
                 o.images[reference]);
  }
  // Curve and ratios come from what is the same in all pictures, also where nobody aligns them.
  // With a reference somebody has looked: what differs is left out there.
  const bool unasked = !o.align && o.reference == 0;
  auto common = unasked ? common_part(stack) : std::nullopt;
  capture::ExposureStack& told = common ? common->stack : stack;
  PENUMBRA_ASSIGN(response, find_response(o, told));
  stack.response = told.response = response;
  if (!o.response)
    stack.first_code = calib::kFirstReliableCode, stack.last_code = calib::kLastReliableCode;
  PENUMBRA_ASSIGN(checked, report_times(o, told));
  stack.exposures = told.exposures;
  if (common)
    log_warning("{} and {}: the camera moved by about {:.0f} px; --align brings them together",
                o.images[common->moved.against], o.images[common->moved.picture],
                common->moved.moved_px);
  else if (unasked)
    warn_of_motion(o, checked);
  if (o.align || o.reference > 0) priority(stack, reference);
  return ReadyStack{std::move(stack), std::move(checked)};
}

nlohmann::json to_json(const ReadyStack& ready, const std::vector<std::string>& images) {
  nlohmann::json out = nlohmann::json::array();
  for (const CheckedTime& c : ready.checked)
    out.push_back({{"picture", images[c.picture]},
                   {"against", images[c.against]},
                   {"ratio", c.ratio.ratio},
                   {"low", c.ratio.low},
                   {"high", c.ratio.high},
                   {"blocks", c.ratio.blocks},
                   {"moved_fraction", c.ratio.moved_fraction},
                   {"labelled_ratio",
                    c.labelled_ratio > 0 ? nlohmann::json(c.labelled_ratio) : nlohmann::json()}});
  return out;
}

}  // namespace

Result<void> hdr_merge(const HdrMergeOptions& o) {
  PENUMBRA_TRY(check_writable(o.output));
  PENUMBRA_ASSIGN(ready, prepare(o));
  const capture::ExposureStack& stack = ready.stack;
  auto merged = capture::merge(stack);
  if (!merged)
    return fail(merged.error().code, o.images[0] + " and its bracket", merged.error().detail);
  PENUMBRA_TRY(codec::write_hdr(o.output, merged->radiance, codec::Depth::kFloat));
  if (o.json) {
    print_json({{"width", merged->radiance.width()},
                {"height", merged->radiance.height()},
                {"exposures_used", stack.frames.size()},
                {"exposure_ratios", to_json(ready, o.images)},
                {"clipped_fraction", merged->clipped_fraction},
                {"black_fraction", merged->black_fraction}});
  } else {
    fmt::print("{}: {}x{} from {} exposures, {:.3f} % clipped in all, {:.3f} % black in all\n",
               o.output, merged->radiance.width(), merged->radiance.height(), stack.frames.size(),
               100 * merged->clipped_fraction, 100 * merged->black_fraction);
  }
  return {};
}

void add_hdr_merge(CLI::App& parent, Action& action) {
  static HdrMergeOptions merge;
  auto* c = parent.add_subcommand("merge", "Merge a bracket of exposures into one HDR picture");
  c->add_option(
       "images", merge.images,
       "Pictures of the bracket: 8-bit or 16-bit PNG, JPEG or TIFF, or linear OpenEXR or Radiance "
       "HDR")
      ->required();
  c->add_option(
       "--times", merge.times,
       "Exposure time of each picture in seconds, as 1/60,0.1,...; by default what the cameras "
       "wrote into the JPEGs, at the ISO of the first one; with --response, ? is found from the "
       "pixels that two pictures both expose well")
      ->check(not_empty);
  c->add_flag("--align", merge.align, "Align the pictures of a hand-held camera first");
  c->add_option(
       "--reference", merge.reference,
       "Number of the picture, from 1, that is trusted where something moved: what contradicts it "
       "is left out; by default none, with --align the middle exposure")
      ->check(within(1, 10000));
  c->add_option("--response", merge.response,
                "Response curve: linear, srgb, gamma:2.2 or a response file; by default it is "
                "estimated from the bracket");
  c->add_option("-o,--output", merge.output, "Picture to write, .exr or .hdr")->required();
  add_json(c, merge.json);
  c->callback([&] { action = [] { return hdr_merge(merge); }; });
}

}  // namespace penumbra::tools
