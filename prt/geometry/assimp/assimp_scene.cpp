#include "prt/geometry/internal/assimp_scene.h"

#include <assimp/DefaultIOSystem.h>
#include <assimp/MemoryIOWrapper.h>
#include <assimp/postprocess.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <deque>
#include <fstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/io/files.h"
#include "prt/geometry/gltf/gltf.h"

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

}  // namespace

Rgb clamped_albedo(Rgb a, Rgb fallback) {
  for (int k = 0; k < 3; ++k) a[k] = std::isfinite(a[k]) ? std::clamp(a[k], 0.f, 1.f) : fallback[k];
  return a;
}

Rgb albedo_of(const aiScene& scene, const aiMesh& mesh, Rgb fallback) {
  const aiMaterial* const material =
      mesh.mMaterialIndex < scene.mNumMaterials ? scene.mMaterials[mesh.mMaterialIndex] : nullptr;
  if (!is_own_material(material)) return fallback;
  aiColor4D colour;
  if (material->Get(AI_MATKEY_BASE_COLOR, colour) == AI_SUCCESS ||
      material->Get(AI_MATKEY_COLOR_DIFFUSE, colour) == AI_SUCCESS)
    return clamped_albedo({colour.r, colour.g, colour.b}, fallback);
  return fallback;
}

namespace {

// Assimp's PLY reader never returns from a text header without its end, and reads one triangle of a
// strip.
Result<void> check_ply(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::string head(1 << 16, '\0');
  in.read(head.data(), static_cast<std::streamsize>(head.size()));
  head.resize(static_cast<std::size_t>(in.gcount()));
  if (!head.starts_with("ply")) return {};
  const std::size_t end = head.find("end_header");
  if (end == std::string::npos)
    return fail(ErrorCode::kUnreadable, path.string(), "has a PLY header without an end");
  if (head.find("element tristrips") < end)
    return fail(ErrorCode::kInvalid, path.string(),
                "has triangle strips, which are not supported: save it with faces");
  return {};
}

// Assimp reads no number that begins with its point, such as -.15 in an OBJ file.
std::string with_leading_zeros(std::string_view text) {
  constexpr std::string_view kNames = "mugon#";  // lines of these hold names of files and groups
  std::string out;
  out.reserve(text.size());
  const auto is_space = [](char c) { return c == ' ' || c == '\t'; };
  char first = '\n', before = '\n', one_more = '\n';
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (before == '\n' && !is_space(c)) first = c;
    const bool begins =
        is_space(before) || ((before == '-' || before == '+') && is_space(one_more));
    const bool digit_follows = i + 1 < text.size() && text[i + 1] >= '0' && text[i + 1] <= '9';
    if (c == '.' && begins && digit_follows && kNames.find(first) == std::string_view::npos)
      out += '0';
    out += c;
    one_more = std::exchange(before, c);
  }
  return out;
}

// Hands out an OBJ file and its materials as Assimp can read them.
class ObjFiles : public Assimp::DefaultIOSystem {
 public:
  Assimp::IOStream* Open(const char* file, const char*) override {
    const auto text = read_text(file);
    if (!text) return nullptr;
    texts_.push_back(with_leading_zeros(*text));
    return new Assimp::MemoryIOStream(reinterpret_cast<const std::uint8_t*>(texts_.back().data()),
                                      texts_.back().size());
  }

 private:
  std::deque<std::string> texts_;  // as long as Assimp may read them
};

// Hands out a glTF file as Assimp can read it; what it names, as it is.
class GltfFiles : public Assimp::DefaultIOSystem {
 public:
  GltfFiles(std::string file, std::vector<unsigned char> bytes)
      : file_(std::move(file)), bytes_(std::move(bytes)) {}
  Assimp::IOStream* Open(const char* file, const char* mode) override {
    if (file_ != file) return DefaultIOSystem::Open(file, mode);
    return new Assimp::MemoryIOStream(bytes_.data(), bytes_.size());
  }

 private:
  const std::string file_;
  const std::vector<unsigned char> bytes_;
};

// Other kinds that Assimp knows end the process on a damaged file: Debian builds it with assertions
// on.
constexpr std::string_view kKinds[] = {".gltf", ".glb", ".obj", ".ply", ".stl", ".fbx", ".dae"};

}  // namespace

Result<const aiScene*> open_scene(Assimp::Importer& importer, const std::filesystem::path& path) {
  const std::string file = path.string();
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error))
    return fail(ErrorCode::kNotFound, file,
                std::filesystem::exists(path, error) ? "is not a file" : "no such file");
  PENUMBRA_TRY(check_ply(path));
  std::string kind = path.extension().string();
  std::ranges::transform(kind, kind.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (std::ranges::find(kKinds, kind) == std::end(kKinds))
    return fail(ErrorCode::kInvalid, file,
                "is none of the mesh formats glTF, OBJ, PLY, STL, FBX and COLLADA");
  if (kind == ".obj") importer.SetIOHandler(new ObjFiles);  // which the importer owns
  if (gltf::is_gltf(path)) {
    PENUMBRA_ASSIGN(bytes, gltf::clip_file_bytes(path));
    importer.SetIOHandler(new GltfFiles(file, std::move(bytes)));
  }
  // Wide smoothing angle: scanned meshes come without normals and are smooth.
  importer.SetPropertyFloat(AI_CONFIG_PP_GSN_MAX_SMOOTHING_ANGLE, 80.f);
  const aiScene* scene = importer.ReadFile(
      file, aiProcess_Triangulate | aiProcess_GenSmoothNormals | aiProcess_SortByPType);
  if (scene == nullptr || scene->mRootNode == nullptr)
    return fail(ErrorCode::kUnreadable, file, importer.GetErrorString());
  return scene;
}

}  // namespace penumbra::prt
