#include "prt/geometry/gltf/internal/nodes.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <glm/gtc/quaternion.hpp>
#include <optional>
#include <utility>

#include "prt/geometry/gltf/internal/accessors.h"

namespace penumbra::prt::gltf {

namespace {

// `count` finite numbers of a list; nothing where it has others.
std::optional<std::vector<double>> list_of(const Json& of, std::size_t count) {
  if (!of.is_array() || of.size() != count) return std::nullopt;
  std::vector<double> out;
  for (const Json& v : of) {
    if (!v.is_number() || !std::isfinite(v.get<double>())) return std::nullopt;
    out.push_back(v.get<double>());
  }
  return out;
}

glm::dmat4 placed(const glm::dvec3& translation, const glm::dquat& rotation,
                  const glm::dvec3& scale) {
  const double length = glm::length(rotation);
  const glm::dquat turn = length > 1e-12 ? rotation / length : glm::dquat(1, 0, 0, 0);
  return glm::translate(glm::dmat4(1), translation) * glm::mat4_cast(turn) *
         glm::scale(glm::dmat4(1), scale);
}

Result<glm::dmat4> local_matrix(const Document& document, const Json& node,
                                const std::string& name) {
  const auto damaged = [&](const char* what) {
    return document.invalid(fmt::format("{} has a damaged {}", name, what));
  };
  if (const Json* matrix = member(node, "matrix")) {
    const auto v = list_of(*matrix, 16);
    if (!v) return damaged("matrix");
    glm::dmat4 out;
    for (int c = 0; c < 4; ++c)
      for (int r = 0; r < 4; ++r) out[c][r] = (*v)[static_cast<std::size_t>(4 * c + r)];
    return out;
  }
  glm::dvec3 translation(0), scale(1);
  glm::dquat rotation(1, 0, 0, 0);
  if (const Json* t = member(node, "translation")) {
    const auto v = list_of(*t, 3);
    if (!v) return damaged("translation");
    translation = {(*v)[0], (*v)[1], (*v)[2]};
  }
  if (const Json* r = member(node, "rotation")) {
    const auto v = list_of(*r, 4);
    if (!v) return damaged("rotation");
    rotation = glm::dquat((*v)[3], (*v)[0], (*v)[1], (*v)[2]);
  }
  if (const Json* s = member(node, "scale")) {
    const auto v = list_of(*s, 3);
    if (!v) return damaged("scale");
    scale = {(*v)[0], (*v)[1], (*v)[2]};
  }
  return placed(translation, rotation, scale);
}

using Children = std::vector<std::vector<std::size_t>>;

// With one parent for each node, what a root reaches is a tree.
Result<Children> children_of_nodes(const Document& document, std::vector<bool>& has_parent) {
  const std::size_t count = document.count("nodes");
  Children out(count);
  has_parent.assign(count, false);
  for (std::size_t i = 0; i < count; ++i) {
    const Json& node = document.at("nodes", i);
    const Json* list = member(node, "children");
    if (!list) continue;
    const std::string name = called("node", i, node);
    if (!list->is_array()) return document.invalid(name + " has children that are no list");
    for (const Json& child : *list) {
      if (!child.is_number_unsigned() || child.get<std::uint64_t>() >= count)
        return document.invalid(name + " has a child that is not there");
      const auto index = child.get<std::size_t>();
      if (has_parent[index])
        return document.invalid(called("node", index, document.at("nodes", index)) +
                                " has two parents");
      has_parent[index] = true;
      out[i].push_back(index);
    }
  }
  return out;
}

Result<std::vector<std::size_t>> roots(const Document& document,
                                       const std::vector<bool>& has_parent) {
  std::vector<std::size_t> out;
  PENUMBRA_ASSIGN(chosen, document.reference(document.root(), "scene", "scenes", "the file"));
  if (document.count("scenes") == 0) {
    for (std::size_t i = 0; i < has_parent.size(); ++i)
      if (!has_parent[i]) out.push_back(i);
    return out;
  }
  const Json* list = member(document.at("scenes", chosen.value_or(0)), "nodes");
  if (!list) return out;
  if (!list->is_array()) return document.invalid("its scene has nodes that are no list");
  for (const Json& node : *list) {
    if (!node.is_number_unsigned() || node.get<std::uint64_t>() >= has_parent.size())
      return document.invalid("its scene names a node that is not there");
    out.push_back(node.get<std::size_t>());
  }
  return out;
}

}  // namespace

Result<std::vector<glm::dmat4>> instance_matrices(Document& document, const Json& node,
                                                  const std::string& name) {
  const Json* found = extension(node, "EXT_mesh_gpu_instancing");
  if (!found) return std::vector<glm::dmat4>{glm::dmat4(1)};
  const Json* attributes = member(*found, "attributes");
  if (!attributes) return document.invalid(name + " has instances without attributes");
  std::optional<std::size_t> count;
  const auto read = [&](const char* key, std::size_t components) -> Result<AccessorValues> {
    PENUMBRA_ASSIGN(index, document.reference(*attributes, key, "accessors", name));
    if (!index) return AccessorValues{};
    const std::size_t allowed[] = {components};
    PENUMBRA_ASSIGN(out, read_numbers(document, *index, allowed, name));
    if (count.value_or(out.size()) != out.size())
      return document.invalid(name + " has different numbers of places and turns of instances");
    count = out.size();
    return out;
  };
  PENUMBRA_ASSIGN(translations, read("TRANSLATION", 3));
  PENUMBRA_ASSIGN(rotations, read("ROTATION", 4));
  PENUMBRA_ASSIGN(scales, read("SCALE", 3));
  if (!count || *count > kMaxPlaced)
    return document.invalid(fmt::format("{} has no instances, or more than {}", name, kMaxPlaced));
  std::vector<glm::dmat4> out;
  for (std::size_t i = 0; i < *count; ++i) {
    glm::dvec3 translation(0), scale(1);
    glm::dquat turn(1, 0, 0, 0);
    if (const auto t = translations.size() ? translations.at(i) : std::span<const float>{};
        !t.empty())
      translation = {t[0], t[1], t[2]};
    if (const auto r = rotations.size() ? rotations.at(i) : std::span<const float>{}; !r.empty())
      turn = glm::dquat(r[3], r[0], r[1], r[2]);
    if (const auto s = scales.size() ? scales.at(i) : std::span<const float>{}; !s.empty())
      scale = {s[0], s[1], s[2]};
    out.push_back(placed(translation, turn, scale));
  }
  return out;
}

Result<std::vector<PlacedMesh>> placed_meshes(Document& document) {
  std::vector<bool> has_parent;
  PENUMBRA_ASSIGN(children, children_of_nodes(document, has_parent));
  PENUMBRA_ASSIGN(first, roots(document, has_parent));
  std::vector<PlacedMesh> out;
  std::vector<bool> met(children.size(), false);
  // By a list of what is to be visited, as chains of nodes may be deeper than the stack.
  std::vector<std::pair<std::size_t, glm::dmat4>> next;
  for (const std::size_t root : first) next.emplace_back(root, glm::dmat4(1));
  std::ranges::reverse(next);
  while (!next.empty()) {
    const auto [index, world_from_parent] = next.back();
    next.pop_back();
    const Json& node = document.at("nodes", index);
    const std::string name = called("node", index, node);
    if (met[index]) return document.invalid(name + " is its own ancestor, or in the scene twice");
    met[index] = true;
    PENUMBRA_ASSIGN(local, local_matrix(document, node, name));
    const glm::dmat4 world = world_from_parent * local;
    for (auto child = children[index].rbegin(); child != children[index].rend(); ++child)
      next.emplace_back(*child, world);
    PENUMBRA_ASSIGN(mesh, document.reference(node, "mesh", "meshes", name));
    if (!mesh) continue;
    if (member(node, "skin"))
      document.leave_out(name + ": its skin is for animation, and it stands as it was bound");
    PENUMBRA_ASSIGN(places, instance_matrices(document, node, name));
    for (const glm::dmat4& place : places) out.push_back({*mesh, world * place, name});
    if (out.size() > kMaxPlaced)
      return document.invalid(fmt::format("places more than {} meshes", kMaxPlaced));
  }
  return out;
}

}  // namespace penumbra::prt::gltf
