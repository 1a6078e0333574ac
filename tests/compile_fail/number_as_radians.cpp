// A bare number may be degrees.
#include "core/units.h"

using namespace penumbra;

constexpr double half(Radians angle) {
  return .5 * angle.value();
}

int main() {
#ifdef WRONG
  return half(90.) > 0;  // expect: Radians
#else
  return half(Radians(1.5)) > 0;
#endif
}
