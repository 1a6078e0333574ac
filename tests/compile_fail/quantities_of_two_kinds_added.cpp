// Arithmetic exists only where the units allow it.
#include "core/units.h"

using namespace penumbra;

int main() {
  const Gain gain(2);
  [[maybe_unused]] const Radians angle(1);
#ifdef WRONG
  return (gain + angle).value() > 0;  // expect: Radians
#else
  return (gain + gain).value() > 0;
#endif
}
