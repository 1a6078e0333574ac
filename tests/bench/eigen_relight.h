// Eigen's relight, in a file of its own: it is built for the instructions that ours picks at run
// time, AVX2 and FMA, and nothing that others include may be. It reads floats, ours 16-bit ones.
#pragma once

#include <memory>
#include <span>

namespace penumbra::bench {

class EigenRelight {
 public:
  /// transfer: [coefficient][point], 25 coefficients; light: [coefficient][channel]
  EigenRelight(std::span<const float> transfer, std::span<const float> light);
  ~EigenRelight();
  /// The machine lacks the instructions.
  static bool missing();
  /// A 100k x 25 float matrix times a 25 x 3 one, its rows on as many threads as ours.
  void run();
  std::span<const float> radiance() const;

 private:
  struct Matrices;
  std::unique_ptr<Matrices> matrices_;
};

}  // namespace penumbra::bench
