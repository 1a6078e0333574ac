// Shadow ratios at places of the floor, without a camera: what mirrors show of it.
#include <algorithm>
#include <cmath>
#include <glm/common.hpp>

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

}  // namespace

Rgb Receivers::ratio_at(const glm::dvec3& place) const {
  Rgb out{1, 1, 1};
  for (const FloorReceiver& r : receivers_) {
    if (!r.has_shadow || !r.visible) continue;
    const glm::dvec3 here = r.world_from_bake.inverse() * place;
    if (std::abs(here.y - r.grid.height) > kSamePlane) continue;
    const glm::vec2 uv = r.grid.uv({here.x, here.z});
    if (uv.x < 0 || uv.y < 0 || uv.x > 1 || uv.y > 1) continue;
    out = out * between(r.ratio.width(), r.ratio.height(),
                        uv * static_cast<float>(r.ratio.width()) - .5f,
                        [&](int x, int y) { return unpacked(r.ratio.at(x, y)); });
  }
  for (const OnPlane& light : lights_) {
    const Image<float>& taken = light.shadow.virtual_occlusion;
    if (taken.empty()) continue;
    const glm::dvec3 here = light.shadow.world_from_map.inverse() * place;
    const glm::vec2 node(here.x / light.shadow.cell_m, here.z / light.shadow.cell_m);
    if (std::abs(here.y) > kSamePlane || node.x < 0 || node.y < 0 ||
        node.x > static_cast<float>(taken.width() - 1) ||
        node.y > static_cast<float>(taken.height() - 1))
      continue;
    out = out - light.fraction * between(taken.width(), taken.height(), node,
                                         [&](int x, int y) { return taken.at(x, y); });
  }
  return {std::max(out.r, 0.f), std::max(out.g, 0.f), std::max(out.b, 0.f)};
}

Image<Rgb> Receivers::ratios_on(int receiver, int texels) const {
  const FloorReceiver& r = receivers_[static_cast<std::size_t>(receiver)];
  Image<Rgb> out(texels, texels);
  for (int y = 0; y < texels; ++y)
    for (int x = 0; x < texels; ++x) {
      const glm::vec2 p = r.grid.position((glm::vec2(x, y) + .5f) / static_cast<float>(texels));
      out.at(x, y) = ratio_at(r.world_from_bake * glm::dvec3(p.x, r.grid.height, p.y));
    }
  return out;
}

}  // namespace penumbra::compositor
