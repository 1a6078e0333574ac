#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <map>
#include <mutex>
#include <span>
#include <tuple>
#include <utility>

#include "core/threads/parallel.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/bake/bake.h"
#include "prt/bake/bake_rules.h"
#include "prt/bake/internal/baker.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"
#include "prt/rays/ray_pattern.h"
#include "prt/rays/rays.h"
#include "prt/transfer/transfer.h"
#include "prt/transfer/visibility_map.h"

namespace penumbra::prt {

namespace {

constexpr int kLanes = RayScene::kPacket;
static_assert(kLanes == lighting::kBasisLanes);
constexpr int kManyRays = 512;      // a quarter of them is enough for reflected light
constexpr std::size_t kChunk = 64;  // points a task takes at once

}  // namespace

void Baker::add_receiver_points(const GroundGrid& grid) {
  for (int j = 0; j < grid.size; ++j)
    for (int i = 0; i < grid.size; ++i) {
      const glm::vec2 p =
          grid.position({(static_cast<float>(i) + .5f) / static_cast<float>(grid.size),
                         (static_cast<float>(j) + .5f) / static_cast<float>(grid.size)});
      const glm::vec3 position = (glm::vec3(p.x, grid.height, p.y) - centre_) * scale_;
      points_.push_back({position, {0, 1, 0}, ground_rays_at(position)});
    }
}

// Rays into a narrow cone have little weight each: fewer of them find the floor's light as exactly.
int Baker::ground_rays_at(const glm::vec3& position) const {
  const float distance = glm::length(position);
  // In a clip as many in all frames: changes of number would flicker.
  if (distance <= kConeFrom || !options_.ray_frames.empty()) return options_.ground_rays;
  const float of_hemisphere = 1 - std::sqrt(1 - 1 / (distance * distance));
  const int quarters = of_hemisphere > .25f ? 4 : of_hemisphere > .1f ? 2 : 1;
  return std::max(64, options_.ground_rays * quarters / 4 / 64 * 64);
}

bool Baker::grey() const {
  return std::ranges::all_of(mesh_.albedo, is_grey) && is_grey(floor_albedo_);
}

std::uint32_t Baker::ground_mask(const RayScene::RayPacket& packet) const {
  std::uint32_t mask = 0;
  for (int i = 0; i < kLanes; ++i)
    if (packet.y[i] < 0) mask |= 1u << i;
  return mask;
}

// 0..1, even over the rays of a point and other ones at the next.
static float choice_of(std::size_t point, int ray) {
  constexpr double kByRay = .6180339887498949, kByPoint = .7548776662466927;
  const double at = kByRay * ray + kByPoint * double(point);
  return static_cast<float>(at - std::floor(at));
}

// Of many rays one of the four groups stands for all (null: all are kept): reflected light is a
// small and smooth part, and every hit is read again in every bounce.
void Baker::keep_hits(const RayScene::RayPacket& packet, int first_ray, const glm::vec3& origin,
                      const float* weight, const std::uint8_t* groups, std::size_t index,
                      std::uint32_t blocked, PointResult& out) const {
  for (; blocked; blocked &= blocked - 1) {
    const int i = std::countr_zero(blocked);
    if (!(weight[i] > 0)) continue;
    const bool on_object = packet.triangle[i] != RayScene::kMiss;
    if (on_object && !packet.front[i]) {
      out.behind += weight[i];
      continue;
    }
    if (!on_object && is_ground_point(index)) continue;
    out.all_hits += weight[i];
    if (groups && groups[i] != 0) continue;
    const float choice = choice_of(index, first_ray + i);
    const std::uint32_t point =
        on_object ? nearby_vertex(packet, i, choice) : nearby_texel(origin, packet, i, choice);
    out.hits.push_back({point, weight[i]});
  }
}

std::uint32_t Baker::nearby_vertex(const RayScene::RayPacket& packet, int ray, float choice) const {
  const auto& t = mesh_.triangles[packet.triangle[ray]];
  return choice < packet.u[ray] ? t[1] : choice < packet.u[ray] + packet.v[ray] ? t[2] : t[0];
}

std::uint32_t Baker::nearby_texel(const glm::vec3& origin, const RayScene::RayPacket& packet,
                                  int ray, float choice) const {
  const GroundGrid& grid = options_.receiver->grid;
  const float t = std::max(0.f, (plane_height() - origin.y) / packet.y[ray]);
  const glm::vec2 here(origin.x + t * packet.x[ray], origin.z + t * packet.z[ray]);
  const glm::vec2 uv = grid.uv(here / scale_ + glm::vec2(centre_.x, centre_.z));
  if (!(uv.x >= 0 && uv.x < 1 && uv.y >= 0 && uv.y < 1)) return BounceHit::kBeyond;
  // One choice serves both axes: what it leaves of the first is as even.
  const auto last = static_cast<float>(grid.size - 1);
  const glm::vec2 at = glm::clamp(uv * static_cast<float>(grid.size) - .5f, 0.f, last);
  const glm::vec2 low = glm::floor(at), within = at - low;
  const bool right = choice < within.x;
  const float left_over =
      right ? choice / within.x : (choice - within.x) / std::max(1 - within.x, 1e-6f);
  const int x = static_cast<int>(low.x) + right,
            y = static_cast<int>(low.y) + (left_over < within.y);
  return static_cast<std::uint32_t>(mesh_.positions.size()) +
         static_cast<std::uint32_t>(y * grid.size + x);
}

// Of quarters of the rays, each of which holds a quarter of the weight; the mean of four has
// variance s^2/4.
static std::pair<float, float> sum_and_error(const std::array<float, 4>& by_group) {
  float sum = 0, square = 0;
  for (const float g : by_group) sum += g;
  for (const float g : by_group) square += (4 * g - sum) * (4 * g - sum);
  return {sum, std::sqrt(square / 3 / 4)};
}

void Baker::trace_point(const RayScene& scene, const RayPatterns& patterns, std::size_t index,
                        PointResult& out) const {
  const BakePoint& point = points_[index];
  const bool ground_point = is_ground_point(index);
  const bool plane_blocks = options_.receiver && !ground_point;
  const glm::vec3 origin = point.position + kRayNear * point.normal;
  const RayPatterns::Turn turn = RayPatterns::turn_of(index);

  // From the receiver the object fills a cone; rays elsewhere would be wasted.
  const float distance = glm::length(origin);
  const bool cone = ground_point && distance > kConeFrom;
  const float cos_half = cone ? std::sqrt(1 - 1 / (distance * distance)) : 0;
  const glm::mat3 frame = cone                                 ? frame_around(-origin / distance)
                          : index < options_.ray_frames.size() ? options_.ray_frames[index]
                                                               : frame_around(point.normal);
  const float uniform_weight = cone ? 2 * (1 - cos_half) / static_cast<float>(patterns.rays())
                                    : 1 / static_cast<float>(patterns.rays());

  out.blocked.assign(coefficients_, 0);
  out.hits.clear();
  out.all_hits = 0;
  out.behind = 0;
  std::array<float, 4> by_group{};
  alignas(64) float sum[kMaxCoefficients * kLanes];
  std::fill_n(sum, coefficients_ * kLanes, 0.f);
  RayScene::RayPacket packet;
  alignas(64) float weight[kLanes], basis[kMaxCoefficients * kLanes];
  for (int block = 0; block < patterns.rays() / kLanes; ++block) {
    if (cone) {
      patterns.cone_block(turn, block, frame, cos_half, packet);
      for (int i = 0; i < kLanes; ++i) weight[i] = uniform_weight * std::max(0.f, packet.y[i]);
    } else {
      patterns.cosine_block(turn, block, frame, packet);
      std::fill_n(weight, kLanes, uniform_weight);
    }
    std::uint32_t blocked = 0;
    if (options_.bounces > 0) {
      scene.intersect(origin, kRayNear, packet);
      for (int i = 0; i < kLanes; ++i)
        if (packet.triangle[i] != RayScene::kMiss) blocked |= 1u << i;
    } else {
      blocked = scene.occluded(origin, kRayNear, packet);
    }
    if (plane_blocks) blocked |= ground_mask(packet);
    if (blocked == 0) continue;
    const std::uint8_t* const groups = patterns.groups(turn, block);
    if (options_.bounces > 0)
      keep_hits(packet, kLanes * block, origin, weight,
                patterns.rays() >= kManyRays ? groups : nullptr, index, blocked, out);
    lighting::evaluate_basis_block(bands_, packet.x, packet.y, packet.z, basis);
    for (int i = 0; i < kLanes; ++i) {
      weight[i] = blocked >> i & 1 ? weight[i] : 0;
      by_group[groups[i]] += weight[i];
    }
    for (std::size_t n = 0; n < coefficients_; ++n)
      for (int i = 0; i < kLanes; ++i) sum[n * kLanes + i] += weight[i] * basis[n * kLanes + i];
  }
  for (std::size_t n = 0; n < coefficients_; ++n)
    for (int i = 0; i < kLanes; ++i) out.blocked[n] += sum[n * kLanes + i];
  std::tie(out.blocked_fraction, out.standard_error) = sum_and_error(by_group);
  float kept = 0;
  for (const BounceHit& hit : out.hits) kept += hit.weight;
  for (BounceHit& hit : out.hits) hit.weight *= out.all_hits / kept;  // no energy lost
}

// What is blocked is taken from the closed form, so nothing blocked means an exact result.
void Baker::start_transfer(std::size_t index, const PointResult& result) {
  double basis[kMaxCoefficients];
  lighting::evaluate_basis(bands_, glm::normalize(glm::dvec3(points_[index].normal)), basis);
  for (int l = 0; l < bands_; ++l)
    for (int m = -l; m <= l; ++m) {
      const auto n = static_cast<std::size_t>(sh_index(l, m));
      const double open = lighting::cosine_coefficient(l) / kPi * basis[n];
      for (int c = 0; c < channels_; ++c)
        shadowed_[(index * static_cast<std::size_t>(channels_) + static_cast<std::size_t>(c)) *
                      coefficients_ +
                  n] = static_cast<float>(open) - result.blocked[n];
    }
}

void Baker::report_progress(double fraction) {
  if (!options_.progress || fraction == 0) return;
  const std::scoped_lock lock(progress_mutex_);
  progress_ += fraction;
  options_.progress(std::min(1., progress_));
}

std::vector<PointQuality> Baker::quality(const std::vector<PointResult>& results) const {
  std::vector<PointQuality> out;
  for (std::size_t i = 0; i < mesh_.positions.size(); ++i)
    out.push_back({results[i].standard_error, results[i].behind});
  return out;
}

double Baker::standard_error(const std::vector<PointResult>& results,
                             const std::vector<PointQuality>& quality) const {
  double variance = 0, mean = 0;
  for (std::size_t i = 0; i < quality.size(); ++i) {
    variance += std::pow(double(quality[i].standard_error), 2);
    mean += 1 - double(results[i].blocked_fraction);
  }
  const auto count = static_cast<double>(quality.size());
  mean /= count;
  return mean > 0 ? std::sqrt(variance / count) / mean : 0;
}

Transfer Baker::packed_vertices() const {
  Transfer out(options_.bands, channels_, mesh_.positions.size());
  for (std::size_t p = 0; p < out.points; ++p)
    for (int c = 0; c < channels_; ++c)
      for (int n = 0; n < coefficient_count(options_.bands); ++n)
        out.set(c, n, p, transfer_at(p, c)[n]);
  return out;
}

// The deficit, not the transfer: it is small where the shadow is faint, so halves stay exact there.
Transfer Baker::packed_deficit() const {
  Transfer out(options_.bands, channels_, points_.size() - mesh_.positions.size());
  for (std::size_t p = 0; p < out.points; ++p)
    for (int c = 0; c < channels_; ++c)
      for (int n = 0; n < coefficient_count(options_.bands); ++n)
        out.set(c, n, p,
                ground_far_[static_cast<std::size_t>(n)] -
                    transfer_at(mesh_.positions.size() + p, c)[n]);
  return out;
}

// What the bounces added.
Transfer Baker::packed_reflected(std::size_t first, std::size_t count) const {
  const int bands = options_.bounces > 0 ? options_.reflected_bands : 1;
  Transfer out(bands, channels_, count);
  for (std::size_t p = 0; p < count; ++p)
    for (int c = 0; c < channels_; ++c) {
      const float* const all = transfer_at(first + p, c);
      const float* const direct = &shadowed_[static_cast<std::size_t>(all - current_.data())];
      for (int n = 0; n < coefficient_count(bands); ++n) out.set(c, n, p, all[n] - direct[n]);
    }
  return out;
}

// All of it.
Transfer Baker::packed(std::size_t first, std::size_t count, int bands) const {
  Transfer out(bands, channels_, count);
  for (std::size_t p = 0; p < count; ++p)
    for (int c = 0; c < channels_; ++c)
      for (int n = 0; n < coefficient_count(bands); ++n)
        out.set(c, n, p, transfer_at(first + p, c)[n]);
  return out;
}

Transfer Baker::shadow_probes() const {
  std::vector<std::size_t> dark;
  for (std::size_t p = mesh_.positions.size(); p < points_.size(); ++p)
    if (ground_far_[0] - transfer_at(p, 0)[0] > .05f * ground_far_[0]) dark.push_back(p);
  const std::size_t count =
      bands_ < kMaxBands ? 0 : std::min<std::size_t>(dark.size(), BakedObject::kShadowProbes);
  Transfer out(kMaxBands, 1, count);
  for (std::size_t i = 0; i < count; ++i) {
    // Steps by the golden ratio reach all of the dark part evenly, whatever its silhouette.
    const double at = std::fmod(.5 + static_cast<double>(i) * .6180339887498949, 1.);
    const float* const t = transfer_at(dark[static_cast<std::size_t>(at * double(dark.size()))], 0);
    for (int n = 0; n < kMaxCoefficients; ++n)
      out.set(0, n, i, ground_far_[static_cast<std::size_t>(n)] - t[n]);
  }
  return out;
}

void Baker::for_points(std::size_t first, std::size_t last, double progress,
                       const std::function<void(std::size_t)>& act) {
  parallel_for(first, last, kChunk, [&](const Indices<std::size_t>& range) {
    for (std::size_t i = range.begin(); i < range.end(); ++i) act(i);
    report_progress(progress * static_cast<double>(range.size()) /
                    static_cast<double>(last - first));
  });
}

// Points from `first` on, by rays of their own. Returns how many.
std::uint64_t Baker::trace_points(const RayScene& scene, std::size_t first, double progress,
                                  std::vector<PointResult>& out) {
  std::map<int, RayPatterns> patterns;  // by how many rays
  std::uint64_t rays = 0;
  for (std::size_t i = first; i < points_.size(); ++i) {
    patterns.try_emplace(points_[i].rays, points_[i].rays);
    rays += static_cast<std::uint64_t>(points_[i].rays);
  }
  for_points(first, points_.size(), progress, [&](std::size_t i) {
    trace_point(scene, patterns.at(points_[i].rays), i, out[i]);
    start_transfer(i, out[i]);
  });
  return rays;
}

// What a vertex sees through its wide cells, and what its rays hit.
void Baker::trace_wide(const RayScene& scene, const HemiOctSums& sums, std::size_t index,
                       VisibilityBake& visibility, PointResult& out) const {
  const HemiOctFrame frame = HemiOctFrame::of(index, points_[index].normal);
  const glm::vec3 origin = points_[index].position + kRayNear * points_[index].normal;
  RayScene::RayPacket packet;
  alignas(64) float weight[kLanes];
  for (int block = 0; block < VisibilityBake::kPackets; ++block) {
    VisibilityBake::wide_rays(frame, block, packet);
    for (int i = 0; i < kLanes; ++i)
      weight[i] = sums.wide_weight(4 * (block % 4) + i % 4, 4 * (block / 4) + i / 4);
    if (options_.bounces == 0) {
      visibility.keep_wide(index, block, scene.occluded(origin, kRayNear, packet));
      continue;
    }
    scene.intersect(origin, kRayNear, packet);
    std::uint32_t blocked = 0;
    for (int i = 0; i < kLanes; ++i)
      if (packet.triangle[i] != RayScene::kMiss) blocked |= 1u << i;
    visibility.keep_wide(index, block, blocked);
    if (options_.receiver) blocked |= ground_mask(packet);
    keep_hits(packet, kLanes * block, origin, weight, nullptr, index, blocked, out);
  }
}

// What hides from all wide rays of a vertex: through the first of its finer cells that are blocked.
void Baker::trace_blocked(const RayScene& scene, const OpenCells& open, std::size_t index,
                          PointResult& out) const {
  const HemiOctFrame frame = HemiOctFrame::of(index, mesh_.normals[index]);
  RayScene::RayPacket packet;
  alignas(64) float weight[kLanes] = {};
  int rays = 0;
  for (int i = 0; i < VisibilityMap::kFineCells * VisibilityMap::kFineCells && rays < kLanes; ++i) {
    const int x = i % VisibilityMap::kFineCells, y = i / VisibilityMap::kFineCells;
    const glm::vec3 d = frame.direction(x, y, VisibilityMap::kFineCells);
    const std::uint64_t block =
        open[static_cast<std::size_t>(VisibilityMap::kBlocks * (y / 8) + x / 8)];
    if ((block >> (8 * (y % 8) + x % 8) & 1) != 0 && !(options_.receiver && d.y < 0)) continue;
    packet.x[rays] = d.x, packet.y[rays] = d.y, packet.z[rays] = d.z;
    weight[rays++] = glm::dot(d, frame.normal);
  }
  for (int i = rays; i < kLanes; ++i)
    packet.x[i] = frame.normal.x, packet.y[i] = frame.normal.y, packet.z[i] = frame.normal.z;
  const glm::vec3 origin = points_[index].position + kRayNear * points_[index].normal;
  scene.intersect(origin, kRayNear, packet);
  std::uint32_t blocked = options_.receiver ? ground_mask(packet) : 0;
  for (int i = 0; i < kLanes; ++i)
    if (packet.triangle[i] != RayScene::kMiss) blocked |= 1u << i;
  keep_hits(packet, 0, origin, weight, nullptr, index, blocked, out);
}

// Vertices, by what they see past the mesh. Returns the number of rays.
std::uint64_t Baker::trace_by_visibility(const RayScene& scene, double progress,
                                         std::vector<PointResult>& out) {
  const std::size_t vertices = mesh_.positions.size();
  const HemiOctSums sums(bands_);
  VisibilityBake visibility(mesh_, scene);
  for_points(0, vertices, .35 * progress,
             [&](std::size_t i) { trace_wide(scene, sums, i, visibility, out[i]); });
  for_points(0, vertices, .65 * progress, [&](std::size_t i) {
    PointResult& result = out[i];
    result.blocked.assign(coefficients_, 0);
    const OpenCells open = visibility.refine(i);
    const HemiOctSums::Blocked blocked = sums.add_blocked(
        open, HemiOctFrame::of(i, mesh_.normals[i]), options_.receiver.has_value(), result.blocked);
    if (options_.bounces > 0 && result.hits.empty() && blocked.fraction > 0)
      trace_blocked(scene, open, i, result);
    result.blocked_fraction = blocked.fraction, result.standard_error = blocked.standard_error;
    // What wide rays hit stands for all that is blocked.
    const float hit = result.all_hits + result.behind;
    for (BounceHit& h : result.hits) h.weight *= blocked.fraction / hit;
    start_transfer(i, result);
  });
  visibility_ = visibility.take();
  return visibility.rays();
}

// Transfer without bounces, and what vertices see past the mesh alone. Returns the number of rays.
std::uint64_t Baker::trace_all(const RayScene& scene, std::vector<PointResult>& out) {
  constexpr double kProgress = .9;
  if (!options_.visibility) return trace_points(scene, 0, kProgress, out);
  const std::size_t vertices = mesh_.positions.size();
  // A wish for more rays than the visibility has cells is met by rays of their own.
  const bool apart = options_.rays > VisibilityMap::kFineCells * VisibilityMap::kFineCells;
  const double by_visibility = apart ? .2 : points_.size() > vertices ? .8 : kProgress;
  const std::uint64_t rays = trace_by_visibility(scene, by_visibility, out);
  return rays + trace_points(scene, apart ? 0 : vertices, kProgress - by_visibility, out);
}

Result<BakedObject> Baker::run(Mesh mesh) {
  const auto start = std::chrono::steady_clock::now();
  PENUMBRA_ASSIGN(scene, RayScene::build(mesh_));
  channels_ = options_.bounces > 0 && !grey() ? 3 : 1;
  const std::size_t floats = points_.size() * static_cast<std::size_t>(channels_) * coefficients_;
  shadowed_.resize(floats);
  double up[kMaxCoefficients];
  lighting::evaluate_basis(bands_, {0, 1, 0}, up);
  for (int l = 0; l < bands_; ++l)
    for (int m = -l; m <= l; ++m)
      ground_far_.push_back(
          static_cast<float>(lighting::cosine_coefficient(l) / kPi * up[sh_index(l, m)]));

  std::vector<PointResult> results(points_.size());
  const std::uint64_t rays = trace_all(scene, results);
  bounce_all(results, options_.bounces, ground_far_, options_.floor_apart ? .05 : .1);
  BakedObject out;
  const std::size_t vertices = mesh_.positions.size();
  out.transfer = packed_vertices();
  out.reflected = packed_reflected(0, vertices);
  if (options_.receiver) {
    out.receiver = options_.receiver;
    out.ground_deficit = packed_deficit();
    out.shadow_probes = shadow_probes();
    out.ground_reflected = packed_reflected(vertices, points_.size() - vertices);
  }
  if (options_.floor_apart && options_.receiver) {
    out.receiver->albedo = {};
    if (options_.bounces > 0) bake_floor(results, out);
  }
  out.visibility = std::move(visibility_);
  out.mesh = std::move(mesh);
  if (options_.progress) options_.progress(1);  // parts do not add up to it to the last bit
  const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
  std::vector<PointQuality> by_vertex = quality(results);
  out.report = {rays, seconds.count(), standard_error(results, by_vertex), std::move(by_vertex)};
  return out;
}

Result<BakedObject> bake(Mesh mesh, const BakeOptions& o) {
  if (mesh.triangles.empty()) return fail(ErrorCode::kInvalid, "mesh", "has no triangles");
  if (mesh.normals.size() != mesh.positions.size() || mesh.albedo.size() != mesh.positions.size())
    return fail(ErrorCode::kInvalid, "mesh",
                "has different numbers of positions, normals and albedos");
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const glm::vec3 sum = mesh.positions[i] + mesh.normals[i];
    if (!std::isfinite(sum.x + sum.y + sum.z))
      return fail(ErrorCode::kNonFinite, "mesh", fmt::format("vertex {} is not finite", i));
  }
  if (o.receiver) {
    const GroundGrid& g = o.receiver->grid;
    if (g.size < 2 || g.size > 4096 || !(g.half_extent > 0) ||
        !std::isfinite(g.half_extent + g.height + g.centre.x + g.centre.y))
      return fail(
          ErrorCode::kInvalid, "receiver",
          "has a size that is not within 2..4096, or an extent that is not positive and finite");
  }
  if (o.bands < 1 || o.bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "bands",
                fmt::format("{} is not within 1..{}", o.bands, kMaxBands));
  if (o.rays < 64 || o.rays % 64 != 0 || o.ground_rays < 64 || o.ground_rays % 64 != 0)
    return fail(ErrorCode::kInvalid, "rays", "are not a positive multiple of 64");
  if (o.reflected_bands < 1 || o.reflected_bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "bands of reflected light",
                fmt::format("{} is not within 1..{}", o.reflected_bands, kMaxBands));
  if (!o.ray_frames.empty() && o.ray_frames.size() != mesh.positions.size())
    return fail(ErrorCode::kInvalid, "ray frames", "are not as many as the vertices");
  if (!o.ray_frames.empty() && o.visibility)
    return fail(ErrorCode::kInvalid, "ray frames", "do not turn a visibility map's rays");
  if (o.bounces < 0 || o.bounces > kMaxBounces)
    return fail(ErrorCode::kInvalid, "bounces",
                fmt::format("{} is not within 0..{}", o.bounces, kMaxBounces));
  return Baker(mesh, o).run(std::move(mesh));
}

}  // namespace penumbra::prt
