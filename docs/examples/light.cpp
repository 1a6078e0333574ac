// The light of an environment map: spherical harmonics and the distant lights beside them.
// Links penumbra::lighting alone.
#include <penumbra/lighting/estimate.h>

#include <cstdio>

int main() {
  // A grey sky and a small sun; row 0 looks up, radiance is linear (core/conventions.h).
  penumbra::Image<penumbra::Rgb> map(256, 128, {.4f, .5f, .6f});
  map.at(40, 30) = {9e3f, 8e3f, 6e3f};

  const auto light = penumbra::lighting::estimate_map(map, {.bands = 5});
  if (!light) {
    std::fprintf(stderr, "%s: %s\n", light.error().where.c_str(), light.error().detail.c_str());
    return 1;
  }
  for (const penumbra::Rgb& c : light->light.terms())
    std::printf("%8.4f %8.4f %8.4f\n", double(c.r), double(c.g), double(c.b));
  for (const auto& sun : light->lights)
    std::printf("light towards %.2f %.2f %.2f, radius %.2f degrees\n", sun.direction.x,
                sun.direction.y, sun.direction.z, sun.radius.value() * 57.29578);
}
