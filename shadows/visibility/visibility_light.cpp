#include "shadows/visibility/internal/visibility_light.h"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "prt/transfer/vertex_samples.h"
#include "shadows/silhouette/light_rays.h"

namespace penumbra::shadows {

namespace {

constexpr std::size_t kAtOnce = 1024;  // vertices
constexpr int kAgain = 32;             // directions, where few do not tell

// A thing like the object, in its place, hides what the object itself does.
bool is_twin(const Caster& a, const Caster& b) {
  return is_same(a, b) ||
         (a.world_from_mesh == b.world_from_mesh && a.mesh->positions == b.mesh->positions &&
          a.mesh->triangles == b.mesh->triangles);
}

// Directions in the mesh's frame.
void aim(const Caster& object, const prt::Plane* plane, const lighting::DistantLight& source,
         int cells, std::size_t each, prt::VisibilitySamples& out) {
  thread_local SamplePattern pattern;  // grows once per thread
  pattern.make(source, static_cast<int>(each), kTurns);
  if (plane) pattern.keep_before(*plane);
  const glm::mat3 mesh_from_world = glm::transpose(object.world_from_mesh.rotation_matrix());
  out.clear(cells, each);
  for (std::size_t turn = 0; turn < kTurns; ++turn)
    for (const glm::vec3& d : pattern.at(turn)) out.add(mesh_from_world * d, !behind(plane, d));
}

// All of the light in as many directions as there may be, the same ones for every vertex.
void aim_finely(const Caster& object, const prt::Plane* plane, const lighting::DistantLight& source,
                int cells, prt::VisibilitySamples& out) {
  thread_local SamplePattern pattern;  // grows once per thread
  pattern.make(source, kAgain, 1);
  const glm::mat3 mesh_from_world = glm::transpose(object.world_from_mesh.rotation_matrix());
  out.clear(cells, kAgain);
  // What is behind the plane looks nowhere.
  for (const glm::vec3& d : pattern.at(0))
    out.add(behind(plane, d) ? glm::vec3(0) : mesh_from_world * d, true);
}

// What the samples see, and after the last one nothing.
const std::vector<prt::CosineSums>& look_from_samples(const Caster& object,
                                                      const lighting::DistantLight& source) {
  thread_local prt::VisibilitySamples samples_memory;  // grow once per thread
  thread_local std::vector<prt::CosineSums> sums_memory;
  prt::VisibilitySamples& directions_used = samples_memory;
  std::vector<prt::CosineSums>& sums = sums_memory;
  aim(object, nullptr, source, prt::VisibilityMap::kFineCells, prt::VisibilitySamples::kFew,
      directions_used);
  const std::span<const std::uint32_t> vertices = object.visibility->samples().vertices();
  sums.resize(vertices.size() + 1);
  sums.back() = {};
  parallel_for(std::size_t{0}, vertices.size(), kAtOnce, [&](const auto& part) {
    object.visibility->look_up(directions_used, vertices, part.begin(), part.end(), sums);
  });
  return sums;
}

// What samples say of a light: nothing, where they are turned away.
enum Says : std::uint8_t { kSaysLit = 1, kSaysDark = 2, kSaysMixed = 4 };

std::uint8_t says(const prt::CosineSums& here) {
  constexpr float kRounding = 1e-5f;
  if (here.open <= 0) return 0;
  if (here.seen <= 0) return kSaysDark;
  return here.seen >= here.open * (1 - kRounding) ? kSaysLit : kSaysMixed;
}

// Vertices that see a part of the light, and those beside them: what takes little of it is found
// by some of them only, and where it is found alone it would count for too little.
const std::vector<std::uint32_t>& mixed_and_beside(const prt::Mesh& mesh,
                                                   std::span<const prt::CosineSums> sums) {
  thread_local std::vector<char> marked_memory;  // grow once per thread
  thread_local std::vector<std::uint32_t> out;
  std::vector<char>& marked = marked_memory;
  marked.assign(sums.size(), 0);
  out.clear();
  const auto mixed = [&](std::uint32_t v) { return says(sums[v]) == kSaysMixed; };
  parallel_for(std::size_t{0}, mesh.triangles.size(), 8 * kAtOnce, [&](const auto& part) {
    for (std::size_t t = part.begin(); t < part.end(); ++t) {
      const auto& corners = mesh.triangles[t];
      if (!std::ranges::any_of(corners, mixed)) continue;
      for (const std::uint32_t v : corners)
        std::atomic_ref(marked[v]).store(1, std::memory_order_relaxed);
    }
  });
  for (std::size_t v = 0; v < marked.size(); ++v)
    if (marked[v]) out.push_back(static_cast<std::uint32_t>(v));
  return out;
}

// Few directions tell the part of the light that is seen in steps, which look like grain. There all
// of them are looked into.
void look_again(const Caster& object, const prt::Plane* plane, const lighting::DistantLight& source,
                int cells, std::span<prt::CosineSums> out) {
  thread_local prt::VisibilitySamples samples_memory;  // grow once per thread
  thread_local std::vector<prt::CosineSums> sums_memory;
  const std::vector<std::uint32_t>& again = mixed_and_beside(*object.mesh, out);
  if (again.empty()) return;
  prt::VisibilitySamples& directions_used = samples_memory;
  aim_finely(object, plane, source, cells, directions_used);
  std::vector<prt::CosineSums>& sums = sums_memory;
  sums.resize(again.size());
  constexpr float kOfFew = float{prt::VisibilitySamples::kMax} / kAgain;
  parallel_for(std::size_t{0}, again.size(), kAtOnce, [&](const auto& part) {
    object.visibility->look_up(directions_used, again, part.begin(), part.end(), sums);
    for (std::size_t k = part.begin(); k < part.end(); ++k)
      if (sums[k].open > 0) out[again[k]] = {kOfFew * sums[k].seen, kOfFew * sums[k].open};
  });
}

}  // namespace

CastersBetween::CastersBetween(const ShadowCasters& casters, const Caster& object,
                               const lighting::DistantLight& source,
                               std::pmr::memory_resource* memory)
    : boxes_(memory),
      towards_(glm::transpose(object.world_from_mesh.rotation_matrix()) *
               glm::vec3(source.direction)),
      near_m_(casters.near_m) {
  const double angle = std::min(largest_angle(source), kPi / 2);
  sine_ = static_cast<float>(std::sin(angle)), cosine_ = static_cast<float>(std::cos(angle));
  for (const auto& things : {casters.virtual_things, casters.real_things})
    for (const Caster& c : things)
      if (!is_twin(c, object)) add(c, object);
}

void CastersBetween::add(const Caster& caster, const Caster& object) {
  const Pose object_from_caster = object.world_from_mesh.inverse() * caster.world_from_mesh;
  const prt::Bounds& bounds = caster.silhouette->bounds();
  const Box box{glm::vec3(object_from_caster * glm::dvec3(bounds.centre())),
                .5f * (bounds.high - bounds.low) + near_m_, object_from_caster.rotation_matrix(),
                caster.silhouette->radius_m() + near_m_};
  const prt::Bounds& own = object.silhouette->bounds();
  if (may_shade(box, own.centre(), object.silhouette->radius_m(), .5f * (own.high - own.low)))
    boxes_.push_back(box);
}

// Of a sphere and box around a point. What goes past the caster's sphere leaves it farther aside
// than the light's cone has widened there; what goes away from its box starts beyond one of its
// sides.
bool CastersBetween::may_shade(const Box& box, const glm::vec3& point, float radius,
                               const glm::vec3& half) const {
  const glm::vec3 apart = box.centre - point;
  const float both = box.radius + radius, along = glm::dot(apart, towards_);
  if (along < -both) return false;
  const float aside = std::sqrt(std::max(0.f, glm::dot(apart, apart) - along * along));
  if (aside * cosine_ - along * sine_ > both) return false;
  for (int k = 0; k < 3; ++k) {
    const glm::vec3& axis = box.axes[k];
    const float from = glm::dot(apart, axis), goes = glm::dot(towards_, axis);
    if (std::abs(from) > box.half[k] + glm::dot(glm::abs(axis), half) &&
        (from > 0 ? -goes : goes) > sine_)
      return false;
  }
  return true;
}

LookupUse lookup_use(const Caster& object, const lighting::DistantLight& source, int samples) {
  // RMS angles of the light, in those that look-ups are off: they add as squares do. From the first
  // on the light looks less than a tenth wider, which is as good as eight rays a vertex; from the
  // second on look-ups in finer cells are about as good as four.
  constexpr double kCoarseFrom = 2.5, kFineFrom = 1.5;
  constexpr int kMaxRays = 8;
  if (!object.visibility || samples == 1 || samples > kMaxRays) return LookupUse::kNone;
  const auto beside = [&](int cells) {
    return rms_angle(source) / prt::VisibilityMap::blur(cells);
  };
  if (beside(prt::VisibilityMap::kCells) > kCoarseFrom) return LookupUse::kCoarse;
  const double fine_from = samples > 4 ? kCoarseFrom : kFineFrom;
  return beside(prt::VisibilityMap::kFineCells) > fine_from ? LookupUse::kFine : LookupUse::kScout;
}

void look_up(const Caster& object, const prt::Plane* plane, const lighting::DistantLight& source,
             int cells, std::span<prt::CosineSums> out) {
  thread_local prt::VisibilitySamples memory;  // grows once per thread
  prt::VisibilitySamples& directions_used = memory;
  aim(object, plane, source, cells, prt::VisibilitySamples::kMax, directions_used);
  parallel_for(std::size_t{0}, out.size(), kAtOnce, [&](const auto& part) {
    object.visibility->look_up(directions_used, part.begin(), part.end(), out);
  });
  if (!object.hurried) look_again(object, plane, source, cells, out);
}

void scout(const Caster& object, const lighting::DistantLight& source,
           std::vector<VisibilityVerdict>& out) {
  thread_local std::vector<std::uint8_t> by_sample;  // grows once per thread
  const std::vector<prt::CosineSums>& seen = look_from_samples(object, source);
  std::vector<std::uint8_t>& said = by_sample;
  said.resize(seen.size());
  std::ranges::transform(seen, said.begin(), says);
  const prt::VertexSamples& samples = object.visibility->samples();
  const glm::vec3 towards =
      glm::transpose(object.world_from_mesh.rotation_matrix()) * glm::vec3(source.direction);
  const auto turned_away = -static_cast<float>(std::sin(largest_angle(source)));
  const std::span<const glm::vec3> normals = object.mesh->normals;
  out.resize(normals.size());
  parallel_for(std::size_t{0}, out.size(), kAtOnce, [&](const auto& part) {
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      const auto& [a, b, c, d] = samples.around(i);
      const int all = said[a] | said[b] | said[c] | said[d];
      if (glm::dot(normals[i], towards) <= turned_away)
        out[i] = VisibilityVerdict::kTurnedAway;
      else if (all == kSaysLit)
        out[i] = VisibilityVerdict::kLit;
      else if (all == kSaysDark)
        out[i] = VisibilityVerdict::kDark;
      else if (!samples.is_sample(i) || said[a] == kSaysMixed)
        out[i] = VisibilityVerdict::kMixed;
      else
        out[i] = said[a] == kSaysLit ? VisibilityVerdict::kMaybeLit : VisibilityVerdict::kMaybeDark;
    }
  });
}

}  // namespace penumbra::shadows
