// Rows of half floats to floats with the machine's vector conversion.
#pragma once

#include <cstdint>
#include <span>

namespace penumbra::compositor {

/// out must be as long as in.
void floats_from_halves(std::span<const std::uint16_t> in, std::span<float> out);

}  // namespace penumbra::compositor
