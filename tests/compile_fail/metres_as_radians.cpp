// Two quantities over the same number type are still two.
#include "core/units.h"

using namespace penumbra;

constexpr double half(Radians angle) {
  return .5 * angle.value();
}

int main() {
  [[maybe_unused]] const Metres distance(2);
#ifdef WRONG
  return half(distance) > 0;  // expect: Metres
#else
  return half(Radians(2)) > 0;
#endif
}
