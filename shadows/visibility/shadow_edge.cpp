#include "shadows/visibility/internal/shadow_edge.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "core/threads/parallel.h"
#include "shadows/silhouette/light_rays.h"

namespace penumbra::shadows {

namespace {

// An edge is drawn over a third of the way between two vertices, since few rays place it no better,
// and penumbras are not much narrower. Of vertices that see almost all of a light, or hardly any,
// distances tell more than fractions.
constexpr float kRamp = .35f;
constexpr float kHardly = .3f;
constexpr int kHalvings = 2;

// Where a vertex lies. Corners of one triangle join theirs by or.
enum : std::uint8_t { kTurnedAway = 1, kDark = 2, kLit = 4, kPartly = 8 };

std::uint8_t place_of(const prt::CosineSums& s) {
  if (s.open <= 0) return kTurnedAway;
  if (s.seen < kHardly * s.open) return kDark;
  return s.seen > (1 - kHardly) * s.open ? kLit : kPartly;
}

// A side of triangles that an edge crosses, from what is lit to what is dark.
struct Crossing {
  std::uint32_t lit, dark;
  float at = .5f;  // of the way
  std::uint64_t ends() const { return std::uint64_t{lit} << 32 | dark; }
};

// A triangle that an edge cuts in two: the corner on one side, those on the other.
struct CutTriangle {
  std::uint32_t alone, first, second;
  bool alone_is_lit;
  Crossing side(std::uint32_t other) const {
    return alone_is_lit ? Crossing{alone, other} : Crossing{other, alone};
  }
};

class EdgeFinder {
 public:
  EdgeFinder(const prt::Mesh& mesh, std::span<const prt::CosineSums> sums, std::span<float> lit)
      : mesh_(mesh), sums_(sums), lit_(lit) {}

  void find(const RayOccluders& occluders, const Pose& world_from_mesh, const glm::vec3& towards) {
    take_fractions();
    sort_triangles();
    if (memory().cut.empty()) return;
    place_crossings(occluders, world_from_mesh, towards);
    take_distances();
  }

 private:
  struct WeightedSum {
    float sum = 0, weight = 0;
  };
  struct EdgeCorner {  // of a corner of cut triangles
    WeightedSum distance;
    WeightedSum side;  // that an edge crosses
  };
  struct Memory {  // grows once per thread
    std::vector<std::uint8_t> place;
    std::vector<CutTriangle> cut;
    std::vector<Crossing> crossings;
    std::vector<EdgeCorner> beside;
  };
  static Memory& memory() {
    thread_local Memory memory;
    return memory;
  }

  void take_fractions() {
    std::vector<std::uint8_t>& place = memory().place;
    place.resize(sums_.size());
    for (std::size_t i = 0; i < sums_.size(); ++i) {
      place[i] = place_of(sums_[i]);
      lit_[i] = sums_[i].open > 0 ? sums_[i].seen / sums_[i].open : 0;
    }
  }

  void sort_triangles() {
    Memory& m = memory();
    m.cut.clear(), m.crossings.clear();
    for (const auto& t : mesh_.triangles) {
      const unsigned places = m.place[t[0]] | m.place[t[1]] | m.place[t[2]];
      if (places == (kDark | kLit)) add_cut(t);
    }
    std::ranges::sort(m.crossings, {}, &Crossing::ends);
    const auto rest = std::ranges::unique(m.crossings, {}, &Crossing::ends);
    m.crossings.erase(rest.begin(), rest.end());
  }

  void add_cut(const std::array<std::uint32_t, 3>& t) {
    Memory& m = memory();
    const auto is_lit = [&](std::size_t k) { return m.place[t[k]] == kLit; };
    const std::size_t k = is_lit(0) == is_lit(1) ? 2 : is_lit(0) == is_lit(2) ? 1 : 0;
    const CutTriangle& cut = m.cut.emplace_back(t[k], t[(k + 1) % 3], t[(k + 2) % 3], is_lit(k));
    m.crossings.push_back(cut.side(cut.first));
    m.crossings.push_back(cut.side(cut.second));
  }

  // Where the light's middle goes out of sight, by halving.
  void place_crossings(const RayOccluders& occluders, const Pose& world_from_mesh,
                       const glm::vec3& towards) {
    std::vector<Crossing>& crossings = memory().crossings;
    const glm::mat3 turn = world_from_mesh.rotation_matrix();
    const glm::vec3 shift = world_from_mesh.translation;
    parallel_for(std::size_t{0}, crossings.size(), 512, [&](const auto& part) {
      float step = .5f;
      for (int round = 0; round < kHalvings; ++round) {
        step *= .5f;
        Packets packets(occluders, [&](std::size_t i, float, bool by_virtual, bool by_real) {
          crossings[i].at += by_virtual || by_real ? -step : step;
        });
        for (std::size_t i = part.begin(); i < part.end(); ++i) {
          const Crossing& c = crossings[i];
          const glm::vec3 n =
              glm::normalize(glm::mix(mesh_.normals[c.lit], mesh_.normals[c.dark], c.at));
          packets.add(i, 1, turn * (point_at(c) + occluders.near_m * n) + shift, towards);
        }
      }
    });
  }

  glm::vec3 point_at(const Crossing& c) const {
    return glm::mix(mesh_.positions[c.lit], mesh_.positions[c.dark], c.at);
  }
  const Crossing& known(const Crossing& side) const {
    return *std::ranges::lower_bound(memory().crossings, side.ends(), {}, &Crossing::ends);
  }

  // Corners of cut triangles take their distance from the edge, in the mean of their triangles,
  // over the width of an edge there.
  void take_distances() {
    Memory& m = memory();
    m.beside.assign(sums_.size(), {});
    for (const CutTriangle& t : m.cut) {
      const glm::vec3 a = point_at(known(t.side(t.first))), b = point_at(known(t.side(t.second)));
      const float length = glm::distance(a, b);
      const float side = glm::distance(mesh_.positions[t.alone], mesh_.positions[t.first]) +
                         glm::distance(mesh_.positions[t.alone], mesh_.positions[t.second]);
      for (const std::uint32_t v : {t.alone, t.first, t.second}) {
        EdgeCorner& here = m.beside[v];
        // Weighted by the length of the edge in the triangle.
        here.distance.sum += glm::length(glm::cross(mesh_.positions[v] - a, b - a));
        here.distance.weight += length;
        here.side.sum += side, here.side.weight += 2;
      }
    }
    for (const CutTriangle& t : m.cut)
      for (const std::uint32_t v : {t.alone, t.first, t.second}) {
        const EdgeCorner& here = m.beside[v];
        if (here.distance.weight <= 0 || here.side.sum <= 0) continue;
        const float distance = here.distance.sum / here.distance.weight,
                    width = kRamp * here.side.sum / here.side.weight;
        lit_[v] = m.place[v] == kLit ? .5f + distance / width : .5f - distance / width;
      }
  }

  const prt::Mesh& mesh_;
  std::span<const prt::CosineSums> sums_;
  std::span<float> lit_;
};

}  // namespace

void find_shadow_edge(const RayOccluders& occluders, const prt::Mesh& mesh,
                      const Pose& world_from_mesh, const glm::vec3& towards,
                      std::span<const prt::CosineSums> sums, std::span<float> lit) {
  EdgeFinder(mesh, sums, lit).find(occluders, world_from_mesh, towards);
}

}  // namespace penumbra::shadows
