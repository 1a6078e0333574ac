#include "prt/clip/internal/seams.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "prt/clip/internal/frame_bake.h"
#include "prt/prt.h"
#include "tests/support/characters.h"

namespace penumbra::prt {
namespace {

constexpr Rgb kGrey{.5f, .5f, .5f};
constexpr int kSide = 64;

Character character_of(const Mesh& mesh) {
  return for_light_map(test::resting(mesh), kSide, kSide);
}

// A sphere whose atlas has many charts, and a map over it.
struct Sphere {
  Character character = character_of(make_sphere({0, 0, 0}, 1, 3, kGrey));
  SurfaceLayout layout = lay_out(character, kSide, kSide);
  Seams seams{character, layout};
  std::vector<float> smooth() const {
    Mesh mesh;
    deform(character, rest_pose(character), mesh);
    add_texels(character, layout, mesh);
    std::vector<float> out;
    for (const glm::vec3& n : mesh.normals) out.push_back(1 + .3f * n.x - .2f * n.y * n.z);
    return out;
  }
  std::vector<float> noisy(float sigma) const {
    std::vector<float> out = smooth();
    std::mt19937 random(3);
    std::normal_distribution<float> noise(0, sigma);
    for (float& v : out) v += noise(random);
    return out;
  }
  std::vector<char> all_seen() const { return std::vector<char>(layout.points(), 0); }
};

double rms_difference(std::span<const float> a, std::span<const float> b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += std::pow(double(a[i]) - b[i], 2);
  return std::sqrt(sum / static_cast<double>(a.size()));
}

// How far equalising moves a map: nothing where both sides of every seam agree.
double moved(const Sphere& s, const std::vector<float>& map) {
  std::vector<float> after = map;
  s.seams.equalise(s.all_seen(), after.size(), after);
  return rms_difference(map, after);
}

TEST(Seams, NoiseOnTheirTwoSidesMeets) {
  const Sphere s;
  ASSERT_FALSE(s.seams.empty());
  constexpr float kNoise = .05f;
  const std::vector<float> before = s.noisy(kNoise);
  std::vector<float> after = before;
  s.seams.equalise(s.all_seen(), after.size(), after);
  EXPECT_GT(moved(s, before), .1 * kNoise);
  EXPECT_LT(moved(s, after), .2 * moved(s, before));
  // Two estimates of one place are brought together: what is left is nearer to the truth, not
  // further.
  EXPECT_LT(rms_difference(after, s.smooth()), rms_difference(before, s.smooth()));
}

TEST(Seams, LeaveAloneWhatMeets) {
  const Sphere s;
  const std::vector<float> before = s.smooth();
  std::vector<float> after = before;
  s.seams.equalise(s.all_seen(), after.size(), after);
  EXPECT_LT(rms_difference(before, after), .005);
  const std::vector<float> constant(before.size(), 1.f);
  after = constant;
  s.seams.equalise(s.all_seen(), after.size(), after);
  EXPECT_LT(rms_difference(constant, after), 1e-6);
}

// Texels within another part are dark: they must not darken the other side of a seam.
TEST(Seams, HiddenTexelsDoNotPull) {
  const Sphere s;
  std::vector<char> hidden = s.all_seen();
  std::vector<float> before = s.smooth();
  Mesh mesh;
  deform(s.character, rest_pose(s.character), mesh);
  add_texels(s.character, s.layout, mesh);
  for (std::size_t p = 0; p < hidden.size(); ++p)
    if (mesh.normals[p].x > .3f) hidden[p] = 1, before[p] = 0;
  std::vector<float> naive = before, after = before;
  s.seams.equalise(s.all_seen(), naive.size(), naive);
  s.seams.equalise(hidden, after.size(), after);
  double worst_naive = 0, worst = 0;
  for (std::size_t p = 0; p < hidden.size(); ++p) {
    if (hidden[p]) {
      EXPECT_EQ(after[p], before[p]);
      continue;
    }
    worst_naive = std::max(worst_naive, double(std::abs(naive[p] - before[p])));
    worst = std::max(worst, double(std::abs(after[p] - before[p])));
  }
  EXPECT_GT(worst_naive, .2);
  EXPECT_LT(worst, .05);
}

// Edges of a box are real: its faces get different light.
TEST(Seams, CreasesAreNone) {
  const Character box = character_of(make_box({-1, -1, -1}, {1, 1, 1}, 4, kGrey));
  EXPECT_TRUE(Seams(box, lay_out(box, kSide, kSide)).empty());
}

TEST(Seams, AreEqualisedInBakedFrames) {
  const Sphere s;
  SequenceOptions options;
  options.bands = 2;
  options.bounces = 1;
  options.rays = 64;
  options.map_width = options.map_height = kSide;
  options.denoise = false;
  options.ground_size = 8;  // or nothing would be blocked, and no ray noisy
  Character standing = s.character;
  standing.frame[3] = glm::vec4(0, 1, 0, 1);
  const auto baker = FrameBaker::create(standing, 0, options);
  ASSERT_TRUE(baker);
  const auto record = baker->bake(0, {});
  ASSERT_TRUE(record);
  Transfer t = baker->shape(FrameBaker::kSurface);
  std::copy_n(record->values.begin(), t.values.size(), t.values.begin());
  std::vector<float> first;
  double mean = 0;
  for (std::size_t p = 0; p < s.layout.points(); ++p) {
    first.push_back(t.value(0, 0, p));
    mean += double(first.back()) / static_cast<double>(s.layout.points());
  }
  // Both sides of every seam agree already: equalising again moves next to nothing.
  RecordProperty("moved_percent", std::to_string(100 * moved(s, first) / mean));
  EXPECT_LT(moved(s, first), .004 * mean);
}

}  // namespace
}  // namespace penumbra::prt
