#include <algorithm>
#include <cmath>

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

// What one texel of another object's grid holds.
struct TexelSample {
  float coefficients[kMaxCoefficients];
  Rgb ratio;
};

// The nearest texel; false outside the other's grid.
bool sample(const prt::BakedObject& object, const PlanarShadow& shadow, glm::vec2 position,
            TexelSample& out) {
  const int size = object.receiver->grid.size;
  const glm::vec2 uv = object.receiver->grid.uv(position);
  if (!(uv.x >= 0 && uv.x < 1 && uv.y >= 0 && uv.y < 1)) return false;
  const int x = std::min(static_cast<int>(uv.x * static_cast<float>(size)), size - 1),
            y = std::min(static_cast<int>(uv.y * static_cast<float>(size)), size - 1);
  out.ratio = shadow.ratio.at(x, y);
  const prt::Transfer& t = object.ground_deficit;
  for (int n = 0; n < coefficient_count(t.bands); ++n)
    out.coefficients[n] = t.value(0, n, static_cast<std::size_t>(y * size + x));
  return true;
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

// Coefficients about another frame, red alone.
void rotate(const lighting::ShRotation& rotation, int bands, float* coefficients) {
  RadianceSh terms(bands);
  for (int n = 0; n < terms.size(); ++n) terms[n].r = coefficients[n];
  terms = rotation * terms;
  for (int n = 0; n < terms.size(); ++n) coefficients[n] = terms[n].r;
}

}  // namespace

void combine_shadows(const PlacedShadow& first, const PlacedShadow& second, PlanarShadow& out) {
  if (first.shadow->empty() || out.empty()) return;
  const prt::GroundGrid& grid = second.object->receiver->grid;
  const Pose first_from_second = first.world_from_bake.inverse() * second.world_from_bake;
  const glm::dmat3 turn = first_from_second.rotation_matrix();
  const int bands =
      std::min(first.object->ground_deficit.bands, second.object->ground_deficit.bands);
  const lighting::ShRotation rotation(glm::transpose(turn), bands);
  const bool turned = std::abs(turn[0].x - 1) > 1e-9;
  parallel_for(out.y0, out.y1, [&](int y) {
    TexelSample a, b;
    for (int x = out.x0; x < out.x1; ++x) {
      Rgb& s = out.ratio.at(x, y);
      const glm::vec2 p =
          grid.position({(static_cast<float>(x) + .5f) / static_cast<float>(grid.size),
                         (static_cast<float>(y) + .5f) / static_cast<float>(grid.size)});
      const glm::dvec3 at = first_from_second * glm::dvec3(p.x, grid.height, p.y);
      if (!sample(*first.object, *first.shadow, {at.x, at.z}, a) || a.ratio == Rgb{1, 1, 1})
        continue;
      sample(*second.object, *second.shadow, p, b);
      if (turned) rotate(rotation, bands, a.coefficients);
      const Overlap shared = overlap(a.coefficients, b.coefficients, coefficient_count(bands));
      for (int c = 0; c < 3; ++c) s[c] = without_common(a.ratio[c], s[c], shared);
    }
  });
}

}  // namespace penumbra::shadows
