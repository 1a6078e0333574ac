// The built-in mannequin: tubes along limbs, joined by skin weights, each with a field of its own
// in the texture plane.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "core/conventions.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"

namespace penumbra::prt {

namespace {

enum WalkerNode {
  kHips,
  kSpine,
  kChest,
  kHead,
  kUpperArmLeft,
  kForearmLeft,
  kUpperArmRight,
  kForearmRight,
  kThighLeft,
  kShinLeft,
  kFootLeft,
  kThighRight,
  kShinRight,
  kFootRight,
  kNodes
};
struct Joint {
  const char* name;
  int parent;
  glm::vec3 place;  // in the rest pose, metres; the figure looks along +z, its left is +x
};
constexpr Joint kJoints[kNodes] = {
    {"hips", -1, {0, .93f, 0}},
    {"spine", kHips, {0, 1.05f, 0}},
    {"chest", kSpine, {0, 1.22f, 0}},
    {"head", kChest, {0, 1.5f, 0}},
    {"upper arm left", kChest, {.2f, 1.4f, 0}},
    {"forearm left", kUpperArmLeft, {.34f, 1.145f, 0}},
    {"upper arm right", kChest, {-.2f, 1.4f, 0}},
    {"forearm right", kUpperArmRight, {-.34f, 1.145f, 0}},
    {"thigh left", kHips, {.1f, .9f, 0}},
    {"shin left", kThighLeft, {.1f, .49f, 0}},
    {"foot left", kShinLeft, {.1f, .09f, 0}},
    {"thigh right", kHips, {-.1f, .9f, 0}},
    {"shin right", kThighRight, {-.1f, .49f, 0}},
    {"foot right", kShinRight, {-.1f, .09f, 0}},
};

/// A cross section: an ellipse across the tube's way.
struct CrossSection {
  glm::vec3 centre;
  float side, depth;  // half axes, metres
};
struct Tube {
  std::vector<CrossSection> sections;  // the ends close to a point
  std::vector<int> bones;              // in their order along the tube
  glm::vec2 corner, size;              // of its field in the texture plane
  int rings, around;
};

CrossSection between(const std::vector<CrossSection>& s, float at) {
  const float scaled = std::clamp(at, 0.f, 1.f) * static_cast<float>(s.size() - 1);
  const auto i = std::min(static_cast<std::size_t>(scaled), s.size() - 2);
  // Catmull-Rom, so that limbs have no rings.
  const float t = scaled - static_cast<float>(i);
  const auto curve = [&](auto get) {
    const auto p0 = get(s[i > 0 ? i - 1 : 0]), p1 = get(s[i]), p2 = get(s[i + 1]),
               p3 = get(s[std::min(i + 2, s.size() - 1)]);
    return .5f * (2.f * p1 + (p2 - p0) * t + (2.f * p0 - 5.f * p1 + 4.f * p2 - p3) * t * t +
                  (3.f * p1 - p0 - 3.f * p2 + p3) * t * t * t);
  };
  return {curve([](const CrossSection& x) { return x.centre; }),
          curve([](const CrossSection& x) { return x.side; }),
          curve([](const CrossSection& x) { return x.depth; })};
}

/// Smoothly from bone to bone within this distance of the joint between them.
Character::Influence influence_at(const Tube& tube, const glm::vec3& p) {
  constexpr float kSoft = .07f;  // metres
  float own = 1;
  Character::Influence out;
  // Along the limb the last joint passed holds the most; half a turn's blend around each joint.
  std::vector<float> weights(tube.bones.size(), 0);
  for (std::size_t k = tube.bones.size(); k-- > 0;) {
    float passed = 1;
    if (k > 0) {
      const glm::vec3 joint = kJoints[tube.bones[k]].place,
                      way = glm::normalize(joint - kJoints[tube.bones[k - 1]].place);
      const float along = glm::dot(p - joint, way) / kSoft;
      passed = std::clamp(.5f + .5f * along, 0.f, 1.f);
      passed = passed * passed * (3 - 2 * passed);
    }
    weights[k] = own * passed;
    own *= 1 - passed;
  }
  std::vector<std::size_t> order(tube.bones.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
  std::ranges::stable_sort(order, std::ranges::greater(), [&](auto k) { return weights[k]; });
  for (std::size_t k = 0; k < std::min<std::size_t>(order.size(), Character::kInfluences); ++k) {
    out.bone[k] = static_cast<std::uint16_t>(tube.bones[order[k]]);
    out.weight[k] = weights[order[k]];
  }
  return out;
}

void add_tube(const Tube& tube, Rgb albedo, Character& out) {
  const auto first = static_cast<std::uint32_t>(out.positions.size());
  const int columns = tube.around + 1;  // the seam's vertices stand twice
  const glm::vec3 way = glm::normalize(tube.sections.back().centre - tube.sections.front().centre);
  const glm::vec3 depth_axis =
      glm::normalize(glm::vec3(0, 0, 1) - way * way.z + glm::vec3(0, way.z, 0));
  const glm::vec3 side_axis = glm::cross(way, depth_axis);
  for (int j = 0; j <= tube.rings; ++j) {
    const float v = static_cast<float>(j) / static_cast<float>(tube.rings);
    // Rings crowd at the ends, where the tube rounds off.
    const float at = .5f - .5f * std::cos(static_cast<float>(kPi) * v);
    const CrossSection s = between(tube.sections, at);
    const float round = std::sqrt(std::max(0.f, 1 - std::pow(2 * at - 1, 8.f)));
    for (int i = 0; i < columns; ++i) {
      const float u = static_cast<float>(i) / static_cast<float>(tube.around);
      // Round to the same bits: what is one place must compare as one.
      const float a = static_cast<float>(2 * kPi) * static_cast<float>(i % tube.around) /
                      static_cast<float>(tube.around);
      out.positions.push_back(s.centre + round * (s.side * std::cos(a) * side_axis +
                                                  s.depth * std::sin(a) * depth_axis));
      out.texture_coordinates.push_back(tube.corner + tube.size * glm::vec2(u, v));
      out.albedo.push_back(albedo);
      out.influences.push_back(influence_at(tube, s.centre));
    }
  }
  for (int j = 0; j < tube.rings; ++j)
    for (int i = 0; i < tube.around; ++i) {
      const auto a = first + static_cast<std::uint32_t>(j * columns + i), b = a + 1,
                 c = a + static_cast<std::uint32_t>(columns), d = c + 1;
      if (j > 0) out.triangles.push_back({a, d, b});
      if (j + 1 < tube.rings) out.triangles.push_back({a, c, d});
    }
}

// By the triangles' areas; vertices in one place share theirs.
void smooth_normals(Character& c) {
  std::vector<glm::vec3> sums(c.positions.size(), glm::vec3(0));
  for (const auto& t : c.triangles) {
    const glm::vec3 n =
        glm::cross(c.positions[t[1]] - c.positions[t[0]], c.positions[t[2]] - c.positions[t[0]]);
    for (const std::uint32_t i : t) sums[i] += n;
  }
  c.normals.resize(sums.size());
  for (std::size_t i = 0; i < sums.size(); ++i) {
    glm::vec3 sum = sums[i];
    for (std::size_t k = i > 64 ? i - 64 : 0; k < std::min(sums.size(), i + 64); ++k)
      if (k != i && glm::distance(c.positions[i], c.positions[k]) < 1e-6f) sum += sums[k];
    c.normals[i] = glm::length(sum) > 0 ? glm::normalize(sum) : glm::vec3(0, 1, 0);
  }
}

void add_limbs(Rgb albedo, float mirror, glm::vec2 arm, glm::vec2 leg, glm::vec2 foot,
               Character& out) {
  const bool left = mirror > 0;
  const auto at = [&](float x, float y, float z) { return glm::vec3(mirror * x, y, z); };
  add_tube({{{at(.155f, 1.44f, 0), .05f, .055f},
             {at(.22f, 1.365f, 0), .057f, .058f},
             {at(.28f, 1.255f, 0), .047f, .048f},
             {at(.34f, 1.145f, 0), .041f, .043f},
             {at(.385f, 1.06f, 0), .042f, .042f},
             {at(.455f, .93f, 0), .029f, .033f},
             {at(.49f, .865f, 0), .03f, .045f},
             {at(.53f, .79f, 0), .018f, .03f}},
            left ? std::vector<int>{kUpperArmLeft, kForearmLeft}
                 : std::vector<int>{kUpperArmRight, kForearmRight},
            arm,
            {.2f, .38f},
            25,
            15},
           albedo, out);
  add_tube(
      {{{at(.1f, .96f, 0), .09f, .095f},
        {at(.1f, .86f, 0), .09f, .095f},
        {at(.1f, .68f, .005f), .077f, .082f},
        {at(.1f, .5f, .005f), .055f, .06f},
        {at(.1f, .37f, -.01f), .055f, .063f},
        {at(.1f, .2f, -.005f), .04f, .045f},
        {at(.1f, .06f, 0), .037f, .042f}},
       left ? std::vector<int>{kThighLeft, kShinLeft} : std::vector<int>{kThighRight, kShinRight},
       leg,
       {.2f, .42f},
       27,
       15},
      albedo, out);
  add_tube({{{at(.1f, .045f, -.075f), .04f, .043f},
             {at(.1f, .05f, 0), .045f, .05f},
             {at(.105f, .035f, .1f), .048f, .035f},
             {at(.11f, .025f, .18f), .035f, .025f}},
            {left ? kFootLeft : kFootRight},
            foot,
            {.18f, .12f},
            11,
            13},
           albedo, out);
}

glm::quat turn(float degrees, const glm::vec3& axis) {
  return glm::angleAxis(glm::radians(degrees), axis);
}
constexpr glm::vec3 kX{1, 0, 0}, kY{0, 1, 0}, kZ{0, 0, 1};

// Swings forward are turns about -x.
CharacterPose stride(const Character& c, float phase) {
  CharacterPose pose = rest_pose(c);
  const float swing = std::sin(phase);
  const auto leg = [&](int thigh, float p) {
    const float hip = 26 * std::sin(p) + 4;
    const float knee = 8 + 48 * std::pow(std::max(0.f, std::cos(p)), 1.5f);
    pose.nodes[static_cast<std::size_t>(thigh)].rotation = turn(-hip, kX);
    pose.nodes[static_cast<std::size_t>(thigh + 1)].rotation = turn(knee, kX);
    pose.nodes[static_cast<std::size_t>(thigh + 2)].rotation = turn(.7f * (hip - knee), kX);
  };
  leg(kThighLeft, phase);
  leg(kThighRight, phase + static_cast<float>(kPi));
  const auto arm = [&](int upper, float forward, float in) {
    pose.nodes[static_cast<std::size_t>(upper)].rotation =
        turn(-24 * forward, kX) * turn(in * 17, kZ);
    pose.nodes[static_cast<std::size_t>(upper + 1)].rotation = turn(-(24 + 14 * forward), kX);
  };
  arm(kUpperArmLeft, -swing, -1);
  arm(kUpperArmRight, swing, 1);
  pose.nodes[kHips].rotation = turn(-5 * swing, kY);
  pose.nodes[kSpine].rotation = turn(4 * swing, kY) * turn(4, kX);
  pose.nodes[kChest].rotation = turn(6 * swing, kY);
  pose.nodes[kHead].rotation = turn(-5 * swing, kY) * turn(-3, kX);
  return pose;
}

CharacterPose wave(const Character& c, float phase) {
  CharacterPose pose = stride(c, 0);
  for (int leg = kThighLeft; leg < kNodes; ++leg)
    pose.nodes[static_cast<std::size_t>(leg)].rotation = {1, 0, 0, 0};
  const float beat = std::sin(2 * phase);
  pose.nodes[kUpperArmLeft].rotation = turn(118 + 6 * beat, kZ);
  pose.nodes[kForearmLeft].rotation = turn(20 + 28 * beat, kZ);
  pose.nodes[kHead].rotation = turn(12, kY) * turn(3 * std::sin(phase), kZ);
  pose.nodes[kHips].rotation = turn(2 * std::sin(phase), kY);
  return pose;
}

// Feet on the floor: the lowest point of the body stands at 0.
void set_on_floor(const Character& c, CharacterPose& pose) {
  Mesh mesh;
  deform(c, pose, mesh);
  pose.nodes[kHips].translation.y -= bounds_of(mesh).low.y;
}

Clip make_clip(const Character& c, const std::string& name, double seconds,
               CharacterPose (*pose_at)(const Character&, float)) {
  constexpr int kKeys = 48;
  Clip clip;
  clip.name = name;
  clip.seconds = seconds;
  for (int node = 0; node < kNodes; ++node) clip.nodes.push_back({node, {}, {}, {}});
  for (int k = 0; k <= kKeys; ++k) {
    // The last key is the first again.
    CharacterPose pose = pose_at(c, static_cast<float>(2 * kPi * (k % kKeys) / kKeys));
    set_on_floor(c, pose);
    const double at = seconds * k / kKeys;
    clip.nodes[kHips].translation.push_back({at, pose.nodes[kHips].translation});
    for (std::size_t node = 0; node < kNodes; ++node)
      clip.nodes[node].rotation.push_back({at, pose.nodes[node].rotation});
  }
  return clip;
}

}  // namespace

Character make_walker(Rgb albedo) {
  Character out;
  for (const Joint& j : kJoints) {
    Character::Node node{j.name, j.parent, {}};
    node.rest.translation =
        j.parent < 0 ? j.place : j.place - kJoints[static_cast<std::size_t>(j.parent)].place;
    glm::mat4 to_bone(1);
    to_bone[3] = glm::vec4(-j.place, 1);
    out.bones.push_back({static_cast<int>(out.nodes.size()), to_bone});
    out.nodes.push_back(node);
  }
  add_tube({{{{0, .82f, 0}, .12f, .1f},
             {{0, .9f, 0}, .165f, .115f},
             {{0, 1.02f, 0}, .14f, .095f},
             {{0, 1.15f, 0}, .145f, .1f},
             {{0, 1.3f, 0}, .18f, .115f},
             {{0, 1.42f, 0}, .16f, .09f},
             {{0, 1.48f, 0}, .065f, .065f},
             {{0, 1.56f, .005f}, .055f, .06f}},
            {kHips, kSpine, kChest},
            {.01f, .01f},
            {.5f, .42f},
            27,
            23},
           albedo, out);
  add_tube({{{{0, 1.515f, .01f}, .06f, .07f},
             {{0, 1.58f, .015f}, .075f, .092f},
             {{0, 1.66f, .01f}, .083f, .1f},
             {{0, 1.75f, 0}, .06f, .075f}},
            {kHead},
            {.53f, .01f},
            {.3f, .3f},
            17,
            19},
           albedo, out);
  add_limbs(albedo, 1, {.01f, .45f}, {.43f, .45f}, {.53f, .32f}, out);
  add_limbs(albedo, -1, {.22f, .45f}, {.64f, .45f}, {.72f, .32f}, out);
  smooth_normals(out);
  out.clips.push_back(make_clip(out, "Walk", 1.1, stride));
  out.clips.push_back(make_clip(out, "Wave", 2.2, wave));
  out.clips.push_back({"Rest", 0, {}, {}});
  return out;
}

}  // namespace penumbra::prt
