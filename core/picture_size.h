// How large a picture may be.
// threads: a constant
#pragma once

#pragma GCC visibility push(default)
namespace penumbra {

/// Longest side of a picture that is read, filmed or written, pixels.
inline constexpr int kMaxSide = 32768;

}  // namespace penumbra
#pragma GCC visibility pop
