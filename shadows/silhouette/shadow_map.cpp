#include "shadows/silhouette/shadow_map.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/threads/scratch.h"
#include "shadows/silhouette/internal/projected_shadow.h"
#include "shadows/silhouette/internal/silhouette_segments.h"
#include "shadows/silhouette/light_rays.h"
#include "shadows/silhouette/place_kernel.h"
#include "shadows/silhouette/projection_kernel.h"
#include "shadows/silhouette/silhouette_cache.h"
#include "shadows/silhouette/silhouette_mesh.h"

namespace penumbra::shadows {

namespace {

constexpr double kLongest = 10;  // radii of the caster: longest shadow
// Of a sample's elevation: lower ones cast their shadow like this one.
constexpr double kMinSine = .02;
static_assert(kMaxSamples <= kMaxDirections);
constexpr int kRim = 2;  // cells around what is drawn

using PlaneSamples = std::pmr::vector<PlaneSample>;

// Wide penumbras show their directions, and hide cells.
struct MapDetail {
  int samples, size;
};
MapDetail detail_for(const lighting::DistantLight& source, const ShadowMapOptions& options) {
  if (!is_wide(source)) return {options.samples, options.size};
  constexpr int kFewest = 4, kFewestCells = 4 * kRim;
  const int samples = std::min(kMaxSamples, 4 * options.samples);
  const double cells = .625 * .5 * (1 + options.resolution_scale) * options.size;
  return {std::max(kFewest, static_cast<int>(options.resolution_scale * samples)),
          std::max(kFewestCells, static_cast<int>(cells))};
}

// Bounds of the casters' shadow in the plane frame.
struct Extent {
  glm::dvec2 low{1e30}, high{-1e30};
  bool cut = false;  // the shadow goes on beyond high.x
  bool empty() const { return low.x >= high.x || low.y >= high.y; }
};

// Samples below the horizon bring no light and take none.
PlaneSamples samples_over(std::span<const glm::vec3> directions, const glm::dmat3& plane_from_world,
                          std::pmr::memory_resource* memory) {
  PlaneSamples out(memory);
  float all = 0;
  for (const glm::vec3& direction : directions) {
    const glm::dvec3 d = plane_from_world * glm::dvec3(direction);
    if (d.y <= 0) continue;
    const auto cosine = static_cast<float>(d.y);
    out.push_back({-glm::dvec2(d.x, d.z) / std::max(d.y, kMinSine), cosine});
    all += cosine;
  }
  for (PlaneSample& t : out) t.weight /= all;
  return out;
}

// Where the shadow of a point at height one lies, over all samples.
Extent reach_of(std::span<const PlaneSample> samples) {
  Extent reach;
  for (const PlaneSample& t : samples) {
    reach.low = glm::min(reach.low, t.shift);
    reach.high = glm::max(reach.high, t.shift);
  }
  return reach;
}

// Where something that is in part below the plane goes through it.
void add_cuts(const Caster& caster, const AffineTransform& placing, Footprint& out) {
  const auto place = [&](std::uint32_t vertex) {
    return placing.turn * caster.mesh->positions[vertex] + placing.shift;
  };
  for (const SilhouetteMesh::Edge& e : caster.silhouette->edges()) {
    const glm::vec3 a = place(e.from), b = place(e.to);
    if ((a.y < 0) == (b.y < 0)) continue;
    const glm::vec3 cut = glm::mix(a, b, a.y / (a.y - b.y));
    const glm::vec2 foot(cut.x, cut.z);
    for (glm::vec2* low : {&out.low, &out.shadow_low}) *low = glm::min(*low, foot);
    for (glm::vec2* high : {&out.high, &out.shadow_high}) *high = glm::max(*high, foot);
  }
}

Extent shadow_extent(std::span<const Caster> casters, float near_m, const Pose& plane_from_world,
                     const Extent& reach) {
  Extent all;
  for (const Caster& caster : casters) {
    const Pose place = plane_from_world * caster.world_from_mesh;
    const AffineTransform placing{glm::mat3(place.rotation_matrix()), glm::vec3(place.translation)};
    Footprint f = footprint_of(caster.mesh->positions, placing,
                               {glm::vec2(reach.low), glm::vec2(reach.high)}, near_m);
    if (f.below) add_cuts(caster, placing, f);
    if (f.shadow_low.x >= f.shadow_high.x || f.shadow_low.y >= f.shadow_high.y) continue;
    const double longest = kLongest * caster.silhouette->radius_m();
    all.cut |= f.shadow_high.x > f.high.x + longest;
    all.low = glm::min(all.low, glm::max(glm::dvec2(f.shadow_low), glm::dvec2(f.low) - longest));
    all.high =
        glm::max(all.high, glm::min(glm::dvec2(f.shadow_high), glm::dvec2(f.high) + longest));
  }
  return all;
}

// Nothing may end abruptly: a shadow that is cut off runs out over the last fifth.
void fade_end(Image<float>& map) {
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      const float t = std::min(
          1.f, 5 * static_cast<float>(map.width() - 1 - x) / static_cast<float>(map.width()));
      map.at(x, y) *= t * t * (3 - 2 * t);
    }
}

void clear_rim(Image<float>& map) {
  for (int y = 0; y < map.height(); ++y) map.at(0, y) = map.at(map.width() - 1, y) = 0;
  for (int x = 0; x < map.width(); ++x) map.at(x, 0) = map.at(x, map.height() - 1) = 0;
}

// How a plane lies to a light, and the light's directions.
struct Setting {
  Pose world_from_plane;  // x away from the light
  PlaneSamples samples;
  DirectionCone around;
  Extent reach;
};

std::optional<Setting> set_up(const prt::Plane& plane, const lighting::DistantLight& source,
                              int samples, std::pmr::memory_resource* memory) {
  // Any direction will do under a light at the zenith.
  const double sine = glm::dot(plane.normal, source.direction);
  glm::dvec3 away = sine * plane.normal - source.direction;
  if (glm::length(away) < 1e-6)
    away = glm::cross(plane.normal,
                      std::abs(plane.normal.x) < .9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 0, 1));
  away = glm::normalize(away);
  const glm::dmat3 axes(away, plane.normal, glm::cross(away, plane.normal));
  thread_local SamplePattern pattern;  // grows once per thread
  pattern.make(source, samples, 1);
  PlaneSamples above = samples_over(pattern.at(0), glm::transpose(axes), memory);
  if (above.empty()) return std::nullopt;
  const Extent reach = reach_of(above);
  // Low samples are bent up by so much.
  const double bent = sine < std::sin(largest_angle(source)) + kMinSine ? std::asin(kMinSine) : 0;
  return Setting{
      {glm::quat_cast(axes), plane.point}, std::move(above), cone_of(source, bent), reach};
}

void draw(const ShadowCasters& casters, const Setting& setting, const Extent& e, int size,
          ShadowMap& out) {
  const glm::dvec2 lengths = e.high - e.low;
  const double cell = std::max(lengths.x, lengths.y) / (size - 2 * kRim);
  const auto nodes = [&](double length) {
    return static_cast<int>(std::ceil(length / cell + 2 * kRim)) + 1;
  };
  out.cell_m = static_cast<float>(cell);
  out.world_from_map = setting.world_from_plane *
                       Pose{{1, 0, 0, 0}, {e.low.x - kRim * cell, 0, e.low.y - kRim * cell}};
  out.virtual_occlusion.reset(nodes(lengths.x), nodes(lengths.y));
  if (!casters.real_things.empty())
    out.real_occlusion.reset(out.virtual_occlusion.width(), out.virtual_occlusion.height());
  const NodeGrid grid{out.world_from_map, out.cell_m,
                      static_cast<float>(out.virtual_occlusion.width()),
                      static_cast<float>(out.virtual_occlusion.height())};
  add_projected_shadows(casters, grid, {setting.samples, setting.around}, cache_of(casters),
                        out.virtual_occlusion, out.real_occlusion);
  if (e.cut) fade_end(out.virtual_occlusion);
  clear_rim(out.virtual_occlusion);
}

void clear(ShadowMap& out) {
  out.virtual_occlusion.reset(0, 0);
  out.real_occlusion.reset(0, 0);
}

Extent united(const Extent& a, const Extent& b) {
  return {glm::min(a.low, b.low), glm::max(a.high, b.high), a.cut || b.cut};
}

bool overlap(const Extent& a, const Extent& b) {
  return a.low.x < b.high.x && b.low.x < a.high.x && a.low.y < b.high.y && b.low.y < a.high.y;
}

}  // namespace

void render_real_shadow_map(const ShadowCasters& casters, std::span<const Neighbourhood> around,
                            const prt::Plane& plane, const lighting::DistantLight& source,
                            const ShadowMapOptions& options, ShadowMap& out) {
  clear(out);
  if (around.empty()) return;
  const Scratch::Scope scope;
  const auto [samples, size] = detail_for(source, options);
  const auto setting = set_up(plane, source, samples, scope.memory());
  if (!setting) return;
  const Pose plane_from_world = setting->world_from_plane.inverse();
  Extent e;
  for (const Neighbourhood& n : around) {
    const glm::dvec3 p = plane_from_world * n.centre;
    e.low = glm::min(e.low, glm::dvec2(p.x, p.z) - n.radius);
    e.high = glm::max(e.high, glm::dvec2(p.x, p.z) + n.radius);
  }
  draw({casters.real_things, {}, casters.near_m, casters.cache}, *setting, e, size, out);
}

void render_shadow_maps(const ShadowCasters& casters, const prt::Plane& plane,
                        const lighting::DistantLight& source, const ShadowMapOptions& options,
                        std::vector<ShadowMap>& out) {
  for (ShadowMap& shadow : out) clear(shadow);
  if (casters.virtual_things.empty()) return;
  const Scratch::Scope scope;
  const auto [samples, size] = detail_for(source, options);
  const auto setting = set_up(plane, source, samples, scope.memory());
  if (!setting) return;
  // A group's casters in one row, so that each map draws its own alone.
  struct CasterRow {
    Extent extent;
    std::pmr::vector<Caster> casters;
  };
  std::pmr::vector<CasterRow> groups(scope.memory());
  for (const Caster& caster : casters.virtual_things) {
    const Extent e = shadow_extent({&caster, 1}, casters.near_m,
                                   setting->world_from_plane.inverse(), setting->reach);
    if (e.empty()) continue;
    CasterRow group{e, std::pmr::vector<Caster>({caster}, scope.memory())};
    // A rectangle that grew may meet others that it had passed.
    for (std::size_t i = 0; i < groups.size();) {
      if (!overlap(groups[i].extent, group.extent)) {
        ++i;
        continue;
      }
      group.extent = united(groups[i].extent, group.extent);
      group.casters.insert(group.casters.end(), groups[i].casters.begin(), groups[i].casters.end());
      groups.erase(groups.begin() + static_cast<std::ptrdiff_t>(i));
      i = 0;
    }
    groups.push_back(std::move(group));
  }
  if (out.size() < groups.size()) out.resize(groups.size());
  for (std::size_t i = 0; i < groups.size(); ++i)
    draw({groups[i].casters, casters.real_things, casters.near_m, casters.cache}, *setting,
         groups[i].extent, size, out[i]);
}

}  // namespace penumbra::shadows
