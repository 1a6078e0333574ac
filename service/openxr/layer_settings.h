// How the layer gives light to one application: by its engine, or as the environment says.
// threads: reentrant
#pragma once

#include <string_view>

#include "service/client/penumbra_convert.h"

namespace penumbra::openxr {

struct LayerSettings {
  penumbra_convention convention = PENUMBRA_CONVENTION_WEBXR;
  bool towards_light = true;  // the sign of the main light's direction
  double yaw_rad = 0;         // turn of Penumbra's world in the stage about y, by the right hand
};

/// PENUMBRA_XR_CONVENTION, PENUMBRA_XR_LIGHT_DIRECTION and PENUMBRA_XR_YAW_DEGREES go before what
/// the engine's name tells. What cannot be read is told on standard error and left out.
LayerSettings read_layer_settings(std::string_view engine_name);

}  // namespace penumbra::openxr
