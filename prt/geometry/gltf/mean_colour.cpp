#include "prt/geometry/gltf/internal/mean_colour.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/vec3.hpp>

namespace penumbra::prt::gltf {

const Image<Rgb>& MeanColours::reduced(const Texture& texture, TexelCodes codes,
                                       std::size_t vertices) {
  const Image<Rgba8>& in = texture.picture->codes;
  // A few texels a vertex, since charts leave part of the picture empty.
  const double wanted = 8. * static_cast<double>(vertices);
  const int step =
      std::max(1, static_cast<int>(std::sqrt(static_cast<double>(in.area()) / wanted)));
  const auto [found, fresh] = reduced_.try_emplace({texture.picture.get(), codes, step});
  Image<Rgb>& out = found->second;
  if (!fresh) return out;
  out = Image<Rgb>((in.width() + step - 1) / step, (in.height() + step - 1) / step);
  const auto& srgb = linear_of_srgb();
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x) {
      Rgb sum, opaque_sum;
      float count = 0, opaque = 0;
      for (int j = y * step; j < std::min((y + 1) * step, in.height()); ++j)
        for (int i = x * step; i < std::min((x + 1) * step, in.width()); ++i, ++count) {
          const Rgba8& c = in.at(i, j);
          const Rgb linear{srgb[c.r], srgb[c.g], srgb[c.b]};
          const float alpha = static_cast<float>(c.a) / 255;
          sum += linear, opaque_sum += linear * alpha, opaque += alpha;
        }
      const bool by_alpha = codes == TexelCodes::kSrgbByAlpha && opaque > 0;
      out.at(x, y) = by_alpha ? opaque_sum * (1 / opaque) : sum * (1 / count);
    }
  return out;
}

Rgb MeanColours::sample(const Texture& texture, TexelCodes codes,
                        const std::array<glm::vec2, 2>& coordinates, std::size_t vertices) {
  const Image<Rgb>& image = reduced(texture, codes, vertices);
  const glm::vec2& uv = coordinates[static_cast<std::size_t>(texture.set)];
  const glm::vec2 place = texture.transform * glm::vec3(uv.x, uv.y, 1);
  return image.at(texel_at(place.x, image.width(), texture.wrap_s),
                  texel_at(place.y, image.height(), texture.wrap_t));
}

Rgb MeanColours::albedo(const Material& material, const std::array<glm::vec2, 2>& coordinates,
                        std::size_t vertices) {
  Rgb out = material.base_colour;
  const TexelCodes codes =
      material.alpha == Material::Alpha::kOpaque ? TexelCodes::kSrgb : TexelCodes::kSrgbByAlpha;
  if (material.base_colour_map)
    out = out * sample(material.base_colour_map, codes, coordinates, vertices);
  return out;
}

}  // namespace penumbra::prt::gltf
