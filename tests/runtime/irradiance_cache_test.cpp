// What virtual things take from a real wall, gathered at few points, against closed forms.
#include "runtime/surroundings/irradiance_cache.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "prt/prt.h"

namespace penumbra::runtime {
namespace {

using glm::dvec3;

constexpr double kRadius_m = .2, kAway_m = .45;  // of the ball, and its middle from the wall

// A ball before a wall of 3 x 3 m that stands at z = 0 and looks along +z. No floor.
class BallBeforeAWall : public testing::Test {
 protected:
  void SetUp() override {
    PreparedObject ball;
    ball.baked.mesh = prt::make_sphere({0, 0, 0}, float(kRadius_m), 4, {1, 1, 1});
    scene_.objects.push_back(std::move(ball));
    scene_.real_mesh = prt::make_box({-1.5f, -1.5f, -.1f}, {1.5f, 1.5f, 0}, 1, {.5f, .5f, .5f});
    prt::subdivide(scene_.real_mesh, .04f);
    auto virtual_things = prt::RayWorld::create(), real_things = prt::RayWorld::create();
    ASSERT_TRUE(virtual_things && real_things);
    virtual_.emplace(std::move(*virtual_things));
    real_.emplace(std::move(*real_things));
    ASSERT_TRUE(virtual_->add(scene_.objects[0].baked.mesh));
    ASSERT_TRUE(real_->add(scene_.real_mesh));
    probes_.emplace(scene_);
    cache_.emplace(scene_);
  }

  void put(const dvec3& at, bool other_form = false) {
    pose_ = Pose{{1, 0, 0, 0}, at};
    virtual_->set_pose(0, pose_);
    const shadows::RayOccluders occluders{&*virtual_, &*real_, 1e-4f};
    probes_->update(occluders, {&pose_, 1});
    cache_->update(occluders, {&pose_, 1}, *probes_, other_form);
  }
  // Form factor of the ball as gathered, at every vertex of the wall.
  std::vector<float> gathered() const {
    std::vector<Rgb> of_points(cache_->points()), out(scene_.real_mesh.positions.size());
    for (std::size_t p = 0; p < of_points.size(); ++p)
      of_points[p] = Rgb{1, 1, 1} * (float(cache_->hits(p).size()) / float(IrradianceCache::kRays));
    cache_->interpolate(of_points, out);
    std::vector<float> factors;
    for (const Rgb& c : out) factors.push_back(c.g);
    return factors;
  }
  // (R/d)^2 cos, of a ball wholly above the horizon of what faces +z; 0 behind the wall.
  double true_factor(std::size_t vertex) const {
    const prt::Mesh& wall = scene_.real_mesh;
    if (wall.normals[vertex].z < .9f) return 0;
    const dvec3 to = pose_.translation - dvec3(wall.positions[vertex]);
    const double d2 = glm::dot(to, to);
    return kRadius_m * kRadius_m / d2 * to.z / std::sqrt(d2);
  }

  PreparedScene scene_;
  std::optional<prt::RayWorld> virtual_, real_;
  std::optional<OcclusionProbes> probes_;
  std::optional<IrradianceCache> cache_;
  Pose pose_;
};

TEST_F(BallBeforeAWall, TakesItsFormFactorAtFewPoints) {
  put({.1, -.2, kAway_m});
  const std::vector<float> factors = gathered();
  double square = 0, worst = 0, largest = 0;
  int near = 0;
  for (std::size_t v = 0; v < factors.size(); ++v) {
    const glm::vec3 off = scene_.real_mesh.positions[v] - glm::vec3(pose_.translation);
    if (glm::length(off) > 4 * kRadius_m) continue;  // where it fades
    const double error = double(factors[v]) - true_factor(v);
    square += error * error;
    worst = std::max(worst, std::abs(error));
    largest = std::max(largest, true_factor(v));
    ++near;
  }
  ASSERT_GT(near, 1000);
  EXPECT_GT(largest, .19);
  EXPECT_LT(std::sqrt(square / near), .008);
  EXPECT_LT(worst, .04);
  EXPECT_LT(cache_->points(), factors.size() / 10) << "that few points are gathered at";
  EXPECT_GT(cache_->points(), 20u);
}

TEST_F(BallBeforeAWall, ChangesNothingFarAwayAndBehind) {
  put({0, 0, kAway_m});
  const std::vector<float> factors = gathered();
  const float reach = IrradianceCache::kReach * float(kRadius_m);
  for (std::size_t v = 0; v < factors.size(); ++v) {
    const glm::vec3 off = scene_.real_mesh.positions[v] - glm::vec3(pose_.translation);
    if (glm::length(off) > reach || scene_.real_mesh.normals[v].z < -.9f) {
      ASSERT_EQ(factors[v], 0) << v;
    }
  }
  put({0, 0, 40});
  EXPECT_EQ(cache_->points(), 0u);
}

// The nearer the ball, the denser the points.
TEST_F(BallBeforeAWall, LooksCloserWhereTheBallIsNear) {
  put({0, 0, kRadius_m + .01});
  const std::size_t near = cache_->points();
  put({0, 0, 4 * kRadius_m});
  EXPECT_GT(near, cache_->points() + cache_->points() / 2);
}

// What was gathered follows the ball without steps.
TEST_F(BallBeforeAWall, FollowsWithoutSteps) {
  put({0, 0, kAway_m});
  const std::vector<float> before = gathered();
  put({.005, 0, kAway_m});
  const std::vector<float> after = gathered();
  float worst = 0;
  for (std::size_t v = 0; v < before.size(); ++v)
    worst = std::max(worst, std::abs(after[v] - before[v]));
  EXPECT_GT(worst, 0);
  EXPECT_LT(worst, .02f);
}

TEST_F(BallBeforeAWall, LooksAgainWhenSomethingMovedOrHasAnotherForm) {
  put({0, 0, kAway_m});
  const std::vector<float> whole = gathered();
  for (glm::vec3& p : scene_.objects[0].baked.mesh.positions) p *= .5f;
  virtual_->update_vertices(0, scene_.objects[0].baked.mesh);
  put(pose_.translation);
  EXPECT_EQ(gathered(), whole) << "rays were cast though nothing is said to have moved";
  put(pose_.translation, true);
  const std::vector<float> half = gathered();
  EXPECT_LT(*std::ranges::max_element(half), .35f * *std::ranges::max_element(whole));
}

TEST(IrradianceCache, AnObjectWithoutRealThingsNeedsNone) {
  PreparedScene scene;
  scene.objects.emplace_back().baked.mesh = prt::make_sphere({0, 0, 0}, .2f, 2, {1, 1, 1});
  EXPECT_EQ(IrradianceCache(scene).points(), 0u);
}

}  // namespace
}  // namespace penumbra::runtime
