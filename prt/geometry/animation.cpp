#include "prt/geometry/animation.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <glm/gtc/matrix_inverse.hpp>

#include "prt/geometry/mesh.h"

namespace penumbra::prt {

namespace {

glm::vec3 between(const glm::vec3& a, const glm::vec3& b, float fraction) {
  return glm::mix(a, b, fraction);
}
glm::quat between(const glm::quat& a, const glm::quat& b, float fraction) {
  return glm::normalize(glm::slerp(a, b, fraction));  // on the shorter arc
}
float between(float a, float b, float fraction) {
  return std::lerp(a, b, fraction);
}

template <class T>
void set_from(const Clip::Track<T>& track, double seconds, T& value) {
  if (track.empty()) return;
  const auto after = std::ranges::upper_bound(track, seconds, {}, &Clip::Key<T>::seconds);
  if (after == track.begin()) {
    value = track.front().value;
  } else if (after == track.end()) {
    value = track.back().value;
  } else {
    const Clip::Key<T>&a = *(after - 1), &b = *after;
    const double span = b.seconds - a.seconds;
    value = between(a.value, b.value,
                    span > 0 ? static_cast<float>((seconds - a.seconds) / span) : 1.f);
  }
}

glm::mat4 matrix_of(const NodePose& p) {
  glm::mat4 m(glm::mat3_cast(p.rotation));
  for (int c = 0; c < 3; ++c) m[c] *= p.scale[c];
  m[3] = glm::vec4(p.translation, 1);
  return m;
}

// From each bone's rest frame to the character's.
void bone_matrices(const Character& c, const CharacterPose& pose, std::vector<glm::mat4>& out) {
  thread_local std::vector<glm::mat4> nodes;  // grows once per thread
  nodes.resize(c.nodes.size());
  for (std::size_t i = 0; i < c.nodes.size(); ++i) {
    const int parent = c.nodes[i].parent;
    nodes[i] =
        (parent < 0 ? c.frame : nodes[static_cast<std::size_t>(parent)]) * matrix_of(pose.nodes[i]);
  }
  out.resize(c.bones.size());
  for (std::size_t i = 0; i < c.bones.size(); ++i)
    out[i] = nodes[static_cast<std::size_t>(c.bones[i].node)] * c.bones[i].bone_from_rest;
}

// Determinant times inverse transpose: turns normals right under any scale, and needs no division.
glm::mat3 cofactors(const glm::mat3& m) {
  return {glm::cross(m[1], m[2]), glm::cross(m[2], m[0]), glm::cross(m[0], m[1])};
}

void add_morphs(const Character& c, const CharacterPose& pose, Mesh& out) {
  for (std::size_t k = 0; k < c.morph_targets.size(); ++k) {
    const float w = pose.morph_weights[k];
    if (w == 0) continue;
    const Character::MorphTarget& target = c.morph_targets[k];
    for (std::size_t i = 0; i < target.positions.size(); ++i)
      out.positions[target.first + i] += w * target.positions[i];
    for (std::size_t i = 0; i < target.normals.size(); ++i)
      out.normals[target.first + i] += w * target.normals[i];
  }
}

}  // namespace

CharacterPose rest_pose(const Character& character) {
  CharacterPose pose;
  for (const Character::Node& node : character.nodes) pose.nodes.push_back(node.rest);
  for (const Character::MorphTarget& target : character.morph_targets)
    pose.morph_weights.push_back(target.rest_weight);
  return pose;
}

CharacterPose sample(const Character& character, const Clip& clip, double seconds) {
  CharacterPose pose = rest_pose(character);
  if (clip.seconds > 0) {
    seconds = std::fmod(seconds, clip.seconds);
    if (seconds < 0) seconds += clip.seconds;
  }
  for (const Clip::NodeTracks& tracks : clip.nodes) {
    NodePose& node = pose.nodes[static_cast<std::size_t>(tracks.node)];
    set_from(tracks.translation, seconds, node.translation);
    set_from(tracks.rotation, seconds, node.rotation);
    set_from(tracks.scale, seconds, node.scale);
  }
  for (const Clip::MorphTrack& track : clip.morphs)
    set_from(track.weight, seconds, pose.morph_weights[static_cast<std::size_t>(track.target)]);
  return pose;
}

CharacterPose blend(const CharacterPose& a, const CharacterPose& b, float fraction) {
  CharacterPose out = a;
  for (std::size_t i = 0; i < out.nodes.size(); ++i) {
    NodePose& n = out.nodes[i];
    n.translation = between(n.translation, b.nodes[i].translation, fraction);
    n.rotation = between(n.rotation, b.nodes[i].rotation, fraction);
    n.scale = between(n.scale, b.nodes[i].scale, fraction);
  }
  for (std::size_t i = 0; i < out.morph_weights.size(); ++i)
    out.morph_weights[i] = between(out.morph_weights[i], b.morph_weights[i], fraction);
  return out;
}

void deform(const Character& c, const CharacterPose& pose, Mesh& out) {
  out.positions = c.positions;
  out.normals = c.normals;
  out.albedo = c.albedo;
  out.triangles = c.triangles;
  add_morphs(c, pose, out);
  thread_local std::vector<glm::mat4> bones;
  bone_matrices(c, pose, bones);
  for (std::size_t i = 0; i < out.positions.size(); ++i) {
    const Character::Influence& f = c.influences[i];
    glm::mat4 m = f.weight[0] * bones[f.bone[0]];
    for (std::size_t k = 1; k < Character::kInfluences && f.weight[k] > 0; ++k)
      m += f.weight[k] * bones[f.bone[k]];
    out.positions[i] = glm::vec3(m * glm::vec4(out.positions[i], 1));
    const glm::mat3 linear(m);
    // Of a mirrored node the cofactors point inwards.
    const float outwards = glm::determinant(linear) < 0 ? -1.f : 1.f;
    const glm::vec3 n = outwards * (cofactors(linear) * out.normals[i]);
    const float length = glm::length(n);
    // Bones that fold a point's surroundings to nothing leave no normal: any one will do there.
    out.normals[i] = length > 0 ? n / length : glm::vec3(0, 1, 0);
  }
  if (glm::determinant(glm::mat3(c.frame)) < 0)
    for (auto& t : out.triangles) std::swap(t[1], t[2]);
}

std::vector<glm::mat3> bone_turns(const Character& c, const CharacterPose& pose) {
  std::vector<glm::mat4> bones;
  bone_matrices(c, pose, bones);
  std::vector<glm::mat3> turns;
  for (const glm::mat4& m : bones) {
    // Gram-Schmidt: a rotation for every matrix, and the bone's own where it has neither scale nor
    // shear.
    const auto unit = [](const glm::vec3& v, const glm::vec3& otherwise) {
      return glm::length(v) > 1e-20f ? glm::normalize(v) : otherwise;
    };
    const glm::vec3 x = unit(glm::vec3(m[0]), {1, 0, 0});
    const glm::vec3 any = std::abs(x.y) < .9f ? glm::vec3(0, 1, 0) : glm::vec3(0, 0, 1);
    const glm::vec3 y = unit(glm::vec3(m[1]) - glm::dot(glm::vec3(m[1]), x) * x,
                             glm::normalize(any - glm::dot(any, x) * x));
    turns.emplace_back(x, y, glm::cross(x, y));
  }
  return turns;
}

namespace {

// The strongest of both, which sum to 1 again.
Character::Influence mean_influence(const Character::Influence& a, const Character::Influence& b) {
  struct BoneWeight {
    std::uint16_t bone;
    float weight;
  };
  std::vector<BoneWeight> fractions;
  for (const Character::Influence* f : {&a, &b})
    for (std::size_t k = 0; k < Character::kInfluences; ++k) {
      if (f->weight[k] == 0) continue;
      const auto known = std::ranges::find(fractions, f->bone[k], &BoneWeight::bone);
      if (known == fractions.end()) {
        fractions.push_back({f->bone[k], .5f * f->weight[k]});
      } else {
        known->weight += .5f * f->weight[k];
      }
    }
  std::ranges::stable_sort(fractions, std::ranges::greater(), &BoneWeight::weight);
  if (fractions.size() > Character::kInfluences) fractions.resize(Character::kInfluences);
  float sum = 0;
  for (const BoneWeight& s : fractions) sum += s.weight;
  Character::Influence out;
  for (std::size_t k = 0; k < fractions.size(); ++k) {
    out.bone[k] = fractions[k].bone;
    out.weight[k] = fractions[k].weight / sum;
  }
  return out;
}

}  // namespace

// Morph targets and their bases are linear in the vertices; a target that covers part of them
// covers the middles of its own edges only, so it is widened to all.
void subdivide(Character& c, float longest_edge, std::size_t triangle_limit) {
  Mesh mesh{c.positions, c.normals, c.albedo, c.triangles};
  const auto ends = subdivide(mesh, longest_edge, triangle_limit);
  const std::size_t before = c.positions.size();
  c.positions = std::move(mesh.positions);
  c.normals = std::move(mesh.normals);
  c.albedo = std::move(mesh.albedo);
  c.triangles = std::move(mesh.triangles);
  for (Character::MorphTarget& t : c.morph_targets) {
    const auto widen = [&](std::vector<glm::vec3>& deltas) {
      if (deltas.empty()) return;
      std::vector<glm::vec3> all(before, glm::vec3(0));
      std::ranges::copy(deltas, all.begin() + static_cast<std::ptrdiff_t>(t.first));
      for (const auto& [a, b] : ends) all.push_back(.5f * (all[a] + all[b]));
      deltas = std::move(all);
    };
    widen(t.positions);
    widen(t.normals);
    t.first = 0;
  }
  if (c.surface) {
    auto surface = std::make_shared<SurfaceMaterials>(*c.surface);
    surface->extend(ends);
    c.surface = std::move(surface);
  }
  for (const auto& [a, b] : ends) {
    c.influences.push_back(mean_influence(c.influences[a], c.influences[b]));
    for (auto* uv : {&c.texture_coordinates, &c.light_coordinates})
      if (!uv->empty()) uv->push_back(.5f * ((*uv)[a] + (*uv)[b]));
    if (!c.tint.empty()) c.tint.push_back((c.tint[a] + c.tint[b]) * .5f);
  }
}

Result<int> find_clip(const Character& character, const std::string& wanted) {
  if (character.clips.empty())
    return fail(ErrorCode::kInvalid, "animation", "the asset has no animation");
  const auto named = std::ranges::find(character.clips, wanted, &Clip::name);
  if (named != character.clips.end()) return static_cast<int>(named - character.clips.begin());
  int index = 0;
  const auto [end, error] = std::from_chars(wanted.data(), wanted.data() + wanted.size(), index);
  if (error == std::errc() && end == wanted.data() + wanted.size() && index >= 0 &&
      index < static_cast<int>(character.clips.size()))
    return index;
  std::string names;
  for (const Clip& clip : character.clips) names += (names.empty() ? "" : ", ") + clip.name;
  return fail(ErrorCode::kNotFound, "animation",
              fmt::format("\"{}\" is not a clip of the asset; it has {} (or 0 to {})", wanted,
                          names, character.clips.size() - 1));
}

}  // namespace penumbra::prt
