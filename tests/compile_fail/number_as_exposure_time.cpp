// A bare number is no time: it may be milliseconds.
#include "core/units.h"

using namespace penumbra;

int main() {
#ifdef WRONG
  const Exposure exposure{.time = .01};  // expect: Seconds
#else
  const Exposure exposure{.time = Seconds(.01)};
#endif
  return exposure.product() > 0;
}
