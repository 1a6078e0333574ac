#include "shadows/visibility/direct_light.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "core/threads/parallel.h"
#include "prt/transfer/visibility_map.h"
#include "shadows/silhouette/light_rays.h"
#include "shadows/silhouette/place_kernel.h"
#include "shadows/visibility/internal/vertex_smoothing.h"
#include "shadows/visibility/internal/visibility_groups.h"
#include "shadows/visibility/internal/visibility_light.h"

namespace penumbra::shadows {

namespace {

// By vertex, over the directions that were asked for it.
using Sums = std::vector<prt::CosineSums>;

constexpr float kSeenAtAll = .002f;  // mean cosine: less of the light is not worth a ray
constexpr int kOpenSamples = 16;     // of the whole light, for the cosine of an open vertex

// Whether some of a light may be behind the plane: then how much is a question for all of its
// directions.
bool is_cut(const prt::Plane* plane, const lighting::DistantLight& source) {
  return plane && glm::dot(plane->normal, source.direction) <= std::sin(largest_angle(source));
}

// Bit by direction.
std::uint64_t before_bits(const prt::Plane* plane, std::span<const glm::vec3> directions) {
  std::uint64_t out = 0;
  for (std::size_t k = 0; k < directions.size(); ++k)
    if (!behind(plane, directions[k])) out |= std::uint64_t{1} << k;
  return out;
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
  std::span<const glm::vec3> samples(std::size_t vertex) const { return pattern_.at(vertex); }
  /// Of such directions, with nothing in their way.
  prt::CosineSums unhindered(std::size_t vertex, std::span<const glm::vec3> directions) const {
    const glm::vec3 n = normal(vertex);
    prt::CosineSums out;
    for (const glm::vec3& d : directions) {
      const float cosine = std::max(0.f, glm::dot(n, d));
      out.open += cosine;
      if (!behind(plane_, d)) out.seen += cosine;
    }
    return out;
  }

  /// Adds samples [first, last) of the vertices to the sums of cosines.
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
          if (cosine <= 0) continue;
          sums[i].open += cosine;
          if (!behind(plane_, d)) packets.add(i, cosine, o, d);
        }
      }
    });
  }
  /// By one ray each; sums as large as those of `scale` samples.
  void ask(std::span<const VisibilityGroups::PartlyLit> parts, std::span<const glm::vec3> samples,
           float scale, Sums& sums) const {
    parallel_for(std::size_t{0}, parts.size(), 1024, [&](const auto& some) {
      Packets packets(occluders_, [&](std::size_t i, float all, bool by_virtual, bool by_real) {
        if (!by_virtual && !by_real) sums[i].seen = all;
      });
      for (const auto& [i, part] : parts.subspan(some.begin(), some.size())) {
        sums[i].open = scale * part.open;
        if (part.seen > kSeenAtAll)
          packets.add(i, scale * part.seen, origin(i, normal(i)), samples[part.ask]);
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

// One vertex of so many that follow each other, without a beat that rows of vertices could share.
// source: the finaliser of Wellons 2018, "Prospecting for Hash Functions" (lowbias32)
std::size_t probe_of(std::size_t part, std::size_t vertices) {
  auto x = static_cast<std::uint32_t>(part + 1);  // zero would stay zero
  x = (x ^ x >> 16) * 0x7feb352du;
  x = (x ^ x >> 15) * 0x846ca68bu;
  return vertices * part + (x ^ x >> 16) % vertices;
}

// Calls tell(vertex, lit) for vertices whose group tells their light; the others that are not
// turned away are `own`. Some of each group's vertices ask for it by `scouts` rays; where they do
// not agree that all or that none arrives every vertex has its own. Where surfaces may cut through
// a group a part that is cut off and holds no probe, of some dozen vertices, stays wrong.
template <class Tell>
void ask_groups(const VertexTracer& tracer, const VisibilityGroups& visibility, std::size_t scouts,
                Sums& sums, Tell tell, std::vector<std::uint32_t>& own) {
  constexpr char kUnknown = 0, kLit = 1, kDark = 2, kMixed = 3;
  const std::span<const std::uint32_t> group = visibility.group();
  const auto is_grouped = [&](std::size_t i) { return group[i] < visibility.groups(); };
  thread_local std::vector<char> verdict;  // grow once per thread
  thread_local std::vector<std::uint32_t> probes;
  probes.assign(visibility.members().begin(), visibility.members().end());
  const std::size_t probe_each = visibility.may_be_cut() ? 16 : 256;
  for (std::size_t part = 0; part * probe_each < group.size(); ++part)
    if (const std::size_t i = probe_of(part, probe_each);
        i < group.size() && is_grouped(i) && !visibility.is_member(i))
      probes.push_back(static_cast<std::uint32_t>(i));
  tracer.trace(probes, 0, scouts, sums);
  verdict.assign(visibility.groups(), kUnknown);
  for (const std::uint32_t i : probes) {
    const float all = tracer.unhindered(i, tracer.samples(i).first(scouts)).seen;
    const float arrives = std::exchange(sums[i], {}).seen;
    if (all <= 0) continue;
    constexpr float kRounding = 1e-5f;
    const char one = arrives <= 0 ? kDark : arrives > all - kRounding ? kLit : kMixed;
    char& verdict_here = verdict[group[i]];
    verdict_here = verdict_here == kUnknown || verdict_here == one ? one : kMixed;
  }
  own.clear();
  for (std::uint32_t i = 0; i < group.size(); ++i) {
    if (group[i] == VisibilityGroups::kTurnedAway || group[i] == VisibilityGroups::kInPart)
      continue;
    const char one = is_grouped(i) ? verdict[group[i]] : kMixed;
    if (one == kLit || one == kDark)
      tell(i, one == kLit);
    else
      own.push_back(i);
  }
}

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

// The light of vertices that see all of a light or nothing. Only the part of it counts, unless
// neighbours share it or the plane hides some of the light.
class Teller {
 public:
  /// `alike`: the directions of all vertices, where neighbours do not share theirs.
  Teller(const VertexTracer& tracer, const prt::Plane* plane, bool averaged, bool cut,
         std::span<const glm::vec3> alike, Sums& sums)
      : tracer_(tracer), averaged_(averaged), cut_(cut), alike_(alike), sums_(sums) {
    for (const glm::vec3& d : alike) {
      all_ += d;
      if (!behind(plane, d)) before_ += d;
    }
    all_ /= static_cast<float>(alike.size()), before_ /= static_cast<float>(alike.size());
    for (const glm::vec3& d : alike) reach_ = std::max(reach_, glm::distance(d, all_));
  }

  void operator()(std::size_t vertex, bool lit) const {
    const prt::CosineSums here = averaged_     ? tracer_.unhindered(vertex, tracer_.samples(vertex))
                                 : cut_ && lit ? of_alike(vertex)
                                               : prt::CosineSums{1, 1};
    sums_[vertex] = {lit ? here.seen : 0, here.open};
  }

 private:
  // What faces all of the light has the light of its mean direction.
  prt::CosineSums of_alike(std::size_t vertex) const {
    const glm::vec3 n = tracer_.normal(vertex);
    const float open = glm::dot(n, all_);
    if (open <= reach_) return tracer_.unhindered(vertex, alike_);
    return {glm::dot(n, before_), open};
  }

  const VertexTracer& tracer_;
  bool averaged_, cut_;
  std::span<const glm::vec3> alike_;
  glm::vec3 all_{0}, before_{0};
  float reach_ = 0;
  Sums& sums_;
};

// Rays where what tells for a whole group of vertices does not do.
void trace_groups(const VertexTracer& tracer, const VisibilityGroups& visibility,
                  const prt::Mesh& mesh, const lighting::DistantLight& source, int samples,
                  std::span<const glm::vec3> asked, const Teller& tell, Sums& sums) {
  thread_local std::vector<char> place;  // grow once per thread
  thread_local std::vector<std::uint32_t> own;
  const bool narrow = !is_wide(source), hard = samples == 1;
  const auto last = static_cast<std::size_t>(samples);
  ask_groups(tracer, visibility, narrow ? 1 : last, sums, tell, own);
  tracer.ask(visibility.parts(), asked, static_cast<float>(last), sums);
  // The penumbra of a narrow light is a line between vertices that see it and vertices that do not:
  // one ray each finds it. To look at every triangle for that costs more than all rays of few
  // vertices. Not so for wide ones, where a start with two rays each adds error.
  constexpr std::size_t kFew = 64;
  std::size_t traced = 0;
  if (narrow && !hard && kFew * own.size() > mesh.triangles.size()) {
    tracer.trace(own, 0, 1, sums);
    find_edges(mesh, sums, place);
    std::erase_if(own, [](std::uint32_t i) { return place[i] == kInside; });
    traced = 1;
  }
  tracer.trace(own, traced, last, sums);
}

// Rays where the object's visibility is not sure; where it may be, two ask whether there is a need
// for the others.
void trace_unsure(const VertexTracer& tracer, const Caster& object,
                  const lighting::DistantLight& source, int samples, const Teller& tell,
                  Sums& sums) {
  constexpr std::size_t kAsks = 2;                      // one misses thin penumbras
  thread_local std::vector<VisibilityVerdict> verdict;  // grow once per thread
  thread_local std::vector<std::uint32_t> own, asked;
  scout(object, source, verdict);
  own.clear(), asked.clear();
  for (std::uint32_t i = 0; i < verdict.size(); ++i) {
    switch (verdict[i]) {
      case VisibilityVerdict::kTurnedAway:
        break;
      case VisibilityVerdict::kDark:
      case VisibilityVerdict::kLit:
        tell(i, verdict[i] == VisibilityVerdict::kLit);
        break;
      case VisibilityVerdict::kMaybeDark:
      case VisibilityVerdict::kMaybeLit:
        asked.push_back(i);
        break;
      case VisibilityVerdict::kMixed:
        own.push_back(i);
    }
  }
  const auto last = static_cast<std::size_t>(samples);
  tracer.trace(own, 0, last, sums);
  tracer.trace(asked, 0, kAsks, sums);
  std::erase_if(asked, [&](std::uint32_t i) {
    const bool lit = verdict[i] == VisibilityVerdict::kMaybeLit;
    const bool is_so = lit ? sums[i].seen >= sums[i].open : sums[i].seen <= 0;
    if (is_so) tell(i, lit);
    return is_so;
  });
  tracer.trace(asked, kAsks, last, sums);
}

}  // namespace

void trace_direct_light(const RayOccluders& occluders, const ShadowCasters& casters,
                        const Caster& object, const prt::Plane* plane,
                        const lighting::DistantLight& source, int samples, std::span<float> out) {
  const prt::Mesh& mesh = *object.mesh;
  // All memory grows once per thread.
  thread_local SamplePattern all, pattern_memory;
  thread_local VisibilityGroups shared;
  thread_local Sums sums_memory;
  SamplePattern& pattern = pattern_memory;
  Sums& sums = sums_memory;
  const bool hard = samples == 1;
  const std::size_t count = mesh.positions.size();
  const LookupUse use = lookup_use(casters, object, source, samples);
  const bool looked_up = use == LookupUse::kCoarse || use == LookupUse::kFine;
  // Neighbours share what few rays find; what is looked up has no noise that they could average.
  const bool averaged = !hard && !looked_up && is_wide(source) &&
                        penumbra_exceeds_edges(source, *object.silhouette),
             cut = is_cut(plane, source);
  all.make(source, cut && !averaged ? kMaxSamples : std::max(samples, kOpenSamples), 1);
  if (looked_up) {
    sums.resize(count);
    const int cells =
        use == LookupUse::kCoarse ? prt::VisibilityMap::kCells : prt::VisibilityMap::kFineCells;
    look_up(object, plane, source, cells, sums);
  } else {
    sums.assign(count, {});
    pattern.make(source, samples, hard ? 1 : kTurns);
    const VertexTracer tracer(occluders, mesh, object.world_from_mesh, plane, pattern);
    const std::span<const glm::vec3> alike = hard ? pattern.at(0) : all.at(0);
    const Teller tell(tracer, plane, averaged, cut, alike, sums);
    if (use == LookupUse::kScout) {
      trace_unsure(tracer, object, source, samples, tell, sums);
    } else {
      shared.find(casters, object, source, {alike, before_bits(plane, alike)});
      trace_groups(tracer, shared, mesh, source, samples, all.at(0), tell, sums);
    }
  }
  if (averaged) smooth_over_neighbours(mesh, smoothing_passes(source), sums);
  const UnoccludedLight whole(all.at(0), glm::vec3(source.direction),
                              glm::transpose(object.world_from_mesh.rotation_matrix()), hard);
  parallel_for(std::size_t{0}, count, 1024, [&](const auto& part) {
    whole.light(std::span(mesh.normals).subspan(part.begin(), part.size()),
                out.subspan(part.begin(), part.size()));
    for (std::size_t i = part.begin(); i < part.end(); ++i)
      out[i] = sums[i].seen <= 0 ? 0 : sums[i].seen / sums[i].open * out[i];
  });
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
  if (is_wide(source) && !hard)
    for (auto* sums : {&out.open, &out.virtual_occlusion, &out.real_occlusion})
      smooth_over_neighbours(mesh, smoothing_passes(source), *sums);
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
