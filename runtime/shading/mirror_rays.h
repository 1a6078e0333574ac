// Rays from the pixels of surfaces that mirror, and what they meet of virtual objects.
// threads: trace() parallel inside, reentrant; everything else only while no ray is under way
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "calib/camera/camera_model.h"
#include "compositor/view.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"
#include "prt/rays/rays.h"
#include "runtime/scene/scene.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// Where a ray met a surface that sends some of its own light: what of that counts.
struct MetPlace {
  Rgb weight;
  std::uint16_t object = 0;
  std::array<std::uint32_t, 3> corners{};  // of vertices that are lit: (1-u-v) a + u b + v c
  float u = 0, v = 0;
};

/// A ray that met something, and those that go on from there.
struct MirrorChain {
  static constexpr int kMaxHits = 3;

  std::uint32_t column = 0;  // of the texel
  int places = 0;            // 1 at least
  std::array<MetPlace, kMaxHits> place;
  Rgb emitted;  // in the unit of materials
  Rgb end_weight;
  glm::vec3 end_at, end_towards;  // where the last ray leaves into the open, if its weight is not 0
  float end_alpha = 0;            // width of the lobe that it stands for
};

/// A sample of a texel's lobe, whatever it met.
struct MirrorSample {
  std::uint32_t column = 0;
  bool open = false;
  float weight = 0, alpha = 0;
  glm::vec3 at, towards;
};

struct MirrorRow {
  std::vector<MirrorChain> chains;
  std::vector<MirrorSample> samples;  // by column, of texels of which some are open, some are not
  std::vector<float> weights, open;   // of all samples of a texel, of those that met nothing
};

/// What one object mirrors of objects in one view.
struct MirroredByObject {
  std::size_t object = 0;
  int least_samples = 1;  // that its lobes take
  int samples = 1;        // of a texel
  int step = 1;           // pixels along a texel's side
  /// Of pictures whose mean counts: each takes other rays, and what it meets mirrors by a lobe as
  /// well; nothing: one picture, which must not have grain.
  std::optional<int> pass{};
  int x0 = 0, y0 = 0;  // the first texel's corner, on multiples of `step`
  int columns = 0;     // texels
  std::vector<MirrorRow> rows{};
};

/// One view of all objects; by object where it is a list.
struct ViewOfObjects {
  const compositor::View& view;
  const calib::CameraModel& camera;
  std::span<const Pose> poses, floors;  // ObjectNow::world_from_bake, world_from_floor
  std::span<const char> visible;
};

class MirrorRays {
 public:
  /// in:     a scene that outlives this
  /// errors: kUnavailable (Embree)
  static Result<MirrorRays> create(const PreparedScene& scene);

  /// Of an object whose form is another one now.
  void update_vertices(std::size_t object);
  void set_poses(std::span<const Pose> poses);
  /// rays: at most, but for the samples that a lobe takes at least; step and samples follow
  void trace(MirroredByObject& o, const ViewOfObjects& seen, double rays) const;

 private:
  struct Lanes;
  explicit MirrorRays(const PreparedScene& scene, prt::RayWorld world)
      : scene_(&scene), world_(std::move(world)) {}
  // out: rows of texels
  int choose_texels(MirroredByObject& o, const ViewOfObjects& seen, double rays) const;
  void trace_row(const MirroredByObject& o, const ViewOfObjects& seen, int y, MirrorRow& out) const;
  void meet_first(const MirroredByObject& o, const ViewOfObjects& seen, int x, int y, int sample,
                  Lanes& lanes) const;
  void send_first(const MirroredByObject& o, const ViewOfObjects& seen, std::size_t x, int sample,
                  const Lanes& first, Lanes& lanes, MirrorRow& out) const;
  // Of the lobe of what the sample of `place` meets: one for all, or another one for each.
  struct LaterSamples {
    std::optional<glm::vec2> place;
    int count;  // that stand for a lobe
  };
  void follow(const LaterSamples& later, const ViewOfObjects& seen, Lanes& lanes,
              MirrorRow& out) const;
  void bounce(const LaterSamples& later, std::size_t lane, bool last, Lanes& lanes,
              MirrorRow& out) const;
  void intersect_all(const ViewOfObjects& seen, Lanes& lanes) const;

  const PreparedScene* scene_;
  prt::RayWorld world_;       // all objects, by their numbers
  std::vector<float> radii_;  // of them, metres
  std::vector<prt::Bounds> bounds_;
  std::vector<bool> opaque_;  // others are not there for those that mirror them
};

/// How many rays a lobe of an object's materials takes; 0: nothing of it mirrors objects.
int mirror_samples_of(const prt::BakedObject& baked);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
