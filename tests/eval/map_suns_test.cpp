// Suns and lamps as maps really hold them: what is left of a map without its sources, and the edge
// of a shadow under the pixels that a light stands for.
#include <gtest/gtest.h>

#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"
#include "tests/stability/maps.h"
#include "tests/stability/occlusion.h"
#include "tests/support/environment_maps.h"
#include "tests/support/shadow_maps.h"

namespace penumbra {
namespace {

using glm::dvec3;

class Map : public testing::TestWithParam<const char*> {};

std::string name_of(const testing::TestParamInfo<const char*>& p) {
  return p.param;
}

// ---------------------------------------------------------------------------------- what is left

class MapSources : public Map {};

TEST_P(MapSources, LeaveNoNegativeRadianceAndNoNegativeIrradiance) {
  PENUMBRA_NEED_ENVIRONMENT(map, GetParam());
  lighting::LightExtraction split;
  ASSERT_TRUE(lighting::extract_lights(map, {}, split));
  for (int y = 0; y < split.residual.height(); ++y)
    for (const Rgb& c : split.residual.row(y))
      for (int i = 0; i < 3; ++i) ASSERT_GE(c[i], 0) << "row " << y;
  for (const lighting::DistantLight& d : split.lights)
    for (int i = 0; i < 3; ++i) ASSERT_GE(d.radiance[i], 0);
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  for (const auto& [largest, bands] : {std::pair(8, 3), {8, 5}, {1, 5}}) {
    const auto ours = lighting::estimate_map(map, {bands, {largest, .02}});
    const auto naive = lighting::project_latlong(map, bands);
    ASSERT_TRUE(ours && naive);
    const IrradianceSh residual = lighting::irradiance(ours->light),
                       whole = lighting::irradiance(naive->light);
    double mean = 0, smallest = HUGE_VAL, min_naive = HUGE_VAL;
    constexpr int kNormals = 4000;
    for (int k = 0; k < kNormals; ++k) {
      const dvec3 n = glm::normalize(dvec3(normal(random), normal(random), normal(random)));
      Rgb all = lighting::evaluate(residual, n);
      for (const lighting::DistantLight& d : ours->lights) all += lighting::irradiance(d, n);
      const Rgb theirs = lighting::evaluate(whole, n);
      mean += double(luminance(theirs)) / kNormals;
      for (int i = 0; i < 3; ++i) {
        smallest = std::min(smallest, double(all[i]));
        min_naive = std::min(min_naive, double(theirs[i]));
      }
    }
    std::printf(
        "%s, %d lights at most, %d bands: least irradiance %.3f of the mean, all in harmonics "
        "%.3f\n",
        GetParam(), largest, bands, smallest / mean, min_naive / mean);
    EXPECT_GE(smallest, 0) << largest << " lights, " << bands << " bands";
    if (std::string_view(GetParam()) == "rustig_koppie_puresky") {
      EXPECT_LT(min_naive / mean, -.05) << "nothing rings";
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Light, MapSources,
                         testing::Values("room", "clear_sky", "adams_place_bridge",
                                         "immenstadter_horn",
                                         "kloofendal_48d_partly_cloudy_puresky", "potsdamer_platz",
                                         "rustig_koppie_puresky", "st_fagans_interior",
                                         "studio_small_03", "venice_sunset"),
                         name_of);

// ---------------------------------------------------------------------------------- the sun's edge

// An edge at a height of one, along `aside`, which hides what crosses it at x > 0: the fraction of
// light that it takes at x, from directions and how much each brings.
class Edge {
 public:
  Edge(const dvec3& along, std::vector<std::pair<dvec3, double>> light) {
    for (const auto& [d, power] : light) {
      from_.emplace_back(-glm::dot(d, along) / d.y, power * d.y);
      all_ += power * d.y;
    }
    std::ranges::sort(from_);
  }
  /// Where it has taken so much.
  double at(double fraction) const {
    double sum = 0;
    for (const auto& [x, power] : from_)
      if ((sum += power) >= fraction * all_) return x;
    return NAN;
  }
  double width() const { return at(.9) - at(.1); }
  double middle() const { return at(.5); }

 private:
  std::vector<std::pair<double, double>> from_;
  double all_ = 0;
};

// What the first light was cut out of the map, by places within its pixels.
std::vector<std::pair<dvec3, double>> pixels_of_sun(const Image<Rgb>& map,
                                                    const lighting::LightExtraction& split) {
  constexpr int kParts = 8;
  std::vector<std::pair<dvec3, double>> out;
  const lighting::DistantLight& sun = split.lights[0];
  const double reach = 6 * sun.radius.value() + .02;
  for (int y = 0; y < map.height(); ++y) {
    const double weight = latlong_solid_angle(y, map.width(), map.height()) / (kParts * kParts);
    for (int x = 0; x < map.width(); ++x) {
      const double power = weight * double(luminance(map.at(x, y) - split.residual.at(x, y)));
      const dvec3 centre = latlong_direction(x + .5, y + .5, map.width(), map.height());
      if (power <= 0 || std::acos(std::min(1., glm::dot(centre, sun.direction))) > reach) continue;
      for (int j = 0; j < kParts; ++j)
        for (int i = 0; i < kParts; ++i)
          out.emplace_back(latlong_direction(x + (i + .5) / kParts, y + (j + .5) / kParts,
                                             map.width(), map.height()),
                           power);
    }
  }
  return out;
}

class MapSun : public Map {};

TEST_P(MapSun, ThrowsTheEdgeThatItsPixelsThrow) {
  PENUMBRA_NEED_ENVIRONMENT(map, GetParam());
  lighting::LightExtraction split;
  ASSERT_TRUE(lighting::extract_lights(map, {}, split));
  ASSERT_FALSE(split.lights.empty());
  const lighting::DistantLight& sun = split.lights[0];
  const auto pixels = pixels_of_sun(map, split);
  // What all of the map throws beside it, in harmonics.
  const auto naive_light = lighting::project_latlong(map, 3);
  ASSERT_TRUE(naive_light);
  std::vector<std::pair<dvec3, double>> harmonic;
  double basis[kMaxCoefficients];
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 256; ++x) {
      const dvec3 d = latlong_direction(x + .5, y + .5, 256, 128);
      lighting::evaluate_basis(3, d, basis);
      double radiance = 0;
      for (int n = 0; n < 9; ++n) radiance += basis[n] * double(luminance(naive_light->light[n]));
      harmonic.emplace_back(d, radiance * latlong_solid_angle(y, 256, 128));
    }
  constexpr int kEdges = 8, kHeights = 24;
  double ratios = 0, narrowest = HUGE_VAL, widest = 0, naive_ratio = HUGE_VAL;
  int compared = 0;
  for (int edge = 0; edge < kEdges; ++edge) {
    const double yaw = kPi * edge / kEdges;
    const dvec3 along(std::cos(yaw), 0, -std::sin(yaw)), aside(std::sin(yaw), 0, std::cos(yaw));
    const Edge truth(along, pixels), naive(along, harmonic);
    for (double height = .02; height <= 2.0001; height += height < .1 ? .02 : .1) {
      // Many times as large as the penumbra is wide, a half plane where it matters; and so large
      // that the plane's end of long shadows, ten radii away, lies beyond.
      const double away = height * std::hypot(sun.direction.x, sun.direction.z) / sun.direction.y,
                   size = std::max(10 * height * truth.width(), .25 * away);
      const auto s = static_cast<float>(size), h = static_cast<float>(height);
      prt::Mesh mesh =
          prt::make_box({0, h, -.5f * s}, {s, h + .001f * s, .5f * s}, 1, {.5f, .5f, .5f});
      prt::transform(mesh, glm::mat4_cast(glm::angleAxis(yaw, dvec3(0, 1, 0))));
      const shadows::SilhouetteMesh outline(mesh);
      const shadows::Caster caster{&mesh, &outline, {}};
      shadows::ShadowMap shadow;
      shadows::render_shadow_map({{&caster, 1}, {}, 1e-6f}, prt::Plane{}, sun, {}, shadow);
      ASSERT_FALSE(shadow.empty()) << height;
      // The plate's middle in the line of the sun, and there across its edge.
      const dvec3 below = -sun.direction * (height / sun.direction.y);
      const dvec3 start = glm::dot(below, aside) * aside;
      const double middle = height * truth.middle(), reach = .4 * size;
      const auto crossing = [&](double fraction) {
        constexpr int kSteps = 4000;
        double last = middle - reach;
        for (int i = 0; i <= kSteps; ++i) {
          const double x = middle + reach * (2. * i / kSteps - 1);
          if (test::taken_at(shadow, start + x * along) >= fraction) return .5 * (x + last);
          last = x;
        }
        return double{NAN};
      };
      const double all = test::taken_at(shadow, start + (middle + .8 * reach) * along);
      EXPECT_NEAR(all, 1, .02) << height;
      const double width = crossing(.9) - crossing(.1), expected = height * truth.width();
      ASSERT_TRUE(std::isfinite(width)) << height;
      EXPECT_NEAR(crossing(.5), middle, .15 * expected + shadow.cell_m) << height;
      const double ratio = width / expected;
      ratios += ratio, ++compared;
      narrowest = std::min(narrowest, ratio), widest = std::max(widest, ratio);
    }
    naive_ratio = std::min(naive_ratio, naive.width() / truth.width());
  }
  const double mean = ratios / compared;
  std::printf(
      "%s: width %.3f of what its pixels throw (%.3f to %.3f by the edge's direction), "
      "nine coefficients at least %.0f times\n",
      GetParam(), mean, narrowest, widest, naive_ratio);
  EXPECT_EQ(compared, kEdges * kHeights);
  EXPECT_NEAR(mean, 1, .15);
  // A sun of two pixels in one row is not round: no light has its edge in each direction.
  EXPECT_GT(narrowest, .8);
  EXPECT_LT(widest, 1.35);
  EXPECT_GT(naive_ratio, 1.15) << "harmonics would do";
}

INSTANTIATE_TEST_SUITE_P(Shadows, MapSun, testing::Values("clear_sky", "rustig_koppie_puresky"),
                         name_of);

}  // namespace
}  // namespace penumbra
