// Stills in linear radiance: the real world alone, our composite over it, and the path-traced
// truth.
#pragma once

#include <functional>
#include <string>

#include "lighting/light_estimate.h"
#include "prt/geometry/pinhole_view.h"
#include "prt/geometry/plane.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/pipeline/pipeline.h"
#include "runtime/scene/scene.h"

namespace penumbra::tools {

struct Still {
  Image<Rgb> radiance;
  double error = 0;  // the reference's own estimate; 0 where nothing was sampled
  int samples = 0;
  Image<Rgb> half_a, half_b;  // of a reference: independent, their mean is `radiance`; else empty
};

struct StillScene {
  const runtime::PreparedScene* scene = nullptr;
  const Image<Rgb>* environment = nullptr;  // lat-long
  prt::PinholeView view{};
  double seconds = 0;  // of what moves by itself or turns
  // Instead of the view's pinhole, whose focal length then is the one near the axis
  std::optional<calib::CameraModel> lens{};
};

/// The lens, or the view's own pinhole where there is none.
calib::CameraModel camera_of(const prt::PinholeView& view,
                             const std::optional<calib::CameraModel>& lens);

using Progress = std::function<void(double)>;

/// Of an unshadowed plane, from every pixel of the map.
Rgb exact_irradiance(const Image<Rgb>& map, const glm::dvec3& normal);

/// A map whose lower half is what the highest level plane of known albedo sends in the open: what
/// mirrors show of a map of elsewhere. As it is without such a plane.
Image<Rgb> with_floor_below(Image<Rgb> map, const std::vector<prt::Plane>& planes);

/// The world without virtual objects: environment and planes in closed form (irradiance exact from
/// every pixel), path traced when there are real meshes or several planes.
Result<Still> render_real(const StillScene& in, double error, const Progress& progress);

/// For stills of one view: 16 samples a pixel. The scene must outlive it.
/// errors: as Pipeline::create
Result<Pipeline> make_still_pipeline(const runtime::PreparedScene& scene,
                                     const prt::PinholeView& view,
                                     const runtime::ShadowSampling& sampling,
                                     const std::optional<calib::CameraModel>& lens = {});
/// The mean of four pictures a fraction of a pixel apart: edges get 64 samples a pixel.
/// errors: as Pipeline::composite
Result<Still> composite_still(Pipeline& pipeline, const prt::PinholeView& view,
                              const lighting::LightEstimate& light, const Still& real,
                              double seconds = 0);

/// Our method over the real picture, under `light`.
Result<Still> render_composite(const StillScene& in, const lighting::LightEstimate& light,
                               const Still& real, const runtime::ShadowSampling& sampling = {});

/// The light that the compositor uses for what stands on these planes: the floor's when all are
/// level.
const RadianceSh& light_on(const std::vector<prt::Plane>& planes,
                           const lighting::LightEstimate& light);

/// The truth: the objects really stand there, and the lamps. Under the whole environment, or under
/// `truncated` light.
Result<Still> render_reference(const StillScene& in, bool with_objects, double error,
                               const std::optional<lighting::LightEstimate>& truncated,
                               const Progress& progress);

}  // namespace penumbra::tools
