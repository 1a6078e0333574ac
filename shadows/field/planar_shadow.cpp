#include <algorithm>
#include <cmath>
#include <glm/common.hpp>

#include "lighting/lights/distant_light.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/transfer/relight.h"
#include "shadows/field/planar_shadow.h"

namespace penumbra::shadows {

namespace {

float smooth_step(float t) {
  t = std::clamp(t, 0.f, 1.f);
  return t * t * (3 - 2 * t);
}

// 1 inside, 0 at the rim, by distance from the grid's centre in texture coordinates: the lesser one
// of column and row.
void rim_fades(int size, std::vector<float>& out) {
  out.clear();
  for (int i = 0; i < size; ++i) {
    const float off = std::abs((static_cast<float>(i) + .5f) / static_cast<float>(size) * 2 - 1);
    out.push_back(smooth_step((1 - off) / .1f));
  }
}

}  // namespace

Result<void> compose_planar_shadow(const prt::BakedObject& object, const ReceiverLight& light,
                                   PlanarShadow& out) {
  if (!object.receiver) return fail(ErrorCode::kInvalid, "object", "was baked without a receiver");
  thread_local std::vector<float> deficit, reflected;  // grow once per thread
  const std::size_t stride = object.ground_deficit.stride;
  deficit.resize(3 * stride);
  prt::relight(object.ground_deficit, light.residual, deficit);
  if (luminance(light.distant_irradiance) > 0) {
    reflected.resize(3 * stride);
    prt::relight(object.ground_reflected, light.lights, reflected);
    for (std::size_t i = 0; i < deficit.size(); ++i) deficit[i] -= reflected[i];
  }
  compose_planar_shadow({object.receiver->grid, object.ground_deficit.bands, stride, deficit},
                        light, out);
  return {};
}

std::optional<glm::ivec2> texel_at(const prt::GroundGrid& grid, const glm::vec2& position) {
  const glm::vec2 uv = grid.uv(position);
  if (!(uv.x >= 0 && uv.x < 1 && uv.y >= 0 && uv.y < 1)) return std::nullopt;
  return glm::min(glm::ivec2(uv * static_cast<float>(grid.size)), grid.size - 1);
}

Rgb ratio_at(const PlanarShadow& shadow, const prt::GroundGrid& grid, const glm::vec2& position) {
  const auto texel = shadow.empty() ? std::nullopt : texel_at(grid, position);
  return texel ? shadow.ratio.at(texel->x, texel->y) : Rgb{1, 1, 1};
}

void compose_planar_shadow(const ReceiverChange& change, const ReceiverLight& light,
                           PlanarShadow& out) {
  const int size = change.grid.size;
  if (out.ratio.width() != size || out.ratio.height() != size) out.ratio = Image<Rgb>(size, size);
  // All in units of irradiance/pi, like the deficit.
  const RadianceSh used = light.residual.with_bands(change.bands);
  const Rgb open =
      (lighting::evaluate(lighting::irradiance(used), {0, 1, 0}) + light.distant_irradiance) *
      static_cast<float>(1 / kPi);
  const Rgb mean = (used[0] + light.lights[0]) * static_cast<float>(1 / std::sqrt(4 * kPi));
  Rgb inverse;
  for (int c = 0; c < 3; ++c) inverse[c] = open[c] > kMinIrradiance * mean[c] ? 1 / open[c] : 0;

  thread_local std::vector<float> fades, deficit;  // grow once per thread
  rim_fades(size, fades);
  const auto width = static_cast<std::size_t>(size);
  deficit.resize(4 * width);  // of a row: three colours, and the largest of them
  float* const largest = &deficit[3 * width];
  out.x0 = out.y0 = size;
  out.x1 = out.y1 = 0;
  for (std::size_t y = 0; y < width; ++y) {
    std::fill_n(largest, width, 0.f);
    for (std::size_t c = 0; c < 3; ++c) {
      const std::size_t row = c * change.stride + y * width;
      const float* const from = &change.deficit[row];
      const float scale = inverse[static_cast<int>(c)], fade = fades[y];
      float* const here = &deficit[c * width];
      for (std::size_t x = 0; x < width; ++x) {
        here[x] = std::min(fades[x], fade) * scale * from[x];
        largest[x] = std::max(largest[x], std::abs(here[x]));
      }
    }
    for (std::size_t x = 0; x < width; ++x) {
      const float d[3] = {deficit[x], deficit[width + x], deficit[2 * width + x]};
      Rgb& s = out.ratio.at(static_cast<int>(x), static_cast<int>(y));
      s = {1, 1, 1};
      if (!(largest[x] > kInvisibleRatio && std::isfinite(d[0] + d[1] + d[2]))) continue;
      const float kept = smooth_step(largest[x] / kInvisibleRatio - 1);
      for (int c = 0; c < 3; ++c) s[c] = std::clamp(1 - kept * d[c], 0.f, 1.5f);
      out.x0 = std::min(out.x0, static_cast<int>(x));
      out.y0 = std::min(out.y0, static_cast<int>(y));
      out.x1 = std::max(out.x1, static_cast<int>(x) + 1);
      out.y1 = std::max(out.y1, static_cast<int>(y) + 1);
    }
  }
}

}  // namespace penumbra::shadows
