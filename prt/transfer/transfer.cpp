#include <algorithm>

#include "core/half.h"
#include "prt/transfer/transfer.h"

namespace penumbra::prt {

Transfer::Transfer(int bands_, int channels_, std::size_t points_)
    : bands(bands_),
      channels(channels_),
      points(points_),
      stride((points_ + 63) / 64 * 64),
      values(static_cast<std::size_t>(channels_) *
                 static_cast<std::size_t>(coefficient_count(bands_)) * stride,
             0) {}

float Transfer::value(int channel, int n, std::size_t point) const {
  return float_from_half(values[index(channel, n, point)]);
}

void Transfer::set(int channel, int n, std::size_t point, float v) {
  values[index(channel, n, point)] = half_from_float(v);
}

}  // namespace penumbra::prt
