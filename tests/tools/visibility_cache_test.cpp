// Xu's cache of visibility against rays, where it holds and where it fails.
#include "tools/chart/peers/visibility_cache.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/conventions.h"

namespace penumbra::tools {
namespace {

constexpr float kNear_m = 3e-5f;

struct CachedLight {
  std::vector<float> light;
  std::size_t traced;
};

class CacheTrial {
 public:
  explicit CacheTrial(double radius_deg) {
    source_.direction = glm::normalize(glm::dvec3(.7, .64, .2));
    source_.radius = Radians{radius_deg * kPi / 180};
    source_.radiance = {1, 1, 1};
  }
  CachedLight light(float max_error, int samples = 16) {
    CachedLight out{std::vector<float>(mesh_.positions.size()), 0};
    out.traced = cache_.light(source_, samples, max_error, out.light);
    return out;
  }
  double error(float max_error) {
    const std::vector<float> truth = light(0, 64).light, ours = light(max_error).light;
    double off = 0, all = 0;
    for (std::size_t i = 0; i < truth.size(); ++i)
      off += std::pow(ours[i] - truth[i], 2), all += std::pow(truth[i], 2);
    return std::sqrt(off / all);
  }
  // Each vertex by so many rays of its own.
  std::vector<float> by_rays(int samples) const {
    prt::Mesh points = mesh_;
    points.triangles.clear();
    shadows::DirectLightAtVertices light;
    shadows::trace_direct_light_at_vertices({&cache_.world(), nullptr, kNear_m}, points, source_,
                                            samples, light);
    for (std::size_t i = 0; i < light.open.size(); ++i) light.open[i] -= light.virtual_occlusion[i];
    return light.open;
  }

 private:
  prt::Mesh mesh_ = prt::make_knot(.5f, 240, 40, {.5f, .5f, .5f});
  VisibilityCache cache_ = *VisibilityCache::create(mesh_, kNear_m);
  lighting::DistantLight source_;
};

TEST(VisibilityCaches, WithNoErrorAllowedAreRays) {
  CacheTrial trial(5);
  const std::vector<float> cached = trial.light(0).light, rays = trial.by_rays(16);
  std::size_t off = 0;
  for (std::size_t i = 0; i < rays.size(); ++i) off += std::abs(cached[i] - rays[i]) > 1e-3f;
  EXPECT_LE(off, rays.size() / 500) << "of " << rays.size();
}

TEST(VisibilityCaches, TraceFewVerticesUnderAWideLight) {
  CacheTrial trial(15);
  EXPECT_LT(trial.light(.2f).traced, trial.light(0).traced / 3);
  EXPECT_LT(trial.light(.4f).traced, trial.light(.2f).traced / 2);
  EXPECT_LT(trial.error(.2f), .06);
  EXPECT_LT(trial.error(.2f), trial.error(.4f));
}

// The distance of what hides a vertex says nothing of how sharp its shadow's edge is.
TEST(VisibilityCaches, LoseTheEdgesOfASunsShadows) {
  CacheTrial trial(.27);
  EXPECT_LT(trial.error(0), .01);
  EXPECT_GT(trial.error(.2f), .08);
}

TEST(VisibilityCaches, ForgetTheLightBefore) {
  CacheTrial trial(4);
  const CachedLight once = trial.light(.2f);
  trial.light(.4f);
  const CachedLight again = trial.light(.2f);
  EXPECT_EQ(once.traced, again.traced);
  EXPECT_EQ(once.light, again.light);
}

}  // namespace
}  // namespace penumbra::tools
