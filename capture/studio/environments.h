// Built-in environments.
// threads: reentrant
#pragma once

#include <cstdint>

#include "capture/frames.h"
#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// The built-in interior: a white room with a window, two ceiling panels, a warm wall and a lamp.
Image<Rgb> make_room_environment(int width, int height);
/// Clear sky with a sun light (radius .2666 degrees) of the given elevation, over grey ground.
Image<Rgb> make_sky_environment(int width, int height, double sun_elevation_rad);
/// Sky, ground and up to four lamps, windows or suns drawn at random: scenes for calibration and
/// its proof.
Image<Rgb> make_random_environment(int width, int height, std::uint32_t seed);

}  // namespace penumbra::capture
#pragma GCC visibility pop
