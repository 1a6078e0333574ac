#include <algorithm>
#include <cmath>
#include <initializer_list>

#include "core/parallel.h"
#include "shadows/disc_rays.h"

namespace penumbra::shadows {

namespace {

constexpr int kTurns = 64;     // patterns for vertices
constexpr int kOpenTaps = 16;  // of the whole disc, for the cosine of an open vertex

// An object on a plane gets nothing from behind it but what the bake knows.
bool behind(const prt::Plane* plane, const glm::vec3& d) {
  return plane && glm::dot(glm::vec3(plane->normal), d) <= 0;
}

// Each vertex with its neighbours: few rays a vertex, turned from one to the next, become many.
void average_neighbours(const prt::Mesh& mesh, std::vector<float>& values) {
  thread_local std::vector<float> sums;  // grows once per thread
  sums = values;
  for (const auto& [a, b, c] : mesh.triangles) {
    const float all = values[a] + values[b] + values[c];
    sums[a] += all - values[a];
    sums[b] += all - values[b];
    sums[c] += all - values[c];
  }
  std::swap(sums, values);
}

// Sums over the rays of a disc that is not narrow. Once leaves the beat of the turns with a grid's rows as ripples in
// broad penumbras; patterns in random order leave blotches. Three times would blur the edges of smaller sources
// (studio: 2.5 to 3.3 %).
void smooth(const prt::Mesh& mesh, const lighting::Disc& disc,
            std::initializer_list<std::vector<float>*> sums) {
  if (is_narrow(disc)) return;
  constexpr double kBroad = .25;  // radians
  const int passes = disc.radius.value() > kBroad ? 3 : 1;
  for (int pass = 0; pass < passes; ++pass)
    for (std::vector<float>* values : sums) average_neighbours(mesh, *values);
}

float mean_cosine(std::span<const glm::vec3> directions, const glm::vec3& normal) {
  float sum = 0;
  for (const glm::vec3& d : directions) sum += std::max(0.f, glm::dot(normal, d));
  return sum / static_cast<float>(directions.size());
}

// Lambert's law over a disc on the vertices of a mesh: rays, and what of them arrives.
class VertexTracer {
 public:
  VertexTracer(const Blockers& blockers, const prt::Mesh& mesh, const Pose& world_from_mesh,
               const prt::Plane* plane, const TapPattern& pattern)
      : blockers_(blockers),
        mesh_(mesh),
        plane_(plane),
        pattern_(pattern),
        turn_(world_from_mesh.rotation_matrix()),
        shift_(world_from_mesh.translation) {}

  glm::vec3 normal(std::size_t vertex) const { return turn_ * mesh_.normals[vertex]; }

  /// Adds taps [first, last) of all vertices that `wanted` names to the sums of cosines.
  template <class Wanted>
  void trace(std::size_t first, std::size_t last, Wanted wanted, std::vector<float>& seen,
             std::vector<float>& open) const {
    parallel_for(std::size_t{0}, mesh_.positions.size(), 1024, [&](const auto& part) {
      Packets packets(blockers_, [&](std::size_t i, float weight, bool by_virtual, bool by_real) {
        if (!by_virtual && !by_real) seen[i] += weight;
      });
      for (std::size_t i = part.begin(); i < part.end(); ++i) {
        if (!wanted(i)) continue;
        const glm::vec3 n = normal(i);
        const glm::vec3 o = turn_ * mesh_.positions[i] + shift_ + blockers_.near_m * n;
        for (const glm::vec3& d : pattern_.at(i).subspan(first, last - first)) {
          const float cosine = glm::dot(n, d);
          if (cosine <= 0) continue;
          open[i] += cosine;
          if (!behind(plane_, d)) packets.add(i, cosine, o, d);
        }
      }
    });
  }

 private:
  const Blockers& blockers_;
  const prt::Mesh& mesh_;
  const prt::Plane* plane_;
  const TapPattern& pattern_;
  glm::mat3 turn_;
  glm::vec3 shift_;
};

// Marks the corners of triangles whose corners do not agree that all, or that none, of the light arrives, and points
// that no triangle joins to others (texels of a light map).
void mark_edges(const prt::Mesh& mesh, const std::vector<float>& seen,
                const std::vector<float>& open, std::vector<char>& edge) {
  edge.assign(seen.size(), 1);
  for (const auto& t : mesh.triangles)
    for (const std::uint32_t v : t) edge[v] = 0;
  for (const auto& t : mesh.triangles) {
    bool all = true, none = true;
    for (const std::uint32_t v : t) {
      if (open[v] <= 0) continue;  // turned away: says nothing about what stands in the way
      all &= seen[v] >= open[v];
      none &= seen[v] <= 0;
    }
    if (all || none) continue;
    for (const std::uint32_t v : t) edge[v] = 1;
  }
}

}  // namespace

void trace_disc_light(const Blockers& blockers, const prt::Mesh& mesh, const Pose& world_from_mesh,
                      const prt::Plane* plane, const lighting::Disc& disc, int taps,
                      std::span<float> out) {
  // All memory grows once per thread.
  thread_local TapPattern pattern_memory, all_memory;
  thread_local std::vector<float> seen_memory, open_memory;  // sums of cosines
  thread_local std::vector<char> edge_memory;
  TapPattern &pattern = pattern_memory, &all = all_memory;
  std::vector<float>&seen = seen_memory, &open = open_memory;
  std::vector<char>& edge = edge_memory;
  const bool narrow = is_narrow(disc);
  pattern.make(disc, taps, kTurns);
  const VertexTracer tracer(blockers, mesh, world_from_mesh, plane, pattern);
  const std::size_t count = mesh.positions.size();
  seen.assign(count, 0);
  open.assign(count, 0);
  const auto last = static_cast<std::size_t>(taps);
  // The penumbra of a narrow disc is a line between vertices that see it and vertices that do not: one ray each finds
  // it. (Not so for wide ones: two rays each, then the rest where they differ, cost 1.6 % on an object under adams.)
  const std::size_t scouts = narrow ? 1 : last;
  tracer.trace(
      0, scouts, [](std::size_t) { return true; }, seen, open);
  if (scouts < last) {
    mark_edges(mesh, seen, open, edge);
    tracer.trace(
        scouts, last, [&](std::size_t i) { return edge[i] != 0; }, seen, open);
  }
  smooth(mesh, disc, {&seen, &open});
  all.make(disc, std::max(taps, kOpenTaps), 1);
  parallel_for(std::size_t{0}, count, 1024, [&](const auto& part) {
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      out[i] = 0;
      if (seen[i] <= 0) continue;
      out[i] = seen[i] / open[i] * mean_cosine(all.at(0), tracer.normal(i));
    }
  });
}

void trace_disc_vertices(const Blockers& blockers, const prt::Mesh& mesh,
                         const lighting::Disc& disc, int taps, DiscAtVertices& out) {
  const std::size_t count = mesh.positions.size();
  for (auto* v : {&out.open, &out.taken, &out.missing}) v->assign(count, 0.f);
  thread_local TapPattern pattern_memory, all_memory;  // grow once per thread
  TapPattern &pattern = pattern_memory, &all = all_memory;
  pattern.make(disc, taps, kTurns);
  parallel_for(std::size_t{0}, count, 512, [&](const auto& part) {
    Packets packets(blockers, [&](std::size_t i, float weight, bool by_virtual, bool by_real) {
      if (by_real)
        out.missing[i] += weight;
      else if (by_virtual)
        out.taken[i] += weight;
    });
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      const glm::vec3& n = mesh.normals[i];
      const glm::vec3 o = mesh.positions[i] + blockers.near_m * n;
      for (const glm::vec3& d : pattern.at(i)) {
        const float cosine = glm::dot(n, d);
        if (cosine <= 0) continue;
        out.open[i] += cosine;
        packets.add(i, cosine, o, d);
      }
    }
  });
  smooth(mesh, disc, {&out.open, &out.taken, &out.missing});
  all.make(disc, std::max(taps, kOpenTaps), 1);
  parallel_for(std::size_t{0}, count, 1024, [&](const auto& part) {
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      const float open = mean_cosine(all.at(0), mesh.normals[i]),
                  scale = out.open[i] > 0 ? open / out.open[i] : 0;
      out.open[i] = open;
      out.taken[i] *= scale;
      out.missing[i] *= scale;
    }
  });
}

}  // namespace penumbra::shadows
