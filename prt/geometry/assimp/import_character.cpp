#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <span>

#include "codec/codec.h"
#include "codec/display.h"
#include "core/exceptions.h"
#include "core/io/files.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/gltf/gltf.h"
#include "prt/geometry/gltf/internal/materials.h"
#include "prt/geometry/internal/assimp_scene.h"

namespace penumbra::prt {

namespace {

constexpr std::size_t kMaxBones = 65535;

glm::vec3 to_glm(const aiVector3D& v) {
  return {v.x, v.y, v.z};
}
glm::quat to_glm(const aiQuaternion& q) {
  const glm::quat out(q.w, q.x, q.y, q.z);
  return glm::length(out) > 1e-12f ? glm::normalize(out) : glm::quat(1, 0, 0, 0);
}
glm::mat4 to_glm(const aiMatrix4x4& m) {  // Assimp's are row-major
  return {{m.a1, m.b1, m.c1, m.d1},
          {m.a2, m.b2, m.c2, m.d2},
          {m.a3, m.b3, m.c3, m.d3},
          {m.a4, m.b4, m.c4, m.d4}};
}
bool finite(const glm::vec3& v) {
  return std::isfinite(v.x + v.y + v.z);
}
bool finite(const glm::quat& q) {
  return std::isfinite(q.x + q.y + q.z + q.w);
}
bool finite(float v) {
  return std::isfinite(v);
}

// A texture's albedo as coarse as vertices can show it: each texel a mean, so that no vertex picks
// a single speck.
class CoarseTexture {
 public:
  CoarseTexture(const FramePixels& pixels, std::size_t vertices) {
    std::visit([&](const auto& p) { reduce(p, vertices); }, pixels);
  }
  Rgb at(glm::vec2 uv) const {
    const auto wrap = [](float t, int size) {
      const float inside = t - std::floor(t);
      return std::clamp(static_cast<int>(inside * static_cast<float>(size)), 0, size - 1);
    };
    return image_.at(wrap(uv.x, image_.width()), wrap(uv.y, image_.height()));
  }

 private:
  template <class Pixel>
  void reduce(const Image<Pixel>& in, std::size_t vertices) {
    // A few texels a vertex, since charts leave part of the picture empty.
    const double wanted = 8. * static_cast<double>(vertices);
    const int step =
        std::max(1, static_cast<int>(std::sqrt(static_cast<double>(in.area()) / wanted)));
    image_ = Image<Rgb>((in.width() + step - 1) / step, (in.height() + step - 1) / step);
    for (int y = 0; y < image_.height(); ++y)
      for (int x = 0; x < image_.width(); ++x) {
        Rgb sum;
        float count = 0;
        for (int j = y * step; j < std::min((y + 1) * step, in.height()); ++j)
          for (int i = x * step; i < std::min((x + 1) * step, in.width()); ++i, ++count)
            sum += linear(in.at(i, j));
        image_.at(x, y) = sum * (1 / count);
      }
  }
  static Rgb linear(const Rgb8& c) {
    return {codec::linear_from_srgb(float(c.r) / 255), codec::linear_from_srgb(float(c.g) / 255),
            codec::linear_from_srgb(float(c.b) / 255)};
  }
  static Rgb linear(const Rgb16& c) {
    return {codec::linear_from_srgb(float(c.r) / 65535),
            codec::linear_from_srgb(float(c.g) / 65535),
            codec::linear_from_srgb(float(c.b) / 65535)};
  }
  static Rgb linear(const Rgb& c) { return c; }

  Image<Rgb> image_;
};

class Importer {
 public:
  Importer(const aiScene& scene, std::filesystem::path path, Rgb fallback)
      : scene_(scene), path_(std::move(path)), file_(path_.string()), fallback_(fallback) {}

  /// Of a glTF file, in its order, which Assimp keeps.
  void take_materials(std::vector<Material> materials) {
    materials_ = std::move(materials);
    of_file_ = materials_.size();
  }

  Result<Character> run() {
    PENUMBRA_TRY(add_node(*scene_.mRootNode, -1));
    PENUMBRA_TRY(add_meshes(*scene_.mRootNode));
    if (out_.triangles.empty())
      return fail(
          ErrorCode::kInvalid, file_,
          out_.degenerate_triangles > 0 ? "has only degenerate triangles" : "has no triangles");
    if (out_.bones.size() > kMaxBones)
      return fail(ErrorCode::kInvalid, file_,
                  fmt::format("has {} bones, and {} are the limit", out_.bones.size(), kMaxBones));
    keep_surface();
    if (!one_texture_ || out_.surface) out_.texture.reset();
    if (!out_.texture) out_.tint.clear();
    for (unsigned i = 0; i < scene_.mNumAnimations; ++i)
      PENUMBRA_TRY(add_clip(*scene_.mAnimations[i], i));
    return std::move(out_);
  }

 private:
  Result<void> add_node(const aiNode& node, int parent) {
    aiVector3D scale, position;
    aiQuaternion rotation;
    node.mTransformation.Decompose(scale, rotation, position);
    const NodePose rest{to_glm(position), to_glm(rotation), to_glm(scale)};
    if (!finite(rest.translation) || !finite(rest.rotation) || !finite(rest.scale))
      return fail(
          ErrorCode::kNonFinite, file_,
          fmt::format("node \"{}\" has a transform that is not finite", node.mName.C_Str()));
    const int index = static_cast<int>(out_.nodes.size());
    out_.nodes.push_back({node.mName.C_Str(), parent, rest});
    by_name_.try_emplace(node.mName.C_Str(), index);
    by_node_[&node] = index;
    for (unsigned i = 0; i < node.mNumChildren; ++i)
      PENUMBRA_TRY(add_node(*node.mChildren[i], index));
    return {};
  }

  Result<void> add_meshes(const aiNode& node) {
    for (unsigned i = 0; i < node.mNumMeshes; ++i)
      PENUMBRA_TRY(add_mesh(*scene_.mMeshes[node.mMeshes[i]], by_node_.at(&node)));
    for (unsigned i = 0; i < node.mNumChildren; ++i) PENUMBRA_TRY(add_meshes(*node.mChildren[i]));
    return {};
  }

  Result<void> add_mesh(const aiMesh& in, int node) {
    const std::size_t first = out_.positions.size();
    add_surface(in);
    PENUMBRA_TRY(add_vertices(in));
    PENUMBRA_TRY(in.HasBones() ? add_skin(in, first) : add_rigid(in, node));
    add_triangles(in, first, !in.HasBones() && is_mirrored(node));
    return add_morph_targets(in, node, first);
  }

  Result<void> add_vertices(const aiMesh& in) {
    const Rgb albedo = colour_of(in);
    const auto pixels = texture_of(in);
    std::optional<CoarseTexture> texture;
    if (pixels) texture.emplace(*pixels, in.mNumVertices);
    for (unsigned i = 0; i < in.mNumVertices; ++i) {
      const glm::vec3 p = to_glm(in.mVertices[i]);
      glm::vec3 n = in.mNormals ? to_glm(in.mNormals[i]) : glm::vec3(0, 1, 0);
      if (!finite(p) || std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) > kFarthest)
        return fail(
            ErrorCode::kNonFinite, file_,
            fmt::format(
                "vertex {} of mesh \"{}\" is not finite, or more than {:.0g} units from the origin",
                i, in.mName.C_Str(), kFarthest));
      if (!finite(n) || glm::length(n) < 1e-10f) n = {0, 1, 0};
      out_.positions.push_back(p);
      out_.normals.push_back(glm::normalize(n));
      glm::vec2 uv(0);
      if (in.HasTextureCoords(0))  // Assimp counts v upwards
        uv = {in.mTextureCoords[0][i].x, 1 - in.mTextureCoords[0][i].y};
      if (!std::isfinite(uv.x + uv.y)) uv = {0, 0};
      out_.texture_coordinates.push_back(uv);
      Rgb a = texture ? albedo * texture->at(in_picture(in, i, uv)) : albedo;
      Rgb tint = albedo;
      if (in.mColors[0]) {
        const Rgb colour{in.mColors[0][i].r, in.mColors[0][i].g, in.mColors[0][i].b};
        a = a * colour;
        tint = tint * colour;
      }
      out_.albedo.push_back(clamped_albedo(a, albedo));
      out_.tint.push_back(clamped_albedo(tint, albedo));
    }
    return {};
  }

  // Where a vertex lies in the picture of its base colour. uv: of the first coordinates
  glm::vec2 in_picture(const aiMesh& in, unsigned vertex, glm::vec2 uv) const {
    if (in.mMaterialIndex >= of_file_) return uv;
    const Texture& map = materials_[in.mMaterialIndex].base_colour_map;
    const auto set = static_cast<unsigned>(map.set);
    if (set > 0 && in.HasTextureCoords(set)) {
      const aiVector3D& at = in.mTextureCoords[set][vertex];
      if (std::isfinite(at.x + at.y)) uv = {at.x, 1 - at.y};
    }
    return map.transform * glm::vec3(uv, 1);
  }

  // Assimp takes a white material of a glTF file for none.
  Rgb colour_of(const aiMesh& in) const {
    if (of_file_ == 0) return albedo_of(scene_, in, fallback_);
    if (in.mMaterialIndex >= of_file_) return fallback_;
    const Material& m = materials_[in.mMaterialIndex];
    return clamped_albedo(m.base_colour, m.base_colour);
  }

  // Before the mesh's vertices are added.
  void add_surface(const aiMesh& in) {
    if (materials_.empty()) return;
    // Assimp's own material of what has none comes after the file's.
    if (in.mMaterialIndex >= of_file_ && materials_.size() == of_file_)
      materials_.emplace_back().base_colour = fallback_;
    const auto place =
        static_cast<std::uint16_t>(std::min<std::size_t>(in.mMaterialIndex, of_file_));
    surface_.material.insert(surface_.material.end(), in.mNumVertices, place);
    for (unsigned i = 0; i < in.mNumVertices; ++i)
      for (unsigned set = 0; set < 2; ++set) {
        glm::vec2 uv(0);
        if (in.HasTextureCoords(set))
          uv = {in.mTextureCoords[set][i].x, 1 - in.mTextureCoords[set][i].y};
        surface_.coordinates[set].push_back(std::isfinite(uv.x + uv.y) ? uv : glm::vec2(0));
        if (set == 1) continue;
        const aiColor4D* const c = in.mColors[0];
        surface_.tint.push_back(c ? clamped_albedo({c[i].r, c[i].g, c[i].b}, {1, 1, 1})
                                  : Rgb{1, 1, 1});
      }
  }

  // One that is laid as Character::texture is.
  static bool is_laid_plainly(const Texture& t) {
    using enum Texture::Wrap;
    return t.set == 0 && t.transform == Texture{}.transform && t.wrap_s == kRepeat &&
           t.wrap_t == kRepeat && !t.nearest;
  }

  // One base colour map that is laid plainly, or none, is drawn without.
  void keep_surface() {
    if (surface_.material.empty()) return;
    bool asked = !one_texture_;
    for (const std::uint16_t place : std::set(surface_.material.begin(), surface_.material.end())) {
      Material& m = materials_[place];
      if (m.normal_map)
        out_.left_out.push_back(
            fmt::format("material \"{}\": its normal map is left out, as it moves", m.name));
      m.normal_map = {};
      Material beyond = m;
      if (is_laid_plainly(beyond.base_colour_map)) beyond.base_colour_map = {};
      asked |= !gltf::is_plain(beyond);
    }
    if (!asked) return;
    surface_.materials = std::move(materials_);
    out_.surface = std::make_shared<const SurfaceMaterials>(std::move(surface_));
  }

  // None where the material has none, or it cannot be read: the material's factor is what remains.
  std::optional<FramePixels> texture_of(const aiMesh& in) {
    const auto name = texture_name(in);
    note_texture(name);
    if (!name) return {};
    if (const aiTexture* embedded = scene_.GetEmbeddedTexture(name->c_str())) {
      if (embedded->mHeight != 0) return {};  // uncompressed, which no exporter writes
      const auto* bytes = reinterpret_cast<const unsigned char*>(embedded->pcData);
      return keep(codec::decode_frame({bytes, embedded->mWidth}, file_));
    }
    return keep(codec::read_frame(path_.parent_path() / *name));
  }

  std::optional<std::string> texture_name(const aiMesh& in) const {
    if (in.mMaterialIndex >= scene_.mNumMaterials || !in.HasTextureCoords(0)) return {};
    const aiMaterial& material = *scene_.mMaterials[in.mMaterialIndex];
    aiString name;
    if (material.GetTexture(aiTextureType_BASE_COLOR, 0, &name) != AI_SUCCESS &&
        material.GetTexture(aiTextureType_DIFFUSE, 0, &name) != AI_SUCCESS)
      return {};
    return name.C_Str();
  }

  // One picture is drawn as it is where it serves all meshes.
  void note_texture(const std::optional<std::string>& name) {
    const std::string known = name.value_or("");
    one_texture_ &= !texture_name_ || *texture_name_ == known;
    texture_name_ = known;
  }

  std::optional<FramePixels> keep(Result<FramePixels> pixels) {
    if (!pixels) return {};
    if (const auto* codes = std::get_if<Image<Rgb8>>(&*pixels))
      out_.texture = std::make_shared<const Image<Rgb8>>(*codes);
    return std::move(*pixels);
  }

  Result<void> add_rigid(const aiMesh& in, int node) {
    const auto bone = static_cast<std::uint16_t>(std::min(out_.bones.size(), kMaxBones));
    out_.bones.push_back({node, glm::mat4(1)});
    out_.influences.insert(out_.influences.end(), in.mNumVertices, {{bone}, {1}});
    return {};
  }

  Result<void> add_skin(const aiMesh& in, std::size_t first) {
    const std::size_t first_bone = out_.bones.size();
    std::vector<std::vector<std::pair<float, std::uint16_t>>> fractions(in.mNumVertices);
    for (unsigned b = 0; b < in.mNumBones; ++b) {
      const aiBone& bone = *in.mBones[b];
      const auto node = by_name_.find(bone.mName.C_Str());
      if (node == by_name_.end())
        return fail(ErrorCode::kInvalid, file_,
                    fmt::format("has no node for joint \"{}\"", bone.mName.C_Str()));
      const auto index = static_cast<std::uint16_t>(std::min(out_.bones.size(), kMaxBones));
      out_.bones.push_back({node->second, to_glm(bone.mOffsetMatrix)});
      for (unsigned w = 0; w < bone.mNumWeights; ++w) {
        const aiVertexWeight& weight = bone.mWeights[w];
        if (weight.mVertexId >= in.mNumVertices || !(weight.mWeight > 0) ||
            !std::isfinite(weight.mWeight))
          continue;
        fractions[weight.mVertexId].emplace_back(weight.mWeight, index);
      }
    }
    for (auto& s : fractions) {
      std::ranges::stable_sort(s, std::ranges::greater(), &std::pair<float, std::uint16_t>::first);
      if (s.size() > Character::kInfluences) s.resize(Character::kInfluences);
      if (s.empty()) {
        ++out_.unbound_vertices;
        s.emplace_back(1.f, static_cast<std::uint16_t>(first_bone));
      }
      float sum = 0;
      for (const auto& [weight, bone] : s) sum += weight;
      Character::Influence f;
      for (std::size_t k = 0; k < s.size(); ++k)
        f.weight[k] = s[k].first / sum, f.bone[k] = s[k].second;
      out_.influences.push_back(f);
    }
    return out_.influences.size() == first + in.mNumVertices
               ? Result<void>{}
               : fail(ErrorCode::kInvalid, file_,
                      "has a different number of skin weights and vertices");
  }

  // Its triangles are seen from their other sides.
  bool is_mirrored(int node) const {
    bool out = false;
    for (int at = node; at >= 0; at = out_.nodes[static_cast<std::size_t>(at)].parent) {
      const glm::vec3& s = out_.nodes[static_cast<std::size_t>(at)].rest.scale;
      out ^= s.x * s.y * s.z < 0;
    }
    return out;
  }

  void add_triangles(const aiMesh& in, std::size_t first, bool mirrored) {
    const auto& p = out_.positions;
    for (unsigned f = 0; f < in.mNumFaces; ++f) {
      const aiFace& face = in.mFaces[f];
      if (face.mNumIndices != 3) continue;
      std::array<std::uint32_t, 3> t;
      for (unsigned k = 0; k < 3; ++k) t[k] = static_cast<std::uint32_t>(first) + face.mIndices[k];
      if (std::ranges::any_of(t, [&](auto i) { return i >= p.size(); })) continue;
      const glm::vec3 e1 = p[t[1]] - p[t[0]], e2 = p[t[2]] - p[t[0]];
      if (glm::length(glm::cross(e1, e2)) <= 1e-7f * glm::length(e1) * glm::length(e2)) {
        ++out_.degenerate_triangles;
        continue;
      }
      if (mirrored) std::swap(t[1], t[2]);
      out_.triangles.push_back(t);
    }
  }

  Result<void> add_morph_targets(const aiMesh& in, int node, std::size_t first) {
    for (unsigned k = 0; k < in.mNumAnimMeshes; ++k) {
      const aiAnimMesh& with = *in.mAnimMeshes[k];
      if (with.mNumVertices != in.mNumVertices || !with.HasPositions()) continue;
      Character::MorphTarget target{with.mName.C_Str(), with.mWeight, first, {}, {}};
      for (unsigned i = 0; i < in.mNumVertices; ++i) {
        const glm::vec3 delta = to_glm(with.mVertices[i]) - to_glm(in.mVertices[i]);
        if (!finite(delta))
          return fail(ErrorCode::kNonFinite, file_,
                      fmt::format("vertex {} of morph target {} is not finite", i, k));
        target.positions.push_back(delta);
        if (!with.HasNormals() || !in.HasNormals()) continue;
        const glm::vec3 turn = to_glm(with.mNormals[i]) - to_glm(in.mNormals[i]);
        target.normals.push_back(finite(turn) ? turn : glm::vec3(0));
      }
      targets_[{node, k}].push_back(static_cast<int>(out_.morph_targets.size()));
      out_.morph_targets.push_back(std::move(target));
    }
    return {};
  }

  // Keys in order and finite; what is not is left out.
  template <class T, class In>
  Clip::Track<T> track(const In* keys, unsigned count, double seconds_per_tick,
                       double& last) const {
    Clip::Track<T> out;
    for (unsigned i = 0; i < count; ++i) {
      const double seconds = keys[i].mTime * seconds_per_tick;
      const T value = to_glm(keys[i].mValue);
      if (!std::isfinite(seconds) || !finite(value)) continue;
      out.push_back({std::max(seconds, 0.), value});
      last = std::max(last, seconds);
    }
    std::ranges::stable_sort(out, {}, &Clip::Key<T>::seconds);
    return out;
  }

  Result<void> add_clip(const aiAnimation& in, unsigned number) {
    const double tick = in.mTicksPerSecond > 0 ? 1 / in.mTicksPerSecond : 1. / 25;
    Clip clip;
    clip.name = in.mName.length > 0 ? in.mName.C_Str() : fmt::format("{}", number);
    for (unsigned i = 0; i < in.mNumChannels; ++i) {
      const aiNodeAnim& channel = *in.mChannels[i];
      const auto node = by_name_.find(channel.mNodeName.C_Str());
      if (node == by_name_.end()) continue;
      Clip::NodeTracks tracks{node->second, {}, {}, {}};
      tracks.translation =
          track<glm::vec3>(channel.mPositionKeys, channel.mNumPositionKeys, tick, clip.seconds);
      tracks.rotation =
          track<glm::quat>(channel.mRotationKeys, channel.mNumRotationKeys, tick, clip.seconds);
      tracks.scale =
          track<glm::vec3>(channel.mScalingKeys, channel.mNumScalingKeys, tick, clip.seconds);
      clip.nodes.push_back(std::move(tracks));
    }
    for (unsigned i = 0; i < in.mNumMorphMeshChannels; ++i)
      add_morph_tracks(*in.mMorphMeshChannels[i], tick, clip);
    out_.clips.push_back(std::move(clip));
    return {};
  }

  void add_morph_tracks(const aiMeshMorphAnim& channel, double tick, Clip& clip) const {
    const auto node = by_name_.find(channel.mName.C_Str());
    if (node == by_name_.end()) return;
    std::map<int, Clip::Track<float>> tracks;
    for (unsigned k = 0; k < channel.mNumKeys; ++k) {
      const aiMeshMorphKey& key = channel.mKeys[k];
      const double seconds = key.mTime * tick;
      if (!std::isfinite(seconds)) continue;
      clip.seconds = std::max(clip.seconds, seconds);
      for (unsigned v = 0; v < key.mNumValuesAndWeights; ++v) {
        const auto found = targets_.find({node->second, key.mValues[v]});
        const auto weight = static_cast<float>(key.mWeights[v]);
        if (found == targets_.end() || !finite(weight)) continue;
        for (const int target : found->second)
          tracks[target].push_back({std::max(seconds, 0.), weight});
      }
    }
    for (auto& [target, keys] : tracks) {
      std::ranges::stable_sort(keys, {}, &Clip::Key<float>::seconds);
      clip.morphs.push_back({target, std::move(keys)});
    }
  }

  const aiScene& scene_;
  std::filesystem::path path_;
  std::string file_;
  Rgb fallback_;
  Character out_;
  std::vector<Material> materials_;
  std::size_t of_file_ = 0;  // of them
  SurfaceMaterials surface_;
  std::optional<std::string> texture_name_;
  bool one_texture_ = true;
  std::map<std::string, int> by_name_;
  std::map<const aiNode*, int> by_node_;
  std::map<std::pair<int, unsigned>, std::vector<int>> targets_;  // by node and number
};

}  // namespace

Result<Character> import_character(const std::filesystem::path& path, Rgb default_albedo) {
  try {
    Assimp::Importer importer;
    PENUMBRA_ASSIGN(scene, open_scene(importer, path));
    Importer character(*scene, path, default_albedo);
    if (gltf::is_gltf(path)) {
      PENUMBRA_ASSIGN(bytes, read_bytes(path));
      PENUMBRA_ASSIGN(materials, gltf::read_materials(std::move(bytes), path));
      character.take_materials(std::move(materials));
    }
    return character.run();
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnreadable, path.string(), reason_of(e));
  }
}

}  // namespace penumbra::prt
