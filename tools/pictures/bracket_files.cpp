#include "tools/pictures/bracket_files.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "calib/camera/response_table.h"
#include "capture/frames.h"
#include "capture/hdr/stacks.h"
#include "codec/codec.h"
#include "core/counted.h"
#include "core/io/log.h"
#include "tools/pictures/camera_film.h"
#include "tools/pictures/exif_exposure.h"

namespace penumbra::tools {

namespace {

Result<std::vector<double>> parse_times(const std::string& text, bool unknown_allowed) {
  std::vector<double> out;
  std::size_t start = 0;
  while (start <= text.size()) {
    const std::size_t end = std::min(text.find(',', start), text.size());
    std::string item = text.substr(start, end - start);
    item.erase(0, item.find_first_not_of(' '));
    if (unknown_allowed && item == "?") {
      out.push_back(kUnknownTime.count());
      start = end + 1;
      continue;
    }
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

// Sums of codes of the frames of one exposure.
struct Average {
  Exposure exposure;
  Image<Rgb> sum{};
  int frames = 0;

  void add(const Image<Rgb8>& frame) {
    if (frames++ == 0) sum = Image<Rgb>(frame.width(), frame.height());
    for (std::size_t i = 0; i < frame.area(); ++i) {
      const Rgb8& p = frame.pixels()[i];
      sum.pixels()[i] += {float(p.r), float(p.g), float(p.b)};
    }
  }
  Image<Rgb8> mean() const {
    Image<Rgb8> out(sum.width(), sum.height());
    const auto code = [&](float v) {
      return static_cast<std::uint8_t>(std::lround(v / static_cast<float>(frames)));
    };
    for (std::size_t i = 0; i < sum.area(); ++i) {
      const Rgb& p = sum.pixels()[i];
      out.pixels()[i] = {code(p.r), code(p.g), code(p.b)};
    }
    return out;
  }
};

// Frames of a capture into the average of their exposure.
Result<void> add_frames(const std::string& path, const std::string& name,
                        std::vector<Average>& averages) {
  constexpr std::size_t kMax = 16;
  PENUMBRA_ASSIGN(film, CameraFilm::open(path, name));
  while (true) {
    PENUMBRA_ASSIGN(frame, film.next());
    if (!frame) return {};
    const auto* codes = std::get_if<Image<Rgb8>>(frame->pixels.get());
    if (!codes)
      return fail(ErrorCode::kInvalid, path,
                  "is not 8-bit, and the response is estimated from 8-bit pictures only");
    auto average = std::ranges::find_if(averages, [&](const Average& a) {
      return std::abs(a.exposure.product() / frame->exposure.product() - 1) < .01;
    });
    if (average == averages.end()) {
      if (averages.size() == kMax)
        return fail(ErrorCode::kUndetermined, path,
                    fmt::format("has more than {} exposures", kMax));
      averages.push_back({frame->exposure});
      average = averages.end() - 1;
    }
    if (average->frames > 0 && !average->sum.same_size(*codes))
      return fail(ErrorCode::kInvalid, path, "has pictures of another size");
    average->add(*codes);
  }
}

}  // namespace

Result<capture::ExposureStack> average_clips(const std::vector<std::string>& captures,
                                             const std::string& camera) {
  std::vector<Average> averages;
  for (const std::string& path : captures) PENUMBRA_TRY(add_frames(path, camera, averages));
  if (averages.size() < 2)
    return fail(
        ErrorCode::kUndetermined, captures[0],
        fmt::format(
            "has only {} exposure: film the same still scene with another one, two stops away",
            averages.size()));
  capture::ExposureStack stack;
  for (const Average& a : averages) {
    stack.frames.push_back(std::make_shared<const FramePixels>(a.mean()));
    stack.exposures.push_back({Seconds(a.exposure.product()), Gain(1)});
  }
  return stack;
}

namespace {

// In seconds at the ISO of the first picture.
Result<std::vector<double>> times_by_exif(const std::vector<std::string>& images) {
  std::vector<double> out;
  std::optional<ExifExposure> first;
  for (const std::string& image : images) {
    const auto exposure = read_exif_exposure(image);
    if (!exposure && exposure.error().code == ErrorCode::kUndetermined)
      return fail(ErrorCode::kUndetermined, image,
                  "holds no exposure time (EXIF), and --times gives none");
    if (!exposure) return std::unexpected(exposure.error());
    if (!first) first = *exposure;
    constexpr double kSameAperture = .02;
    if (exposure->iso.has_value() != first->iso.has_value())
      return fail(ErrorCode::kUndetermined, image,
                  "and " + images[0] + " do not both tell their ISO (EXIF): give --times");
    if (exposure->f_number && first->f_number &&
        std::abs(*exposure->f_number / *first->f_number - 1) > kSameAperture)
      return fail(
          ErrorCode::kInvalid, image,
          fmt::format("was taken at f/{:.3g}, {} at f/{:.3g}: give --times that count it in",
                      *exposure->f_number, images[0], *first->f_number));
    const double iso = exposure->iso && first->iso ? *exposure->iso / *first->iso : 1;
    out.push_back(exposure->time.count() * iso);
    log_info("{}: {:.4g} s by its EXIF", image, out.back());
  }
  return out;
}

}  // namespace

Result<capture::ExposureStack> read_bracket(const std::vector<std::string>& images,
                                            const std::string& times_text, bool unknown_allowed) {
  PENUMBRA_ASSIGN(
      times, times_text.empty() ? times_by_exif(images) : parse_times(times_text, unknown_allowed));
  if (times.size() != images.size())
    return fail(ErrorCode::kInvalid, "--times",
                fmt::format("has {} for {}", counted(times.size(), "time"),
                            counted(images.size(), "picture")));
  capture::ExposureStack stack;
  for (std::size_t k = 0; k < images.size(); ++k) {
    PENUMBRA_ASSIGN(frame, codec::read_frame(images[k]));
    if (k > 0) {
      const FramePixels& first = *stack.frames[0];
      const int w = capture::width(first), h = capture::height(first);
      if (capture::width(frame) != w || capture::height(frame) != h)
        return fail(ErrorCode::kInvalid, images[k],
                    fmt::format("has {}x{} pixels, but {} has {}x{}", capture::width(frame),
                                capture::height(frame), images[0], w, h));
      if (frame.index() != first.index())
        return fail(ErrorCode::kInvalid, images[k], "has another bit depth than " + images[0]);
    }
    if (const auto* linear = std::get_if<Image<Rgb>>(&frame))
      if (const auto bad = std::ranges::count_if(
              linear->pixels(), [](const Rgb& c) { return !std::isfinite(c.r + c.g + c.b); }))
        log_warning("{}: {} pixels are NaN or infinite and are left out", images[k], bad);
    stack.frames.push_back(std::make_shared<const FramePixels>(std::move(frame)));
    stack.exposures.push_back({Seconds((times)[k]), Gain(1)});
  }
  return stack;
}

namespace {

Image<Rgb8> part_of(const Image<Rgb8>& whole, int x0, int y0, int width, int height) {
  Image<Rgb8> out(width, height);
  for (int y = 0; y < height; ++y) std::copy_n(&whole.at(x0, y0 + y), width, &out.at(0, y));
  return out;
}

}  // namespace

std::optional<CommonPart> common_part(const capture::ExposureStack& stack) {
  const std::size_t count = stack.frames.size();
  if (count < 2 || !std::holds_alternative<Image<Rgb8>>(*stack.frames[0])) return std::nullopt;
  const auto picture = [&](std::size_t k) -> const Image<Rgb8>& {
    return std::get<Image<Rgb8>>(*stack.frames[k]);
  };
  // Neighbours by exposure have most in common; times that are not told stay where they were given.
  std::vector<std::size_t> order(count);
  std::iota(order.begin(), order.end(), std::size_t{0});
  if (std::ranges::none_of(stack.exposures, [](auto& e) { return e.time == kUnknownTime; }))
    std::ranges::stable_sort(order, {}, [&](std::size_t k) { return stack.exposures[k].time; });
  std::vector<std::array<int, 2>> place(count, {0, 0});  // of what the first of the order shows
  MovedCamera most{0, 0, 0};
  for (std::size_t i = 1; i < count; ++i) {
    const std::size_t before = order[i - 1], here = order[i];
    place[here] = place[before];
    const auto shift = capture::find_camera_shift(picture(before), picture(here));
    if (!shift || !shift->moved()) continue;
    const double moved_px = std::hypot(shift->moved_px[0], shift->moved_px[1]);
    for (std::size_t axis = 0; axis < 2; ++axis)
      place[here][axis] += static_cast<int>(std::lround(shift->moved_px[axis]));
    if (moved_px > most.moved_px) most = {here, before, moved_px};
  }
  if (most.moved_px == 0) return std::nullopt;
  std::array<int, 2> low = place[0], high = place[0];
  for (const auto& p : place)
    for (std::size_t axis = 0; axis < 2; ++axis)
      low[axis] = std::min(low[axis], p[axis]), high[axis] = std::max(high[axis], p[axis]);
  const int width = picture(0).width() - (high[0] - low[0]),
            height = picture(0).height() - (high[1] - low[1]);
  CommonPart out{stack, most};
  if (2 * width < picture(0).width() || 2 * height < picture(0).height()) return out;
  for (std::size_t k = 0; k < count; ++k)
    out.stack.frames[k] = std::make_shared<const FramePixels>(
        part_of(picture(k), place[k][0] - low[0], place[k][1] - low[1], width, height));
  return out;
}

namespace {

// Pictures of any depth as overlaps are looked for in: 8 bits of a known curve.
struct OverlapPictures {
  std::vector<std::shared_ptr<const FramePixels>> frames;
  ResponseTable curve;
  std::vector<double> gains;  // of each, over the others
};

// What is brighter than all but the brightest of a picture is clipped: linear pictures have no full
// scale of their own.
double white_of(const Image<Rgb>& picture) {
  constexpr double kClipped = .005;
  std::vector<float> all;
  for (const Rgb& c : picture.pixels())
    if (const float most = std::max({c.r, c.g, c.b}); std::isfinite(most) && most > 0)
      all.push_back(most);
  if (all.empty()) return 1;
  const auto at =
      all.end() - 1 - static_cast<std::ptrdiff_t>(kClipped * static_cast<double>(all.size()));
  std::ranges::nth_element(all, at);
  return double(*at);
}

OverlapPictures overlap_pictures(const capture::ExposureStack& stack) {
  const bool has_codes = !std::holds_alternative<Image<Rgb>>(*stack.frames[0]);
  if (std::holds_alternative<Image<Rgb8>>(*stack.frames[0]))
    return {stack.frames, capture::make_response_table(stack.response, 8, stack.black_level),
            std::vector<double>(stack.frames.size(), 1)};
  OverlapPictures out{{}, capture::make_response_table(calib::Response::srgb(), 8, 0), {}};
  const ResponseTable fine = capture::make_response_table(stack.response, 16, stack.black_level);
  const auto convert = [&](const auto& from, const auto& signal) {
    Image<Rgb8> to(from.width(), from.height());
    for (std::size_t i = 0; i < from.area(); ++i) {
      const auto code = [&](int c, auto value) {
        const float s = signal(c, value);  // not finite: as clipped
        return static_cast<std::uint8_t>(s < 1 ? out.curve.encode(c, std::max(s, 0.f)) : 255);
      };
      const auto& p = from.pixels()[i];
      to.pixels()[i] = {code(0, p.r), code(1, p.g), code(2, p.b)};
    }
    out.frames.push_back(std::make_shared<const FramePixels>(std::move(to)));
  };
  for (const auto& f : stack.frames) {
    const double white = has_codes ? 1 : white_of(std::get<Image<Rgb>>(*f)) - stack.black_level;
    out.gains.push_back(1 / white);
    if (has_codes)
      convert(std::get<Image<Rgb16>>(*f),
              [&](int c, std::uint16_t v) { return fine.decode(c, v); });
    else
      convert(std::get<Image<Rgb>>(*f), [&](int, float v) {
        return static_cast<float>((double(v) - stack.black_level) / white);
      });
  }
  return out;
}

}  // namespace

Result<std::vector<CheckedTime>> check_times(capture::ExposureStack& stack, double exponent_sigma) {
  const OverlapPictures pictures = overlap_pictures(stack);
  const auto ratio_of = [&](std::size_t against,
                            std::size_t picture) -> Result<capture::ExposureRatio> {
    PENUMBRA_ASSIGN(
        found, capture::estimate_exposure_ratio(std::get<Image<Rgb8>>(*pictures.frames[against]),
                                                std::get<Image<Rgb8>>(*pictures.frames[picture]),
                                                pictures.curve, exponent_sigma));
    const double scale = pictures.gains[against] / pictures.gains[picture];
    found.ratio *= scale, found.low *= scale, found.high *= scale;
    return found;
  };
  const auto known = [&](std::size_t k) { return stack.exposures[k].time > kUnknownTime; };
  std::vector<CheckedTime> out;
  std::vector<std::size_t> told;
  for (std::size_t k = 0; k < stack.frames.size(); ++k)
    if (known(k)) told.push_back(k);
  if (told.empty())
    return fail(ErrorCode::kUndetermined, "--times",
                "no time is given: give at least one, such as 1, to count from");
  std::ranges::stable_sort(told, {},
                           [&](std::size_t k) { return stack.exposures[k].time.count(); });
  for (std::size_t i = 1; i < told.size(); ++i) {
    // Far apart nothing may overlap; that is no fault of the times.
    const auto ratio = ratio_of(told[i - 1], told[i]);
    if (ratio)
      out.push_back({told[i], told[i - 1], *ratio,
                     stack.exposures[told[i]].time / stack.exposures[told[i - 1]].time});
  }
  for (std::size_t left = stack.frames.size() - told.size(); left > 0; --left) {
    std::size_t picture = 0;
    const auto has_neighbour = [&](std::size_t k) {
      return (k > 0 && known(k - 1)) || (k + 1 < stack.frames.size() && known(k + 1));
    };
    while (known(picture) || !has_neighbour(picture)) ++picture;
    const std::size_t against = picture > 0 && known(picture - 1) ? picture - 1 : picture + 1;
    const auto ratio = ratio_of(against, picture);
    if (!ratio)
      return fail(ratio.error().code, fmt::format("--times: the ? of picture {}", picture + 1),
                  ratio.error().detail);
    constexpr double kWidest = 1.5;   // interval, high over low
    constexpr double kFewest = .005;  // of the pictures' patches
    if (ratio->high > kWidest * ratio->low || ratio->fraction < kFewest)
      return fail(
          ErrorCode::kUndetermined, fmt::format("--times: the ? of picture {}", picture + 1),
          fmt::format("its exposure is {:.3g} to {:.3g} times that of picture {}: too little "
                      "is well exposed in both, and the curve's dark end decides",
                      ratio->low, ratio->high, against + 1));
    stack.exposures[picture].time = stack.exposures[against].time * ratio->ratio;
    out.push_back({picture, against, *ratio, 0});
  }
  return out;
}

bool CheckedTime::contradicts_label(double fraction) const {
  constexpr double kFarOff = .1;
  return labelled_ratio > 0 && ratio.fraction > fraction &&
         std::abs(ratio.ratio / labelled_ratio - 1) > kFarOff &&
         (labelled_ratio < ratio.low || labelled_ratio > ratio.high);
}

EightBitBracket eight_bit_bracket(const capture::ExposureStack& stack) {
  EightBitBracket out;
  for (std::size_t k = 0; k < stack.frames.size(); ++k) {
    out.pictures.push_back(&std::get<Image<Rgb8>>(*stack.frames[k]));
    out.times.push_back(stack.exposures[k].time);
  }
  return out;
}

}  // namespace penumbra::tools
