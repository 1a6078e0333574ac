#include <assimp/postprocess.h>
#include <assimp/scene.h>
#include <fmt/format.h>

#include <algorithm>
#include <assimp/Importer.hpp>
#include <cctype>
#include <cmath>
#include <fstream>
#include <glm/geometric.hpp>
#include <map>
#include <string_view>

#include "prt/prt.h"

namespace penumbra::prt {

namespace {

// Assimp invents materials for files that have none: by a name of its own, or nameless in white or
// .6 grey.
bool is_own_material(const aiMaterial* material) {
  if (material == nullptr) return false;
  aiString name;
  if (material->Get(AI_MATKEY_NAME, name) == AI_SUCCESS && name.length > 0)
    return std::string_view(name.C_Str()) != AI_DEFAULT_MATERIAL_NAME;
  aiColor4D c;
  if (material->Get(AI_MATKEY_BASE_COLOR, c) != AI_SUCCESS &&
      material->Get(AI_MATKEY_COLOR_DIFFUSE, c) != AI_SUCCESS)
    return false;
  const bool grey = c.r == c.g && c.g == c.b;
  return !(grey && (c.r == 1 || std::abs(c.r - .6f) < 1e-3f));
}

Rgb clamped_albedo(Rgb a, Rgb fallback) {
  for (int k = 0; k < 3; ++k) a[k] = std::isfinite(a[k]) ? std::clamp(a[k], 0.f, 1.f) : fallback[k];
  return a;
}

Rgb albedo_of(const aiMaterial* material, Rgb fallback, bool has_own) {
  if (!has_own || material == nullptr) return fallback;
  aiColor4D colour;
  if (material->Get(AI_MATKEY_BASE_COLOR, colour) == AI_SUCCESS ||
      material->Get(AI_MATKEY_COLOR_DIFFUSE, colour) == AI_SUCCESS)
    return clamped_albedo({colour.r, colour.g, colour.b}, fallback);
  return fallback;
}

// Beyond, areas leave the range of floats.
constexpr float kFarthest = 1e9f;

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
      return fail(ErrorCode::kInvalid, file,
                  fmt::format("vertex {} of mesh \"{}\" lies {:.2g} units away, more than {:.0g}",
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
    const aiMaterial* material =
        mesh.mMaterialIndex < scene.mNumMaterials ? scene.mMaterials[mesh.mMaterialIndex] : nullptr;
    const Rgb albedo = albedo_of(material, default_albedo, is_own_material(material));
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
  using Key = std::array<float, 9>;
  std::map<Key, std::uint32_t> known;
  Mesh out;
  for (auto& t : mesh.triangles)
    for (auto& i : t) {
      const glm::vec3 &p = mesh.positions[i], &n = mesh.normals[i];
      const Rgb& a = mesh.albedo[i];
      const auto [found, fresh] =
          known.try_emplace(Key{p.x, p.y, p.z, n.x, n.y, n.z, a.r, a.g, a.b},
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

// Assimp's PLY reader never returns from a text header without its end, and reads one triangle of a strip.
Result<void> check_ply(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::string head(1 << 16, '\0');
  in.read(head.data(), static_cast<std::streamsize>(head.size()));
  head.resize(static_cast<std::size_t>(in.gcount()));
  if (!head.starts_with("ply")) return {};
  const std::size_t end = head.find("end_header");
  if (end == std::string::npos)
    return fail(ErrorCode::kUnreadable, path.string(), "its PLY header has no end");
  if (head.find("element tristrips") < end)
    return fail(ErrorCode::kInvalid, path.string(),
                "holds triangle strips, which are not read; save it with faces");
  return {};
}

// Other kinds that Assimp knows end the process on a damaged file: Debian builds it with assertions
// on.
constexpr std::string_view kKinds[] = {".gltf", ".glb", ".obj", ".ply", ".stl", ".fbx", ".dae"};

}  // namespace

Result<Import> import_mesh(const std::filesystem::path& path, Rgb default_albedo) {
  const std::string file = path.string();
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error))
    return fail(ErrorCode::kNotFound, file,
                std::filesystem::exists(path, error) ? "not a file" : "no such file");
  PENUMBRA_TRY(check_ply(path));
  std::string kind = path.extension().string();
  std::ranges::transform(kind, kind.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (std::ranges::find(kKinds, kind) == std::end(kKinds))
    return fail(ErrorCode::kInvalid, file,
                "not a kind that is read: glTF, OBJ, PLY, STL, FBX or COLLADA");
  try {
    Assimp::Importer importer;
    // Wide smoothing angle: scanned meshes come without normals and are smooth.
    importer.SetPropertyFloat(AI_CONFIG_PP_GSN_MAX_SMOOTHING_ANGLE, 80.f);
    const aiScene* scene = importer.ReadFile(
        file, aiProcess_Triangulate | aiProcess_GenSmoothNormals | aiProcess_SortByPType);
    if (scene == nullptr || scene->mRootNode == nullptr)
      return fail(ErrorCode::kUnreadable, file, importer.GetErrorString());
    Import out;
    PENUMBRA_TRY(add_node(*scene, *scene->mRootNode, aiMatrix4x4(), default_albedo, file, out));
    if (out.mesh.triangles.empty())
      return fail(
          ErrorCode::kInvalid, file,
          out.degenerate_triangles > 0 ? "all its triangles are degenerate" : "has no triangles");
    weld(out.mesh);
    return out;
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnreadable, file, e.what());
  }
}

}  // namespace penumbra::prt
