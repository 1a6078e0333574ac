// A quantity gives up its unit only when asked to.
#include "core/units.h"

using namespace penumbra;

int main() {
  const Radians angle(1);
#ifdef WRONG
  const double number = angle;  // expect: Radians
#else
  const double number = angle.value();
#endif
  return number > 0;
}
