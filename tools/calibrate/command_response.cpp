#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <numeric>
#include <optional>

#include "calib/camera/response.h"
#include "calib/estimate/estimate_response.h"
#include "capture/frames.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "runtime/pipeline/report.h"
#include "tools/calibrate/calibration_report.h"
#include "tools/calibrate/commands.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/pictures/bracket_files.h"

namespace penumbra::tools {

namespace {

struct CalibrateResponseOptions {
  std::vector<std::string> images;
  std::string times;  // seconds, separated by commas
  // Instead of both: of a still scene, two exposures at least in all
  std::vector<std::string> captures;
  std::string camera;  // in the captures
  std::string output;
  std::optional<std::string> report;
  bool json = false;
};

// What a picture shows of its time; given and shown.
struct WrongTime {
  std::size_t picture;
  Seconds given, shown;
};

constexpr double kMinOverlap = .05;  // of the pictures

bool any_contradicts(const std::vector<CheckedTime>& checked) {
  return std::ranges::any_of(checked,
                             [](const CheckedTime& c) { return c.contradicts_label(kMinOverlap); });
}

// The picture without which all others agree, if there is one alone. Three are needed to agree.
std::optional<WrongTime> find_wrong_time(const capture::ExposureStack& given) {
  // By time, since neighbours tell most of each other.
  std::vector<std::size_t> order(given.frames.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, {},
                           [&](std::size_t k) { return given.exposures[k].time.count(); });
  capture::ExposureStack stack = given;
  for (std::size_t k = 0; k < order.size(); ++k) {
    stack.frames[k] = given.frames[order[k]];
    stack.exposures[k] = given.exposures[order[k]];
  }
  const EightBitBracket all = eight_bit_bracket(stack);
  constexpr std::size_t kFewest = 4;
  if (all.pictures.size() < kFewest) return std::nullopt;
  std::optional<WrongTime> found;
  for (std::size_t k = 0; k < all.pictures.size(); ++k) {
    const auto there = static_cast<std::ptrdiff_t>(k);
    EightBitBracket others = all;
    others.pictures.erase(others.pictures.begin() + there);
    others.times.erase(others.times.begin() + there);
    const auto curve = calib::estimate_response(others.pictures, others.times);
    if (!curve) continue;
    capture::ExposureStack rest = stack;
    rest.response = *curve;
    rest.exposures[k].time = kUnknownTime;
    const auto checked = check_times(rest, capture::kEstimatedExponentSigma);
    if (!checked || any_contradicts(*checked)) continue;
    if (found) return std::nullopt;
    found = WrongTime{order[k], stack.exposures[k].time, rest.exposures[k].time};
  }
  return found;
}

std::string name_of(const CalibrateResponseOptions& o, const capture::ExposureStack& stack,
                    std::size_t picture) {
  return o.captures.empty() ? o.images[picture]
                            : fmt::format("{:.4g} s", stack.exposures[picture].time.count());
}

std::string contradiction(const WrongTime& wrong) {
  return fmt::format(
      "its time of {:.4g} s is wrong, or its scene another one: all others agree with each other, "
      "and tell {:.4g} s for it",
      wrong.given.count(), wrong.shown.count());
}

// A curve that is made of wrong times fits none of them: what the pictures show under it is held
// against what was told.
Result<void> check_times_against(const CalibrateResponseOptions& o,
                                 const capture::ExposureStack& stack,
                                 const calib::Response& response) {
  const auto name = [&](std::size_t k) { return name_of(o, stack, k); };
  if (stack.frames.size() == 2)
    log_warning(
        "two exposures make a curve of any ratio of their times: a wrong one would go unnoticed, "
        "and a third exposure tells it");
  capture::ExposureStack as_told = stack;
  as_told.response = response;
  PENUMBRA_ASSIGN(checked, check_times(as_told, capture::kEstimatedExponentSigma));
  if (!any_contradicts(checked)) return {};
  if (const auto wrong = find_wrong_time(stack)) {
    log_warning("{}: {}; the curve is off until that is mended", name(wrong->picture),
                contradiction(*wrong));
    return {};
  }
  for (const CheckedTime& c : checked)
    if (c.contradicts_label(kMinOverlap))
      log_warning(
          "{}: {:.4g} times the exposure of {} by the given times, but {:.4g} by what both show "
          "under this curve (95 % within {:.4g} to {:.4g}): a time is wrong, or the scene changed",
          name(c.picture), c.labelled_ratio, name(c.against), c.ratio.ratio, c.ratio.low,
          c.ratio.high);
  return {};
}

}  // namespace

Result<void> calibrate_response(const CalibrateResponseOptions& o) {
  PENUMBRA_TRY(check_writable(o.output));
  if (o.report) PENUMBRA_TRY(make_folder(*o.report));
  if (o.captures.empty() && o.images.empty())
    return fail(ErrorCode::kInvalid, "calibrate response",
                "needs images, or --capture with --camera");
  PENUMBRA_ASSIGN(stack, o.captures.empty() ? read_bracket(o.images, o.times)
                                            : average_clips(o.captures, o.camera));
  const std::string& first = o.captures.empty() ? o.images[0] : o.captures[0];
  if (!std::holds_alternative<Image<Rgb8>>(*stack.frames[0]))
    return fail(ErrorCode::kUndetermined, first,
                "is not 8-bit, and the response is estimated from 8-bit pictures only");
  if (const auto common = common_part(stack)) {
    log_warning(
        "{} and {}: the camera moved by about {:.0f} px, and the curve is of what is the same in "
        "all pictures: a tripod gives a better one",
        name_of(o, stack, common->moved.against), name_of(o, stack, common->moved.picture),
        common->moved.moved_px);
    stack = common->stack;
  }
  const EightBitBracket bracket = eight_bit_bracket(stack);
  auto found = calib::calibrate_response(bracket.pictures, bracket.times);
  if (!found) {
    const auto wrong = find_wrong_time(stack);
    if (!wrong) return std::unexpected(found.error());
    return fail(ErrorCode::kUndetermined, name_of(o, stack, wrong->picture), contradiction(*wrong));
  }
  const calib::ResponseCalibration& result = *found;
  PENUMBRA_TRY(check_times_against(o, stack, result.response));
  const std::string text =
      fmt::format("# from {} pictures; one standard deviation, of full scale: {:.5f}\n{}",
                  stack.frames.size(), result.sigma, calib::print_response_file(result.response));
  PENUMBRA_TRY(write_bytes(o.output, text));
  if (o.report) PENUMBRA_TRY(write_response_report(*o.report, result));
  if (o.json)
    print_json({{"pictures", stack.frames.size()},
                {"sigma", result.sigma},
                {"between_places", result.between_places ? nlohmann::json(*result.between_places)
                                                         : nlohmann::json()}});
  else
    fmt::print("{}: response of {} pictures, uncertain by {:.2f} % of full scale\n", o.output,
               stack.frames.size(), 100 * result.sigma);
  return {};
}

void add_calibrate_response(CLI::App& parent, Action& action) {
  static CalibrateResponseOptions response;
  auto* c = parent.add_subcommand(
      "response",
      "Find the response curve of an 8-bit camera from a bracket of a still scene that goes from "
      "dark to bright");
  auto* images = c->add_option(
      "images", response.images,
      "Pictures of the bracket: 8-bit PNG, JPEG or TIFF, from a camera that stands still");
  c->add_option("--times", response.times,
                "Exposure time of each picture in seconds, as 1/60,0.1,...; by default what the "
                "cameras wrote into the JPEGs")
      ->needs(images)
      ->check(not_empty);
  auto* name = c->add_option("--camera", response.camera, "Name of the camera in the captures");
  c->add_option(
       "--capture", response.captures,
       "Recordings or capture folders of one still scene, instead of pictures: at least two "
       "exposures in all; the frames of each exposure are averaged")
      ->excludes(images)
      ->needs(name);
  c->add_option("-o,--output", response.output, "Response file to write, .toml")->required();
  c->add_option("--report", response.report, "Folder for a plot and a table of the curves");
  add_json(c, response.json);
  c->callback([&] { action = [] { return calibrate_response(response); }; });
}

}  // namespace penumbra::tools
