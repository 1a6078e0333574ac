// Light that neighbouring vertices share.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "lighting/lights/distant_light.h"
#include "prt/geometry/mesh.h"
#include "prt/transfer/visibility_map.h"

namespace penumbra::shadows {

/// Each vertex with its neighbours: few directions a vertex, turned from one to the next, become
/// many.
template <class T>
void average_neighbours(const prt::Mesh& mesh, std::vector<T>& values) {
  thread_local std::vector<T> sums;  // grows once per thread
  sums = values;
  for (const auto& [a, b, c] : mesh.triangles) {
    const T all = values[a] + values[b] + values[c];
    sums[a] = sums[a] + (all - values[a]);
    sums[b] = sums[b] + (all - values[b]);
    sums[c] = sums[c] + (all - values[c]);
  }
  std::swap(sums, values);
}

/// Sums over several directions of a light, so often. Once leaves the beat of the turns with a
/// grid's rows as ripples in wide penumbras; patterns in random order leave blotches. Three times
/// would blur the edges of smaller sources (studio: 2.5 to 3.3 %).
inline int smoothing_passes(const lighting::DistantLight& source) {
  constexpr double kThriceFrom = .25;  // radians
  return source.radius.value() > kThriceFrom ? 3 : 1;
}
template <class T>
void smooth_over_neighbours(const prt::Mesh& mesh, int times, std::vector<T>& sums) {
  for (int pass = 0; pass < times; ++pass) average_neighbours(mesh, sums);
}

/// As smooth_over_neighbours, as often as smoothing_passes() says, as far as vertices differ by no
/// more than few directions make them: an edge of a shadow that is sharper than the mesh stays one.
/// in:      directions: by vertex, how many different ones its sums are of; 0: no noise is in them
/// threads: reentrant
/// source:  local statistics, Lee 1980; the variance of stratified samples of an edge falls with
///          n^-1.5, Mitchell 1996
void smooth_noise_over_neighbours(const prt::Mesh& mesh, const lighting::DistantLight& source,
                                  std::span<const std::uint8_t> directions,
                                  std::vector<prt::CosineSums>& sums);

}  // namespace penumbra::shadows
