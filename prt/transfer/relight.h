// Transfer times light.
// threads: reentrant
#pragma once

#include <span>

#include "core/sh.h"
#include "prt/transfer/transfer.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// out[channel * stride + point] = sum_n l_n t_n(point): exit radiance for a unit albedo (times pi:
/// irradiance). `light` must be in the bake frame; further bands than baked are ignored.
/// out: 3 * transfer.stride floats.
/// threads: reentrant, no allocation
void relight(const Transfer& transfer, const RadianceSh& light, std::span<float> out);

}  // namespace penumbra::prt
#pragma GCC visibility pop
