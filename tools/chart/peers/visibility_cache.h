// Light of a distant light at vertices by a cache of visibility, as Xu proposed it: a point takes
// what near points with a similar normal have seen, as far as what hides them is far away.
// threads: thread-bound
// source: Xu 2005, section 9.2.1, equations 9.3 and 9.4, whose second term is printed without the
//         root that it has in Ward, Rubinstein & Clear 1988
#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/ext/vector_int3.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <vector>

#include "core/result.h"
#include "lighting/lights/distant_light.h"
#include "prt/geometry/mesh.h"
#include "prt/rays/rays.h"

namespace penumbra::tools {

class VisibilityCache {
 public:
  /// Measures how far what hides each vertex is, which a mesh at rest knows beforehand.
  /// in:     mesh outlives the cache; near_m: rays start so far off it
  /// errors: as RayWorld::add
  static Result<VisibilityCache> create(const prt::Mesh& mesh, float near_m);

  /// out[v] = mean over the light of V max(n.w, 0). Returns how many vertices were traced.
  /// in: samples: rays of a traced vertex, 1..64; max_error: of equation 9.4, 0: all are traced;
  ///     out: as many as the mesh has vertices
  std::size_t light(const lighting::DistantLight& source, int samples, float max_error,
                    std::span<float> out);

  const prt::RayWorld& world() const { return world_; }

 private:
  struct Sample {
    glm::vec3 position, normal;
    float per_distance, visible;
  };
  struct Entry {
    std::uint32_t sample;
    std::int32_t next;
  };
  static constexpr std::size_t kSlots = std::size_t{1} << 16;
  static constexpr int kLevels = 10;

  VisibilityCache(const prt::Mesh& mesh, prt::RayWorld world, float near_m);
  float occluder_distance_m(std::size_t vertex) const;
  std::optional<float> trace(std::size_t vertex, std::span<const glm::vec3> directions) const;
  void clear();
  bool interpolate(std::size_t vertex, float max_error, float& visible) const;
  void insert(std::size_t vertex, float visible, float max_error);
  float cell_m(int level) const;
  glm::ivec3 cell_of(const glm::vec3& p, int level) const;

  const prt::Mesh* mesh_;
  prt::RayWorld world_;
  float near_m_, radius_m_;
  glm::vec3 low_;
  std::vector<std::uint32_t> order_;  // coarse first
  std::vector<float> distance_m_;     // by vertex
  std::vector<std::int32_t> heads_;   // by slot
  std::vector<Entry> entries_;
  std::vector<Sample> samples_;
  unsigned used_levels_ = 0;  // bit by level
};

}  // namespace penumbra::tools
