#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/saturation_recovery.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"

namespace penumbra::lighting {

namespace {

constexpr double kMinCosine = .05;  // mean over a light, of a surface that sees it
constexpr double kMinPower = .9;    // of the measured lower bound: noise of the patches
constexpr std::size_t kMaxKnown = 16;

Rgb power(const DistantLight& source) {
  return source.radiance * static_cast<float>(source.solid_angle_sr());
}

// Irradiance by a light of power 1.
double response(DistantLight source, const glm::dvec3& normal) {
  source.radiance = {1, 1, 1};
  return double(irradiance(source, normal).r) / source.solid_angle_sr();
}

// By everything but the lights that `left_out` names.
template <class LeftOut>
Rgb irradiance_without(const LightEstimate& light, const IrradianceSh& residual,
                       const glm::dvec3& normal, LeftOut left_out) {
  Rgb sum = evaluate(residual, normal);
  for (const DistantLight& d : light.lights)
    if (!std::invoke(left_out, d)) sum += irradiance(d, normal);
  return sum;
}

Result<void> check(const ReflectancePatch& patch) {
  const char* const where = "patch";
  if (!(std::abs(glm::dot(patch.normal, patch.normal) - 1) < 1e-3))
    return fail(ErrorCode::kInvalid, where, "has a normal that is not a unit vector");
  if (!is_finite(patch.radiance))
    return fail(ErrorCode::kNonFinite, where, "has a radiance that is not finite");
  for (int c = 0; c < 3; ++c)
    if (!(patch.albedo[c] > 0 && patch.albedo[c] <= 1))
      return fail(
          ErrorCode::kInvalid, where,
          fmt::format("has an albedo of {}, which is not above 0 and at most 1", patch.albedo[c]));
  return {};
}

// All that is missing, since nothing was measured of the sun. It may be behind a cloud.
std::vector<SaturationRecovery> recover_unseen(const LightEstimate& light, const DistantLight& sun,
                                               const ReflectancePatch& patch) {
  const double seen = response(sun, patch.normal);
  const Rgb others = irradiance_without(light, irradiance(light.light), patch.normal,
                                        [&](const DistantLight& d) { return &d == &sun; });
  SaturationRecovery out{sun.id, {}};
  for (int c = 0; c < 3; ++c) {
    const float missing = static_cast<float>(kPi) * patch.radiance[c] / patch.albedo[c] - others[c];
    out.power[c] = std::max(0.f, missing / static_cast<float>(seen));
  }
  return {out};
}

}  // namespace

Result<std::vector<SaturationRecovery>> recover_jointly(const LightEstimate& light,
                                                        const ReflectancePatch& patch) {
  PENUMBRA_TRY(check(patch));
  const auto unseen = std::ranges::find(light.lights, kUnseenSun, &DistantLight::id);
  if (unseen != light.lights.end() && response(*unseen, patch.normal) >= kMinCosine)
    return recover_unseen(light, *unseen, patch);
  const auto is_sun = [](const DistantLight& d) { return d.clipped && d.radius <= kSunLike; };
  const bool suns = std::ranges::any_of(light.lights, is_sun);
  const auto fractions = [&](const DistantLight& d) { return suns ? is_sun(d) : d.clipped; };
  const Rgb others = irradiance_without(light, irradiance(light.light), patch.normal, fractions);
  std::vector<SaturationRecovery> out;
  Rgb measured;
  double nearest = 0;
  for (const DistantLight& d : light.lights) {
    if (!fractions(d)) continue;
    measured += irradiance(d, patch.normal);
    nearest = std::max(nearest, response(d, patch.normal));
    out.push_back({d.id, power(d)});
  }
  if (out.empty()) return fail(ErrorCode::kInvalid, "light", "has no saturated light");
  if (nearest < kMinCosine)
    return fail(ErrorCode::kUndetermined, "surface", "does not face a saturated light");
  Rgb factor;
  for (int c = 0; c < 3; ++c) {
    const float missing = static_cast<float>(kPi) * patch.radiance[c] / patch.albedo[c] - others[c];
    factor[c] = measured[c] > 0 ? std::max(0.f, missing / measured[c]) : 1;
  }
  for (SaturationRecovery& recovery : out) recovery.power = recovery.power * factor;
  if (!(luminance(out[0].power) > 0))
    return fail(ErrorCode::kUndetermined, "surface",
                "shows none of the saturated light: it lies in shadow, or its albedo is another");
  return out;
}

Result<SaturationRecovery> recover_from_shadow(const LightEstimate& light, int source,
                                               const ShadowEdge& edge) {
  const auto at = std::ranges::find_if(
      light.lights, [&](const DistantLight& d) { return d.clipped && d.id == source; });
  if (at == light.lights.end())
    return fail(ErrorCode::kInvalid, "shadow edge",
                fmt::format("is of light {}, which is not saturated", source));
  if (!(std::abs(glm::dot(edge.normal, edge.normal) - 1) < 1e-3))
    return fail(ErrorCode::kInvalid, "shadow edge", "has a normal that is not a unit vector");
  if (!is_finite(edge.lit) || !is_finite(edge.shadowed))
    return fail(ErrorCode::kNonFinite, "shadow edge", "has a radiance that is not finite");
  for (int c = 0; c < 3; ++c)
    if (!(edge.shadowed[c] > 0))
      return fail(ErrorCode::kUndetermined, "shadow edge",
                  "has a shadow that is black in one channel");
  if (!(luminance(edge.lit) > luminance(edge.shadowed)))
    return fail(ErrorCode::kUndetermined, "shadow edge",
                "has a lit side that is not brighter than the shadow");
  const double seen = response(*at, edge.normal);
  if (seen < kMinCosine)
    return fail(ErrorCode::kUndetermined, "shadow edge",
                fmt::format("lies on a surface that does not face saturated light {}", source));
  const Rgb others = irradiance_without(light, irradiance(light.light), edge.normal,
                                        [&](const DistantLight& d) { return &d == &*at; });
  SaturationRecovery out{source, {}};
  for (int c = 0; c < 3; ++c)
    out.power[c] = std::max(0.f, others[c] *
                                     (edge.others_at_shadowed[c] * edge.lit[c] / edge.shadowed[c] -
                                      edge.others_at_lit[c]) /
                                     static_cast<float>(seen));
  if (!(luminance(out.power) > 0))
    return fail(ErrorCode::kUndetermined, "shadow edge",
                "has no light in the shadow to compare with");
  return out;
}

DistantLight unseen_sun(const glm::dvec3& direction) {
  return {.id = kUnseenSun,
          .direction = direction,
          .radius = kSunRadius,
          .radiance = {},
          .clipped = true};
}

DistantLight completed(const DistantLight& measured, const Rgb& power) {
  DistantLight out = measured;
  const double solid_angle = measured.solid_angle_sr();
  for (int c = 0; c < 3; ++c)
    out.radiance[c] = std::max(measured.radiance[c], power[c] / static_cast<float>(solid_angle));
  if (measured.radius > kSunLike) return out;
  out.shape.clear();
  out.radius = kSunRadius;
  out.radiance = out.radiance * static_cast<float>(solid_angle / out.solid_angle_sr());
  return out;
}

RecoveryMemory::RecoveredLight* RecoveryMemory::find(int source) {
  const auto at = std::ranges::find(known_, source, &RecoveredLight::source);
  return at == known_.end() ? nullptr : &*at;
}

Result<void> RecoveryMemory::remember(const SaturationRecovery& recovery) {
  const auto where = fmt::format("light {}", recovery.source);
  RecoveredLight* const known = find(recovery.source);
  if (known == nullptr) return fail(ErrorCode::kInvalid, where, "is not a saturated light");
  if (!is_finite(recovery.power))
    return fail(ErrorCode::kNonFinite, where, "has a recovered power that is not finite");
  const Rgb whole = recovery.power + known->in_harmonics;
  const float smallest = luminance(known->power), now = luminance(whole);
  if (!(now >= static_cast<float>(kMinPower) * smallest))
    return fail(ErrorCode::kUndetermined, where,
                fmt::format("has a recovered power of {:.3g}, which is below the measured {:.3g}",
                            now, smallest));
  known->radiance = whole * static_cast<float>(1 / known->solid_angle_sr);
  return {};
}

// In place of one that is gone, where there are too many.
RecoveryMemory::RecoveredLight& RecoveryMemory::add(const DistantLight& source,
                                                    std::span<const DistantLight> present) {
  RecoveredLight out{source.id, source.direction, {}, {}, source.solid_angle_sr(), std::nullopt};
  const auto is_same_sun = [&](const RecoveredLight& k) {
    return k.radiance && (k.source == kUnseenSun) != (source.id == kUnseenSun) &&
           source.radius <= kSunLike &&
           glm::dot(k.direction, source.direction) > std::cos(kSunLike.value());
  };
  if (const auto same = std::ranges::find_if(known_, is_same_sun); same != known_.end())
    out.radiance = *same->radiance * static_cast<float>(same->solid_angle_sr / out.solid_angle_sr);
  if (known_.size() >= kMaxKnown) {
    const auto gone = std::ranges::find_if(known_, [&](const RecoveredLight& k) {
      return std::ranges::find(present, k.source, &DistantLight::id) == present.end();
    });
    known_.erase(gone == known_.end() ? known_.begin() : gone);
  }
  return known_.emplace_back(out);
}

void RecoveryMemory::apply(std::vector<DistantLight>& lights, std::span<DistantLight> unused) {
  bool changed = false;
  for (DistantLight& source : lights) {
    if (!source.clipped) {
      std::erase_if(known_, [&](const RecoveredLight& k) { return k.source == source.id; });
      continue;
    }
    // A light that is fading in is in two parts.
    const auto residual = std::ranges::find(unused, source.id, &DistantLight::id);
    const Rgb left = residual == unused.end() ? Rgb{} : power(*residual),
              whole = power(source) + left;
    RecoveredLight* known = find(source.id);
    if (known == nullptr) known = &add(source, lights);
    known->direction = source.direction;
    known->power = whole;
    known->in_harmonics = left;
    known->solid_angle_sr = source.solid_angle_sr();
    if (!known->radiance) continue;
    const Rgb full = *known->radiance * static_cast<float>(known->solid_angle_sr);
    const float fraction = luminance(whole) > 0 ? luminance(power(source)) / luminance(whole) : 1;
    source = completed(source, full * fraction);
    source.recovered = true;
    if (residual != unused.end()) {
      *residual = completed(*residual, full * (1 - fraction));
      residual->recovered = true;
      known->in_harmonics = power(*residual);
    }
    changed = true;
  }
  if (changed)
    std::ranges::stable_sort(lights, std::greater<>(),
                             [](const DistantLight& d) { return luminance(power(d)); });
}

}  // namespace penumbra::lighting
