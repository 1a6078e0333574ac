#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <memory>
#include <utility>

#include "core/exceptions.h"
#include "prt/geometry/gltf/gltf.h"
#include "prt/geometry/gltf/internal/mean_colour.h"
#include "prt/geometry/internal/assimp_materials.h"
#include "prt/geometry/internal/assimp_scene.h"
#include "prt/geometry/internal/weld.h"
#include "prt/geometry/mesh.h"

namespace penumbra::prt {

namespace {

// What Assimp made of a file, as one mesh.
class SceneImport {
 public:
  SceneImport(const aiScene& scene, const std::filesystem::path& path, Rgb default_albedo)
      : scene_(scene), file_(path.string()), materials_(scene, path, default_albedo) {}

  Result<Import> run() {
    PENUMBRA_TRY(add_node(*scene_.mRootNode, aiMatrix4x4()));
    if (out_.mesh.triangles.empty())
      return fail(
          ErrorCode::kInvalid, file_,
          out_.degenerate_triangles > 0 ? "has only degenerate triangles" : "has no triangles");
    out_.left_out = materials_.left_out();
    const auto& all = materials_.all();
    if (std::ranges::none_of(all, [](const Material& m) { return bool(m.base_colour_map); })) {
      weld(out_.mesh);
      return std::move(out_);
    }
    if (!any_tint_) surface_.tint = {};
    surface_.materials = std::move(materials_).take();
    std::ranges::stable_sort(out_.mesh.triangles, {},
                             [&](const auto& t) { return surface_.material[t[0]]; });
    weld(out_.mesh, &surface_);
    out_.surface = std::make_shared<const SurfaceMaterials>(std::move(surface_));
    return std::move(out_);
  }

 private:
  Result<void> add_node(const aiNode& node, const aiMatrix4x4& to_parent) {
    const aiMatrix4x4 to_world = to_parent * node.mTransformation;
    const bool mirrored = aiMatrix3x3(to_world).Determinant() < 0;
    for (unsigned i = 0; i < node.mNumMeshes; ++i) {
      const aiMesh& mesh = *scene_.mMeshes[node.mMeshes[i]];
      const auto first = static_cast<std::uint32_t>(out_.mesh.positions.size());
      PENUMBRA_TRY(add_vertices(mesh, to_world));
      add_surface(mesh);
      add_triangles(mesh, first, mirrored);
    }
    for (unsigned i = 0; i < node.mNumChildren; ++i)
      PENUMBRA_TRY(add_node(*node.mChildren[i], to_world));
    return {};
  }

  Result<void> add_vertices(const aiMesh& in, const aiMatrix4x4& to_world) {
    aiMatrix3x3 normal_matrix(to_world);
    normal_matrix.Inverse().Transpose();
    for (unsigned i = 0; i < in.mNumVertices; ++i) {
      const aiVector3D p = to_world * in.mVertices[i];
      aiVector3D n = in.mNormals ? normal_matrix * in.mNormals[i] : aiVector3D(0, 1, 0);
      if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z))
        return fail(ErrorCode::kNonFinite, file_,
                    fmt::format("vertex {} of mesh \"{}\" is not finite", i, in.mName.C_Str()));
      if (std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) > kFarthest)
        return fail(ErrorCode::kInvalid, file_,
                    fmt::format("vertex {} of mesh \"{}\" is {:.2g} units from the origin, and "
                                "{:.0g} are the limit",
                                i, in.mName.C_Str(), p.Length(), kFarthest));
      if (!std::isfinite(n.x + n.y + n.z) || n.SquareLength() < 1e-20f) n = aiVector3D(0, 1, 0);
      n.Normalize();
      out_.mesh.positions.emplace_back(p.x, p.y, p.z);
      out_.mesh.normals.emplace_back(n.x, n.y, n.z);
    }
    return {};
  }

  void add_surface(const aiMesh& in) {
    const std::uint16_t place = materials_.use(in);
    const Material& material = materials_.all()[place];
    any_tint_ |= in.mColors[0] != nullptr;
    for (unsigned i = 0; i < in.mNumVertices; ++i) {
      glm::vec2 uv(0);
      if (in.HasTextureCoords(0))  // Assimp counts v upwards
        uv = {in.mTextureCoords[0][i].x, 1 - in.mTextureCoords[0][i].y};
      if (!std::isfinite(uv.x + uv.y)) uv = {0, 0};
      Rgb tint{1, 1, 1};
      if (in.mColors[0]) tint = {in.mColors[0][i].r, in.mColors[0][i].g, in.mColors[0][i].b};
      const Rgb mean = means_.albedo(material, {uv, uv}, in.mNumVertices);
      out_.mesh.albedo.push_back(clamped_albedo(mean * tint, material.base_colour));
      surface_.material.push_back(place);
      surface_.coordinates[0].push_back(uv);
      surface_.tint.push_back(clamped_albedo(tint, {1, 1, 1}));
    }
  }

  void add_triangles(const aiMesh& in, std::uint32_t first, bool mirrored) {
    const auto& p = out_.mesh.positions;
    for (unsigned f = 0; f < in.mNumFaces; ++f) {
      const aiFace& face = in.mFaces[f];
      if (face.mNumIndices != 3) continue;  // points and lines carry no surface
      std::array<std::uint32_t, 3> t{first + face.mIndices[0], first + face.mIndices[1],
                                     first + face.mIndices[2]};
      if (std::ranges::any_of(t, [&](auto i) { return i >= p.size(); })) continue;
      if (mirrored) std::swap(t[1], t[2]);
      const glm::vec3 e1 = p[t[1]] - p[t[0]], e2 = p[t[2]] - p[t[0]];
      // Relative to the edges, so that small models keep their triangles.
      if (glm::length(glm::cross(e1, e2)) <= 1e-7f * glm::length(e1) * glm::length(e2)) {
        ++out_.degenerate_triangles;
        continue;
      }
      out_.mesh.triangles.push_back(t);
    }
  }

  const aiScene& scene_;
  std::string file_;
  AssimpMaterials materials_;
  gltf::MeanColours means_;
  SurfaceMaterials surface_;
  bool any_tint_ = false;
  Import out_;
};

}  // namespace

Result<Import> import_mesh(const std::filesystem::path& path, Rgb default_albedo) {
  const std::string file = path.string();
  try {
    if (gltf::is_gltf(path)) return gltf::import_file(path, default_albedo);
    Assimp::Importer importer;
    PENUMBRA_ASSIGN(scene, open_scene(importer, path));
    return SceneImport(*scene, path, default_albedo).run();
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnreadable, file, reason_of(e));
  }
}

}  // namespace penumbra::prt
