// Shadow ratios on receiving planes, evaluated pixel by pixel on the CPU: a plane seen by a pinhole
// is one homography, so a row costs a division, a lookup and no drawing. Without a GPU this takes a
// fifth of the time of a textured quad; with one it takes the same. Through a lens the homography
// is of the pixels' rays, which a grid holds.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "compositor/projection.h"
#include "compositor/view.h"
#include "compositor/view_lens.h"
#include "core/pose.h"
#include "prt/geometry/receiver.h"
#include "shadows/field/planar_shadow.h"
#include "shadows/silhouette/shadow_map.h"

namespace penumbra::compositor {

/// Homogeneous position on a plane of a pixel: (x, z, w) = h * (px, py, 1), w > 0 in front; through
/// a lens of the pixel's ray in the camera's frame instead.
struct Homography {
  float h[3][3];
};

/// Pixels at which a plane is in front of another one: a px + b py + c >= 0; through a lens
/// a x + b y + c z + margin of the ray.
struct HalfImage {
  double a, b, c;
  double margin = 0;
};

/// Some of Receivers' half images; the first ones count to the pixel, for the others a few pixels
/// more do no harm.
struct Sides {
  std::size_t first = 0, count = 0, exact = 0;
  std::size_t bands = 0;  // through a lens: the first of Receivers' bands
};

/// A shadow ratio of 0 to 1.5 in one word: a pixel reads four instead of twelve, which is most of
/// what it costs. What is missing from 1 in steps of 1/1364 (red, green) and 1/682 (blue), so that
/// an open plane is exactly 1.
struct PackedRatio {
  static constexpr int kOne11 = 1364, kOne10 = 682;
  static constexpr std::uint32_t pack(const Rgb& s) {
    const auto steps = [](float v, int one) {
      return static_cast<std::uint32_t>((v > 0 ? std::min(v, 1.5f) : 0) * static_cast<float>(one) +
                                        .5f);
    };
    return steps(s.r, kOne11) << 21 | steps(s.g, kOne11) << 10 | steps(s.b, kOne10);
  }
};

/// The ratios of one object on its plane, as the kernel wants them.
struct PlaneLookup {
  Homography at;               // in half extents from the grid's centre
  const std::uint32_t* ratio;  // PackedRatio, size x size
  int size;
  Rect area;  // pixels that the visible part can reach
  Sides visible{};
  const ViewLens* lens = nullptr;
};

/// The shadow of one light on a plane, likewise.
struct ShadowMapLookup {
  Homography at;       // in cells from node (0, 0)
  const float* nodes;  // width x height
  int width, height;
  int samples;   // a pixel along each axis: a hard edge must not show its pixels
  Rgb fraction;  // of the light in the light of the open plane
  Rect area;
  Sides visible{};
  const ViewLens* lens = nullptr;
};

class Receivers {
 public:
  /// samples: of a light's shadow, a pixel along each axis
  explicit Receivers(int samples) : samples_(samples) {}

  int add(const prt::GroundGrid& grid);
  /// Real planes: a shadow is seen where its own plane is the nearest.
  void add_plane(const glm::dvec3& point, const glm::dvec3& normal) {
    planes_.push_back({point, normal});
  }
  void set_pose(int receiver, const Pose& world_from_bake);
  void show(int receiver, bool visible);
  void set_shadow(int receiver, const shadows::PlanarShadow& shadow,
                  const Rgb& of_open = {1, 1, 1});
  /// What real things take of a plane's light without lights, r below. At most one.
  void add_real(const prt::GroundGrid& grid, const Pose& world_from_bake);
  void set_real_shadow(const shadows::PlanarShadow& shadow);
  /// All of them at once; copies the maps.
  void set_shadow_maps(std::span<const ShadowMapOnPlane> lights);

  /// Counts what the functions above were told.
  int changes() const { return changes_; }
  /// What an object leaves of the open plane's light, on its own grid with so many texels a side,
  /// and what all virtual things leave of the distant lights; without what real things take. Below
  /// a neighbour, which the mirror does not show, would be a black spot.
  Image<Rgb> ratios_on(int receiver, int texels) const;
  bool is_shown(int receiver) const {
    return receivers_[static_cast<std::size_t>(receiver)].visible;
  }

  /// Prepares for one view; returns the pixels that any shadow can reach.
  /// in: the view's lens stays for as long as rows are loaded
  Rect prepare(const View& view);
  /// The ratios s of row y, pixels [area.x0, area.x1), into r, g, b, which hold 1 on entry:
  ///   s = 1 - (1 - product of the objects' ratios + sum_j F_j q_j)/(r - sum_j F_j m_j)
  /// An object's ratio is 1 - of_open (1 - its shadow's), so that all is of the open plane's light.
  /// Virtual things take q_j of light j, real things m_j anyway; F_j is its fraction of the open
  /// plane's light. r is what real things leave of the rest. False when no shadow reaches the row.
  /// area: may be narrower; reach_in_row alone is shaded
  bool load_row(int y, const Rect& area, float* r, float* g, float* b) const;
  /// Multiplies pixels of row y by what real things leave of the open plane's light there, the
  /// denominator above.
  /// out: left: area.width() of each colour, one colour after the other
  void multiply_by_left(int y, const Rect& area, std::span<float> left) const;
  /// The pixels of row y that any shadow can reach: seen slantwise they are far fewer than the
  /// rectangle holds.
  Rect reach_in_row(int y) const;

 private:
  struct FloorReceiver {
    prt::GroundGrid grid;
    Pose world_from_bake;
    Image<std::uint32_t> ratio;        // PackedRatio
    glm::dvec2 low{0, 0}, high{0, 0};  // visible part, metres
    bool has_shadow = false;
    bool visible = true;
  };
  struct OnPlane {
    shadows::ShadowMap shadow;
    Rgb fraction;
    int real = -1;  // in real_shadow_maps_
  };
  struct RealShadowMap {
    const shadows::ShadowMap* source;  // only to tell lights apart
    shadows::ShadowMap shadow;
    Rgb fraction;
  };
  struct FineLookup {  // where virtual things shade a light
    std::size_t real;  // in real_shadow_maps_
    ShadowMapLookup map;
  };
  struct ReceiverPlane {
    glm::dvec3 point, normal;
  };
  struct Columns {
    int x0, x1;
  };
  /// To half_images_: where a plane is in front of all real ones.
  void find_visible(const View& view, const glm::dvec3& point, const glm::dvec3& normal);
  /// To half_images_: the pixels that touch positions [low, high] of a plane.
  void add_sides(const Homography& at, const glm::dvec2& low, const glm::dvec2& high);
  void find_visible_part(const View& view, const Homography& at, const glm::dvec3& point,
                         const glm::dvec3& normal, const glm::dvec2& low, const glm::dvec2& high,
                         const Rect& area, Sides& out);
  Columns visible_columns(const Sides& sides, int y, const Rect& area) const;
  /// To bands_, for each row of the lens's cells that `area` meets: the columns that the sides
  /// leave.
  void find_bands(const Rect& area, Sides& sides);
  /// Calls body(columns) for the pixels of a row within `area` where a lookup is seen.
  template <class Lookup, class Body>
  void for_visible(const Lookup& lookup, int y, const Rect& area, const Body& body) const;
  bool prepare_lookup(const View& view, const ViewProjection& from_world,
                      const FloorReceiver& receiver, PlaneLookup& out);
  void multiply(const PlaneLookup& plane, int y, const Rect& area, float* r, float* g,
                float* b) const;
  void take_missing(int y, const Rect& area, std::span<float> left) const;
  static void take_light(const OnPlane& light, const Pose& map_from_grid,
                         const std::vector<glm::dvec3>& places, Image<Rgb>& out);
  /// The lights' shadows, and what is left of it all by real things.
  void subtract_shadows(int y, const Rect& area, float* r, float* g, float* b) const;

  int samples_;
  int changes_ = 0;
  std::vector<FloorReceiver> receivers_;
  std::optional<FloorReceiver> real_;
  std::vector<OnPlane> lights_;
  std::vector<RealShadowMap> real_shadow_maps_;
  std::vector<ReceiverPlane> planes_;
  std::vector<PlaneLookup> lookups_;
  std::optional<PlaneLookup> real_lookup_;
  std::vector<ShadowMapLookup> virtual_occlusion_;
  std::vector<ShadowMapLookup> real_occlusion_;  // of real_shadow_maps_
  std::vector<FineLookup> fine_missing_;
  std::vector<HalfImage> half_images_;  // of the lookups
  const ViewLens* lens_ = nullptr;      // of the last prepare(), as its bands
  std::vector<Columns> bands_;
};

/// Multiplies ratios of pixels [x0, x1) of row y into r[0 .. x1-x0) and so on.
void multiply_plane_ratios(const PlaneLookup& plane, int y, int x0, int x1, float* r, float* g,
                           float* b);

/// Writes the least of the half images' values at pixels [x0, x1) of row y, seen through a lens.
void load_least_side(const ViewLens& lens, std::span<const HalfImage> sides, int y, int x0, int x1,
                     float* out);

/// Writes the value of pixels [x0, x1) of row y that the map holds wholly to out[0 .. x1-x0);
/// leaves the others.
void load_shadow_values(const ShadowMapLookup& shadow_map, int y, int x0, int x1, float* out);

/// Subtracts fraction * value of pixels [x0, x1) of row y from r, g, b; nothing outside the map.
void subtract_shadow_fractions(const ShadowMapLookup& shadow_map, int y, int x0, int x1, float* r,
                               float* g, float* b);

}  // namespace penumbra::compositor
