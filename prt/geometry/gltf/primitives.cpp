#include "prt/geometry/gltf/internal/primitives.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <map>
#include <optional>
#include <utility>

#include "prt/geometry/gltf/internal/accessors.h"
#include "prt/geometry/gltf/internal/compression.h"
#include "prt/geometry/gltf/internal/frames.h"

namespace penumbra::prt::gltf {

namespace {

enum Mode : std::uint64_t { kPoints = 0, kLines, kLineLoop, kLineStrip, kTriangles, kStrip, kFan };

struct Attribute {
  const char* name;
  std::array<std::size_t, 2> components;
};
constexpr Attribute kRead[] = {{"POSITION", {3, 3}},   {"NORMAL", {3, 3}},     {"TANGENT", {4, 4}},
                               {"TEXCOORD_0", {2, 2}}, {"TEXCOORD_1", {2, 2}}, {"COLOR_0", {3, 4}}};

bool finite(std::span<const float> v) {
  return std::ranges::all_of(v, [](float x) { return std::isfinite(x); });
}

class Reader {
 public:
  Reader(Document& document, const Json& json, std::string name)
      : document_(document), json_(json) {
    out_.name = std::move(name);
  }

  // Nothing where it has no triangles.
  Result<std::optional<Primitive>> read(Materials& materials) {
    const auto mode = whole(json_, "mode", kTriangles);
    if (!mode || *mode > kFan) return document_.invalid(out_.name + " has an unknown mode");
    if (*mode < kTriangles) {
      document_.leave_out(out_.name + (*mode == kPoints ? ": points" : ": lines") +
                          " are left out, as they have no surface");
      return std::nullopt;
    }
    PENUMBRA_ASSIGN(index, document_.reference(json_, "material", "materials", out_.name));
    PENUMBRA_ASSIGN(material, materials.use(index));
    out_.material = material;
    PENUMBRA_TRY(read_geometry());
    PENUMBRA_TRY(take_positions());
    PENUMBRA_TRY(make_triangles(*mode));
    if (out_.triangles.empty()) return std::nullopt;
    take_coordinates(materials.all()[material]);
    take_tint(materials.all()[material]);
    take_frames(materials.all()[material]);
    if (member(json_, "targets"))
      document_.leave_out(out_.name + ": morph targets are for animation, and it stands unmoved");
    return std::move(out_);
  }

 private:
  Result<void> read_geometry() {
    if (const Json* draco = extension(json_, "KHR_draco_mesh_compression")) {
      PENUMBRA_ASSIGN(unpacked, unpack_draco(document_, json_, *draco, out_.name));
      given_ = std::move(unpacked.attributes);
      indices_ = std::move(unpacked.indices);
    }
    const Json* attributes = member(json_, "attributes");
    if (!attributes || !attributes->is_object())
      return document_.invalid(out_.name + " has no attributes");
    for (const Attribute& a : kRead) {
      if (given_.contains(a.name)) continue;  // packed
      const std::string whose = fmt::format("{}: {}", out_.name, a.name);
      PENUMBRA_ASSIGN(index, document_.reference(*attributes, a.name, "accessors", out_.name));
      if (!index) continue;
      PENUMBRA_ASSIGN(values, read_numbers(document_, *index, a.components, whose));
      given_[a.name] = std::move(values);
    }
    if (!indices_) {
      PENUMBRA_ASSIGN(index, document_.reference(json_, "indices", "accessors", out_.name));
      if (index) {
        PENUMBRA_ASSIGN(indices, read_indices(document_, *index, out_.name));
        indices_ = std::move(indices);
      }
    }
    return check_counts();
  }

  // One of each for every vertex.
  Result<void> check_counts() const {
    const auto positions = given_.find("POSITION");
    if (positions == given_.end() || positions->second.components != 3)
      return document_.invalid(out_.name + " has no positions");
    for (const Attribute& a : kRead)
      if (const auto found = given_.find(a.name); found != given_.end()) {
        if (found->second.size() != positions->second.size())
          return document_.invalid(fmt::format("{} has {} positions and {} of {}", out_.name,
                                               positions->second.size(), found->second.size(),
                                               a.name));
        if (std::ranges::find(a.components, found->second.components) == a.components.end())
          return document_.invalid(
              fmt::format("{}: {} has {} components", out_.name, a.name, found->second.components));
      }
    return {};
  }

  const AccessorValues* given(const char* name) const {
    const auto found = given_.find(name);
    return found == given_.end() ? nullptr : &found->second;
  }

  Result<void> take_positions() {
    const AccessorValues& in = *given("POSITION");
    for (std::size_t i = 0; i < in.size(); ++i) {
      const auto p = in.at(i);
      if (!finite(p))
        return fail(ErrorCode::kNonFinite, document_.file(),
                    fmt::format("vertex {} of {} is not finite", i, out_.name));
      out_.positions.emplace_back(p[0], p[1], p[2]);
    }
    return {};
  }

  // Strips and fans as glTF 2.0, 3.7.2.1 numbers their triangles.
  Result<void> make_triangles(std::uint64_t mode) {
    if (!indices_) {
      indices_.emplace(out_.positions.size());
      for (std::size_t i = 0; i < indices_->size(); ++i)
        (*indices_)[i] = static_cast<std::uint32_t>(i);
    }
    for (const std::uint32_t i : *indices_)
      if (i >= out_.positions.size())
        return document_.invalid(fmt::format("{} has an index {}, and {} vertices", out_.name, i,
                                             out_.positions.size()));
    const auto& v = *indices_;
    if (mode == kTriangles) {
      for (std::size_t i = 0; i + 2 < v.size(); i += 3)
        out_.triangles.push_back({v[i], v[i + 1], v[i + 2]});
    } else {
      for (std::size_t i = 0; i + 2 < v.size(); ++i) {
        const std::size_t odd = i % 2;
        if (mode == kStrip) out_.triangles.push_back({v[i], v[i + 1 + odd], v[i + 2 - odd]});
        if (mode == kFan) out_.triangles.push_back({v[i + 1], v[i + 2], v[0]});
      }
    }
    return {};
  }

  void take_coordinates(const Material& material) {
    for (std::size_t set = 0; set < 2; ++set) {
      const char* name = set == 0 ? "TEXCOORD_0" : "TEXCOORD_1";
      const AccessorValues* in = given(name);
      if (!in && asks_for(material, static_cast<int>(set)))
        document_.leave_out(fmt::format(
            "{} has no {}: its material shows one place of its pictures", out_.name, name));
      if (!in) continue;
      for (std::size_t i = 0; i < in->size(); ++i) {
        const auto uv = in->at(i);
        out_.coordinates[set].push_back(finite(uv) ? glm::vec2(uv[0], uv[1]) : glm::vec2(0));
      }
    }
  }

  void take_tint(const Material& material) {
    const AccessorValues* in = given("COLOR_0");
    if (!in) return;
    bool clear = false;
    for (std::size_t i = 0; i < in->size(); ++i) {
      const auto c = in->at(i);
      const auto part = [](float v) { return std::isfinite(v) ? std::clamp(v, 0.f, 1.f) : 1.f; };
      out_.tint.push_back({part(c[0]), part(c[1]), part(c[2])});
      clear |= c.size() == 4 && part(c[3]) < 1;
    }
    if (clear && material.alpha != Material::Alpha::kOpaque)
      document_.leave_out(out_.name + ": the alpha of its vertex colours is left out");
  }

  void take_frames(const Material& material) {
    const AccessorValues* normals = given("NORMAL");
    if (normals) {
      for (std::size_t i = 0; i < normals->size(); ++i) {
        const auto n = normals->at(i);
        glm::vec3 normal(n[0], n[1], n[2]);
        const float length = glm::length(normal);
        if (!finite(n) || !(length > 1e-10f)) normal = {0, 1, 0};
        out_.normals.push_back(glm::normalize(normal));
      }
    } else {
      make_normals(out_);
    }
    if (!material.normal_map) return;
    // Those of a file belong to its own normals (glTF 2.0, 3.7.2.1).
    const AccessorValues* tangents = normals ? given("TANGENT") : nullptr;
    if (!tangents) return make_tangents(out_, material.normal_map);
    for (std::size_t i = 0; i < tangents->size(); ++i) {
      const auto t = tangents->at(i);
      const glm::vec3 along = finite(t) ? glm::vec3(t[0], t[1], t[2]) : glm::vec3(0);
      out_.tangents.emplace_back(perpendicular(along, out_.normals[i]), t[3] < 0 ? -1.f : 1.f);
    }
  }

  Document& document_;
  const Json& json_;
  std::map<std::string, AccessorValues> given_;
  std::optional<std::vector<std::uint32_t>> indices_;
  Primitive out_;
};

}  // namespace

Result<std::vector<Primitive>> read_primitives(Document& document, std::size_t mesh,
                                               Materials& materials) {
  const Json& json = document.at("meshes", mesh);
  const std::string name = called("mesh", mesh, json);
  const Json* list = member(json, "primitives");
  if (!list || !list->is_array()) return document.invalid(name + " has no primitives");
  std::vector<Primitive> out;
  for (std::size_t i = 0; i < list->size(); ++i) {
    std::string whose = list->size() == 1 ? name : fmt::format("primitive {} of {}", i, name);
    PENUMBRA_ASSIGN(primitive, Reader(document, (*list)[i], std::move(whose)).read(materials));
    if (primitive) out.push_back(std::move(*primitive));
  }
  return out;
}

}  // namespace penumbra::prt::gltf
