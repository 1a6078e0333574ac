// One light estimator of an application: fills the structs that it chains.
// threads: thread-safe
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>

#include "service/openxr/cube_faces.h"
#include "service/openxr/layer_settings.h"
#include "service/openxr/light_estimation.h"
#include "service/openxr/room_light.h"

namespace penumbra::openxr {

struct CubeRequest {
  std::uint32_t size = 0;  // one of kCubeSizes
  XrCubemapLightingColorFormatANDROID format{};
  bool reproject = false;
};

/// Where the application's space is, and when.
struct EstimateTime {
  SpaceRotation world_from_application;
  XrQuaternionf application_from_world{0, 0, 0, 1};  // the same, the other way
  XrTime now = 0;                                    // that the application asks for
  std::optional<XrTime> published;  // of the light, where the runtime tells its clock
};

class RoomLightEstimator {
 public:
  RoomLightEstimator(RoomLight& room, const LayerSettings& settings,
                     std::optional<CubeRequest> cube)
      : room_(room), settings_(settings), cube_request_(cube) {}

  /// Fills `estimate` and every struct of its chain that the extensions define, also several of one
  /// type. Structs of other types stay as they are.
  void fill(const penumbra_light& light, const EstimateTime& at, XrLightEstimateANDROID& estimate);

  /// Marks all of them as not valid.
  static void invalidate(XrLightEstimateANDROID& estimate);

 private:
  struct Turned;
  XrTime updated_time(const penumbra_light& light, const EstimateTime& at);
  void fill_struct(const penumbra_light& light, const Turned& turned, const EstimateTime& at,
                   XrTime updated, XrBaseOutStructure& one);
  bool fill_cube(const penumbra_light& light, const EstimateTime& at, XrTime updated,
                 XrCubemapLightingDataANDROID& out);

  RoomLight& room_;
  LayerSettings settings_;
  std::optional<CubeRequest> cube_request_;
  std::mutex mutex_;
  std::uint64_t number_ = 0;  // of the light that updated_ belongs to
  XrTime updated_ = 0;
  // The faces are made anew for another cube or another rotation.
  std::unique_ptr<penumbra_cube> cube_;
  CubeImages images_;
  std::uint64_t cube_number_ = 0;
  SpaceRotation cube_rotation_;
};

}  // namespace penumbra::openxr
