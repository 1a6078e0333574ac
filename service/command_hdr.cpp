#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>

#include "capture/capture.h"
#include "codec/codec.h"
#include "core/files.h"
#include "service/commands.h"
#include "service/report.h"

namespace penumbra::service {

namespace {

Result<std::vector<double>> parse_times(const std::string& text) {
  std::vector<double> out;
  std::size_t start = 0;
  while (start <= text.size()) {
    const std::size_t end = std::min(text.find(',', start), text.size());
    const std::string item = text.substr(start, end - start);
    char* rest = nullptr;
    double value = std::strtod(item.c_str(), &rest);
    if (*rest == '/') {  // 1/60
      const char* const below = rest + 1;
      value /= std::strtod(below, &rest);
    }
    if (item.empty() || rest == item.c_str() || *rest != 0)
      return fail(ErrorCode::kInvalid, "--times",
                  fmt::format("\"{}\" is not a number of seconds", item));
    if (!std::isfinite(value) || value <= 0)
      return fail(ErrorCode::kInvalid, "--times",
                  fmt::format("exposure time {} s is not positive and finite", item));
    out.push_back(value);
    start = end + 1;
  }
  return out;
}

Result<capture::ExposureStack> read_stack(const HdrMergeOptions& o) {
  auto times = parse_times(o.times);
  if (!times) return std::unexpected(times.error());
  if (times->size() != o.images.size())
    return fail(ErrorCode::kInvalid, "--times",
                fmt::format("{} times for {} images", times->size(), o.images.size()));
  capture::ExposureStack stack;
  for (std::size_t k = 0; k < o.images.size(); ++k) {
    auto frame = codec::read_frame(o.images[k]);
    if (!frame) return std::unexpected(frame.error());
    if (k > 0) {
      const FramePixels& first = *stack.frames[0];
      const int w = capture::width(first), h = capture::height(first);
      if (capture::width(*frame) != w || capture::height(*frame) != h)
        return fail(ErrorCode::kInvalid, o.images[k],
                    fmt::format("{}x{} pixels, but {} has {}x{}", capture::width(*frame),
                                capture::height(*frame), o.images[0], w, h));
      if (frame->index() != first.index())
        return fail(ErrorCode::kInvalid, o.images[k], "has another bit depth than " + o.images[0]);
    }
    if (const auto* linear = std::get_if<Image<Rgb>>(&*frame))
      if (const auto bad = std::ranges::count_if(
              linear->pixels(), [](const Rgb& c) { return !std::isfinite(c.r + c.g + c.b); }))
        spdlog::warn("{}: {} pixels are NaN or infinite and are left out", o.images[k], bad);
    stack.frames.push_back(std::make_shared<const FramePixels>(std::move(*frame)));
    stack.exposures.push_back({Seconds((*times)[k]), Gain(1)});
  }
  return stack;
}

Result<calib::Response> find_response(const HdrMergeOptions& o,
                                      const capture::ExposureStack& stack) {
  if (o.response) return calib::parse_response(*o.response);
  if (std::holds_alternative<Image<Rgb>>(*stack.frames[0])) return calib::Response::linear();
  if (!std::holds_alternative<Image<Rgb8>>(*stack.frames[0]))
    return fail(ErrorCode::kUndetermined, o.images[0],
                "the response of 16-bit images is not estimated; give --response");
  std::vector<const Image<Rgb8>*> pictures;
  std::vector<Seconds> times;
  for (std::size_t k = 0; k < stack.frames.size(); ++k) {
    pictures.push_back(&std::get<Image<Rgb8>>(*stack.frames[k]));
    times.push_back(stack.exposures[k].time);
  }
  auto response = calib::estimate_response(pictures, times);
  if (response) spdlog::info("response estimated from the bracket: {}", response->describe());
  return response;
}

}  // namespace

Result<void> hdr_merge(const HdrMergeOptions& o) {
  PENUMBRA_TRY(check_writable(o.output));
  auto stack = read_stack(o);
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
