#include "prt/transfer/vertex_samples.h"

#include <algorithm>
#include <glm/geometric.hpp>

#include "prt/geometry/mesh.h"

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

double mean_edge(const Mesh& mesh) {
  double sum = 0;
  for (const auto& [a, b, c] : mesh.triangles)
    sum += double(glm::distance(mesh.positions[a], mesh.positions[b])) +
           double(glm::distance(mesh.positions[b], mesh.positions[c])) +
           double(glm::distance(mesh.positions[c], mesh.positions[a]));
  return mesh.triangles.empty() ? 0 : sum / (3 * static_cast<double>(mesh.triangles.size()));
}

// Those beside it lie near and look the same way, so that they see what it does: not so in a dent,
// nor at the end of long edges.
bool is_like_its_neighbours(const Mesh& mesh, const Neighbours& near, std::uint32_t vertex,
                            double longest) {
  constexpr float kAlike = .7f;  // cosine
  return std::ranges::all_of(near.of(vertex), [&](std::uint32_t k) {
    return glm::dot(mesh.normals[vertex], mesh.normals[k]) >= kAlike &&
           double(glm::distance(mesh.positions[vertex], mesh.positions[k])) <= longest;
  });
}

}  // namespace

// Whom all around it can spare is left out, one after the other.
VertexSamples::VertexSamples(const Mesh& mesh) {
  constexpr std::size_t kMin = 3;
  const Neighbours near = neighbours_of(mesh);
  const std::size_t count = mesh.positions.size();
  std::vector<std::size_t> left(count);  // samples, of a vertex and those beside it
  for (std::size_t i = 0; i < count; ++i) left[i] = near.of(i).size();
  constexpr std::uint32_t kNone = ~std::uint32_t{0};
  std::vector<std::uint32_t> place(count, kNone);
  const double longest = 2 * mean_edge(mesh);
  for (std::uint32_t i = 0; i < count; ++i) {
    if (is_like_its_neighbours(mesh, near, i, longest) &&
        std::ranges::all_of(near.of(i), [&](std::uint32_t k) { return left[k] > kMin; })) {
      for (const std::uint32_t k : near.of(i)) --left[k];
      continue;
    }
    place[i] = static_cast<std::uint32_t>(vertices_.size());
    vertices_.push_back(i);
  }
  around_.resize(count);
  std::vector<std::uint32_t> beside;
  for (std::size_t i = 0; i < count; ++i) {
    around_[i].fill(static_cast<std::uint32_t>(vertices_.size()));
    std::size_t used = 0;
    if (place[i] != kNone) around_[i][used++] = place[i];
    beside.clear();
    for (const std::uint32_t k : near.of(i))
      if (k != i && place[k] != kNone) beside.push_back(place[k]);
    // Of many, some from all over their list: numbers go around a mesh in rows.
    const std::size_t taken = std::min(beside.size(), kMax - used);
    for (std::size_t k = 0; k < taken; ++k)
      around_[i][used++] = beside[(2 * k + 1) * beside.size() / (2 * taken)];
  }
}

}  // namespace penumbra::prt
