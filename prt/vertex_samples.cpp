#include "prt/vertex_samples.h"

#include <algorithm>

#include "prt/prt.h"

namespace penumbra::prt {

namespace {

// By vertex, which are at and beside it.
struct Neighbours {
  std::vector<std::uint32_t> first, vertex;
  std::span<const std::uint32_t> of(std::size_t i) const {
    return std::span(vertex).subspan(first[i], first[i + 1] - first[i]);
  }
};

Neighbours neighbours_of(const Mesh& mesh) {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs;
  pairs.reserve(mesh.positions.size() + 6 * mesh.triangles.size());
  for (std::uint32_t i = 0; i < mesh.positions.size(); ++i) pairs.emplace_back(i, i);
  for (const auto& t : mesh.triangles)
    for (std::size_t k = 0; k < 3; ++k)
      for (std::size_t other = 1; other < 3; ++other) pairs.emplace_back(t[k], t[(k + other) % 3]);
  std::ranges::sort(pairs);
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  Neighbours out;
  for (const auto& [at, beside] : pairs) {
    if (out.first.size() == at) out.first.push_back(static_cast<std::uint32_t>(out.vertex.size()));
    out.vertex.push_back(beside);
  }
  out.first.push_back(static_cast<std::uint32_t>(out.vertex.size()));
  return out;
}

}  // namespace

// Whom all around it can spare is left out, one after the other.
VertexSamples::VertexSamples(const Mesh& mesh) {
  constexpr std::size_t kLeast = 3;
  const Neighbours near = neighbours_of(mesh);
  const std::size_t count = mesh.positions.size();
  std::vector<std::size_t> left(count);  // samples, of a vertex and those beside it
  for (std::size_t i = 0; i < count; ++i) left[i] = near.of(i).size();
  constexpr std::uint32_t kNone = ~std::uint32_t{0};
  std::vector<std::uint32_t> place(count, kNone);
  for (std::uint32_t i = 0; i < count; ++i) {
    if (std::ranges::all_of(near.of(i), [&](std::uint32_t k) { return left[k] > kLeast; })) {
      for (const std::uint32_t k : near.of(i)) --left[k];
      continue;
    }
    place[i] = static_cast<std::uint32_t>(vertices_.size());
    vertices_.push_back(i);
  }
  around_.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    around_[i].fill(static_cast<std::uint32_t>(vertices_.size()));
    std::size_t used = 0;
    if (place[i] != kNone) around_[i][used++] = place[i];
    for (const std::uint32_t k : near.of(i))
      if (k != i && place[k] != kNone && used < kMost) around_[i][used++] = place[k];
  }
}

}  // namespace penumbra::prt
