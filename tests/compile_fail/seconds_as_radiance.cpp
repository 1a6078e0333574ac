// A time passed where a radiance is wanted.
#include "core/units.h"

using namespace penumbra;

constexpr float twice(RelativeRadiance radiance) {
  return 2 * radiance.value();
}

int main() {
  [[maybe_unused]] const Seconds time(.25);
#ifdef WRONG
  return twice(time) > 0;  // expect: RelativeRadiance
#else
  return twice(RelativeRadiance(.25f)) > 0;
#endif
}
