#include <fmt/format.h>
#include <algorithm>
#include <cmath>
#include <limits>

#include "core/conventions.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/reference/environment_light.h"

namespace penumbra::prt {

Result<EnvironmentLight> EnvironmentLight::from_map(const Image<Rgb>& map) {
  if (map.empty()) return fail(ErrorCode::kInvalid, "environment", "has no pixels");
  if (map.width() > std::numeric_limits<std::uint16_t>::max())
    return fail(ErrorCode::kInvalid, "environment", "is wider than 65535 pixels");
  EnvironmentLight light;
  light.map_ = map;
  double total = 0;
  for (int y = 0; y < map.height(); ++y) {
    const double w = latlong_solid_angle(y, map.width(), map.height());
    double row = 0;
    for (int x = 0; x < map.width(); ++x) {
      const Rgb& c = map.at(x, y);
      if (!is_finite(c))
        return fail(ErrorCode::kNonFinite, "environment",
                    fmt::format("pixel {},{} is not finite", x, y));
      row += w * std::max(0.f, luminance(c));
      light.cumulative_columns_.push_back(static_cast<float>(row));
    }
    // Each row's own distribution, normalised; an all-black row is uniform and never chosen.
    for (int x = 0; x < map.width(); ++x) {
      float& c = light.cumulative_columns_[static_cast<std::size_t>(y * map.width() + x)];
      c = row > 0 ? static_cast<float>(c / row)
                  : static_cast<float>(x + 1) / static_cast<float>(map.width());
    }
    light.add_guides(y);
    total += row;
    light.cumulative_rows_.push_back(static_cast<float>(total));
  }
  for (int y = 0; y <= map.height(); ++y)
    light.row_cosines_.push_back(std::cos(kPi * y / map.height()));
  if (total <= 0) return fail(ErrorCode::kUndetermined, "environment", "is black everywhere");
  for (float& r : light.cumulative_rows_) r = static_cast<float>(r / total);
  light.total_ = total;
  return light;
}

EnvironmentLight EnvironmentLight::from_sh(const RadianceSh& sh) {
  // Sampled by its magnitude on a coarse grid, over a floor that leaves no direction out.
  constexpr int kWidth = 128, kHeight = 64;
  Image<Rgb> magnitude(kWidth, kHeight);
  double mean = 0;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const Rgb c = lighting::evaluate(sh, latlong_direction(x + .5, y + .5, kWidth, kHeight));
      const float m = std::max({std::abs(c.r), std::abs(c.g), std::abs(c.b)});
      magnitude.at(x, y) = {m, m, m};
      mean += double(m) / (kWidth * kHeight);
    }
  const auto smallest = static_cast<float>(.05 * mean);
  for (Rgb& m : magnitude.pixels()) m += Rgb{smallest, smallest, smallest};
  auto sampled = from_map(magnitude);
  EnvironmentLight light =
      sampled ? std::move(*sampled) : EnvironmentLight();  // no light at all: no sampler
  light.sh_ = sh;
  return light;
}

Rgb EnvironmentLight::radiance(const glm::vec3& direction) const {
  if (sh_) return lighting::evaluate(*sh_, glm::normalize(glm::dvec3(direction)));
  return map_value(direction);
}

Rgb EnvironmentLight::map_value(const glm::vec3& direction) const {
  const glm::dvec2 p = latlong_pixel(glm::dvec3(direction), map_.width(), map_.height());
  return map_.at(std::clamp(static_cast<int>(p.x), 0, map_.width() - 1),
                 std::clamp(static_cast<int>(p.y), 0, map_.height() - 1));
}

namespace {

// Columns for each guide: a search reads what lies in one line of the cache or two.
constexpr int kColumnsAGuide = 8;

int guides_of(int width) {
  return (width + kColumnsAGuide - 1) / kColumnsAGuide;
}

}  // namespace

void EnvironmentLight::add_guides(int row) {
  const int width = map_.width(), guides = guides_of(width);
  const float* const cumulative = cumulative_columns_.data() + std::ptrdiff_t{row} * width;
  int column = 0;
  for (int g = 0; g < guides; ++g) {
    const float begin = static_cast<float>(g) / static_cast<float>(guides);
    while (column < width - 1 && cumulative[column] <= begin) ++column;
    guides_.push_back(static_cast<std::uint16_t>(column));
  }
}

// The first column beyond the fraction.
// source: guide tables, Chen & Asau 1974
int EnvironmentLight::column_at(int row, float fraction) const {
  const int width = map_.width(), guides = guides_of(width);
  const float* const cumulative = cumulative_columns_.data() + std::ptrdiff_t{row} * width;
  const int g = std::min(static_cast<int>(fraction * static_cast<float>(guides)), guides - 1);
  int column = guides_[static_cast<std::size_t>(row) * static_cast<std::size_t>(guides) +
                       static_cast<std::size_t>(g)];
  while (column > 0 && cumulative[column - 1] > fraction) --column;  // the product was rounded up
  while (column < width - 1 && cumulative[column] <= fraction) ++column;
  return column;
}

EnvironmentLight::LightSample EnvironmentLight::sample(float u1, float u2) const {
  const int w = map_.width(), h = map_.height();
  const auto row = std::ranges::upper_bound(cumulative_rows_, u1);
  const int y = std::min(static_cast<int>(row - cumulative_rows_.begin()), h - 1);
  const float below = y > 0 ? cumulative_rows_[static_cast<std::size_t>(y - 1)] : 0;
  const float row_fraction = cumulative_rows_[static_cast<std::size_t>(y)] - below;
  const float v = row_fraction > 0 ? (u1 - below) / row_fraction : .5f;

  const auto first = cumulative_columns_.begin() + static_cast<std::ptrdiff_t>(y) * w;
  const int x = column_at(y, u2);
  const float left = x > 0 ? first[x - 1] : 0;
  const float fraction = first[x] - left;
  const float u = fraction > 0 ? (u2 - left) / fraction : .5f;

  // Uniform in solid angle inside the pixel: cos th is linear in v.
  const double c0 = row_cosines_[static_cast<std::size_t>(y)],
               c1 = row_cosines_[static_cast<std::size_t>(y) + 1];
  const double c = c0 + (c1 - c0) * v, s = std::sqrt(std::max(0., 1 - c * c));
  const double phi = 2 * kPi * ((x + double(u)) / w - .5);
  const glm::vec3 d(s * std::sin(phi), c, -s * std::cos(phi));
  const Rgb& chosen = map_.at(x, y);
  return {d, sh_ ? radiance(d) : chosen,
          static_cast<float>(std::max(0.f, luminance(chosen)) / total_)};
}

float EnvironmentLight::density(const glm::vec3& direction) const {
  return static_cast<float>(std::max(0.f, luminance(map_value(direction))) / total_);
}

}  // namespace penumbra::prt
