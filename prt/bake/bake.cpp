#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <chrono>
#include <cmath>
#include <mutex>
#include <optional>
#include <span>
#include <utility>

#include "core/half.h"
#include "core/threads/parallel.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/bake/bake.h"
#include "prt/bake/bake_rules.h"
#include "prt/bake/internal/visibility_bake.h"
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
constexpr int kManyRays = 512;        // a quarter of them is enough for reflected light
constexpr std::size_t kChunk = 64;    // points a task takes at once
constexpr double kFineFraction = .2;  // of a bake's progress
constexpr int kFloorAgainBands = 5;

struct BakePoint {
  glm::vec3 position, normal;
  int rays;
};

// Where a blocked ray ended: a triangle's inside point, or the receiver.
struct BounceHit {
  static constexpr std::uint32_t kGround = 0xfffffffeu;
  std::uint32_t triangle;
  float u, v;    // barycentric, or the receiver's texture coordinates
  float weight;  // fraction of this ray in the point's transfer
};

struct PointResult {
  std::vector<float> blocked;  // sum over blocked rays of w Y_n
  float group_blocked[4] = {};
  float behind = 0;  // weight of rays that met a back face
  std::vector<BounceHit> hits;
  float all_hits = 0;  // weight of all hits, kept or not
};

// The bake works on a copy moved to the origin and scaled to radius one, so that neither the size
// nor the place of the model changes a float operation.
class Baker {
 public:
  Baker(const Mesh& mesh, const BakeOptions& options)
      : options_(options), bands_(options.bands), mesh_(mesh) {
    const Bounds b = bounds_of(mesh);
    centre_ = b.centre();
    scale_ = 1 / std::max(radius_around(mesh, centre_), 1e-30f);
    for (glm::vec3& p : mesh_.positions) p = (p - centre_) * scale_;
    for (std::size_t i = 0; i < mesh_.positions.size(); ++i)
      points_.push_back({mesh_.positions[i], mesh_.normals[i], options.rays});
    if (options.receiver && !options.floor_apart) floor_albedo_ = options.receiver->albedo;
    if (options.receiver) add_receiver_points(options.receiver->grid);
    if (options.bounces > 0) bands_ = std::max(bands_, options.reflected_bands);
    coefficients_ = solved_ = static_cast<std::size_t>(coefficient_count(bands_));
  }

  Result<BakedObject> run(Mesh mesh);

 private:
  void add_receiver_points(const GroundGrid& grid);
  bool is_ground_point(std::size_t i) const { return i >= mesh_.positions.size(); }
  float plane_height() const { return (options_.receiver->grid.height - centre_.y) * scale_; }
  bool grey() const;
  void trace_point(const RayScene& scene, const RayPatterns& patterns, std::size_t index,
                   PointResult& out) const;
  std::uint64_t trace_all(const RayScene& scene, std::vector<PointResult>& out);
  void keep_hits(const RayScene::RayPacket& packet, const glm::vec3& origin, const float* weight,
                 const std::uint8_t* groups, bool ground_point, std::uint32_t blocked,
                 PointResult& out) const;
  std::uint32_t ground_mask(const RayScene::RayPacket& packet) const;
  void start_transfer(std::size_t index, const PointResult& result);
  void bounce(std::size_t index, const std::vector<BounceHit>& hits);
  void bounce_all(const std::vector<PointResult>& results, int bounces, double progress);
  void gather_from_floor(const std::vector<PointResult>& results, std::span<const float> far);
  void bake_floor(const std::vector<PointResult>& results, BakedObject& out);
  std::array<double, 3> added_by_last_bounce() const;
  void add_further_bounces(const std::array<double, 3>& fraction);
  void add_ground_bounce(const BounceHit& hit, int channel, float albedo,
                         std::span<const float> far, float* sum) const;
  void report_progress(double fraction);
  std::vector<PointQuality> quality(const std::vector<PointResult>& results) const;
  double standard_error(const std::vector<PointResult>& results,
                        const std::vector<PointQuality>& quality) const;
  Transfer packed_vertices() const;
  Transfer packed_deficit() const;
  Transfer packed_reflected(std::size_t first, std::size_t count) const;
  Transfer packed(std::size_t first, std::size_t count, int bands) const;
  Transfer shadow_probes() const;

  const float* transfer_at(std::size_t point, int channel) const {
    return &current_[(point * static_cast<std::size_t>(channels_) +
                      static_cast<std::size_t>(channel)) *
                     coefficients_];
  }

  const BakeOptions& options_;
  int bands_;  // traced: as many as the transfer or its reflected part needs
  Mesh mesh_;
  glm::vec3 centre_{};
  float scale_ = 1;
  std::vector<BakePoint> points_;
  std::size_t coefficients_ = 0, solved_ = 0;  // kept, and what bounces are found for
  int channels_ = 1;
  Rgb floor_albedo_;  // of the receiver, as far as its light is counted in
  std::vector<float> shadowed_, current_, next_;  // [point][channel][n]
  std::vector<float> ground_far_;                 // transfer of an unshadowed receiver, per n
  std::vector<float> far_;                        // of what bounces, beyond the receiver's grid
  VisibilityMap visibility_;
  std::mutex progress_mutex_;
  double progress_ = 0;
};

void Baker::add_receiver_points(const GroundGrid& grid) {
  for (int j = 0; j < grid.size; ++j)
    for (int i = 0; i < grid.size; ++i) {
      const glm::vec2 p =
          grid.position({(static_cast<float>(i) + .5f) / static_cast<float>(grid.size),
                         (static_cast<float>(j) + .5f) / static_cast<float>(grid.size)});
      const glm::vec3 world(p.x, grid.height, p.y);
      points_.push_back({(world - centre_) * scale_, {0, 1, 0}, options_.ground_rays});
    }
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

// Of many rays one of the four groups stands for all (null: all are kept): reflected light is a
// small and smooth part, and every hit is read again in every bounce.
void Baker::keep_hits(const RayScene::RayPacket& packet, const glm::vec3& origin,
                      const float* weight, const std::uint8_t* groups, bool ground_point,
                      std::uint32_t blocked, PointResult& out) const {
  for (; blocked; blocked &= blocked - 1) {
    const int i = std::countr_zero(blocked);
    const bool on_object = packet.triangle[i] != RayScene::kMiss;
    if (on_object && !packet.front[i]) {
      out.behind += weight[i];
      continue;
    }
    if (!on_object && ground_point) continue;
    out.all_hits += weight[i];
    if (groups && groups[i] != 0) continue;
    if (on_object) {
      out.hits.push_back({packet.triangle[i], packet.u[i], packet.v[i], weight[i]});
    } else {
      const float t = std::max(0.f, (plane_height() - origin.y) / packet.y[i]);
      const glm::vec2 here(origin.x + t * packet.x[i], origin.z + t * packet.z[i]);
      const glm::vec2 uv =
          options_.receiver->grid.uv(here / scale_ + glm::vec2(centre_.x, centre_.z));
      out.hits.push_back({BounceHit::kGround, uv.x, uv.y, weight[i]});
    }
  }
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
  std::fill_n(out.group_blocked, 4, 0.f);
  out.behind = 0;
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
      keep_hits(packet, origin, weight, patterns.rays() >= kManyRays ? groups : nullptr,
                ground_point, blocked, out);
    lighting::evaluate_basis_block(bands_, packet.x, packet.y, packet.z, basis);
    for (int i = 0; i < kLanes; ++i) {
      weight[i] = blocked >> i & 1 ? weight[i] : 0;
      out.group_blocked[groups[i]] += weight[i];
    }
    for (std::size_t n = 0; n < coefficients_; ++n)
      for (int i = 0; i < kLanes; ++i) sum[n * kLanes + i] += weight[i] * basis[n * kLanes + i];
  }
  for (std::size_t n = 0; n < coefficients_; ++n)
    for (int i = 0; i < kLanes; ++i) out.blocked[n] += sum[n * kLanes + i];
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

// far: of the receiver beyond its grid
void Baker::add_ground_bounce(const BounceHit& hit, int channel, float albedo,
                              std::span<const float> far, float* sum) const {
  const float k = hit.weight * albedo;
  if (k == 0) return;
  const int size = options_.receiver->grid.size;
  if (hit.u < 0 || hit.u >= 1 || hit.v < 0 || hit.v >= 1 || !std::isfinite(hit.u + hit.v)) {
    for (std::size_t n = 0; n < solved_; ++n) sum[n] += k * far[n];
    return;
  }
  const float x =
      std::clamp(hit.u * static_cast<float>(size) - .5f, 0.f, static_cast<float>(size - 1));
  const float y =
      std::clamp(hit.v * static_cast<float>(size) - .5f, 0.f, static_cast<float>(size - 1));
  const int x0 = std::min(static_cast<int>(x), size - 2),
            y0 = std::min(static_cast<int>(y), size - 2);
  const float fx = x - static_cast<float>(x0), fy = y - static_cast<float>(y0);
  const std::size_t base = mesh_.positions.size() + static_cast<std::size_t>(y0 * size + x0);
  const float* const t00 = transfer_at(base, channel);
  const float* const t10 = transfer_at(base + 1, channel);
  const float* const t01 = transfer_at(base + static_cast<std::size_t>(size), channel);
  const float* const t11 = transfer_at(base + static_cast<std::size_t>(size) + 1, channel);
  const float w00 = k * (1 - fx) * (1 - fy), w10 = k * fx * (1 - fy), w01 = k * (1 - fx) * fy,
              w11 = k * fx * fy;
  for (std::size_t n = 0; n < solved_; ++n)
    sum[n] += w00 * t00[n] + w10 * t10[n] + w01 * t01[n] + w11 * t11[n];
}

void Baker::bounce(std::size_t index, const std::vector<BounceHit>& hits) {
  for (int c = 0; c < channels_; ++c) {
    const std::size_t at =
        (index * static_cast<std::size_t>(channels_) + static_cast<std::size_t>(c)) * coefficients_;
    float sum[kMaxCoefficients];
    std::copy_n(&shadowed_[at], solved_, sum);
    for (const BounceHit& hit : hits) {
      if (hit.triangle == BounceHit::kGround) {
        add_ground_bounce(hit, c, floor_albedo_[c], far_, sum);
        continue;
      }
      const auto& t = mesh_.triangles[hit.triangle];
      const float w0 = 1 - hit.u - hit.v;
      const float rho = w0 * mesh_.albedo[t[0]][c] + hit.u * mesh_.albedo[t[1]][c] +
                        hit.v * mesh_.albedo[t[2]][c];
      const float k = hit.weight * rho;
      const float *a = transfer_at(t[0], c), *b = transfer_at(t[1], c), *d = transfer_at(t[2], c);
      for (std::size_t n = 0; n < solved_; ++n)
        sum[n] += k * (w0 * a[n] + hit.u * b[n] + hit.v * d[n]);
    }
    std::copy_n(sum, solved_, &next_[at]);
  }
}

// What of current_ comes by one reflection on a white receiver, into shadowed_.
void Baker::gather_from_floor(const std::vector<PointResult>& results, std::span<const float> far) {
  parallel_for(std::size_t{0}, points_.size(), [&](std::size_t index) {
    for (int c = 0; c < channels_; ++c) {
      float* const sum =
          &shadowed_[(index * static_cast<std::size_t>(channels_) + static_cast<std::size_t>(c)) *
                     coefficients_];
      std::fill_n(sum, solved_, 0.f);
      for (const BounceHit& hit : results[index].hits)
        if (hit.triangle == BounceHit::kGround) add_ground_bounce(hit, c, 1, far, sum);
    }
  });
}

// Solves current_ = shadowed_ + what current_ reflects, by bounces.
void Baker::bounce_all(const std::vector<PointResult>& results, int bounces, double progress) {
  current_ = shadowed_;
  if (bounces == 0) return;
  next_.resize(current_.size());
  std::array<double, 3> added{}, fraction{};
  for (int b = 0; b < bounces; ++b) {
    parallel_for(std::size_t{0}, points_.size(), kChunk, [&](const Indices<std::size_t>& range) {
      for (std::size_t i = range.begin(); i < range.end(); ++i) bounce(i, results[i].hits);
    });
    std::swap(current_, next_);
    const std::array<double, 3> before = std::exchange(added, added_by_last_bounce());
    for (std::size_t c = 0; c < 3; ++c) fraction[c] = before[c] > 0 ? added[c] / before[c] : 0;
    report_progress(progress / bounces);
  }
  add_further_bounces(fraction);
}

// What the last bounce added under a constant light, summed over all points.
std::array<double, 3> Baker::added_by_last_bounce() const {
  std::array<double, 3> sum{};
  const auto channels = static_cast<std::size_t>(channels_);
  for (std::size_t p = 0; p < points_.size(); ++p)
    for (std::size_t c = 0; c < channels; ++c) {
      const std::size_t at = (p * channels + c) * coefficients_;
      sum[c] += double(current_[at]) - next_[at];
    }
  return sum;
}

// The bounces that are not traced: each is the one before, fainter by the same factor. Power
// iteration: what a bounce adds soon has the form of the scene's largest eigenvector, whatever the
// light.
void Baker::add_further_bounces(const std::array<double, 3>& fraction) {
  const auto channels = static_cast<std::size_t>(channels_);
  parallel_for(std::size_t{0}, points_.size(), [&](std::size_t p) {
    for (std::size_t c = 0; c < channels; ++c) {
      constexpr double kMaxFraction = .95;  // beyond, two bounces say too little
      const double q = std::clamp(fraction[c], 0., kMaxFraction);
      const auto further = static_cast<float>(q / (1 - q));
      const std::size_t at = (p * channels + c) * coefficients_;
      for (std::size_t n = at; n < at + solved_; ++n)
        current_[n] += further * (current_[n] - next_[n]);
    }
  });
}

void Baker::report_progress(double fraction) {
  if (!options_.progress) return;
  const std::scoped_lock lock(progress_mutex_);
  progress_ += fraction;
  options_.progress(std::min(1., progress_));
}

std::vector<PointQuality> Baker::quality(const std::vector<PointResult>& results) const {
  // t_0 of each group is (1 - its blocked fraction) times a constant; the mean of four has variance
  // s^2/4.
  std::vector<PointQuality> out;
  for (std::size_t i = 0; i < mesh_.positions.size(); ++i) {
    double m = 0, s = 0;
    for (float g : results[i].group_blocked) m += g;  // each group holds a quarter of the weight
    for (float g : results[i].group_blocked) s += std::pow(4 * g - m, 2);
    out.push_back({static_cast<float>(std::sqrt(s / 3 / 4)), results[i].behind});
  }
  return out;
}

double Baker::standard_error(const std::vector<PointResult>& results,
                             const std::vector<PointQuality>& quality) const {
  double variance = 0, mean = 0;
  for (std::size_t i = 0; i < quality.size(); ++i) {
    variance += std::pow(double(quality[i].standard_error), 2);
    mean += 1;
    for (float g : results[i].group_blocked) mean -= g;
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

// t(rho) = sum_k rho^k t_k with t_k = (1 - A)^-1 G t_(k-1): G by one reflection on the white floor,
// A by the object. From the third on each is the one before times the echo.
void Baker::bake_floor(const std::vector<PointResult>& results, BakedObject& out) {
  const std::size_t vertices = mesh_.positions.size();
  const auto sums = [&] {
    std::array<double, 3> sum{};
    for (std::size_t p = 0; p < points_.size(); ++p)
      for (int c = 0; c < channels_; ++c)
        sum[static_cast<std::size_t>(c)] += double(transfer_at(p, c)[0]);
    return sum;
  };
  gather_from_floor(results, ground_far_);
  bounce_all(results, options_.bounces, .05);
  out.floor = packed(0, vertices, options_.reflected_bands);
  out.ground_floor = packed(vertices, points_.size() - vertices, options_.reflected_bands);
  // What comes to the floor a second time is faint, and nearly the same wherever it came from.
  const int few_bands = std::min(kFloorAgainBands, bands_);
  solved_ = static_cast<std::size_t>(coefficient_count(few_bands));
  far_.assign(coefficients_, 0);
  gather_from_floor(results, far_);
  bounce_all(results, options_.bounces, 0);
  out.floor_again = packed(0, vertices, few_bands);
  out.ground_floor_again = packed(vertices, points_.size() - vertices, few_bands);
  const std::array<double, 3> twice = sums();
  gather_from_floor(results, far_);
  bounce_all(results, options_.bounces, 0);
  const std::array<double, 3> thrice = sums();
  for (int c = 0; c < 3; ++c) {
    const auto from = static_cast<std::size_t>(c < channels_ ? c : 0);
    if (twice[from] > 0)
      out.floor_echo[c] = static_cast<float>(std::clamp(thrice[from] / twice[from], 0., .95));
  }
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

// Transfer without bounces, and what vertices see past the mesh alone. Returns the number of rays.
std::uint64_t Baker::trace_all(const RayScene& scene, std::vector<PointResult>& out) {
  const RayPatterns patterns(options_.rays), ground_patterns(options_.ground_rays);
  std::optional<VisibilityBake> visibility;
  if (options_.visibility) visibility.emplace(mesh_, scene);
  const auto rays_of = [&](std::size_t i) {
    return static_cast<std::uint64_t>(
        points_[i].rays + (visibility && !is_ground_point(i) ? VisibilityBake::kRays : 0));
  };
  std::uint64_t rays = 0;
  for (std::size_t i = 0; i < points_.size(); ++i) rays += rays_of(i);
  const double fraction = (visibility ? .9 - kFineFraction : .9) / static_cast<double>(rays);
  parallel_for(std::size_t{0}, points_.size(), kChunk, [&](const Indices<std::size_t>& range) {
    double traced = 0;
    for (std::size_t i = range.begin(); i < range.end(); ++i) {
      trace_point(scene, is_ground_point(i) ? ground_patterns : patterns, i, out[i]);
      start_transfer(i, out[i]);
      if (visibility && !is_ground_point(i)) visibility->trace(i);
      traced += static_cast<double>(rays_of(i));
    }
    report_progress(fraction * traced);
  });
  if (!visibility) return rays;
  visibility->refine([&](double done) { report_progress(kFineFraction * done); });
  visibility_ = visibility->take();
  return rays + 64 * visibility_.fine.size();
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
  far_ = ground_far_;
  bounce_all(results, options_.bounces, options_.floor_apart ? .05 : .1);
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

}  // namespace

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
  if (o.bounces < 0 || o.bounces > kMaxBounces)
    return fail(ErrorCode::kInvalid, "bounces",
                fmt::format("{} is not within 0..{}", o.bounces, kMaxBounces));
  return Baker(mesh, o).run(std::move(mesh));
}

}  // namespace penumbra::prt
