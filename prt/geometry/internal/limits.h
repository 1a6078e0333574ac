// What every importer refuses alike.
// threads: plain values
#pragma once

namespace penumbra::prt {

/// Beyond, areas leave the range of floats.
inline constexpr float kFarthest = 1e9f;

}  // namespace penumbra::prt
