// Instants are subtracted, never added.
#include "core/units.h"

using namespace penumbra;

int main() {
  const TimestampNs a{1}, b{2};
#ifdef WRONG
  return a + b > a;  // expect: TimestampNs
#else
  return b - a > Seconds(0);
#endif
}
