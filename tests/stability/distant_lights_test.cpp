// Where compact sources are found, and that nothing is lost or made in finding them.
#include <gtest/gtest.h>

#include "lighting/lighting.h"
#include "tests/stability/maps.h"

namespace penumbra::lighting {
namespace {

using glm::dvec3;
using test::kDegree, test::kSunRadius;

constexpr int kMapWidth = 1024, kMapHeight = 512;
constexpr Rgb kSun{46000, 43000, 38000};

LightExtraction split_of(const Image<Rgb>& map) {
  LightExtraction split;
  EXPECT_TRUE(extract_lights(map, {}, split));
  return split;
}

dvec3 random_direction(std::mt19937& rng) {
  std::normal_distribution<double> gauss;
  return glm::normalize(dvec3(gauss(rng), gauss(rng), gauss(rng)));
}

// ------------------------------------------------------------------------- zenith, seam and poles

// Connected regions of a picture that does not know that it is a sphere.
int flat_regions_above(const Image<Rgb>& map, float level) {
  Image<std::uint8_t> seen(map.width(), map.height());
  std::vector<std::pair<int, int>> stack;
  int count = 0;
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      if (seen.at(x, y) || luminance(map.at(x, y)) <= level) continue;
      ++count;
      stack.assign(1, {x, y});
      seen.at(x, y) = 1;
      while (!stack.empty()) {
        const auto [px, py] = stack.back();
        stack.pop_back();
        for (int j = std::max(0, py - 1); j <= std::min(map.height() - 1, py + 1); ++j)
          for (int i = std::max(0, px - 1); i <= std::min(map.width() - 1, px + 1); ++i)
            if (!seen.at(i, j) && luminance(map.at(i, j)) > level) {
              seen.at(i, j) = 1;
              stack.emplace_back(i, j);
            }
      }
    }
  return count;
}

struct Path {
  const char* name;
  dvec3 (*at)(double offset_rad);  // the sun's way; 0 is the place that is crossed
  double radius_rad;
};

void PrintTo(const Path& p, std::ostream* out) {
  *out << p.name;
}

// The naive form: the core of a bright source is cut down to a hundredth of its peak instead of to
// its surroundings, and that pedestal becomes a second light in the same place.
class SunCrossing : public testing::TestWithParam<Path> {};

TEST_P(SunCrossing, IsOneLightInItsPlaceWithItsEnergy) {
  const auto [name, at, radius] = GetParam();
  const Image<Rgb> sky = test::sky_over_ground(kMapWidth, kMapHeight);
  const float dimmed = static_cast<float>(std::pow(kSunRadius / radius, 2));
  double worst_angle = 0, worst_energy = 0, worst_small = 0;
  std::size_t max_lights = 0;
  int most_flat = 0;
  for (double offset = -1.5; offset <= 1.5; offset += .075) {
    const dvec3 sun = at(offset * kDegree);
    Image<Rgb> map = sky;
    const double added = test::add_distant_light(map, sun, radius, kSun * dimmed).solid_angle;
    const LightExtraction split = split_of(map);
    ASSERT_FALSE(split.lights.empty()) << offset;
    max_lights = std::max(max_lights, split.lights.size());
    worst_angle = std::max(worst_angle, test::angle_between(split.lights[0].direction, sun));
    const dvec3 e = test::energy(split.lights[0]);
    for (int c = 0; c < 3; ++c)
      worst_energy =
          std::max(worst_energy, std::abs(e[c] / (double(kSun[c]) * dimmed * added) - 1));
    most_flat = std::max(most_flat, flat_regions_above(map, 6 * luminance(sky.at(0, 0))));
    const LightExtraction small = split_of(test::reduced(map, kMapHeight / 64));
    ASSERT_FALSE(small.lights.empty());
    worst_small = std::max(worst_small, test::angle_between(small.lights[0].direction, sun));
  }
  std::printf(
      "%s: %zu lights, direction %.3f deg, energy %.2f %%; naive: %d regions, 64 rows %.2f deg\n",
      name, max_lights, worst_angle / kDegree, 100 * worst_energy, most_flat,
      worst_small / kDegree);
  EXPECT_EQ(max_lights, 1U);
  EXPECT_LE(worst_angle, .1 * kDegree);
  EXPECT_LE(worst_energy, .01);
  EXPECT_TRUE(most_flat > 1 || worst_small > .5 * kDegree) << "the naive forms would do";
}

INSTANTIATE_TEST_SUITE_P(
    Lights, SunCrossing,
    testing::Values(
        Path{"zenith", [](double o) { return dvec3(test::direction_at(.7, kPi / 2 - o)); },
             kSunRadius},
        Path{"nadir", [](double o) { return dvec3(test::direction_at(-2.1, o - kPi / 2)); },
             kSunRadius},
        Path{"seam", [](double o) { return dvec3(test::direction_at(kPi + o, .6)); }, kSunRadius},
        Path{"middle", [](double o) { return dvec3(test::direction_at(o, 1)); }, kSunRadius},
        Path{"wide_at_zenith", [](double o) { return dvec3(test::direction_at(kPi, kPi / 2 - o)); },
             kDegree},
        Path{"wide_at_seam", [](double o) { return dvec3(test::direction_at(kPi + o, -.4)); },
             2 * kDegree}),
    [](const auto& p) { return std::string(p.param.name); });

// --------------------------------------------------------------------------------- opposite lights

TEST(Lights, TwoEqualOppositeLightsAreBothFound) {
  std::mt19937 rng(17);
  for (int i = 0; i < 8; ++i) {
    const dvec3 one = i == 0 ? dvec3(0, 1, 0) : random_direction(rng);
    Image<Rgb> map(kMapWidth, kMapHeight, {.3f, .3f, .3f});
    for (const dvec3& d : {one, -one})
      test::add_distant_light(map, d, 1.5 * kDegree, {900, 800, 700});
    const auto whole = project_latlong(map, 2);
    ASSERT_TRUE(whole);
    const RadianceSh& l = whole->light;
    const double linear = std::hypot(l[1].g, l[2].g, l[3].g) / (std::sqrt(3.) * l[0].g);
    EXPECT_LT(linear, .02) << "the naive dominant direction has a footing (1 for a single light)";
    const LightExtraction split = split_of(map);
    EXPECT_EQ(split.lights.size(), 2U);
    ASSERT_GE(split.lights.size(), 2U);
    const int first = glm::dot(split.lights[0].direction, one) > 0 ? 0 : 1;
    const auto source = [&](int k) { return split.lights[static_cast<std::size_t>(k)]; };
    EXPECT_LE(test::angle_between(source(first).direction, one), .1 * kDegree);
    EXPECT_LE(test::angle_between(source(1 - first).direction, -one), .1 * kDegree);
    EXPECT_NEAR(test::energy(source(0)).y / test::energy(source(1)).y, 1, .01);
  }
}

// -------------------------------------------------------------------------------------- range

struct Range {
  const char* name;
  double ratio, radius_deg;
};

void PrintTo(const Range& r, std::ostream* out) {
  *out << r.name;
}

class HighRange : public testing::TestWithParam<Range> {};

TEST_P(HighRange, NoSurfaceReceivesNegativeLightAndNoEnergyIsLost) {
  const auto [name, ratio, radius] = GetParam();
  const auto k = static_cast<float>(ratio);
  Image<Rgb> map = test::sky_over_ground(kMapWidth, kMapHeight, {.8f, 1, 1.3f}, {.3f, .25f, .2f});
  test::add_distant_light(map, test::direction_at(.4, .9), radius * kDegree,
                          {1.1f * k, k, .8f * k});
  const dvec3 all = test::energy(map);

  LightExtraction split = split_of(map);
  dvec3 parts = test::energy(split.residual.whole());
  for (const DistantLight& d : split.lights) parts += test::energy(d);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(parts[c] / all[c], 1, 1e-4) << name;
  ASSERT_FALSE(split.lights.empty());

  for (const int bands : {3, 5}) {
    EstimateOptions options;
    options.bands = bands;
    const auto estimate = estimate_map(map, options);
    ASSERT_TRUE(estimate);
    const auto naive = project_latlong(map, bands);
    ASSERT_TRUE(naive);
    const IrradianceSh residual = irradiance(estimate->light), whole = irradiance(naive->light);
    std::mt19937 rng(29);
    double smallest = 1e30, min_naive = 1e30;
    for (int i = 0; i < 4000; ++i) {
      const dvec3 n = random_direction(rng);
      Rgb ours = evaluate(residual, n);
      for (const DistantLight& d : estimate->lights) ours += irradiance(d, n);
      const Rgb theirs = evaluate(whole, n);
      for (int c = 0; c < 3; ++c) {
        const double mean = all[c] / 4;  // irradiance over all normals
        smallest = std::min(smallest, ours[c] / mean);
        min_naive = std::min(min_naive, theirs[c] / mean);
      }
    }
    std::printf("%s, %d bands: least irradiance %.4f of the mean, naive %.4f\n", name, bands,
                smallest, min_naive);
    EXPECT_GE(smallest, 0);
    EXPECT_LT(min_naive, -.05);
  }
}

INSTANTIATE_TEST_SUITE_P(Lights, HighRange,
                         testing::Values(Range{"million", 1e6, .6}, Range{"sharp", 1e7, .2666},
                                         Range{"extreme", 1e9, .2666}),
                         [](const auto& p) { return std::string(p.param.name); });

}  // namespace
}  // namespace penumbra::lighting
