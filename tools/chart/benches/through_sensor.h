// The joined chain against the truth: both cameras film a world through their sensors, the program
// measures light and composites, and a path-traced picture shows the world with the object in it.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera/camera_model.h"
#include "core/result.h"
#include "core/units.h"
#include "lighting/governor.h"
#include "prt/geometry/pinhole_view.h"
#include "runtime/scene/scene.h"
#include "tools/chart/measures/accuracy.h"
#include "tools/pictures/still.h"

namespace penumbra::tools {

struct SensorScene {
  std::string name;
  runtime::Scene scene;
  double seconds = 0;                    // of what moves by itself
  std::optional<runtime::Scene> told{};  // to the program, where that is not the truth
};

/// Each asset alone on a 40 % grey floor ("builtin:walker" in mid-step); of the first one also
/// three objects, one on a block and one before a wall.
std::vector<SensorScene> sensor_scenes(std::span<const std::string> assets);

/// What the view camera looks through.
enum class SensorLens : std::uint8_t {
  kPinhole,
  kBarrel,  // a webcam's wide angle
  kFisheye,
};
/// Their names in options and tables.
inline constexpr std::array<std::string_view, 3> kSensorLensNames{"pinhole", "barrel", "fisheye"};

struct SensorSettings {
  int bits = 8;  // of both cameras: 8 with the response of sRGB, 12 linear
  /// Of the environment camera; its schedule is chosen above that.
  Seconds shortest_exposure{1. / 64000};
};

/// Errors of one picture. What the truth shows above full scale is left out: the camera clips it.
struct SensorError {
  double shadow_rmse = 0, shadow_bias = 0;      // of s, over the floor in shadow
  double object_rel_rmse = 0, object_bias = 0;  // of luminance, relative to the object's mean
};

struct SensorPoint {
  std::string environment, scene;
  SensorSettings settings;
  SensorLens lens = SensorLens::kPinhole;
  int exposures = 0, lights = 0, bands = 0;
  bool lower_bound = false;               // of the plan: no error is promised
  std::optional<double> predicted_error;  // of the plan
  SensorError sensor, true_map;           // as the program sees it; with the true map as its light
  Image<Rgb> strip;  // camera, composite and truth side by side, in fractions of full scale
};

/// A scene that is baked once and filmed under many lights.
class SensorBench {
 public:
  /// errors: as runtime::prepare and make_masks
  static Result<SensorBench> make(const SensorScene& scene, SensorLens lens = SensorLens::kPinhole);

  struct World {
    std::string name;
    const Image<Rgb>* environment;
    Still empty, full;
    std::vector<bool> shaded;  // floor whose surroundings are below .95 of their light
  };
  /// in:     lat-long, linear radiance in full scales a second; it must outlive the world
  /// errors: as render_reference
  Result<World> trace(const std::string& name, const Image<Rgb>& environment, double error) const;
  /// errors: as Pipeline; kUndetermined (no light in two seconds)
  Result<SensorPoint> measure(const World& world, const SensorSettings& settings) const;

 private:
  Result<SensorError> under_true_map(const World& world, double full_scale,
                                     const lighting::GovernorConfig& config) const;
  SensorError compare(const Image<Rgb>& composite, const Image<Rgb>& camera, const World& world,
                      double full_scale) const;

  std::string name_;
  double seconds_ = 0;
  std::shared_ptr<const runtime::PreparedScene> prepared_, given_;
  SensorLens lens_kind_ = SensorLens::kPinhole;
  prt::PinholeView view_;
  std::optional<calib::CameraModel> lens_;  // instead of the view's pinhole
  Masks masks_;
};

}  // namespace penumbra::tools
