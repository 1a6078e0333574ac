// The difference of instants is in seconds and does not turn into a bare number.
#include "core/units.h"

using namespace penumbra;

int main() {
  const TimestampNs earlier{1}, later{2};
#ifdef WRONG
  const double age = later - earlier;  // expect: Seconds
#else
  const double age = (later - earlier).count();
#endif
  return age > 0;
}
