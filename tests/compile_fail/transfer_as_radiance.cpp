// A transfer vector taken for the light that it is to be multiplied with.
#include "lighting/lighting.h"

using namespace penumbra;

int main() {
  [[maybe_unused]] const TransferSh transfer(3);
#ifdef WRONG
  lighting::irradiance(transfer);  // expect: TransferSh
#else
  lighting::irradiance(RadianceSh(3));
#endif
}
