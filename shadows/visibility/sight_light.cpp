#include "shadows/visibility/internal/sight_light.h"

#include <algorithm>
#include <cmath>

#include "prt/transfer/vertex_samples.h"
#include "core/parallel.h"
#include "shadows/silhouette/disc_rays.h"
#include "shadows/visibility/internal/shared_sight.h"

namespace penumbra::shadows {

namespace {

constexpr std::size_t kAtOnce = 1024;  // vertices

// A thing like the object, in its place, hides what the object itself does.
bool is_twin(const Caster& a, const Caster& b) {
  return is_same(a, b) ||
         (a.world_from_mesh == b.world_from_mesh && a.mesh->positions == b.mesh->positions &&
          a.mesh->triangles == b.mesh->triangles);
}

bool others_between(std::span<const Caster> casters, const Caster& object,
                    const lighting::Disc& disc) {
  const BoundingSphere here = sphere_of(object);
  return std::ranges::any_of(casters, [&](const Caster& c) {
    return !is_twin(c, object) && may_hide(sphere_of(c), here, disc);
  });
}

// Directions in the mesh's frame.
void aim(const Caster& object, const prt::Plane* plane, const lighting::Disc& disc, int cells,
         std::size_t each, prt::SightTaps& out) {
  thread_local TapPattern pattern;  // grows once per thread
  pattern.make(disc, static_cast<int>(each), kTurns);
  const glm::mat3 mesh_from_world = glm::transpose(object.world_from_mesh.rotation_matrix());
  out.clear(cells, each);
  for (std::size_t turn = 0; turn < kTurns; ++turn)
    for (const glm::vec3& d : pattern.at(turn)) out.add(mesh_from_world * d, !behind(plane, d));
}

// Directions where others beside a vertex look too: what is looked for in finer cells is small and lies in few of them.
std::size_t enough(int cells) {
  return cells == prt::VertexSight::kFineCells ? prt::SightTaps::kFew : prt::SightTaps::kMost;
}

// What the samples see, and after the last one nothing.
const std::vector<prt::CosineSums>& look_from_samples(const Caster& object, const prt::Plane* plane,
                                                      const lighting::Disc& disc, int cells) {
  thread_local prt::SightTaps taps_memory;  // grow once per thread
  thread_local std::vector<prt::CosineSums> sums_memory;
  prt::SightTaps& taps = taps_memory;
  std::vector<prt::CosineSums>& sums = sums_memory;
  aim(object, plane, disc, cells, enough(cells), taps);
  const std::span<const std::uint32_t> vertices = object.sight->samples().vertices();
  sums.resize(vertices.size() + 1);
  sums.back() = {};
  parallel_for(std::size_t{0}, vertices.size(), kAtOnce, [&](const auto& part) {
    object.sight->look(taps, vertices, part.begin(), part.end(), sums);
  });
  return sums;
}

// What samples say of a disc: nothing, where they are turned away.
enum Says : std::uint8_t { kSaysLit = 1, kSaysDark = 2, kSaysMixed = 4 };

std::uint8_t says(const prt::CosineSums& here) {
  constexpr float kRounding = 1e-5f;
  if (here.open <= 0) return 0;
  if (here.seen <= 0) return kSaysDark;
  return here.seen >= here.open * (1 - kRounding) ? kSaysLit : kSaysMixed;
}

}  // namespace

SightUse use_of_sight(const Casters& casters, const Caster& object, const lighting::Disc& disc,
                      int taps) {
  // RMS angles of the disc, in those that look-ups are off: they add as squares do. From the first on the disc looks less than a
  // tenth wider, which is as good as eight rays a vertex; from the second on look-ups in finer cells are about as good as four.
  constexpr double kCoarseFrom = 2.5, kFineFrom = 1.5;
  constexpr int kMostRays = 8;
  if (!object.sight || taps == 1 || taps > kMostRays || SharedSight::counts_parts(object, disc) ||
      others_between(casters.virtual_things, object, disc) ||
      others_between(casters.real_things, object, disc))
    return SightUse::kNone;
  const auto beside = [&](int cells) { return rms_angle(disc) / prt::VertexSight::blur(cells); };
  if (beside(prt::VertexSight::kCells) > kCoarseFrom) return SightUse::kCoarse;
  const double fine_from = taps > 4 ? kCoarseFrom : kFineFrom;
  return beside(prt::VertexSight::kFineCells) > fine_from ? SightUse::kFine : SightUse::kScout;
}

void look_up(const Caster& object, const prt::Plane* plane, const lighting::Disc& disc, int cells,
             bool averaged, std::span<prt::CosineSums> out) {
  thread_local prt::SightTaps memory;  // grows once per thread
  prt::SightTaps& taps = memory;
  aim(object, plane, disc, cells, averaged ? enough(cells) : prt::SightTaps::kMost, taps);
  parallel_for(std::size_t{0}, out.size(), kAtOnce,
               [&](const auto& part) { object.sight->look(taps, part.begin(), part.end(), out); });
}

void look_up_shared(const Caster& object, const prt::Plane* plane, const lighting::Disc& disc,
                    int cells, std::span<prt::CosineSums> out) {
  const std::vector<prt::CosineSums>& seen = look_from_samples(object, plane, disc, cells);
  const prt::VertexSamples& samples = object.sight->samples();
  parallel_for(std::size_t{0}, out.size(), kAtOnce, [&](const auto& part) {
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      const auto& [a, b, c, d] = samples.around(i);
      out[i] = (seen[a] + seen[b]) + (seen[c] + seen[d]);
    }
  });
}

void scout(const Caster& object, const lighting::Disc& disc, std::vector<SightVerdict>& out) {
  thread_local std::vector<std::uint8_t> by_sample;  // grows once per thread
  const std::vector<prt::CosineSums>& seen =
      look_from_samples(object, nullptr, disc, prt::VertexSight::kFineCells);
  std::vector<std::uint8_t>& said = by_sample;
  said.resize(seen.size());
  std::ranges::transform(seen, said.begin(), says);
  const prt::VertexSamples& samples = object.sight->samples();
  const glm::vec3 towards =
      glm::transpose(object.world_from_mesh.rotation_matrix()) * glm::vec3(disc.direction);
  const auto turned_away = -static_cast<float>(std::sin(largest_angle(disc)));
  const std::span<const glm::vec3> normals = object.mesh->normals;
  out.resize(normals.size());
  parallel_for(std::size_t{0}, out.size(), kAtOnce, [&](const auto& part) {
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      const auto& [a, b, c, d] = samples.around(i);
      const int all = said[a] | said[b] | said[c] | said[d];
      if (glm::dot(normals[i], towards) <= turned_away)
        out[i] = SightVerdict::kTurnedAway;
      else if (all == kSaysLit)
        out[i] = SightVerdict::kLit;
      else if (all == kSaysDark)
        out[i] = SightVerdict::kDark;
      else if (!samples.is_sample(i) || said[a] == kSaysMixed)
        out[i] = SightVerdict::kMixed;
      else
        out[i] = said[a] == kSaysLit ? SightVerdict::kMaybeLit : SightVerdict::kMaybeDark;
    }
  });
}

}  // namespace penumbra::shadows
