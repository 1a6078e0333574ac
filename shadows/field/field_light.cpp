#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "core/conventions.h"
#include "core/parallel.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "shadows/field/internal/field_kernel.h"
#include "shadows/field/internal/triple_products.h"
#include "shadows/field/occlusion_field.h"
#include "shadows/field/planar_shadow.h"

namespace penumbra::shadows {

namespace {

// ------------------------------------------------------------------------------------- cosine

// The bands of the clamped cosine that are used. It has no third one: the fourth stands in its
// place.
constexpr int kLobeBands = 5;
constexpr int kLobeTerms = FieldLight::kLobeTerms;
static_assert(kLobeTerms == 9 + 9);

// Where coefficient n of a function stands among the lobe's; -1 where the cosine has none.
int lobe_term(int n) {
  return n < 9 ? n : n < 16 ? -1 : n < 25 ? n - 7 : -1;
}

// Y_n of five bands, `stride` values each, to the lobe's terms in place.
void close_ranks(auto* basis, int stride) {
  std::copy_n(basis + 16 * stride, 9 * stride, basis + 9 * stride);
}

float cosine_factor(int n) {
  return static_cast<float>(
      lighting::cosine_coefficient(static_cast<int>(std::sqrt(static_cast<double>(n) + .5))));
}

}  // namespace

// ------------------------------------------------------------------------------------- light

FieldLight::FieldLight(const RadianceSh& light, int field_bands)
    : light_(light), field_bands_(field_bands) {
  assert(field_bands >= 1 && field_bands <= kMaxFieldBands);
  const int values = coefficient_count(field_bands);
  const auto add = [&](int j, int n, float factor, const Rgb& l) {
    if (lobe_term(n) < 0) return;
    float* const at = &matrix_[static_cast<std::size_t>((j * kLobeTerms + lobe_term(n)) * 3)];
    for (int c = 0; c < 3; ++c) at[c] += factor * l[c];
  };
  for (const TripleTerm& t : TripleProducts::get().terms()) {
    if (t.i >= coefficient_count(kLobeBands)) break;
    if (t.j < values && t.k < light.size()) add(t.j, t.i, t.value * cosine_factor(t.i), light[t.k]);
  }
  for (int n = 0; n < light.size(); ++n) add(values, n, cosine_factor(n), light[n]);
}

Rgb FieldLight::deficit(std::span<const float> blocked, const glm::vec3& normal) const {
  assert(blocked.size() == static_cast<std::size_t>(coefficient_count(field_bands_)));
  double lobe[kLobeBands * kLobeBands];
  lighting::evaluate_basis(kLobeBands, normal, lobe);
  close_ranks(lobe, 1);
  double sum[3] = {};
  const float* m = matrix_.data();
  for (const float b : blocked)
    for (int i = 0; i < kLobeTerms; ++i)
      for (int c = 0; c < 3; ++c) sum[c] += lobe[i] * static_cast<double>(b * *m++);
  return {static_cast<float>(sum[0]), static_cast<float>(sum[1]), static_cast<float>(sum[2])};
}

RadianceSh FieldLight::seen_through(std::span<const float> blocked) const {
  assert(blocked.size() == static_cast<std::size_t>(coefficient_count(field_bands_)));
  RadianceSh out = light_;
  const int values = static_cast<int>(blocked.size());
  for (const TripleTerm& t : TripleProducts::get().terms()) {
    if (t.i >= light_.size()) break;
    if (t.j >= values || t.k >= light_.size()) continue;
    out[t.i] += light_[t.k] * (-t.value * blocked[static_cast<std::size_t>(t.j)]);
  }
  return out;
}

// ------------------------------------------------------------------------------------- ratios

// Sixteen receiver points, one in each lane.
class RatioBlock {
 public:
  RatioBlock(const OcclusionField& field, const FieldLight& light, const Pose& bake_from_world)
      : field_(field),
        light_(light),
        rotation_(bake_from_world.rotation_matrix()),
        translation_(bake_from_world.translation) {
    // The irradiance of a surface under the mean radiance alone is A_0 l_0 Y_0.
    const float of_mean = kMinIrradiance * static_cast<float>(std::sqrt(kPi) / 2);
    for (int c = 0; c < 3; ++c) min_[c] = of_mean * light.light_[0][c];
    std::fill_n(one_, kFieldLanes, 1.f);
  }

  void run(std::span<const glm::vec3> positions, std::span<const glm::vec3> normals,
           std::span<const Rgb> lights, std::span<Rgb> ratios, std::span<float> form_factors) {
    const int values = coefficient_count(field_.bands);
    look_up(positions, normals, static_cast<std::size_t>(values));
    const float* const matrix = light_.matrix_.data();
    alignas(64) float deficit[3 * kFieldLanes], open[3 * kFieldLanes];
    sum_bilinear(matrix, values, kLobeTerms, lobe_, blocked_, deficit);
    sum_bilinear(matrix + values * kLobeTerms * 3, 1, kLobeTerms, lobe_, one_, open);
    for (std::size_t p = 0; p < ratios.size(); ++p)
      for (int c = 0; c < 3; ++c) {
        const std::size_t at = static_cast<std::size_t>(c * kFieldLanes) + p;
        ratios[p][c] = ratio(deficit[at], open[at] + (lights.empty() ? 0 : lights[p][c]), min_[c]);
      }
    for (std::size_t p = 0; p < form_factors.size(); ++p) form_factors[p] = form_factor(p);
  }

 private:
  void look_up(std::span<const glm::vec3> positions, std::span<const glm::vec3> normals,
               std::size_t values) {
    float blocked[kMaxValues];
    for (std::size_t p = 0; p < positions.size(); ++p) {
      const glm::vec3 n = rotation_ * normals[p];
      x_[p] = n.x, y_[p] = n.y, z_[p] = n.z;
      blocked_at(field_, rotation_ * positions[p] + translation_, {blocked, values});
      for (std::size_t j = 0; j < values; ++j) blocked_[j * kFieldLanes + p] = blocked[j];
    }
    lighting::evaluate_basis_block(kLobeBands, x_, y_, z_, lobe_);
    close_ranks(lobe_, kFieldLanes);
  }

  // A_l Y_n b_n: an even light's triple products leave nothing else.
  float form_factor(std::size_t p) const {
    float sum = 0;
    for (int n = 0; n < coefficient_count(field_.bands); ++n)
      if (const int term = lobe_term(n); term >= 0)
        sum += cosine_factor(n) * lobe_[static_cast<std::size_t>(term) * kFieldLanes + p] *
               blocked_[static_cast<std::size_t>(n) * kFieldLanes + p];
    return sum > 0 && std::isfinite(sum) ? sum : 0;
  }

  static float ratio(float deficit, float open, float smallest) {
    if (!(smallest > 0 && open > smallest)) return 1;
    const float s = std::clamp(1 - deficit / open, 0.f, 1.5f);
    if (!std::isfinite(s)) return 1;
    const float t = std::min(1.f, open / smallest - 1);
    return 1 + (s - 1) * t * t * (3 - 2 * t);
  }

  const OcclusionField& field_;
  const FieldLight& light_;
  glm::mat3 rotation_;
  glm::vec3 translation_;
  float min_[3];
  alignas(64) float x_[kFieldLanes] = {}, y_[kFieldLanes] = {}, z_[kFieldLanes] = {};
  alignas(64) float one_[kFieldLanes];
  alignas(64) float blocked_[kMaxValues * kFieldLanes] = {};
  alignas(64) float lobe_[kLobeBands * kLobeBands * kFieldLanes];
};

Result<void> field_ratios(const OcclusionField& field, const FieldLight& light,
                          const Pose& bake_from_world, const FieldReceiver& receiver,
                          std::span<Rgb> ratios, std::span<float> form_factors) {
  const std::size_t points = receiver.positions.size();
  const bool lights = !receiver.distant_irradiance.empty();
  if (receiver.normals.size() != points || ratios.size() != points ||
      (lights && receiver.distant_irradiance.size() != points) ||
      (!form_factors.empty() && form_factors.size() != points))
    return fail(ErrorCode::kInvalid, "receiver", "has lists of different lengths");
  if (field.bands != light.field_bands())
    return fail(ErrorCode::kInvalid, "light", "belongs to an occlusion field with other bands");
  constexpr std::size_t kLanes = kFieldLanes, kBlocksPerTask = 64;
  const std::size_t blocks = (points + kLanes - 1) / kLanes;
  parallel_for(std::size_t{0}, blocks, kBlocksPerTask, [&](const auto& range) {
    RatioBlock block(field, light, bake_from_world);
    for (std::size_t b = range.begin(); b < range.end(); ++b) {
      const std::size_t first = b * kLanes, count = std::min(kLanes, points - first);
      const auto part = [&](auto span) { return span.empty() ? span : span.subspan(first, count); };
      block.run(part(receiver.positions), part(receiver.normals), part(receiver.distant_irradiance),
                part(ratios), part(form_factors));
    }
  });
  return {};
}

}  // namespace penumbra::shadows
