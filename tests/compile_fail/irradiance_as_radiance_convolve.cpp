// Convolving with the cosine twice.
#include "lighting/lighting.h"

using namespace penumbra;

int main() {
  const RadianceSh light(3);
  const IrradianceSh once = lighting::irradiance(light);
#ifdef WRONG
  lighting::irradiance(once);  // expect: IrradianceSh
#else
  lighting::evaluate(once, {0, 1, 0});
#endif
}
