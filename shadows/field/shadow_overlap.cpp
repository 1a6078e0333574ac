#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <glm/ext/vector_int2.hpp>

#include "core/half.h"
#include "core/threads/parallel.h"
#include "lighting/sh/rotation.h"
#include "prt/bake/bake.h"
#include "prt/geometry/receiver.h"
#include "prt/transfer/transfer.h"
#include "shadows/field/planar_shadow.h"

namespace penumbra::shadows {

namespace {

// `s` of the first object below which the second cannot be divided out
constexpr float kDarkest = .02f;

// What the object takes at a texel, by coefficient, of its first channel.
void read_deficit(const prt::BakedObject& object, glm::ivec2 texel, int count, float* out) {
  const prt::Transfer& t = object.ground_deficit;
  const std::uint16_t* from =
      &t.values[static_cast<std::size_t>(texel.y * object.receiver->grid.size + texel.x)];
  for (int n = 0; n < count; ++n, from += t.stride) out[n] = float_from_half(*from);
}

// Fraction of b's blocked directions that a blocks too, and the other way round: <a,b>/<b,b> would
// be exact for visibilities of 0 and 1.
struct Overlap {
  float of_a, of_b;
};

Overlap overlap(const float* a, const float* b, int count) {
  float ab = 0, aa = 0, bb = 0;
  for (int n = 0; n < count; ++n) ab += a[n] * b[n], aa += a[n] * a[n], bb += b[n] * b[n];
  const auto fraction = [&](float square) {
    return square > 0 ? std::clamp(ab / square, 0.f, 1.f) : 0.f;
  };
  return {fraction(aa), fraction(bb)};
}

// The second ratio so that its product with the first counts once what both take, or both bring.
float without_common(float first, float second, const Overlap& shared) {
  const float a = 1 - first, b = 1 - second;
  if (a * b <= 0 || first < kDarkest) return second;  // one takes what the other brings
  const float size_a = std::abs(a), size_b = std::abs(b);
  // Both estimates of the common part agree for even light; either keeps inside the proven
  // interval.
  const float largest = std::min(size_a, size_b),
              smallest = std::min(std::max(0.f, a + b - 1), largest);
  const float common =
      std::clamp(.5f * (shared.of_a * size_a + shared.of_b * size_b), smallest, largest);
  return std::max(0.f, (1 - (a + b - std::copysign(common, a))) / first);
}

// Coefficients of one channel about another frame, for thousands of texels.
class TexelRotation {
 public:
  TexelRotation(const glm::dmat3& turn, int bands) : bands_(bands) {
    const lighting::ShRotation rotation(turn, bands);
    float* to = entries_.data();
    for (int l = 0; l < bands; ++l)
      for (int m = -l; m <= l; ++m)
        for (int n = -l; n <= l; ++n) *to++ = static_cast<float>(rotation.entry(l, m, n));
  }

  void apply(float* coefficients) const {
    float turned[kMaxCoefficients] = {};
    const float* entry = entries_.data();
    float* to = turned;
    for (int l = 0; l < bands_; ++l)
      for (int m = -l; m <= l; ++m, ++to) {
        const float* from = coefficients + l * l;
        *to = 0;
        for (int n = 0; n < 2 * l + 1; ++n) *to += *entry++ * from[n];
      }
    std::copy(turned, to, coefficients);
  }

 private:
  int bands_;
  std::array<float, kMaxBands*(4 * kMaxBands * kMaxBands - 1) / 3> entries_;  // band by band
};

}  // namespace

void combine_shadows(const PlacedShadow& first, const PlacedShadow& second, PlanarShadow& out) {
  if (first.shadow->empty() || out.empty()) return;
  const prt::GroundGrid& grid = second.object->receiver->grid;
  const Pose first_from_second = first.world_from_bake.inverse() * second.world_from_bake;
  const glm::dmat3 turn = first_from_second.rotation_matrix();
  const int bands =
      std::min(first.object->ground_deficit.bands, second.object->ground_deficit.bands);
  const TexelRotation rotation(glm::transpose(turn), bands);
  const bool turned = std::abs(turn[0].x - 1) > 1e-9;
  const int count = coefficient_count(bands);
  parallel_for(out.y0, out.y1, [&](int y) {
    float a[kMaxCoefficients] = {}, b[kMaxCoefficients] = {};
    for (int x = out.x0; x < out.x1; ++x) {
      const glm::vec2 p =
          grid.position({(static_cast<float>(x) + .5f) / static_cast<float>(grid.size),
                         (static_cast<float>(y) + .5f) / static_cast<float>(grid.size)});
      const glm::dvec3 at = first_from_second * glm::dvec3(p.x, grid.height, p.y);
      const auto texel = texel_at(first.object->receiver->grid, {at.x, at.z});
      if (!texel) continue;
      const Rgb taken = first.shadow->ratio.at(texel->x, texel->y);
      if (taken == Rgb{1, 1, 1}) continue;
      read_deficit(*first.object, *texel, count, a);
      if (turned) rotation.apply(a);
      read_deficit(*second.object, {x, y}, count, b);
      const Overlap shared = overlap(a, b, count);
      Rgb& s = out.ratio.at(x, y);
      for (int c = 0; c < 3; ++c) s[c] = without_common(taken[c], s[c], shared);
    }
  });
}

}  // namespace penumbra::shadows
