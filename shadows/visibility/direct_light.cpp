#include "shadows/visibility/direct_light.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/threads/parallel.h"
#include "core/threads/scratch.h"
#include "prt/transfer/visibility_map.h"
#include "shadows/silhouette/light_rays.h"
#include "shadows/silhouette/place_kernel.h"
#include "shadows/visibility/internal/shadow_edge.h"
#include "shadows/visibility/internal/vertex_smoothing.h"
#include "shadows/visibility/internal/visibility_light.h"

namespace penumbra::shadows {

namespace {

// By vertex, over the directions that were asked for it.
using Sums = std::vector<prt::CosineSums>;

constexpr int kOpenSamples = 16;  // of the whole light, for the cosine of an open vertex

// Whether some of a light may be behind the plane: then how much is a question for all of its
// directions.
bool is_cut(const prt::Plane* plane, const lighting::DistantLight& source) {
  return plane && glm::dot(plane->normal, source.direction) <= std::sin(largest_angle(source));
}

// Those that are not behind the plane.
std::span<const glm::vec3> before(const prt::Plane* plane, std::span<const glm::vec3> directions,
                                  std::span<glm::vec3> memory) {
  const auto end = std::ranges::copy_if(directions, memory.begin(), [&](const auto& d) {
                     return !behind(plane, d);
                   }).out;
  return memory.first(static_cast<std::size_t>(end - memory.begin()));
}

// A light's directions in the normals' frame. Of one that casts hard shadows its middle, as long
// as the mean of all is: what faces all of the light has its light, and where the middle sets the
// light is zero.
class UnoccludedLight {
 public:
  UnoccludedLight(std::span<const glm::vec3> directions, const glm::vec3& middle,
                  const glm::mat3& normals_from_world, bool hard)
      : spread_{{}, normals_from_world * middle, glm::vec3(0), 0} {
    for (std::size_t k = 0; k < directions.size(); ++k) {
      directions_[k] = normals_from_world * directions[k];
      spread_.mean += directions_[k] / static_cast<float>(directions.size());
      spread_.reach = std::max(spread_.reach, glm::distance(directions_[k], spread_.middle));
    }
    spread_.directions = std::span(directions_).first(directions.size());
    if (!hard) return;
    spread_.mean = spread_.middle = glm::length(spread_.mean) * spread_.middle;
    directions_[0] = spread_.mean;
    spread_.reach = 0;
    spread_.directions = spread_.directions.first(1);
  }
  UnoccludedLight(const UnoccludedLight&) = delete;
  UnoccludedLight& operator=(const UnoccludedLight&) = delete;
  /// Mean cosines of all of the light.
  void light(std::span<const glm::vec3> normals, std::span<float> out) const {
    mean_cosines(normals, spread_, out);
  }

 private:
  std::array<glm::vec3, kMaxSamples> directions_;
  DirectionSet spread_;
};

// Lambert's law over a light on the vertices of a mesh: rays, and what of them arrives.
class VertexTracer {
 public:
  VertexTracer(const RayOccluders& occluders, const prt::Mesh& mesh, const Pose& world_from_mesh,
               const prt::Plane* plane, const SamplePattern& pattern)
      : occluders_(occluders),
        mesh_(mesh),
        plane_(plane),
        pattern_(pattern),
        turn_(world_from_mesh.rotation_matrix()),
        shift_(world_from_mesh.translation) {}

  glm::vec3 normal(std::size_t vertex) const { return turn_ * mesh_.normals[vertex]; }
  /// Of all samples, with nothing in their way.
  float open(std::size_t vertex) const {
    const glm::vec3 n = normal(vertex);
    float sum = 0;
    for (const glm::vec3& d : pattern_.at(vertex))
      if (!behind(plane_, d)) sum += std::max(0.f, glm::dot(n, d));
    return sum;
  }

  /// How many different ones of its samples may bring a vertex light.
  std::uint8_t directions(std::size_t vertex) const {
    return static_cast<std::uint8_t>(pattern_.count_before(vertex, normal(vertex)));
  }

  /// Adds samples [first, last) of the vertices, as far as they are before the plane, to the sums
  /// of cosines.
  void trace(std::span<const std::uint32_t> vertices, std::size_t first, std::size_t last,
             Sums& sums) const {
    parallel_for(std::size_t{0}, vertices.size(), 1024, [&](const auto& part) {
      Packets packets(occluders_, [&](std::size_t i, float weight, bool by_virtual, bool by_real) {
        if (!by_virtual && !by_real) sums[i].seen += weight;
      });
      for (const std::uint32_t i : vertices.subspan(part.begin(), part.size())) {
        const glm::vec3 n = normal(i);
        const glm::vec3 o = origin(i, n);
        for (const glm::vec3& d : pattern_.at(i).subspan(first, last - first)) {
          const float cosine = glm::dot(n, d);
          if (cosine <= 0 || behind(plane_, d)) continue;
          sums[i].open += cosine;
          packets.add(i, cosine, o, d);
        }
      }
    });
  }

 private:
  glm::vec3 origin(std::size_t vertex, const glm::vec3& n) const {
    return turn_ * mesh_.positions[vertex] + shift_ + occluders_.near_m * n;
  }

  const RayOccluders& occluders_;
  const prt::Mesh& mesh_;
  const prt::Plane* plane_;
  const SamplePattern& pattern_;
  glm::mat3 turn_;
  glm::vec3 shift_;
};

// kInside for vertices that agree with those around them that all, or that none, of the light
// arrives. Not so at edges of shadows, and for points that no triangle joins to others (texels of a
// light map).
constexpr char kInside = 1, kEdge = 2;
void find_edges(const prt::Mesh& mesh, const Sums& sums, std::vector<char>& place) {
  // Turned away says nothing about what stands in the way.
  constexpr char kSome = 1, kNotAll = 2;
  thread_local std::vector<char> light;  // grows once per thread
  light.resize(sums.size());
  std::ranges::transform(sums, light.begin(), [](const prt::CosineSums& here) {
    const int some = here.seen > 0 ? kSome : 0, not_all = here.seen < here.open ? kNotAll : 0;
    return static_cast<char>(here.open <= 0 ? 0 : some | not_all);
  });
  place.assign(sums.size(), 0);
  for (const auto& [a, b, c] : mesh.triangles) {
    const char here = (light[a] | light[b] | light[c]) == (kSome | kNotAll) ? kEdge : kInside;
    place[a] |= here, place[b] |= here, place[c] |= here;
  }
}

// Notes the light of vertices that see all of a light or nothing. Only the part of it counts,
// unless neighbours share it.
struct Teller {
  const VertexTracer& tracer;
  bool averaged;
  Sums& sums;

  void operator()(std::size_t vertex, bool lit) const {
    const float open = averaged ? tracer.open(vertex) : 1;
    sums[vertex] = {lit ? open : 0, open};
  }
};

// How the vertices get their light; those that are turned away from all of it are in no list.
struct RayPlan {
  std::vector<std::uint32_t> all;   // by all rays
  std::vector<std::uint32_t> one;   // by one, and where those beside say otherwise by all
  std::vector<std::uint32_t> two;   // by two, and where those say otherwise by all
  std::vector<std::uint32_t> told;  // by none, unless those beside say otherwise
  void clear() {
    for (auto* list : {&all, &one, &two, &told}) list->clear();
  }
};

// Where nothing is known of the object's visibility. The penumbra of a narrow light is a line
// between vertices that see it and vertices that do not: one ray each finds it. Not so for wide
// ones, where a start with one ray each adds error.
void plan_all(const Caster& object, const lighting::DistantLight& source, int samples,
              RayPlan& plan) {
  std::vector<std::uint32_t>& list = is_wide(source) || samples == 1 ? plan.all : plan.one;
  const glm::vec3 towards =
      glm::transpose(object.world_from_mesh.rotation_matrix()) * glm::vec3(source.direction);
  const auto turned_away = -static_cast<float>(std::sin(largest_angle(source)));
  const std::span<const glm::vec3> normals = object.mesh->normals;
  for (std::uint32_t i = 0; i < normals.size(); ++i)
    if (glm::dot(normals[i], towards) > turned_away) list.push_back(i);
}

// By what the object's visibility map says. Of what else stands between it knows nothing: that
// can only take more.
void plan_unsure(const lighting::DistantLight& source, const CastersBetween& others,
                 std::span<const glm::vec3> positions, std::span<const VisibilityVerdict> verdict,
                 const Teller& tell, RayPlan& plan) {
  std::vector<std::uint32_t>& beside_others = is_wide(source) ? plan.all : plan.one;
  for (std::uint32_t i = 0; i < verdict.size(); ++i) {
    switch (verdict[i]) {
      case VisibilityVerdict::kTurnedAway:
        break;
      case VisibilityVerdict::kLit:
        if (others.may_shade(positions[i])) {
          beside_others.push_back(i);
          break;
        }
        [[fallthrough]];
      case VisibilityVerdict::kDark:
        tell(i, verdict[i] == VisibilityVerdict::kLit);
        plan.told.push_back(i);
        break;
      case VisibilityVerdict::kMaybeDark:
      case VisibilityVerdict::kMaybeLit:
        (others.may_shade(positions[i]) ? plan.all : plan.two).push_back(i);
        break;
      case VisibilityVerdict::kMixed:
        plan.all.push_back(i);
    }
  }
}

// Two rays where the verdict may be so; the others where they say otherwise.
void ask_twice(const VertexTracer& tracer, std::span<const VisibilityVerdict> verdict, int samples,
               const Teller& tell, std::vector<std::uint32_t>& vertices, Sums& sums) {
  constexpr std::size_t kAsks = 2;  // one misses thin penumbras
  tracer.trace(vertices, 0, kAsks, sums);
  std::erase_if(vertices, [&](std::uint32_t i) {
    const bool lit = verdict[i] == VisibilityVerdict::kMaybeLit;
    const bool is_so = sums[i].open > 0 && (lit ? sums[i].seen >= sums[i].open : sums[i].seen <= 0);
    if (is_so) tell(i, lit);
    return is_so;
  });
  tracer.trace(vertices, kAsks, static_cast<std::size_t>(samples), sums);
}

// A shadow's edge that lies between what was traced and what was not, or was by one ray, is found
// by the triangles that it runs through. The map's blur is as good for lights as wide as it.
void follow_edges(const VertexTracer& tracer, const prt::Mesh& mesh,
                  const lighting::DistantLight& source, int samples, RayPlan& plan, Sums& sums) {
  if (rms_angle(source) > prt::VisibilityMap::blur(prt::VisibilityMap::kFineCells))
    plan.told.clear();
  if (plan.one.empty() && plan.told.empty()) return;
  thread_local std::vector<char> place;  // grows once per thread
  find_edges(mesh, sums, place);
  // A ray that the surface is turned away from says nothing.
  const auto is_inside = [&](std::uint32_t i) { return place[i] == kInside && sums[i].open > 0; };
  std::erase_if(plan.one, is_inside);
  std::erase_if(plan.told, is_inside);
  for (const std::uint32_t i : plan.told) sums[i] = {};
  tracer.trace(plan.one, 1, static_cast<std::size_t>(samples), sums);
  tracer.trace(plan.told, 0, static_cast<std::size_t>(samples), sums);
}

void trace_vertices(const VertexTracer& tracer, const Caster& object,
                    const lighting::DistantLight& source, const CastersBetween& others,
                    LookupUse use, int samples, const Teller& tell, Sums& sums) {
  thread_local std::vector<VisibilityVerdict> verdict;  // grow once per thread
  thread_local RayPlan plan;
  plan.clear();
  if (use == LookupUse::kNone) {
    plan_all(object, source, samples, plan);
  } else {
    scout(object, source, verdict);
    plan_unsure(source, others, object.mesh->positions, verdict, tell, plan);
  }
  tracer.trace(plan.all, 0, static_cast<std::size_t>(samples), sums);
  tracer.trace(plan.one, 0, 1, sums);
  ask_twice(tracer, verdict, samples, tell, plan.two, sums);
  follow_edges(tracer, *object.mesh, source, samples, plan, sums);
}

// What few rays find, with its neighbours. Of a single direction nobody knows whether it was asked
// where a map tells some vertices; what is told has no noise.
void smooth_traced(const VertexTracer& tracer, const prt::Mesh& mesh,
                   const lighting::DistantLight& source, bool some_told, Sums& sums) {
  thread_local std::vector<std::uint8_t> directions_memory;  // grows once per thread
  std::vector<std::uint8_t>& directions = directions_memory;
  directions.resize(sums.size());
  parallel_for(std::size_t{0}, sums.size(), 4096, [&](const auto& part) {
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      directions[i] = tracer.directions(i);
      if (some_told && directions[i] == 1) directions[i] = 0;
    }
  });
  smooth_noise_over_neighbours(mesh, source, directions, sums);
}

// Vertices of which the map is not all that there is to know: rays find what else stands between.
// What the object itself keeps dark stays so.
void trace_among_others(const VertexTracer& tracer, const prt::Mesh& mesh,
                        const lighting::DistantLight& source, const CastersBetween& others,
                        int samples, bool averaged, Sums& sums) {
  thread_local std::vector<std::uint32_t> reached;  // grow once per thread
  thread_local Sums shared;
  thread_local std::vector<std::uint8_t> directions;
  reached.clear();
  for (std::uint32_t i = 0; i < sums.size(); ++i)
    if (sums[i].seen > 0 && others.may_shade(mesh.positions[i])) reached.push_back(i);
  if (reached.empty()) return;
  for (const std::uint32_t i : reached) sums[i] = {};
  tracer.trace(reached, 0, static_cast<std::size_t>(samples), sums);
  if (!averaged) return;
  // What is looked up has no noise that neighbours could share, and more directions.
  shared.resize(sums.size());
  parallel_for(std::size_t{0}, sums.size(), 4096, [&, &all = shared](const auto& part) {
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      const float open = sums[i].open > 0 ? tracer.open(i) : 0;
      all[i] = {open > 0 ? open * sums[i].seen / sums[i].open : 0, open};
    }
  });
  directions.assign(sums.size(), 0);
  for (const std::uint32_t i : reached) {
    shared[i] = sums[i];
    directions[i] = tracer.directions(i);
  }
  smooth_noise_over_neighbours(mesh, source, directions, shared);
  for (const std::uint32_t i : reached) sums[i] = shared[i];
}

// One of the sums of cosines beside those of all. Nothing changes where nothing is hidden.
void smooth_hidden(const prt::Mesh& mesh, const lighting::DistantLight& source,
                   std::span<const std::uint8_t> directions, std::span<const float> open,
                   std::span<float> hidden) {
  if (std::ranges::all_of(hidden, [](float h) { return h <= 0; })) return;
  thread_local Sums sums;  // grows once per thread
  sums.resize(open.size());
  for (std::size_t i = 0; i < sums.size(); ++i) sums[i] = {hidden[i], open[i]};
  smooth_noise_over_neighbours(mesh, source, directions, sums);
  // Where no direction was open there is no sum of all to stand beside.
  for (std::size_t i = 0; i < sums.size(); ++i)
    hidden[i] = open[i] > 0 || sums[i].open <= 0 ? sums[i].seen : sums[i].seen / sums[i].open;
}

// What real things take, and what all take, so that both together take no more than there is.
void smooth_occlusion(const prt::Mesh& mesh, const lighting::DistantLight& source,
                      const SamplePattern& pattern, DirectLightAtVertices& out) {
  thread_local std::vector<std::uint8_t> directions_memory;  // grows once per thread
  std::vector<std::uint8_t>& directions = directions_memory;
  directions.resize(out.open.size());
  parallel_for(std::size_t{0}, directions.size(), 4096, [&](const auto& part) {
    for (std::size_t i = part.begin(); i < part.end(); ++i)
      directions[i] = static_cast<std::uint8_t>(pattern.count_before(i, mesh.normals[i]));
  });
  std::vector<float>& taken = out.virtual_occlusion;
  for (std::size_t i = 0; i < taken.size(); ++i) taken[i] += out.real_occlusion[i];
  smooth_hidden(mesh, source, directions, out.open, out.real_occlusion);
  smooth_hidden(mesh, source, directions, out.open, taken);
  for (std::size_t i = 0; i < taken.size(); ++i) {
    taken[i] = std::max(0.f, taken[i] - out.real_occlusion[i]);
    if (out.open[i] <= 0) out.open[i] = 1;  // fractions stand beside it
  }
}

}  // namespace

void trace_direct_light(const RayOccluders& occluders, const ShadowCasters& casters,
                        const Caster& object, const prt::Plane* plane,
                        const lighting::DistantLight& source, int samples, std::span<float> out,
                        EdgedFractions* edged) {
  const prt::Mesh& mesh = *object.mesh;
  // All memory grows once per thread.
  thread_local SamplePattern all, pattern_memory;
  thread_local Sums sums_memory;
  SamplePattern& pattern = pattern_memory;
  Sums& sums = sums_memory;
  const bool hard = samples == 1;
  const std::size_t count = mesh.positions.size();
  const LookupUse use = lookup_use(object, source, samples);
  const bool looked_up = use == LookupUse::kCoarse || use == LookupUse::kFine;
  const glm::vec3 middle(source.direction);
  if (edged) edged->open.clear(), edged->lit.clear();
  const bool with_edges = edged && !looked_up && !is_wide(source) && !behind(plane, middle) &&
                          !penumbra_exceeds_edges(source, *object.silhouette);
  const Scratch::Scope scope;
  const CastersBetween others(casters, object, source, scope.memory());
  const bool averaged =
                 !hard && is_wide(source) && penumbra_exceeds_edges(source, *object.silhouette),
             cut = !hard && is_cut(plane, source);
  all.make(source, cut ? kMaxSamples : std::max(samples, kOpenSamples), 1);
  if (!looked_up || others.any()) {
    pattern.make(source, samples, hard ? 1 : kTurns);
    if (cut) pattern.keep_before(*plane);
  }
  const VertexTracer tracer(occluders, mesh, object.world_from_mesh, plane, pattern);
  if (looked_up) {
    sums.resize(count);
    const int cells =
        use == LookupUse::kCoarse ? prt::VisibilityMap::kCells : prt::VisibilityMap::kFineCells;
    look_up(object, plane, source, cells, sums);
    if (others.any()) trace_among_others(tracer, mesh, source, others, samples, averaged, sums);
  } else {
    sums.assign(count, {});
    trace_vertices(tracer, object, source, others, use, samples, {tracer, averaged, sums}, sums);
    if (averaged) smooth_traced(tracer, mesh, source, use != LookupUse::kNone, sums);
  }
  // What is behind the plane is in neither sum.
  std::array<glm::vec3, kMaxSamples> memory;
  const std::span<const glm::vec3> counted = cut ? before(plane, all.at(0), memory) : all.at(0);
  if (counted.empty()) {
    std::ranges::fill(out, 0.f);
    return;
  }
  const auto fraction = static_cast<float>(counted.size()) / static_cast<float>(all.at(0).size());
  const UnoccludedLight whole(counted, glm::vec3(source.direction),
                              glm::transpose(object.world_from_mesh.rotation_matrix()), hard);
  if (with_edges) edged->open.resize(count);
  parallel_for(std::size_t{0}, count, 1024, [&](const auto& part) {
    whole.light(std::span(mesh.normals).subspan(part.begin(), part.size()),
                out.subspan(part.begin(), part.size()));
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      const float open = fraction * out[i];
      out[i] = sums[i].seen <= 0 ? 0 : sums[i].seen / sums[i].open * open;
      if (with_edges) edged->open[i] = open;
    }
  });
  if (!with_edges) return;
  edged->lit.resize(count);
  find_shadow_edge(occluders, mesh, object.world_from_mesh, middle, sums, edged->lit);
}

void trace_direct_light_at_vertices(const RayOccluders& occluders, const prt::Mesh& mesh,
                                    const lighting::DistantLight& source, int samples,
                                    DirectLightAtVertices& out) {
  const std::size_t count = mesh.positions.size();
  for (auto* v : {&out.open, &out.virtual_occlusion, &out.real_occlusion}) v->assign(count, 0.f);
  thread_local SamplePattern pattern_memory, all_memory;  // grow once per thread
  SamplePattern &pattern = pattern_memory, &all = all_memory;
  const bool hard = samples == 1;
  pattern.make(source, samples, hard ? 1 : kTurns);
  parallel_for(std::size_t{0}, count, 512, [&](const auto& part) {
    Packets packets(occluders, [&](std::size_t i, float weight, bool by_virtual, bool by_real) {
      if (by_real)
        out.real_occlusion[i] += weight;
      else if (by_virtual)
        out.virtual_occlusion[i] += weight;
    });
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      const glm::vec3& n = mesh.normals[i];
      const glm::vec3 o = mesh.positions[i] + occluders.near_m * n;
      for (const glm::vec3& d : pattern.at(i)) {
        const float cosine = glm::dot(n, d);
        if (cosine <= 0) continue;
        out.open[i] += cosine;
        packets.add(i, cosine, o, d);
      }
    }
  });
  if (is_wide(source) && !hard) smooth_occlusion(mesh, source, pattern, out);
  all.make(source, std::max(samples, kOpenSamples), 1);
  const UnoccludedLight whole(all.at(0), glm::vec3(source.direction), glm::mat3(1), hard);
  parallel_for(std::size_t{0}, count, 1024, [&](const auto& part) {
    thread_local std::vector<float> open;  // grows once per thread
    open.resize(part.size());
    whole.light(std::span(mesh.normals).subspan(part.begin(), part.size()), open);
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      const float now = open[i - part.begin()], scale = out.open[i] > 0 ? now / out.open[i] : 0;
      out.open[i] = now;
      out.virtual_occlusion[i] *= scale;
      out.real_occlusion[i] *= scale;
    }
  });
}

}  // namespace penumbra::shadows
