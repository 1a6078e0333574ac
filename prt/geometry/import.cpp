#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <map>

#include "prt/geometry/internal/assimp_scene.h"
#include "prt/geometry/mesh.h"

namespace penumbra::prt {

namespace {

Result<void> add_vertices(const aiMesh& in, const aiMatrix4x4& to_world, Rgb albedo,
                          const std::string& file, Mesh& out) {
  aiMatrix3x3 normal_matrix(to_world);
  normal_matrix.Inverse().Transpose();
  for (unsigned i = 0; i < in.mNumVertices; ++i) {
    const aiVector3D p = to_world * in.mVertices[i];
    aiVector3D n = in.mNormals ? normal_matrix * in.mNormals[i] : aiVector3D(0, 1, 0);
    if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z))
      return fail(ErrorCode::kNonFinite, file,
                  fmt::format("vertex {} of mesh \"{}\" is not finite", i, in.mName.C_Str()));
    if (std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) > kFarthest)
      return fail(
          ErrorCode::kInvalid, file,
          fmt::format(
              "vertex {} of mesh \"{}\" is {:.2g} units from the origin, and {:.0g} are the limit",
              i, in.mName.C_Str(), p.Length(), kFarthest));
    if (!std::isfinite(n.x + n.y + n.z) || n.SquareLength() < 1e-20f) n = aiVector3D(0, 1, 0);
    n.Normalize();
    out.positions.emplace_back(p.x, p.y, p.z);
    out.normals.emplace_back(n.x, n.y, n.z);
    Rgb a = albedo;
    if (in.mColors[0]) a = a * Rgb{in.mColors[0][i].r, in.mColors[0][i].g, in.mColors[0][i].b};
    out.albedo.push_back(clamped_albedo(a, albedo));
  }
  return {};
}

void add_triangles(const aiMesh& in, std::uint32_t first, Import& out) {
  const auto& p = out.mesh.positions;
  for (unsigned f = 0; f < in.mNumFaces; ++f) {
    const aiFace& face = in.mFaces[f];
    if (face.mNumIndices != 3) continue;  // points and lines carry no surface
    const std::array<std::uint32_t, 3> t{first + face.mIndices[0], first + face.mIndices[1],
                                         first + face.mIndices[2]};
    if (std::ranges::any_of(t, [&](auto i) { return i >= p.size(); })) continue;
    const glm::vec3 e1 = p[t[1]] - p[t[0]], e2 = p[t[2]] - p[t[0]];
    // Relative to the edges, so that small models keep their triangles.
    if (glm::length(glm::cross(e1, e2)) <= 1e-7f * glm::length(e1) * glm::length(e2)) {
      ++out.degenerate_triangles;
      continue;
    }
    out.mesh.triangles.push_back(t);
  }
}

Result<void> add_node(const aiScene& scene, const aiNode& node, const aiMatrix4x4& to_parent,
                      Rgb default_albedo, const std::string& file, Import& out) {
  const aiMatrix4x4 to_world = to_parent * node.mTransformation;
  for (unsigned i = 0; i < node.mNumMeshes; ++i) {
    const aiMesh& mesh = *scene.mMeshes[node.mMeshes[i]];
    const Rgb albedo = albedo_of(scene, mesh, default_albedo);
    const auto first = static_cast<std::uint32_t>(out.mesh.positions.size());
    PENUMBRA_TRY(add_vertices(mesh, to_world, albedo, file, out.mesh));
    add_triangles(mesh, first, out);
  }
  for (unsigned i = 0; i < node.mNumChildren; ++i)
    PENUMBRA_TRY(add_node(scene, *node.mChildren[i], to_world, default_albedo, file, out));
  return {};
}

// Equal vertices become one, to the bit (Assimp's own joining merges what lies within 1e-5 of a
// unit, which destroys small models); vertices that no triangle uses would be baked for nothing.
void weld(Mesh& mesh) {
  using VertexKey = std::array<float, 9>;
  std::map<VertexKey, std::uint32_t> known;
  Mesh out;
  for (auto& t : mesh.triangles)
    for (auto& i : t) {
      const glm::vec3 &p = mesh.positions[i], &n = mesh.normals[i];
      const Rgb& a = mesh.albedo[i];
      const auto [found, fresh] =
          known.try_emplace(VertexKey{p.x, p.y, p.z, n.x, n.y, n.z, a.r, a.g, a.b},
                            static_cast<std::uint32_t>(out.positions.size()));
      if (fresh) {
        out.positions.push_back(p);
        out.normals.push_back(n);
        out.albedo.push_back(a);
      }
      i = found->second;
    }
  out.triangles = std::move(mesh.triangles);
  mesh = std::move(out);
}

}  // namespace

Result<Import> import_mesh(const std::filesystem::path& path, Rgb default_albedo) {
  const std::string file = path.string();
  try {
    Assimp::Importer importer;
    PENUMBRA_ASSIGN(scene, open_scene(importer, path));
    Import out;
    PENUMBRA_TRY(add_node(*scene, *scene->mRootNode, aiMatrix4x4(), default_albedo, file, out));
    if (out.mesh.triangles.empty())
      return fail(
          ErrorCode::kInvalid, file,
          out.degenerate_triangles > 0 ? "has only degenerate triangles" : "has no triangles");
    weld(out.mesh);
    return out;
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnreadable, file, e.what());
  }
}

}  // namespace penumbra::prt
