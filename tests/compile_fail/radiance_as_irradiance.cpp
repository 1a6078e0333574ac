// An irradiance is not assigned from a radiance: the cosine would be missing.
#include "lighting/lighting.h"

using namespace penumbra;

int main() {
  const RadianceSh light(3);
#ifdef WRONG
  [[maybe_unused]] const IrradianceSh received = light;  // expect: IrradianceSh
#else
  [[maybe_unused]] const IrradianceSh received = lighting::irradiance(light);
#endif
}
