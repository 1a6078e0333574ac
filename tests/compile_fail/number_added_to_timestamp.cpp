// A step along the clock must say its unit.
#include "core/units.h"

using namespace penumbra;

int main() {
  const TimestampNs now{1};
#ifdef WRONG
  const TimestampNs then = now + .5;  // expect: TimestampNs
#else
  const TimestampNs then = now + Seconds(.5);
#endif
  return then > now;
}
