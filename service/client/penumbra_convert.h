// Penumbra's light in the signs, axes and scales of other engines.
// threads: reentrant
#ifndef PENUMBRA_CONVERT_H
#define PENUMBRA_CONVERT_H

#include "penumbra_client.h"

#ifdef __cplusplus
extern "C" {
#endif

/// Who is to read it.
enum penumbra_convention {
  PENUMBRA_CONVENTION_WEBXR = 0,     // three.js, WebXR, Babylon: as the page has it, any bands
  PENUMBRA_CONVENTION_ARCORE = 1,    // ARCore's shader: radiance, any bands
  PENUMBRA_CONVENTION_GODOT = 2,     // Godot's vendors plugin: radiance, any bands
  PENUMBRA_CONVENTION_FILAMENT = 3,  // IndirectLight::irradiance, sh.txt: irradiance/pi, 1-3 bands
  PENUMBRA_CONVENTION_UNITY = 4,     // SphericalHarmonicsL2: irradiance/pi, left-handed, 1-3 bands
  PENUMBRA_CONVENTION_UNREAL = 5     // FSHVectorRGB3: radiance, left-handed, z up, 1-3 bands
};

/// Coefficients of the page (`coefficients` or `residual`) as the engine wants them, in its order.
/// bands: 1 to 9, or to 3 as told above; bands*bands rows are read and written
/// out:   may be `in`
/// returns PENUMBRA_OK or PENUMBRA_ARGUMENT
PENUMBRA_API int penumbra_sh_convert(enum penumbra_convention convention, const float in[][3],
                                     int bands, float out[][3]);

/// A vector of the world on the engine's axes; its length stays.
/// out: may be `in`
/// returns PENUMBRA_OK or PENUMBRA_ARGUMENT
PENUMBRA_API int penumbra_direction_convert(enum penumbra_convention convention, const float in[3],
                                            float out[3]);

#ifdef __cplusplus
}
#endif

#endif
