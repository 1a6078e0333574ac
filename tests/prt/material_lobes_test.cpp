// What materials do with light, apart from any world: energy, and whether directions are drawn as
// their density says.
#include "prt/reference/materials.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>
#include <string>
#include <vector>

#include "core/conventions.h"
#include "prt/rays/ray_pattern.h"

namespace penumbra::prt {
namespace {

const glm::vec3 kUp = glm::normalize(glm::vec3(.3f, .8f, -.5f));

LocalMaterial metal_of(float roughness, Rgb colour = {1, 1, 1}) {
  LocalMaterial m;
  m.plain = m.normal = kUp;
  m.reflectance = colour;
  m.roughness = roughness;
  return m;
}

LocalMaterial plastic_of(float roughness, Rgb colour = {1, 1, 1}) {
  LocalMaterial m = metal_of(roughness, {.04f, .04f, .04f});
  m.diffuse = colour;
  return m;
}

// At an angle of this cosine to the normal.
glm::vec3 viewer_at(float cosine) {
  return frame_around(kUp) * glm::vec3(std::sqrt(1 - cosine * cosine), 0, cosine);
}

// What is sent of even light of radiance 1.
Rgb of_even_light(const MaterialLobes& lobes) {
  constexpr int kSide = 128;
  Rgb sum;
  for (int i = 0; i < kSide; ++i)
    for (int j = 0; j < kSide; ++j)
      sum +=
          lobes.sample((static_cast<float>(i) + .5f) / kSide, (static_cast<float>(j) + .5f) / kSide)
              .weight;
  return sum * (1.f / (kSide * kSide));
}

TEST(MaterialLobes, WhiteSurfacesSendAllOfEvenLightAtEveryRoughness) {
  for (const float roughness : {0.f, .1f, .25f, .5f, .75f, 1.f})
    for (const float cosine : {.05f, .2f, .5f, .8f, 1.f}) {
      const std::string at = std::to_string(roughness) + " " + std::to_string(cosine);
      const glm::vec3 v = viewer_at(cosine);
      EXPECT_NEAR(of_even_light({metal_of(roughness), v}).g, 1, .01) << at;
      EXPECT_NEAR(of_even_light({plastic_of(roughness), v}).g, 1, .01) << at;
      LocalMaterial coated = plastic_of(roughness);
      coated.clearcoat = 1;
      coated.clearcoat_roughness = .1f;
      EXPECT_NEAR(of_even_light({coated, v}).g, 1, .01) << at;
    }
}

TEST(MaterialLobes, BlackPlasticMirrorsFourPercentAheadAndMostAtGrazing) {
  const LocalMaterial black = plastic_of(.05f, {0, 0, 0});
  EXPECT_NEAR(of_even_light({black, viewer_at(1)}).g, .04, .001);
  // Schlick's term at the viewer's own angle, as of a mirror
  EXPECT_NEAR(of_even_light({black, viewer_at(.3f)}).g, .04 + .96 * std::pow(.7, 5), .004);
  EXPECT_GT(of_even_light({black, viewer_at(.03f)}).g, .7);
}

TEST(MaterialLobes, GoldColoursWhatItMirrorsAndPlasticDoesNot) {
  const Rgb gold = of_even_light({metal_of(.25f, {1, .77f, .34f}), viewer_at(1)});
  EXPECT_NEAR(gold.b / gold.r, .34, .02);
  const Rgb red = of_even_light({plastic_of(.25f, {.5f, 0, 0}), viewer_at(.1f)});
  EXPECT_GT(red.b, .4f);
}

TEST(MaterialLobes, AMirrorSendsWhereItMirrors) {
  const glm::vec3 v = viewer_at(.6f), r = glm::reflect(-v, kUp);
  const MaterialLobes mirror(metal_of(0), v);
  std::mt19937 random(1);
  std::uniform_real_distribution<float> even;
  double near = 0;
  constexpr int kSamples = 1000;
  for (int i = 0; i < kSamples; ++i)
    near += glm::dot(mirror.sample(even(random), even(random)).towards_light, r) > std::cos(.02f);
  EXPECT_GT(near / kSamples, .98);
}

struct Surface {
  const char* name;
  LocalMaterial material;
};
std::vector<Surface> surfaces() {
  LocalMaterial coated = plastic_of(.8f, {.2f, .5f, .1f});
  coated.clearcoat = .7f;
  coated.clearcoat_roughness = .3f;
  LocalMaterial leaning = metal_of(.4f);
  leaning.normal = glm::normalize(kUp + .5f * glm::vec3(.8f, -.3f, 0));
  return {{"metal .3", metal_of(.3f)},
          {"metal 1", metal_of(1)},
          {"plastic .3", plastic_of(.3f, {.5f, .1f, .1f})},
          {"rubber", plastic_of(.9f)},
          {"coated", coated},
          {"leaning", leaning}};
}

// Pearson's statistic over bins of the sphere, each of whose density is summed on a fine grid.
TEST(MaterialLobes, DirectionsComeAsOftenAsTheirDensitySays) {
  constexpr int kRows = 12, kColumns = 24, kFine = 48, kSamples = 200'000;
  for (const Surface& s : surfaces())
    for (const float cosine : {.15f, .6f, 1.f}) {
      const MaterialLobes lobes(s.material, viewer_at(cosine));
      std::vector<double> expected(kRows * kColumns), seen(kRows * kColumns);
      for (int y = 0; y < kRows * kFine; ++y)
        for (int x = 0; x < kColumns * kFine; ++x)
          expected[static_cast<std::size_t>(y / kFine * kColumns + x / kFine)] +=
              kSamples * latlong_solid_angle(y, kColumns * kFine, kRows * kFine) *
              double(lobes.density(
                  glm::vec3(latlong_direction(x + .5, y + .5, kColumns * kFine, kRows * kFine))));
      std::mt19937 random(7);
      std::uniform_real_distribution<float> even;
      double below = 0, above = 0;
      for (int i = 0; i < kSamples; ++i) {
        const auto sample = lobes.sample(even(random), even(random));
        if (sample.density <= 0) {
          ++below;
          continue;
        }
        const glm::dvec2 p = latlong_pixel(glm::dvec3(sample.towards_light), kColumns, kRows);
        ++seen[static_cast<std::size_t>(std::min(int(p.y), kRows - 1) * kColumns +
                                        std::min(int(p.x), kColumns - 1))];
      }
      double statistic = 0;
      int bins = 0;
      for (std::size_t i = 0; i < seen.size(); ++i) {
        above += expected[i];
        if (expected[i] < 20) continue;
        statistic += std::pow(seen[i] - expected[i], 2) / expected[i], ++bins;
      }
      EXPECT_NEAR((above + below) / kSamples, 1, .003) << s.name << ' ' << cosine;
      // Its mean is the number of bins, its variance twice that.
      EXPECT_LT(statistic, bins + 5 * std::sqrt(2. * bins)) << s.name << ' ' << cosine;
    }
}

TEST(MaterialLobes, AWeightIsTheValueOverTheDensity) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> even;
  for (const Surface& s : surfaces()) {
    const MaterialLobes lobes(s.material, viewer_at(.5f));
    int compared = 0;
    for (int i = 0; i < 300; ++i) {
      const auto sample = lobes.sample(even(random), even(random));
      if (sample.density <= 0) continue;
      const Rgb value = lobes.evaluate(sample.towards_light);
      EXPECT_NEAR(lobes.density(sample.towards_light) / sample.density, 1, 1e-3) << s.name;
      for (int c = 0; c < 3; ++c)
        EXPECT_NEAR(value[c], sample.weight[c] * sample.density, 1e-3f * value[c] + 1e-6f)
            << s.name;
      ++compared;
    }
    EXPECT_GT(compared, 200) << s.name;
  }
}

TEST(MaterialLobes, NothingComesFromBelowTheSurfaceNorFromBelowItsOwnNormal) {
  LocalMaterial leaning = plastic_of(.5f);
  leaning.normal = glm::normalize(kUp + frame_around(kUp) * glm::vec3(1, 0, 0));
  const MaterialLobes lobes(leaning, kUp);
  EXPECT_EQ(lobes.evaluate(-kUp), (Rgb{}));
  // Above the leaning plane and below the surface
  const glm::vec3 side = frame_around(kUp) * glm::normalize(glm::vec3(1, 0, -.2f));
  ASSERT_GT(glm::dot(side, leaning.normal), .1f);
  EXPECT_EQ(lobes.evaluate(side), (Rgb{}));
  EXPECT_GT(lobes.evaluate(kUp).g, .1f);
}

TEST(MaterialLobes, ClearPlasticCoversAsMuchAsItMirrors) {
  LocalMaterial clear = plastic_of(.1f, {0, 0, 0});
  clear.transmitted = 1;
  for (const float cosine : {.1f, .5f, 1.f}) {
    const MaterialLobes lobes(clear, viewer_at(cosine));
    EXPECT_NEAR(lobes.cover(), of_even_light(lobes).g, .01) << cosine;
  }
  clear.opacity = .25f;
  EXPECT_NEAR(MaterialLobes(clear, kUp).cover(), .25 * .04, .001);
}

}  // namespace
}  // namespace penumbra::prt
