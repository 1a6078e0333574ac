// An exposure time put where the gain belongs.
#include "core/units.h"

using namespace penumbra;

int main() {
  const Seconds time(.01);
#ifdef WRONG
  const Exposure exposure{time, time};  // expect: Gain
#else
  const Exposure exposure{time, Gain(2)};
#endif
  return exposure.product() > 0;
}
