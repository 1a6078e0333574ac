// One scene under one light, under any treatment: its errors against path-traced truth.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "lighting/governor.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/projection.h"
#include "runtime/scene/scene.h"

namespace penumbra::tools {

/// One object on one floor.
struct TrialScene {
  std::string name;
  runtime::PreparedScene prepared;
};
/// Each asset on floors of 40, 15 and 70 %, the last one tilted by 12 degrees.
/// rays:   of the bake
/// errors: as prepare
Result<std::vector<TrialScene>> make_trial_scenes(const std::vector<std::string>& assets, int rays);

/// Luminances at fixed points: the shadow ratio on the floor, and irradiance/pi at small patches of
/// the object's surface.
struct TrialValues {
  std::vector<double> ratio, object;
};
/// Against the truth: RMS of the ratio where the true one is below .95, and of the objects' light
/// relative to its own RMS. Nothing where no shadow is worth measuring.
std::optional<lighting::PredictedErrors> measured_errors(const TrialValues& ours,
                                                         const TrialValues& truth);

class Trial {
 public:
  /// Traces the truth with so many rays a point, and all that treatments may ask for.
  /// in:     scene outlives the trial
  /// errors: kUndetermined (no shadow worth measuring), else as the parts
  static Result<Trial> make(const TrialScene& scene, const Image<Rgb>& map, int rays);

  lighting::PredictedErrors measured(const lighting::Treatment& treatment) const;
  /// Of the light as it is found in the whole map.
  const lighting::ErrorTable& predicted() const { return predicted_; }

 private:
  // A map read with one step, split as far as it goes, and its lights traced.
  struct TrialLight {
    lighting::DistantLight light;
    double irradiance = 0;       // of the open floor
    std::vector<double> object;  // irradiance/pi at the patches
    std::array<std::vector<double>, 2>
        virtual_occlusion;  // fractions at the floor's points: coarse, fine
  };
  struct Split {
    lighting::ShProjection residual;
    std::vector<TrialLight> lights;
  };
  class Points;
  static Result<Split> split(const TrialScene& scene, const Points& points, const Image<Rgb>& map,
                             int map_step);
  TrialValues values(const lighting::Treatment& treatment) const;

  const TrialScene* scene_ = nullptr;
  std::shared_ptr<const Points> points_;
  TrialValues truth_;
  std::array<Split, 2> splits_;  // of the map as it is, and in blocks
  lighting::ErrorTable predicted_;
};

}  // namespace penumbra::tools
