// Error figures of a composite against the reference picture of the same world.
#pragma once

#include <optional>
#include <vector>

#include "calib/camera/camera_model.h"
#include "core/result.h"
#include "lighting/light_estimate.h"
#include "prt/geometry/pinhole_view.h"
#include "runtime/scene/scene.h"
#include "tools/pictures/still.h"

namespace penumbra::tools {

/// Which pixels show objects alone (full coverage), and which the floor alone.
struct Masks {
  std::vector<bool> object, floor;
};
/// errors: as render_composite
Result<Masks> make_masks(const runtime::PreparedScene& scene, const prt::PinholeView& view,
                         double seconds = 0, const std::optional<calib::CameraModel>& lens = {});

/// The floor in shadow: where its mean radiance within four pixels is below .95 of that without the
/// object. By a pixel's own noise those would be chosen whose truth came out too dark.
std::vector<bool> shaded_floor(const Image<Rgb>& full, const Image<Rgb>& empty, const Masks& masks);

struct Accuracy {
  double object_rel_rmse = 0;  // luminance, relative to the object's mean
  double object_bias = 0;      // signed, likewise
  double shadow_bias = 0;      // mean error of s, where shadow_rmse is measured
  double shadow_rmse = 0;      // of s = L/L_0 on shaded_floor()
  /// |w/w_ref - 1| of the shadow's edges, in the mean over their energy: edges of one height and
  /// length have Int |grad s|^2 inversely as their width. Noise of the reference is left out (its
  /// halves are multiplied).
  double penumbra_error = 0;
  // Noise of the reference on the object, in the unit of object_rel_rmse
  double reference_error = 0;
  /// object_rel_rmse without the reference's noise: the errors against its two independent halves
  /// are multiplied, so that their noise averages out.
  double object_without_noise = 0;
};

/// `empty`: the floor without the object under the same light. Where the light is truncated so that
/// the object's radiance is negative, the compositor cuts it off and only what is positive in the
/// reference is an error there.
Accuracy compare_pictures(const Still& ours, const Still& truth, const Still& empty,
                          const Masks& masks);

/// The floor's own picture under truncated light, in closed form: Lambert under light_on(planes).
void light_floor(const StillScene& in, const lighting::LightEstimate& light, const Masks& masks,
                 Still& empty);

}  // namespace penumbra::tools
