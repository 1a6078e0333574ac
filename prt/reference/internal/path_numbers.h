// The numbers that a path is made of.
// threads: thread-bound
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace penumbra::prt {

// The first six numbers of a path come from the R6 sequence (Roberts 2018: powers of the root of
// x^7 = x + 1) with a random start per pixel; the others are plain random numbers.
class PathNumbers {
 public:
  PathNumbers(std::uint64_t stream, int sample) : state_(mix(stream)) {
    static constexpr double kRoot = 1.1127756842787055;  // of x^7 = x + 1
    double step = 1;
    for (double& value : quasi_) {
      step /= kRoot;
      const double x = step * sample + random();
      value = x - std::floor(x);
    }
    state_ = mix(state_ + static_cast<std::uint64_t>(sample));
  }
  float next() {
    return std::min(0x1.fffffep-1f, static_cast<float>(used_ < 6 ? quasi_[used_++] : random()));
  }

 private:
  static std::uint64_t mix(std::uint64_t z) {  // SplitMix64, Steele et al. 2014
    z += 0x9e3779b97f4a7c15ull;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
  }
  double random() {
    state_ += 0x9e3779b97f4a7c15ull;
    return static_cast<double>(mix(state_) >> 11) * 0x1p-53;
  }
  std::uint64_t state_;
  double quasi_[6]{};
  int used_ = 0;
};

}  // namespace penumbra::prt
