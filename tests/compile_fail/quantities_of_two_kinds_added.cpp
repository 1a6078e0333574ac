// Arithmetic exists only where the units allow it.
#include "core/units.h"

using namespace penumbra;

int main() {
  const Gain gain(2);
  [[maybe_unused]] const Metres distance(1);
#ifdef WRONG
  return (gain + distance).value() > 0;  // expect: Metres
#else
  return (gain + gain).value() > 0;
#endif
}
