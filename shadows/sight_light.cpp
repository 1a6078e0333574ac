#include "shadows/sight_light.h"

#include <algorithm>
#include <cmath>

#include "core/parallel.h"
#include "shadows/disc_rays.h"

namespace penumbra::shadows {

namespace {

constexpr std::size_t kAtOnce = 1024;  // vertices

// Radians.
double rms_angle(const lighting::Disc& disc) {
  if (disc.shape.empty()) return disc.radius.value() / std::sqrt(2.);
  double sum = 0;
  for (const glm::dvec3& d : disc.shape)
    sum += std::pow(std::acos(std::clamp(glm::dot(d, disc.direction), -1., 1.)), 2);
  return std::sqrt(sum / static_cast<double>(disc.shape.size()));
}

// Whether another caster's sphere reaches between the object's and the disc.
bool others_between(std::span<const Caster> casters, const Caster& object,
                    const lighting::Disc& disc) {
  const BoundingSphere here = sphere_of(object);
  const double spread = largest_angle(disc);
  return std::ranges::any_of(casters, [&](const Caster& c) {
    if (is_same(c, object)) return false;
    const BoundingSphere other = sphere_of(c);
    const glm::dvec3 apart = other.centre - here.centre;
    const double far = glm::length(apart), both = here.radius + other.radius;
    return far <= both || std::acos(std::clamp(glm::dot(apart / far, disc.direction), -1., 1.)) <
                              std::asin(both / far) + spread;
  });
}

// Whether outlines are counted for vertices in the penumbra (OutlineGrid::has_lists), which is exact and costs no more: where the
// disc throws nothing on the object aside by an edge's length.
bool is_told_by_outlines(const Caster& object, const lighting::Disc& disc) {
  return 2 * double(object.outline->radius_m()) * std::tan(largest_angle(disc)) <
         double(object.outline->mean_length_m());
}

// Directions in the mesh's frame.
void aim(const Caster& object, const prt::Plane* plane, const lighting::Disc& disc,
         prt::SightTaps& out) {
  thread_local TapPattern pattern;  // grows once per thread
  pattern.make(disc, prt::SightTaps::kEach, kTurns);
  const glm::mat3 mesh_from_world = glm::transpose(object.world_from_mesh.rotation_matrix());
  out.clear();
  for (std::size_t turn = 0; turn < kTurns; ++turn)
    for (const glm::vec3& d : pattern.at(turn)) out.add(mesh_from_world * d, !behind(plane, d));
}

// Every direction farther from the middle, the farthest by `more`.
void widen(const lighting::Disc& disc, double more, lighting::Disc& out) {
  out = disc;
  out.radius = Radians{disc.radius.value() + more};
  const double times = 1 + more / largest_angle(disc);
  for (glm::dvec3& d : out.shape) {
    const double angle = std::acos(std::clamp(glm::dot(d, disc.direction), -1., 1.));
    const glm::dvec3 away = d - std::cos(angle) * disc.direction;
    const double length = glm::length(away);
    if (length > 0)
      d = std::cos(times * angle) * disc.direction + std::sin(times * angle) / length * away;
  }
}

}  // namespace

SightUse use_of_sight(const Casters& casters, const Caster& object, const lighting::Disc& disc,
                      int taps) {
  constexpr int kAsGood = 8;  // rays a vertex
  // RMS angles add up as squares: the disc looks less than a tenth wider.
  constexpr double kWideBeside = 2.5;
  if (!object.sight || taps == 1 || taps > kAsGood || is_told_by_outlines(object, disc) ||
      others_between(casters.virtual_things, object, disc) ||
      others_between(casters.real_things, object, disc))
    return SightUse::kNone;
  return rms_angle(disc) > kWideBeside * object.sight->sight().blur() ? SightUse::kAlone
                                                                      : SightUse::kScout;
}

void look_up(const Caster& object, const prt::Plane* plane, const lighting::Disc& disc,
             std::span<float> seen, std::span<float> open) {
  thread_local prt::SightTaps memory;  // grows once per thread
  prt::SightTaps& taps = memory;
  aim(object, plane, disc, taps);
  parallel_for(std::size_t{0}, seen.size(), kAtOnce, [&](const auto& part) {
    object.sight->look(taps, part.begin(), part.end(), seen, open);
  });
}

void scout(const Caster& object, const lighting::Disc& disc, std::vector<SightVerdict>& out) {
  constexpr double kFarEnough =
      1.6;  // of the blur; half as far: 3.8 instead of 2.6 % where it is sure (studio)
  thread_local lighting::Disc wide;  // grow once per thread
  thread_local std::vector<float> seen, open;
  widen(disc, kFarEnough * object.sight->sight().blur(), wide);
  const std::size_t count = object.mesh->positions.size();
  seen.resize(count), open.resize(count), out.resize(count);
  look_up(object, nullptr, wide, seen, open);
  constexpr float kRounding = 1e-5f;
  for (std::size_t i = 0; i < count; ++i)
    out[i] = open[i] <= 0                           ? SightVerdict::kTurnedAway
             : seen[i] <= 0                         ? SightVerdict::kDark
             : seen[i] >= open[i] * (1 - kRounding) ? SightVerdict::kLit
                                                    : SightVerdict::kMixed;
}

}  // namespace penumbra::shadows
