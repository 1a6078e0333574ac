// A radiance is read at a direction, an irradiance at a normal: the wrong one must not be read.
#include "core/sh.h"
#include "lighting/lighting.h"

using namespace penumbra;

Rgb towards(const RadianceSh& light) {
  return lighting::evaluate(light, {0, 1, 0});
}

int main() {
  const RadianceSh light(3);
  [[maybe_unused]] const IrradianceSh received = lighting::irradiance(light);
#ifdef WRONG
  towards(received);  // expect: IrradianceSh
#else
  towards(light);
#endif
}
