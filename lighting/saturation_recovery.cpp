#include <fmt/format.h>

#include <Eigen/QR>
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

Result<void> check(const ShadowedSurface& surface) {
  const char* const where = "surface";
  if (!(std::abs(glm::dot(surface.normal, surface.normal) - 1) < 1e-3))
    return fail(ErrorCode::kInvalid, where, "has a normal that is not a unit vector");
  for (const ShadowRegion& region : surface.regions)
    if (!is_finite(region.radiance))
      return fail(ErrorCode::kNonFinite, where, "has a radiance that is not finite");
  const auto is_black = [](const ShadowRegion& r) {
    return !(std::min({r.radiance.r, r.radiance.g, r.radiance.b}) > 0);
  };
  if (!surface.albedo && std::ranges::any_of(surface.regions, is_black))
    return fail(ErrorCode::kUndetermined, where, "has a region that is black in one channel");
  if (!surface.albedo) return {};
  for (int c = 0; c < 3; ++c)
    if (const float albedo = (*surface.albedo)[c]; !(albedo > 0 && albedo <= 1))
      return fail(ErrorCode::kInvalid, where,
                  fmt::format("has an albedo of {}, which is not above 0 and at most 1", albedo));
  return {};
}

Rgb part_of(const ShadowRegion& region, const DistantLight& light) {
  const auto at = std::ranges::find(region.parts, light.id, &LightPart::source);
  return at == region.parts.end() ? Rgb{1, 1, 1} : at->part;
}

// Clipped lights that no shadow tells apart.
struct LightGroup {
  std::vector<bool> reaches;  // by region
  std::vector<const DistantLight*> lights;

  // In the mean of them.
  double part(const ShadowRegion& region, int channel) const {
    double sum = 0;
    for (const DistantLight* d : lights) sum += double(part_of(region, *d)[channel]);
    return sum / static_cast<double>(lights.size());
  }
};

// Of the lights that the surface sees.
std::vector<LightGroup> groups_of(const LightEstimate& light, const ShadowedSurface& surface) {
  constexpr float kHalf = .5f;
  std::vector<LightGroup> out;
  for (const DistantLight& d : light.lights) {
    if (!d.clipped || response(d, surface.normal) < kMinCosine) continue;
    std::vector<bool> reaches;
    for (const ShadowRegion& region : surface.regions)
      reaches.push_back(luminance(part_of(region, d)) > kHalf);
    const auto known = std::ranges::find(out, reaches, &LightGroup::reaches);
    if (known == out.end())
      out.push_back({std::move(reaches), {&d}});
    else
      known->lights.push_back(&d);
  }
  return out;
}

Rgb measured(const LightGroup& group, const glm::dvec3& normal) {
  Rgb sum;
  for (const DistantLight* d : group.lights) sum += irradiance(*d, normal);
  return sum;
}

// One channel's equations: what they seek are the irradiances by the groups, and 1/albedo where
// that is not known.
class ChannelEquations {
 public:
  ChannelEquations(const ShadowedSurface& surface, int channel, std::span<const LightGroup> groups,
                   double others)
      : lights_(std::ssize(groups)),
        a_(std::ssize(surface.regions), lights_ + (surface.albedo ? 0 : 1)),
        b_(std::ssize(surface.regions)) {
    // Errors count relative to what is seen; what things send into a shadow is known less well.
    constexpr double kDarkest = .1;
    double brightest = 1e-30;
    for (const ShadowRegion& region : surface.regions)
      brightest = std::max(brightest, double(region.radiance[channel]));
    for (std::ptrdiff_t g = 0; g < a_.rows(); ++g) {
      const ShadowRegion& region = surface.regions[static_cast<std::size_t>(g)];
      const double radiance = double(region.radiance[channel]),
                   weight = brightest / std::max(radiance, kDarkest * brightest);
      for (std::ptrdiff_t k = 0; k < lights_; ++k)
        a_(g, k) = weight * groups[static_cast<std::size_t>(k)].part(region, channel);
      b_(g) = -weight * (double(region.others[channel]) * others + double(region.beside[channel]));
      if (surface.albedo)
        b_(g) += weight * kPi * radiance / double((*surface.albedo)[channel]);
      else
        a_(g, lights_) = -weight * kPi * radiance;
    }
  }

  /// Nothing where they cannot be told apart. A group that comes out below nine tenths of what was
  /// measured of it counts as measured, and the others again; false in `any` where all do.
  std::optional<Eigen::VectorXd> solve(std::span<const double> measured, bool& any) const {
    std::vector<bool> known(static_cast<std::size_t>(lights_), false);
    while (true) {
      auto out = solve_unknown(measured, known);
      if (!out) return out;
      bool found = false;
      for (std::ptrdiff_t k = 0; k < lights_; ++k) {
        const auto at = static_cast<std::size_t>(k);
        if (known[at] || (*out)(k) >= kMinPower * measured[at]) continue;
        known[at] = found = true;
      }
      if (found) continue;
      any = std::ranges::find(known, false) != known.end();
      return out;
    }
  }

 private:
  std::optional<Eigen::VectorXd> solve_unknown(std::span<const double> measured,
                                               const std::vector<bool>& known) const {
    Eigen::MatrixXd a(a_.rows(), 0);
    Eigen::VectorXd b = b_, out = Eigen::VectorXd::Zero(a_.cols());
    std::vector<std::ptrdiff_t> sought;
    std::vector<double> scale;
    for (std::ptrdiff_t k = 0; k < a_.cols(); ++k) {
      if (k < lights_ && known[static_cast<std::size_t>(k)]) {
        out(k) = measured[static_cast<std::size_t>(k)];
        b -= a_.col(k) * out(k);
        continue;
      }
      const double length = a_.col(k).norm();
      if (!(length > 0)) return std::nullopt;
      a.conservativeResize(Eigen::NoChange, a.cols() + 1);
      a.rightCols(1) = a_.col(k) / length;
      sought.push_back(k), scale.push_back(length);
    }
    if (sought.empty()) return out;
    Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(a);
    constexpr double kApart = .02;  // less is noise
    qr.setThreshold(kApart);
    if (qr.rank() < a.cols()) return std::nullopt;
    const Eigen::VectorXd solved = qr.solve(b);
    for (std::size_t i = 0; i < sought.size(); ++i)
      out(sought[i]) = solved(static_cast<std::ptrdiff_t>(i)) / scale[i];
    return out;
  }

  std::ptrdiff_t lights_;
  Eigen::MatrixXd a_;
  Eigen::VectorXd b_;
};

// One group's irradiance among its lights. A sun that no camera sees takes what was not measured.
void divide(const LightGroup& group, const glm::dvec3& normal, Rgb all,
            std::vector<SaturationRecovery>& out) {
  const auto is_unseen = [](const DistantLight* d) { return d->id == kUnseenSun; };
  const auto is_sun = [](const DistantLight* d) { return d->radius <= kSunLike; };
  const bool unseen = std::ranges::any_of(group.lights, is_unseen),
             suns = std::ranges::any_of(group.lights, is_sun);
  std::vector<const DistantLight*> takers;
  Rgb measured;
  for (const DistantLight* d : group.lights) {
    const Rgb own = irradiance(*d, normal);
    if (unseen ? is_unseen(d) : !suns || is_sun(d))
      takers.push_back(d), measured += own;
    else
      all += own * -1.f;
  }
  for (const DistantLight* d : takers) {
    SaturationRecovery& recovery = out.emplace_back(d->id, power(*d), takers.size() > 1);
    for (int c = 0; c < 3; ++c) {
      const float missing = std::max(0.f, all[c]);
      if (is_unseen(d))
        recovery.power[c] = missing / static_cast<float>(response(*d, normal));
      else if (measured[c] > 0)
        recovery.power[c] *= missing / measured[c];
    }
  }
}

bool is_clipped(const LightEstimate& light, int id) {
  return std::ranges::any_of(light.lights,
                             [&](const DistantLight& d) { return d.clipped && d.id == id; });
}

}  // namespace

Result<ShadowRecovery> recover_from_shadows(const LightEstimate& light,
                                            const ShadowedSurface& surface) {
  PENUMBRA_TRY(check(surface));
  for (const ShadowRegion& region : surface.regions)
    for (const LightPart& part : region.parts)
      if (!is_clipped(light, part.source))
        return fail(ErrorCode::kInvalid, "surface",
                    fmt::format("names a part of light {}, which is not saturated", part.source));
  if (std::ranges::none_of(light.lights, &DistantLight::clipped))
    return fail(ErrorCode::kInvalid, "light", "has no saturated light");
  const std::vector<LightGroup> groups = groups_of(light, surface);
  if (groups.empty())
    return fail(ErrorCode::kUndetermined, "surface", "does not face a saturated light");
  const auto is_sought = [&](const DistantLight& d) {
    return std::ranges::any_of(groups, [&](const LightGroup& group) {
      return std::ranges::find(group.lights, &d) != group.lights.end();
    });
  };
  const Rgb others = irradiance_without(light, irradiance(light.light), surface.normal, is_sought);
  ShadowRecovery out{{}, surface.albedo.value_or(Rgb{})};
  std::vector<Rgb> by_group(groups.size());
  bool any = false;
  for (int c = 0; c < 3; ++c) {
    std::vector<double> bounds;
    for (const LightGroup& g : groups) bounds.push_back(double(measured(g, surface.normal)[c]));
    bool any_here = false;
    const auto solved =
        ChannelEquations(surface, c, groups, double(others[c])).solve(bounds, any_here);
    any |= any_here;
    if (!solved)
      return fail(ErrorCode::kUndetermined, "surface",
                  "has no shadows that tell its albedo and the saturated lights apart");
    for (std::size_t k = 0; k < groups.size(); ++k)
      by_group[k][c] = static_cast<float>((*solved)(static_cast<std::ptrdiff_t>(k)));
    if (surface.albedo) continue;
    const double inverse = (*solved)(std::ssize(groups));
    if (!(inverse > 0))
      return fail(ErrorCode::kUndetermined, "surface",
                  "has no light in the shadow to compare with");
    out.albedo[c] = static_cast<float>(1 / inverse);
  }
  if (!any)
    return fail(ErrorCode::kUndetermined, "surface",
                "shows none of the saturated light: it lies in shadow, or its albedo is another");
  for (std::size_t k = 0; k < groups.size(); ++k)
    divide(groups[k], surface.normal, by_group[k], out.powers);
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
  known->is_guess = recovery.is_guess;
  return {};
}

// In place of one that is gone, where there are too many.
RecoveryMemory::RecoveredLight& RecoveryMemory::add(const DistantLight& source,
                                                    std::span<const DistantLight> present) {
  RecoveredLight out{source.id, source.direction, {}, {}, source.solid_angle_sr(), std::nullopt,
                     false};
  const auto is_same_sun = [&](const RecoveredLight& k) {
    return k.radiance && (k.source == kUnseenSun) != (source.id == kUnseenSun) &&
           source.radius <= kSunLike &&
           glm::dot(k.direction, source.direction) > std::cos(kSunLike.value());
  };
  if (const auto same = std::ranges::find_if(known_, is_same_sun); same != known_.end())
    out.radiance = *same->radiance * static_cast<float>(same->solid_angle_sr / out.solid_angle_sr),
    out.is_guess = same->is_guess;
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
    source.recovered = !known->is_guess;
    if (residual != unused.end()) {
      *residual = completed(*residual, full * (1 - fraction));
      residual->recovered = source.recovered;
      known->in_harmonics = power(*residual);
    }
    changed = true;
  }
  if (changed)
    std::ranges::stable_sort(lights, std::greater<>(),
                             [](const DistantLight& d) { return luminance(power(d)); });
}

}  // namespace penumbra::lighting
