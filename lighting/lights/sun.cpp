#include "lighting/lights/sun.h"

#include <algorithm>
#include <cmath>

#include "core/conventions.h"

namespace penumbra::lighting {

namespace {

constexpr double kDegree = kPi / 180;

struct Equatorial {
  double right_ascension, declination;  // radian
};

// `days` since noon of 1 January 2000, universal time.
Equatorial sun_on_the_sky(double days) {
  const double node = 2.1429 - .0010394594 * days,
               mean_longitude = 4.8950630 + .017202791698 * days,
               anomaly = 6.2400600 + .0172019699 * days;
  const double longitude = mean_longitude + .03341607 * std::sin(anomaly) +
                           .00034894 * std::sin(2 * anomaly) - .0001134 - .0000203 * std::sin(node);
  const double obliquity = .4090928 - 6.2140e-9 * days + .0000396 * std::cos(node);
  return {std::atan2(std::cos(obliquity) * std::sin(longitude), std::cos(longitude)),
          std::asin(std::sin(obliquity) * std::sin(longitude))};
}

}  // namespace

glm::dvec3 sun_direction(const SunSite& site, std::chrono::sys_seconds utc) {
  using namespace std::chrono;
  constexpr sys_seconds kNoon2000 = sys_days{January / 1 / 2000} + 12h;
  const double days = duration<double>(utc - kNoon2000).count() / 86400,
               hour = duration<double>(utc - floor<std::chrono::days>(utc)).count() / 3600;
  const Equatorial sun = sun_on_the_sky(days);
  const double sidereal_hours = 6.6974243242 + .0657098283 * days + hour;
  const double hour_angle =
      (15 * sidereal_hours + site.longitude_deg) * kDegree - sun.right_ascension;
  const double latitude = site.latitude_deg * kDegree;
  // Towards the south, the west and the zenith.
  const double south = std::sin(latitude) * std::cos(sun.declination) * std::cos(hour_angle) -
                       std::cos(latitude) * std::sin(sun.declination),
               west = std::cos(sun.declination) * std::sin(hour_angle),
               up = std::cos(latitude) * std::cos(sun.declination) * std::cos(hour_angle) +
                    std::sin(latitude) * std::sin(sun.declination);
  const double azimuth = std::atan2(-west, -south);  // from north over east
  constexpr double kParallax = 6371.01 / 149597890;
  const double zenith = std::acos(std::clamp(up, -1., 1.));
  const double seen = zenith + kParallax * std::sin(zenith);
  const double turn = azimuth + site.north_deg * kDegree;  // clockwise from -z
  return {std::sin(seen) * std::sin(turn), std::cos(seen), -std::sin(seen) * std::cos(turn)};
}

glm::dvec3 sun_direction(const SunSite& site) {
  using namespace std::chrono;
  return sun_direction(site, site.time.value_or(floor<seconds>(system_clock::now())));
}

}  // namespace penumbra::lighting
