// What surfaces with materials mirror of themselves and of other virtual objects.
// threads: thread-bound, parallel inside
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <vector>

#include "compositor/composite/compositor.h"
#include "compositor/surroundings.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/mirror_rays.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

class MirroredObjects {
 public:
  /// in:     a scene that outlives this; wanted: false for none
  /// errors: as MirrorRays::create
  static Result<MirroredObjects> create(const PreparedScene& scene, bool wanted = true);

  bool any() const { return !mirroring_.empty(); }
  /// From then on the compositor draws these objects as it does once update() has told it.
  void begin(const std::vector<int>& handles, compositor::Compositor& compositor) const;
  /// Of an object whose form is another one now.
  void update_vertices(std::size_t object);
  /// From now on time counts: rays are a quarter of those before, and fewer where they take more
  /// than 7 ms. Before, results are the same on every machine.
  void keep_time() {
    keeps_time_ = true;
    max_rays_ = kMaxLiveRays;
  }
  /// From now on the mean of successive pictures counts: each takes other rays.
  void vary_rays() {
    next_pass_ = 0;
    max_rays_ = kMaxStillRays;
  }

  struct LightOnObjects {
    const compositor::Surroundings& surroundings;
    std::span<const std::span<const float>> relit;  // irradiance/pi in prt::relight's layout
    std::span<const std::vector<std::array<float, 4>>> fractions;  // of each light; empty: all
  };
  /// Hands to the compositor what is mirrored in this view of a camera. Rays are traced where
  /// something moved; else what they met is lit anew, if `relit`.
  void update(std::size_t camera, const ViewOfObjects& seen, const LightOnObjects& light,
              bool relit, const std::vector<int>& handles, compositor::Compositor& compositor);

 private:
  struct TracedFor {  // what the rays of a view hold for
    prt::PinholeView camera;
    const compositor::ViewLens* lens;
    std::vector<Pose> poses;
    std::vector<char> visible;
    bool shows(const ViewOfObjects& seen) const;
  };
  struct CameraView {
    std::vector<MirroredByObject> objects;
    std::optional<TracedFor> traced{};
    std::uint64_t light = 0;  // that it was last lit by
  };
  // Of one object in one view, under one light.
  struct MirrorLighting {
    const MirroredByObject& o;
    const LightOnObjects& light;
    const Image<Rgb>* floor;
    glm::mat4 floor_from_world;
  };

  explicit MirroredObjects(const PreparedScene& scene) : scene_(&scene) {}
  void trace(CameraView& view, const ViewOfObjects& seen);
  Rgb surroundings_from(const glm::vec3& at, const glm::vec3& towards, float alpha,
                        const MirrorLighting& l) const;
  Rgb end_of(const MirrorChain& chain, const MirrorLighting& l) const;
  Rgb light_along(const MirrorChain& chain, const MirrorLighting& l) const;
  void light_row(const MirrorLighting& l, int y, compositor::MirroredPicture& out,
                 Image<std::uint8_t>& known) const;
  compositor::MirroredPicture picture_of(const MirrorLighting& l) const;

  // Of a view, first ones.
  static constexpr double kMaxRays = 1 << 18, kMaxStillRays = 1 << 20, kMaxLiveRays = 1 << 16,
                          kMinRays = 1 << 12;

  const PreparedScene* scene_;
  std::optional<MirrorRays> rays_;           // where any() holds
  std::vector<MirroredByObject> mirroring_;  // as they begin
  std::vector<CameraView> views_;            // by camera
  std::optional<std::size_t> shown_camera_;
  std::uint64_t light_ = 1;
  bool keeps_time_ = false;
  std::optional<int> next_pass_{};
  double max_rays_ = kMaxRays;
};

}  // namespace penumbra::runtime
#pragma GCC visibility pop
