// A bare number is not assigned to a radiance.
#include "core/units.h"

using namespace penumbra;

int main() {
#ifdef WRONG
  const RelativeRadiance radiance = .5f;  // expect: RelativeRadiance
#else
  const RelativeRadiance radiance(.5f);
#endif
  return radiance.value() > 0;
}
