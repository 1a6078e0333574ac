// Where the sun stands, by place and time.
// threads: reentrant
#pragma once

#include <chrono>
#include <glm/vec3.hpp>
#include <optional>

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// A place on the earth, and how the scene lies there.
struct SunSite {
  double latitude_deg = 0, longitude_deg = 0;      // north and east positive
  double north_deg = 0;                            // from -z to north, clockwise seen from above
  std::optional<std::chrono::sys_seconds> time{};  // of the first map; nothing: the system's clock
};

/// Towards the sun, a unit vector in the world, +y up; below the horizon y is negative. Within .02
/// degrees from 1999 to 2050, without refraction.
/// source: Blanco-Muriel, Alarcon-Padilla, Lopez-Moratalla & Lara-Coira 2001 (PSA)
glm::dvec3 sun_direction(const SunSite& site, std::chrono::sys_seconds utc);
/// At the site's time.
glm::dvec3 sun_direction(const SunSite& site);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
