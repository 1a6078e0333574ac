#include "codec/internal/icc_profile.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "codec/internal/gain_map.h"

namespace penumbra::codec {

namespace {

constexpr std::size_t kTagTable = 128;
constexpr std::uint32_t tag(const char (&name)[5]) {
  std::uint32_t out = 0;
  for (int i = 0; i < 4; ++i) out = out << 8 | static_cast<unsigned char>(name[i]);
  return out;
}

double fixed16(detail::Numbers& in, std::size_t at) {
  return static_cast<std::int32_t>(in.at(at, 4)) / 65536.;
}

// Where a tag's content begins.
std::optional<std::size_t> place_of(detail::Numbers& in, std::uint32_t signature) {
  const std::size_t count = std::min<std::size_t>(in.at(kTagTable, 4), 100);
  for (std::size_t i = 0; i < count && in.ok; ++i)
    if (in.at(kTagTable + 4 + 12 * i, 4) == signature) return in.at(kTagTable + 8 + 12 * i, 4);
  return {};
}

using CurveOfCodes = std::function<double(double)>;

// No points: a line; one: an exponent; else a table.
std::optional<CurveOfCodes> sampled_curve(detail::Numbers& in, std::size_t at) {
  const std::size_t count = in.at(at + 8, 4);
  if (count == 0) return CurveOfCodes([](double x) { return x; });
  if (count == 1) {
    const double gamma = in.at(at + 12, 2) / 256.;
    return CurveOfCodes([gamma](double x) { return std::pow(x, gamma); });
  }
  constexpr std::size_t kMaxPoints = 65536;
  if (count > kMaxPoints) return {};
  std::vector<double> points;
  for (std::size_t i = 0; i < count && in.ok; ++i)
    points.push_back(in.at(at + 12 + 2 * i, 2) / 65535.);
  if (!in.ok) return {};
  return CurveOfCodes([points = std::move(points)](double x) {
    const double place = x * static_cast<double>(points.size() - 1);
    const auto i = std::min(static_cast<std::size_t>(place), points.size() - 2);
    const double part = place - static_cast<double>(i);
    return (1 - part) * points[i] + part * points[i + 1];
  });
}

// Types 0 to 4: (a x + b)^g + e from d on, c x + f below.
std::optional<CurveOfCodes> parametric_curve(detail::Numbers& in, std::size_t at) {
  constexpr std::array<std::size_t, 5> kCounts{1, 3, 4, 5, 7};
  const std::size_t type = in.at(at + 8, 2);
  if (!in.ok || type >= kCounts.size()) return {};
  std::array<double, 7> p{1, 1, 0, 0, 0, 0, 0};  // g a b c d e f
  for (std::size_t i = 0; i < kCounts[type]; ++i) p[i] = fixed16(in, at + 12 + 4 * i);
  auto [g, a, b, c, d, e, f] = p;
  if (type == 1 || type == 2) {
    if (a == 0) return {};
    e = f = type == 2 ? p[3] : 0;
    c = 0, d = -b / a;
  }
  if (type == 0) d = -1;  // everywhere
  return CurveOfCodes(
      [=](double x) { return x >= d ? std::pow(std::max(a * x + b, 0.), g) + e : c * x + f; });
}

std::optional<CurveOfCodes> curve_at(detail::Numbers& in, std::size_t at) {
  const std::uint32_t type = in.at(at, 4);
  if (type == tag("curv")) return sampled_curve(in, at);
  if (type == tag("para")) return parametric_curve(in, at);
  return {};
}

}  // namespace

Result<IccProfile> parse_icc_profile(Bytes profile) {
  constexpr std::uint32_t kColorants[] = {tag("rXYZ"), tag("gXYZ"), tag("bXYZ")},
                          kCurves[] = {tag("rTRC"), tag("gTRC"), tag("bTRC")};
  const auto unknown = [](const char* what) { return fail(ErrorCode::kUnreadable, "", what); };
  detail::Numbers in{profile};
  IccProfile out{};
  for (int c = 0; c < 3; ++c) {
    const auto colorant = place_of(in, kColorants[c]), curve = place_of(in, kCurves[c]);
    if (!colorant) return unknown("has an ICC profile without colorants of red, green and blue");
    for (int k = 0; k < 3; ++k)
      out.primaries[c][k] = fixed16(in, *colorant + 8 + 4 * static_cast<std::size_t>(k));
    if (!curve) {
      out.linear[static_cast<std::size_t>(c)] = linear_codes();
      continue;
    }
    const auto light = curve_at(in, *curve);
    if (!light) return unknown("has an ICC profile whose tone curve is of an unknown kind");
    for (std::size_t code = 0; code < 256; ++code) {
      const double v = (*light)(static_cast<double>(code) / 255);
      if (!std::isfinite(v)) return unknown("has an ICC profile whose tone curve is not finite");
      out.linear[static_cast<std::size_t>(c)][code] = static_cast<float>(std::clamp(v, 0., 1.));
    }
  }
  if (!in.ok) return unknown("has an ICC profile that is cut off");
  return out;
}

}  // namespace penumbra::codec
