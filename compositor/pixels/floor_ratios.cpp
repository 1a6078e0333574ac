// Shadow ratios at places of the floor, without a camera: what mirrors show of it.
#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <vector>

#include "compositor/pixels/receivers.h"

namespace penumbra::compositor {

namespace {

constexpr double kSamePlane = .01;  // metres

Rgb unpacked(std::uint32_t code) {
  return {static_cast<float>(code >> 21) / PackedRatio::kOne11,
          static_cast<float>(code >> 10 & 2047u) / PackedRatio::kOne11,
          static_cast<float>(code & 1023u) / PackedRatio::kOne10};
}

// Between the four nearest values, of which the first lies at (0, 0); those of the rim beyond it.
template <class Value>
auto between(int width, int height, const glm::vec2& place, const Value& value) {
  const glm::vec2 p = glm::clamp(place, glm::vec2(0), glm::vec2(width - 1, height - 1));
  const int x = std::min(static_cast<int>(p.x), std::max(0, width - 2)),
            y = std::min(static_cast<int>(p.y), std::max(0, height - 2)),
            x1 = std::min(x + 1, width - 1), y1 = std::min(y + 1, height - 1);
  const float fx = p.x - static_cast<float>(x), fy = p.y - static_cast<float>(y);
  return (value(x, y) * (1 - fx) + value(x1, y) * fx) * (1 - fy) +
         (value(x, y1) * (1 - fx) + value(x1, y1) * fx) * fy;
}

Rgb own_ratio(const Image<std::uint32_t>& ratio, const glm::vec2& uv) {
  return between(ratio.width(), ratio.height(), uv * static_cast<float>(ratio.width()) - .5f,
                 [&](int x, int y) { return unpacked(ratio.at(x, y)); });
}

}  // namespace

void Receivers::take_light(const OnPlane& light, const Pose& map_from_grid,
                           const std::vector<glm::dvec3>& places, Image<Rgb>& out) {
  const Image<float>& taken = light.shadow.virtual_occlusion;
  if (taken.empty()) return;
  const glm::vec2 last(taken.width() - 1, taken.height() - 1);
  for (std::size_t i = 0; i < places.size(); ++i) {
    const glm::dvec3 here = map_from_grid * places[i];
    if (std::abs(here.y) > kSamePlane) return;  // another plane
    const glm::vec2 node = glm::vec2(here.x, here.z) / light.shadow.cell_m;
    if (node.x < 0 || node.y < 0 || node.x > last.x || node.y > last.y) continue;
    Rgb& left = out.pixels()[i];
    left = left - light.fraction * between(taken.width(), taken.height(), node,
                                           [&](int x, int y) { return taken.at(x, y); });
  }
}

Image<Rgb> Receivers::ratios_on(int receiver, int texels) const {
  const FloorReceiver& r = receivers_[static_cast<std::size_t>(receiver)];
  std::vector<glm::dvec3> places;
  places.reserve(static_cast<std::size_t>(texels * texels));
  for (int y = 0; y < texels; ++y)
    for (int x = 0; x < texels; ++x) {
      const glm::vec2 p = r.grid.position((glm::vec2(x, y) + .5f) / static_cast<float>(texels));
      places.emplace_back(p.x, r.grid.height, p.y);
    }
  Image<Rgb> out(texels, texels, {1, 1, 1});
  if (r.has_shadow)
    for (std::size_t i = 0; i < places.size(); ++i)
      out.pixels()[i] = own_ratio(r.ratio, r.grid.uv({places[i].x, places[i].z}));
  for (const OnPlane& light : lights_)
    take_light(light, light.shadow.world_from_map.inverse() * r.world_from_bake, places, out);
  for (Rgb& s : out.pixels()) s = {std::max(s.r, 0.f), std::max(s.g, 0.f), std::max(s.b, 0.f)};
  return out;
}

}  // namespace penumbra::compositor
