// The two numbers of an exposure in the wrong order.
#include "core/units.h"

using namespace penumbra;

int main() {
  const Gain gain(4);
  const Seconds time(.01);
#ifdef WRONG
  const Exposure exposure{.time = gain};  // expect: Seconds
#else
  const Exposure exposure{.time = time, .gain = gain};
#endif
  return exposure.product() + time.count() + gain.value() > 0;
}
