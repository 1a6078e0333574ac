// The page of light as the layer needs it: one main light and two sets of harmonics.
// threads: RoomLight is thread-safe; the rest is reentrant
#pragma once

#include <memory>
#include <mutex>

#include "service/client/penumbra_client.h"
#include "service/openxr/space_rotation.h"

namespace penumbra::openxr {

/// The newest light of a running daemon.
class RoomLight {
 public:
  RoomLight();  // no daemon need run yet
  ~RoomLight();
  RoomLight(const RoomLight&) = delete;
  RoomLight& operator=(const RoomLight&) = delete;

  /// False without a valid light, or when the daemon has ended. Does not wait.
  bool read(penumbra_light& out);
  bool read(penumbra_cube& out);

 private:
  std::mutex mutex_;
  penumbra_client* client_ = nullptr;
  penumbra_light last_{};  // stands in while the next one is being written
};

/// Light in the world: `total` is `ambient` and the main light together.
struct MainAndAmbient {
  Harmonics total{}, ambient{};
  Vector3 irradiance{};  // of the main light on a surface that faces it
  Vector3 towards{};
};

/// The main light is the one with most irradiance. Without any it has none, and shows where most
/// light comes from: some applications use no light at all where there is no main light.
MainAndAmbient split_main_light(const penumbra_light& light);

}  // namespace penumbra::openxr
