#include "shadows/sight_light.h"

#include <algorithm>
#include <cmath>

#include "core/parallel.h"
#include "shadows/disc_rays.h"
#include "shadows/shared_sight.h"

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
void aim(const Caster& object, const prt::Plane* plane, const lighting::Disc& disc,
         prt::SightTaps& out) {
  thread_local TapPattern pattern;  // grows once per thread
  pattern.make(disc, prt::SightTaps::kEach, kTurns);
  const glm::mat3 mesh_from_world = glm::transpose(object.world_from_mesh.rotation_matrix());
  out.clear();
  for (std::size_t turn = 0; turn < kTurns; ++turn)
    for (const glm::vec3& d : pattern.at(turn)) out.add(mesh_from_world * d, !behind(plane, d));
}

// A vertex is sure where those around it say the same: what is thin hides between the rays of one vertex.
void ask_neighbours(const prt::Mesh& mesh, std::span<SightVerdict> verdict) {
  constexpr char kLit = 1, kDark = 2, kMixed = 4;
  thread_local std::vector<char> around;  // grows once per thread
  around.assign(verdict.size(), 0);
  const auto said = [&](std::uint32_t v) -> char {
    switch (verdict[v]) {
      case SightVerdict::kTurnedAway:
        return 0;
      case SightVerdict::kLit:
        return kLit;
      case SightVerdict::kDark:
        return kDark;
      default:
        return kMixed;
    }
  };
  for (const auto& [a, b, c] : mesh.triangles) {
    const char here = static_cast<char>(said(a) | said(b) | said(c));
    around[a] |= here, around[b] |= here, around[c] |= here;
  }
  for (std::size_t i = 0; i < verdict.size(); ++i)
    if (verdict[i] == SightVerdict::kLit && (around[i] & ~kLit) != 0)
      verdict[i] = SightVerdict::kMaybeLit;
    else if (verdict[i] == SightVerdict::kDark && (around[i] & ~kDark) != 0)
      verdict[i] = SightVerdict::kMaybeDark;
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
             std::span<prt::CosineSums> out) {
  thread_local prt::SightTaps memory;  // grows once per thread
  prt::SightTaps& taps = memory;
  aim(object, plane, disc, taps);
  parallel_for(std::size_t{0}, out.size(), kAtOnce, [&](const auto& part) {
    object.sight->look(taps, cells, part.begin(), part.end(), out);
  });
}

void scout(const Caster& object, const lighting::Disc& disc, std::vector<SightVerdict>& out) {
  thread_local std::vector<prt::CosineSums> sums;  // grows once per thread
  const std::size_t count = object.mesh->positions.size();
  sums.resize(count), out.resize(count);
  look_up(object, nullptr, disc, prt::VertexSight::kFineCells, sums);
  constexpr float kRounding = 1e-5f;
  std::ranges::transform(sums, out.begin(), [](const prt::CosineSums& here) {
    if (here.open <= 0) return SightVerdict::kTurnedAway;
    if (here.seen <= 0) return SightVerdict::kDark;
    return here.seen >= here.open * (1 - kRounding) ? SightVerdict::kLit : SightVerdict::kMixed;
  });
  ask_neighbours(*object.mesh, out);
}

}  // namespace penumbra::shadows
