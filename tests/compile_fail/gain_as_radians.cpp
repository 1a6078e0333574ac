// Two quantities over the same number type are still two.
#include "core/units.h"

using namespace penumbra;

constexpr double half(Radians angle) {
  return .5 * angle.value();
}

int main() {
  [[maybe_unused]] const Gain gain(2);
#ifdef WRONG
  return half(gain) > 0;  // expect: Gain
#else
  return half(Radians(2)) > 0;
#endif
}
