// The bake of one object: what its points see, and the light that bounces between them.
// threads: one at a time; parallel inside
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <glm/vec3.hpp>
#include <map>
#include <mutex>
#include <span>
#include <vector>

#include "prt/bake/bake.h"
#include "prt/bake/internal/hemi_oct_sums.h"
#include "prt/bake/internal/visibility_bake.h"
#include "prt/rays/ray_pattern.h"
#include "prt/rays/rays.h"

namespace penumbra::prt {

struct BakePoint {
  glm::vec3 position, normal;
  int rays;
};

// Where a blocked ray ended: a vertex of the triangle or texel of the receiver around it, chosen by
// its weight in the interpolation.
struct BounceHit {
  static constexpr std::uint32_t kBeyond = 0xfffffffeu;  // the receiver beyond its grid
  std::uint32_t point;
  float weight;  // fraction of this ray in the point's transfer
};

struct PointResult {
  std::vector<float> blocked;                      // sum over blocked rays of w Y_n
  float blocked_fraction = 0, standard_error = 0;  // of the cosine
  float behind = 0;                                // weight of rays that met a back face
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
  int ground_rays_at(const glm::vec3& position) const;
  bool is_ground_point(std::size_t i) const { return i >= mesh_.positions.size(); }
  float plane_height() const { return (options_.receiver->grid.height - centre_.y) * scale_; }
  bool grey() const;
  void trace_point(const RayScene& scene, const RayPatterns& patterns, std::size_t index,
                   PointResult& out) const;
  std::uint64_t trace_points(const RayScene& scene, std::size_t first, double progress,
                             std::vector<PointResult>& out);
  std::uint64_t trace_by_visibility(const RayScene& scene, double progress,
                                    std::vector<PointResult>& out);
  void trace_wide(const RayScene& scene, const HemiOctSums& sums, std::size_t index,
                  VisibilityBake& visibility, PointResult& out) const;
  void trace_blocked(const RayScene& scene, const OpenCells& open, std::size_t index,
                     PointResult& out) const;
  std::uint64_t trace_all(const RayScene& scene, std::vector<PointResult>& out);
  void for_points(std::size_t first, std::size_t last, double progress,
                  const std::function<void(std::size_t)>& act);
  void keep_hits(const RayScene::RayPacket& packet, int first_ray, const glm::vec3& origin,
                 const float* weight, const std::uint8_t* groups, std::size_t index,
                 std::uint32_t blocked, PointResult& out) const;
  std::uint32_t nearby_vertex(const RayScene::RayPacket& packet, int ray, float choice) const;
  std::uint32_t nearby_texel(const glm::vec3& origin, const RayScene::RayPacket& packet, int ray,
                             float choice) const;
  std::uint32_t ground_mask(const RayScene::RayPacket& packet) const;
  void start_transfer(std::size_t index, const PointResult& result);
  void bounce(std::size_t index, const std::vector<BounceHit>& hits, std::span<const float> far);
  void bounce_all(const std::vector<PointResult>& results, int bounces, std::span<const float> far,
                  double progress);
  void gather_from_floor(const std::vector<PointResult>& results, std::span<const float> far);
  void bake_floor(const std::vector<PointResult>& results, BakedObject& out);
  std::array<double, 3> sum_of_constants(const std::vector<float>& transfer) const;
  void add_further_bounces(const std::array<double, 3>& before, const std::array<double, 3>& last);
  void report_progress(double fraction);
  std::vector<PointQuality> quality(const std::vector<PointResult>& results) const;
  double standard_error(const std::vector<PointResult>& results,
                        const std::vector<PointQuality>& quality) const;
  Transfer packed_vertices() const;
  Transfer packed_deficit() const;
  Transfer packed_reflected(std::size_t first, std::size_t count) const;
  Transfer packed(std::size_t first, std::size_t count, int bands) const;
  Transfer shadow_probes() const;

  std::size_t place(std::size_t point, int channel) const {
    return (point * static_cast<std::size_t>(channels_) + static_cast<std::size_t>(channel)) *
           coefficients_;
  }
  const float* transfer_at(std::size_t point, int channel) const {
    return &current_[place(point, channel)];
  }

  const BakeOptions& options_;
  int bands_;  // traced: as many as the transfer or its reflected part needs
  Mesh mesh_;
  glm::vec3 centre_{};
  float scale_ = 1;
  std::vector<BakePoint> points_;
  std::size_t coefficients_ = 0, solved_ = 0;  // kept, and what bounces are found for
  int channels_ = 1;
  Rgb floor_albedo_;                       // of the receiver, as far as its light is counted in
  std::vector<float> shadowed_, current_;  // [point][channel][n]
  std::vector<float> added_, next_;        // by the last bounce, by the next one
  std::vector<float> ground_far_;          // transfer of an unshadowed receiver, per n
  VisibilityMap visibility_;
  std::mutex progress_mutex_;
  double progress_ = 0;
};

}  // namespace penumbra::prt
