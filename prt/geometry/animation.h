// Meshes that move: skins, node animation and morph targets; poses, clips and their blending.
// threads: free functions reentrant
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <glm/gtc/quaternion.hpp>
#include <glm/mat3x3.hpp>
#include <glm/mat4x4.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

struct Mesh;

/// Where a node stands relative to its parent: scaled, turned, shifted, in this order.
struct NodePose {
  glm::vec3 translation{0, 0, 0};
  glm::quat rotation{1, 0, 0, 0};
  glm::vec3 scale{1, 1, 1};
  friend bool operator==(const NodePose&, const NodePose&) = default;
};

/// All that moves a character, at one time.
struct CharacterPose {
  std::vector<NodePose> nodes;       // one a node
  std::vector<float> morph_weights;  // one a morph target, 0..1 as a rule
  friend bool operator==(const CharacterPose&, const CharacterPose&) = default;
};

/// Keys in order of time; values between two keys lie on the straight line (rotations: on the arc)
/// between them.
struct Clip {
  template <class T>
  struct Key {
    double seconds;
    T value;
  };
  template <class T>
  using Track = std::vector<Key<T>>;
  struct NodeTracks {
    int node;
    Track<glm::vec3> translation, scale;
    Track<glm::quat> rotation;
  };
  struct MorphTrack {
    int target;
    Track<float> weight;
  };
  std::string name;
  double seconds = 0;  // it loops after them; 0: one pose
  std::vector<NodeTracks> nodes;
  std::vector<MorphTrack> morphs;
};

/// Vertices and triangles of a character at rest in their own frames; only deform() brings them to
/// one.
struct Character {
  static constexpr int kInfluences = 4;

  struct Node {
    std::string name;
    int parent = -1;  // stands before its children; -1: none
    NodePose rest;
  };
  /// What vertices hang on: a joint of a skin, or the node of a mesh without skin.
  struct Bone {
    int node;
    glm::mat4 bone_from_rest;
  };
  struct Influence {
    std::array<std::uint16_t, kInfluences> bone{};
    std::array<float, kInfluences> weight{};  // strongest first; they sum to 1
  };
  /// What a weight of 1 adds to the vertices from `first` on.
  struct MorphTarget {
    std::string name;
    float rest_weight = 0;
    std::size_t first = 0;
    std::vector<glm::vec3> positions, normals;
  };

  std::vector<glm::vec3> positions, normals;
  std::vector<Rgb> albedo;
  std::vector<glm::vec2> texture_coordinates;  // v down; empty where the asset has none
  std::vector<glm::vec2> light_coordinates;    // of a light map; empty: as texture_coordinates
  /// Base colour, coded in sRGB, where one picture serves the whole asset; `albedo` are its means
  /// then. What colours the picture further is in `tint`.
  std::shared_ptr<const Image<Rgb8>> texture;
  std::vector<Rgb> tint;  // by vertex; empty without texture
  /// Materials where there is more to draw than colours, of glTF alone and without normal maps,
  /// which would have to turn with the skin; null: `texture`, `tint` and `albedo` are all.
  std::shared_ptr<const SurfaceMaterials> surface;
  std::vector<std::array<std::uint32_t, 3>> triangles;
  std::vector<Influence> influences;
  std::vector<Node> nodes;
  std::vector<Bone> bones;
  std::vector<MorphTarget> morph_targets;
  std::vector<Clip> clips;
  glm::mat4 frame{1};  // placed: from the nodes' common frame to the one wanted

  std::size_t degenerate_triangles = 0;  // removed
  std::vector<std::string> left_out{};   // of its materials, a line each
  // Of a skin but without weights: they follow the skin's first joint
  std::size_t unbound_vertices = 0;
};

/// glTF, FBX or COLLADA with joints, clips and base colour textures, which become an albedo a
/// vertex. A mesh that has nothing to move it is a character of one bone.
/// errors: as import_mesh; kInvalid (more than 65535 bones)
Result<Character> import_character(const std::filesystem::path& path, Rgb default_albedo);

/// The built-in mannequin, 1.75 m tall, with the clips "Walk" (in place, 1.1 s a cycle, feet on y =
/// 0), "Wave" and "Rest" (one pose).
Character make_walker(Rgb albedo);

CharacterPose rest_pose(const Character& character);
/// The clip at a time, which wraps around at its end.
CharacterPose sample(const Character& character, const Clip& clip, double seconds);
/// 0: a, 1: b. Both of one character.
CharacterPose blend(const CharacterPose& a, const CharacterPose& b, float fraction);

/// The character's mesh at a pose, by linear blend skinning. Vertex i is vertex i in every pose.
/// Allocates nothing once `out` has its size.
void deform(const Character& character, const CharacterPose& pose, Mesh& out);
/// How each bone is turned against the vertices' own frame, without scale and shear: a vector of
/// the strongest bone's material, times this, is in the deformed mesh's frame.
std::vector<glm::mat3> bone_turns(const Character& character, const CharacterPose& pose);

/// Splits edges of the mesh at rest as prt::subdivide does; everything a vertex has is its ends'
/// mean.
void subdivide(Character& character, float longest_edge, std::size_t triangle_limit = 400'000);

/// The clip of that name, or of that number.
/// errors: kNotFound (names those that there are), kInvalid (no clips at all)
Result<int> find_clip(const Character& character, const std::string& name_or_index);

}  // namespace penumbra::prt
#pragma GCC visibility pop
