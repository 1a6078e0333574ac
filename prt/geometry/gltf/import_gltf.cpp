#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <map>
#include <utility>

#include "core/exceptions.h"
#include "prt/geometry/gltf/gltf.h"
#include "prt/geometry/gltf/internal/document.h"
#include "prt/geometry/gltf/internal/frames.h"
#include "prt/geometry/gltf/internal/materials.h"
#include "prt/geometry/gltf/internal/mean_colour.h"
#include "prt/geometry/gltf/internal/nodes.h"
#include "prt/geometry/gltf/internal/primitives.h"
#include "prt/geometry/internal/limits.h"
#include "prt/geometry/internal/weld.h"

namespace penumbra::prt::gltf {

namespace {

// Of all that is placed: a small file can place a large mesh many times.
constexpr std::size_t kMaxVertices = std::size_t{1} << 23;

struct PreparedPrimitive {
  Primitive primitive;
  std::vector<Rgb> albedo;
};

// Normals by the inverse transpose, but for its scale: the cofactors, which also a matrix without
// an inverse has. Mirrored space turns them round.
glm::dmat3 normal_matrix(const glm::dmat3& m, bool mirrored) {
  const double way = mirrored ? -1 : 1;
  return {way * glm::cross(m[1], m[2]), way * glm::cross(m[2], m[0]), way * glm::cross(m[0], m[1])};
}

class Assembly {
 public:
  Assembly(Document& document, Rgb default_albedo)
      : document_(document), materials_(document, default_albedo) {}

  Result<Import> run() {
    PENUMBRA_ASSIGN(placed, placed_meshes(document_));
    std::size_t vertices = 0;
    for (const PlacedMesh& place : placed) {
      PENUMBRA_ASSIGN(parts, parts_of(place.mesh));
      for (const PreparedPrimitive& part : *parts) vertices += part.primitive.positions.size();
      if (vertices > kMaxVertices)
        return document_.invalid(
            fmt::format("has more than {} vertices, at {}", kMaxVertices, place.name));
    }
    for (const PlacedMesh& place : placed)
      for (const PreparedPrimitive& part : parts_.at(place.mesh)) PENUMBRA_TRY(add(part, place));
    if (out_.mesh.triangles.empty())
      return document_.invalid(out_.degenerate_triangles > 0 ? "has only degenerate triangles"
                                                             : "has no triangles");
    finish();
    out_.extensions = document_.extensions();
    out_.left_out = std::move(document_).left_out();
    return std::move(out_);
  }

 private:
  // Meshes stand in several places and are read once.
  Result<const std::vector<PreparedPrimitive>*> parts_of(std::size_t mesh) {
    const auto [found, fresh] = parts_.try_emplace(mesh);
    if (!fresh) return &found->second;
    PENUMBRA_ASSIGN(primitives, read_primitives(document_, mesh, materials_));
    for (Primitive& p : primitives) {
      PreparedPrimitive part{std::move(p), {}};
      find_albedo(part);
      found->second.push_back(std::move(part));
    }
    return &found->second;
  }

  void find_albedo(PreparedPrimitive& part) {
    const Primitive& p = part.primitive;
    const Material& material = materials_.all()[p.material];
    for (std::size_t i = 0; i < p.positions.size(); ++i) {
      std::array<glm::vec2, 2> uv{glm::vec2(0), glm::vec2(0)};
      for (std::size_t set = 0; set < 2; ++set)
        if (!p.coordinates[set].empty()) uv[set] = p.coordinates[set][i];
      const Rgb mean = means_.albedo(material, uv, p.positions.size());
      part.albedo.push_back(p.tint.empty() ? mean : mean * p.tint[i]);
    }
  }

  Result<void> add(const PreparedPrimitive& part, const PlacedMesh& place) {
    const Primitive& p = part.primitive;
    Mesh& mesh = out_.mesh;
    const std::size_t first = mesh.positions.size();
    const glm::dmat3 linear(place.world_from_mesh);
    const bool mirrored = glm::determinant(linear) < 0;
    const glm::dmat3 of_normals = normal_matrix(linear, mirrored);
    for (std::size_t i = 0; i < p.positions.size(); ++i) {
      const glm::dvec3 at(place.world_from_mesh * glm::dvec4(glm::dvec3(p.positions[i]), 1));
      PENUMBRA_TRY(check(at, i, p.name));
      mesh.positions.emplace_back(at);
      const glm::dvec3 normal = of_normals * glm::dvec3(p.normals[i]);
      const double length = glm::length(normal);
      mesh.normals.emplace_back(length > 0 && std::isfinite(length) ? glm::vec3(normal / length)
                                                                    : glm::vec3(0, 1, 0));
    }
    mesh.albedo.insert(mesh.albedo.end(), part.albedo.begin(), part.albedo.end());
    add_surface(p, linear, mirrored, first);
    for (auto t : p.triangles) {
      if (mirrored) std::swap(t[1], t[2]);
      for (auto& i : t) i += static_cast<std::uint32_t>(first);
      add_triangle(t);
    }
    return {};
  }

  Result<void> check(const glm::dvec3& at, std::size_t vertex, const std::string& name) const {
    const double farthest = std::max({std::abs(at.x), std::abs(at.y), std::abs(at.z)});
    if (!std::isfinite(farthest) || std::isnan(at.x + at.y + at.z))
      return fail(ErrorCode::kNonFinite, document_.file(),
                  fmt::format("vertex {} of {} is not finite", vertex, name));
    if (farthest > kFarthest)
      return document_.invalid(
          fmt::format("vertex {} of {} is {:.2g} units from the origin, and {:.0g} are the limit",
                      vertex, name, farthest, kFarthest));
    return {};
  }

  void add_surface(const Primitive& p, const glm::dmat3& linear, bool mirrored, std::size_t first) {
    const std::size_t count = p.positions.size();
    surface_.material.insert(surface_.material.end(), count, p.material);
    for (std::size_t set = 0; set < 2; ++set)
      if (p.coordinates[set].empty())
        surface_.coordinates[set].insert(surface_.coordinates[set].end(), count, glm::vec2(0));
      else
        surface_.coordinates[set].insert(surface_.coordinates[set].end(),
                                         p.coordinates[set].begin(), p.coordinates[set].end());
    any_tint_ |= !p.tint.empty();
    if (p.tint.empty()) surface_.tint.insert(surface_.tint.end(), count, Rgb{1, 1, 1});
    surface_.tint.insert(surface_.tint.end(), p.tint.begin(), p.tint.end());
    for (std::size_t i = 0; i < count; ++i) {
      const bool has = !p.tangents.empty();
      glm::dvec3 along = has ? linear * glm::dvec3(glm::vec3(p.tangents[i])) : glm::dvec3(0);
      const double length = glm::length(along);
      along = length > 0 && std::isfinite(length) ? along / length : glm::dvec3(0);
      const float way = (has ? p.tangents[i].w : 1.f) * (mirrored ? -1.f : 1.f);
      surface_.tangents.emplace_back(perpendicular(glm::vec3(along), out_.mesh.normals[first + i]),
                                     has ? way : 1.f);
    }
  }

  void add_triangle(const std::array<std::uint32_t, 3>& t) {
    const auto& p = out_.mesh.positions;
    const glm::vec3 e1 = p[t[1]] - p[t[0]], e2 = p[t[2]] - p[t[0]];
    // Relative to the edges, so that small models keep their triangles.
    if (glm::length(glm::cross(e1, e2)) <= 1e-7f * glm::length(e1) * glm::length(e2))
      ++out_.degenerate_triangles;
    else
      out_.mesh.triangles.push_back(t);
  }

  // What no material asks for goes, and the surface where none says more than an albedo.
  void finish() {
    surface_.materials = std::move(materials_).take();
    const auto& all = surface_.materials;
    if (std::ranges::all_of(all, is_plain)) return weld(out_.mesh);
    for (int set = 0; set < 2; ++set) {
      if (std::ranges::none_of(all, [&](const Material& m) { return asks_for(m, set); }))
        surface_.coordinates[static_cast<std::size_t>(set)] = {};
    }
    if (std::ranges::none_of(all, [](const Material& m) { return bool(m.normal_map); }))
      surface_.tangents = {};
    if (!any_tint_) surface_.tint = {};
    // A primitive for each material is how files hold them.
    std::ranges::stable_sort(out_.mesh.triangles, {},
                             [&](const auto& t) { return surface_.material[t[0]]; });
    weld(out_.mesh, &surface_);
    out_.surface = std::make_shared<const SurfaceMaterials>(std::move(surface_));
  }

  Document& document_;
  Materials materials_;
  MeanColours means_;
  std::map<std::size_t, std::vector<PreparedPrimitive>> parts_;
  SurfaceMaterials surface_;
  bool any_tint_ = false;
  Import out_;
};

Result<Import> assembled(Result<Document> document, const std::filesystem::path& path,
                         Rgb default_albedo) {
  if (!document) return std::unexpected(std::move(document).error());
  try {
    return Assembly(*document, default_albedo).run();
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnreadable, path.string(), reason_of(e));
  }
}

}  // namespace

bool is_gltf(const std::filesystem::path& path) {
  std::string kind = path.extension().string();
  std::ranges::transform(kind, kind.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return kind == ".gltf" || kind == ".glb";
}

Result<Import> import_file(const std::filesystem::path& path, Rgb default_albedo) {
  return assembled(Document::open(path), path, default_albedo);
}

Result<Import> import_bytes(std::vector<unsigned char> bytes, const std::filesystem::path& path,
                            Rgb default_albedo) {
  return assembled(Document::parse(std::move(bytes), path), path, default_albedo);
}

Result<std::vector<Material>> read_materials(std::vector<unsigned char> bytes,
                                             const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(document, Document::parse(std::move(bytes), path));
  Materials materials(document, Rgb{1, 1, 1});
  for (std::size_t i = 0; i < document.count("materials"); ++i) PENUMBRA_TRY(materials.use(i));
  return std::move(materials).take();
}

}  // namespace penumbra::prt::gltf
