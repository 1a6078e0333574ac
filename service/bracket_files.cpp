#include "service/bracket_files.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>

#include "codec/codec.h"

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

}  // namespace

Result<capture::ExposureStack> read_bracket(const std::vector<std::string>& images,
                                            const std::string& times_text) {
  auto times = parse_times(times_text);
  if (!times) return std::unexpected(times.error());
  if (times->size() != images.size())
    return fail(ErrorCode::kInvalid, "--times",
                fmt::format("{} times for {} images", times->size(), images.size()));
  capture::ExposureStack stack;
  for (std::size_t k = 0; k < images.size(); ++k) {
    auto frame = codec::read_frame(images[k]);
    if (!frame) return std::unexpected(frame.error());
    if (k > 0) {
      const FramePixels& first = *stack.frames[0];
      const int w = capture::width(first), h = capture::height(first);
      if (capture::width(*frame) != w || capture::height(*frame) != h)
        return fail(ErrorCode::kInvalid, images[k],
                    fmt::format("{}x{} pixels, but {} has {}x{}", capture::width(*frame),
                                capture::height(*frame), images[0], w, h));
      if (frame->index() != first.index())
        return fail(ErrorCode::kInvalid, images[k], "has another bit depth than " + images[0]);
    }
    if (const auto* linear = std::get_if<Image<Rgb>>(&*frame))
      if (const auto bad = std::ranges::count_if(
              linear->pixels(), [](const Rgb& c) { return !std::isfinite(c.r + c.g + c.b); }))
        spdlog::warn("{}: {} pixels are NaN or infinite and are left out", images[k], bad);
    stack.frames.push_back(std::make_shared<const FramePixels>(std::move(*frame)));
    stack.exposures.push_back({Seconds((*times)[k]), Gain(1)});
  }
  return stack;
}

EightBitBracket eight_bit_bracket(const capture::ExposureStack& stack) {
  EightBitBracket out;
  for (std::size_t k = 0; k < stack.frames.size(); ++k) {
    out.pictures.push_back(&std::get<Image<Rgb8>>(*stack.frames[k]));
    out.times.push_back(stack.exposures[k].time);
  }
  return out;
}

}  // namespace penumbra::service
