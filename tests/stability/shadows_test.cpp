// Shadows of lights against closed forms: penumbrae of a lifted object, colours of lit and shadowed
// floor.
#include <gtest/gtest.h>

#include "lighting/lighting.h"
#include "prt/prt.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/shading/composite_stage.h"
#include "shadows/shadows.h"
#include "tests/stability/maps.h"
#include "tests/stability/occlusion.h"
#include "tests/support/shadow_maps.h"

namespace penumbra::shadows {
namespace {

using glm::dvec3;
using test::kDegree, test::kSunRadius;

const prt::Plane kFloor{};

// A thin plate: seen from below, its rim at x = 0 is the edge of a half plane. Turned about the
// light's axis.
prt::Mesh plate(double height, double size, double yaw) {
  const auto h = static_cast<float>(height), s = static_cast<float>(size);
  prt::Mesh mesh = prt::make_box({0, h, -.5f * s}, {s, h + .01f * s, .5f * s}, 1, {.5f, .5f, .5f});
  prt::transform(mesh, glm::mat4_cast(glm::angleAxis(yaw, dvec3(0, 1, 0))));
  return mesh;
}

// Where the taken fraction first reaches a level, going into the shadow.
template <class Fraction>
double crossing(Fraction fraction, double level, double from, double to) {
  constexpr int kSteps = 4000;
  double last = fraction(from);
  for (int i = 1; i <= kSteps; ++i) {
    const double x = from + (to - from) * i / kSteps, here = fraction(x);
    if (here >= level)
      return x - (to - from) / kSteps * (here > last ? (here - level) / (here - last) : 0);
    last = here;
  }
  return NAN;
}

// Fraction of an even light on one side of a straight line at distance u radii from its centre.
double source_edge(double u) {
  u = std::clamp(u, -1., 1.);
  return .5 + (u * std::sqrt(1 - u * u) + std::asin(u)) / kPi;
}

// Naive: the floor's light under a light at the zenith in harmonics of few bands, blocked by the
// half plane x > 0 at height one.
class HarmonicEdge {
 public:
  explicit HarmonicEdge(int bands) {
    double zenith[kMaxCoefficients], basis[kMaxCoefficients];
    lighting::evaluate_basis(bands, {0, 1, 0}, zenith);
    constexpr int kRings = 200, kSpokes = 400;
    for (int j = 0; j < kRings; ++j)
      for (int i = 0; i < kSpokes; ++i) {
        const double sine = std::sqrt((j + .5) / kRings), a = 2 * kPi * (i + .5) / kSpokes;
        const dvec3 d(sine * std::cos(a), std::sqrt(1 - sine * sine), sine * std::sin(a));
        lighting::evaluate_basis(bands, d, basis);
        double radiance = 0;
        for (int n = 0; n < coefficient_count(bands); ++n) radiance += zenith[n] * basis[n];
        blocked_from_.emplace_back(-d.x / d.y, radiance);  // directions cosine-weighted
        all_ += radiance;
      }
  }
  double taken(double x) const {
    double sum = 0;
    for (const auto& [from, radiance] : blocked_from_) sum += x > from ? radiance : 0;
    return sum / all_;
  }

 private:
  std::vector<std::pair<double, double>> blocked_from_;
  double all_ = 0;
};

struct Case {
  const char* name;
  double radius_rad, yaw;
};
void PrintTo(const Case& c, std::ostream* out) {
  *out << c.name;
}

class LiftedObject : public testing::TestWithParam<Case> {};

TEST_P(LiftedObject, PenumbraWidensAsTheClosedFormSaysAndItsMiddleStays) {
  const auto [name, radius, yaw] = GetParam();
  // Fraction of the whole penumbra, which is 2 h tan a, between 10 % and 90 % of the light.
  const double fraction = crossing(source_edge, .9, -1, 1), tangent = std::tan(radius);
  EXPECT_NEAR(2 * fraction, 1.37, .01) << "of h tan a, methods 6";
  lighting::DistantLight light;
  light.direction = {0, 1, 0};
  light.radius = Radians(radius);
  light.radiance = {1, 1, 1};
  // Three times as large as the widest penumbra: a half plane where it matters.
  const double size = 3 * 2 * 2 * tangent;
  const dvec3 along = glm::angleAxis(yaw, dvec3(0, 1, 0)) * dvec3(1, 0, 0),
              aside = glm::angleAxis(yaw, dvec3(0, 1, 0)) * dvec3(0, 0, 1);
  double last_width[3] = {}, worst = 0, worst_height = 0, finest = 0, middle_off = 0, fall = 0;
  int compared = 0;
  for (double height = 0; height <= 2.0001; height += height < .1 ? .02 : .1) {
    const prt::Mesh mesh = plate(height, size, yaw);
    const SilhouetteMesh silhouette(mesh);
    const Caster caster{&mesh, &silhouette, {}};
    ShadowMap shadow;
    render_shadow_map({{&caster, 1}, {}, 1e-5f}, kFloor, light, {}, shadow);
    ASSERT_FALSE(shadow.empty()) << height;
    for (const float t : shadow.virtual_occlusion.pixels())
      ASSERT_TRUE(t >= 0 && t <= 1.0001f) << height;
    const double expected = 2 * height * tangent * fraction, cell = shadow.cell_m;
    for (int line = 0; line < 3; ++line) {
      const dvec3 start = (line - 1) * .1 * size * aside;
      const auto taken = [&](double x) { return test::taken_at(shadow, start + x * along); };
      const double from = -.4 * size, to = .45 * size, middle = crossing(taken, .5, from, to),
                   width = crossing(taken, .9, from, to) - crossing(taken, .1, from, to);
      ASSERT_TRUE(std::isfinite(width)) << height;
      // A map shows nothing finer than its own nodes: up to four cells it may blur by two.
      if (expected > 4 * cell) {
        if (std::abs(width / expected - 1) > worst) worst_height = height;
        worst = std::max(worst, std::abs(width / expected - 1));
        ++compared;
      } else {
        finest = std::max(finest, (width - expected) / cell);
      }
      middle_off = std::max(middle_off, (std::abs(middle) - .5 * cell) / std::max(expected, cell));
      fall = std::max(fall, (last_width[line] - width - cell) / std::max(expected, cell));
      last_width[line] = width;
    }
  }
  const HarmonicEdge harmonics(3);
  const auto naive = [&](double x) { return harmonics.taken(x); };
  const double naive_width = crossing(naive, .9, -8, 8) - crossing(naive, .1, -8, 8);
  std::printf(
      "%s: width off by %.1f %% (at %.2f m), near contact by %.1f cells, middle by %.1f %% of it, "
      "falls by %.1f %%; naive %.2f h for %.4f h\n",
      name, 100 * worst, worst_height, finest, 100 * middle_off, 100 * fall, naive_width,
      2 * tangent * fraction);
  EXPECT_GE(compared, 30);
  EXPECT_LE(worst, .15);
  EXPECT_LE(finest, 2);
  EXPECT_LE(middle_off, .1) << "the edge moves";
  // One of 16 rays is 6 % of the light, and where the edge is faint that is up to a tenth of its
  // width.
  EXPECT_LE(fall, .1) << "the penumbra narrows while the object is lifted";
  EXPECT_GT(naive_width / (2 * tangent * fraction), 1.15) << "harmonics would do";
}

INSTANTIATE_TEST_SUITE_P(
    Shadows, LiftedObject,
    testing::Values(Case{"sun", kSunRadius, 0}, Case{"sun_turned", kSunRadius, .5},
                    Case{"lamp", 2 * kDegree, 0}, Case{"lamp_turned", 2 * kDegree, 1.1},
                    Case{"window", 12 * kDegree, 0}, Case{"window_turned", 12 * kDegree, .3}),
    [](const auto& p) { return std::string(p.param.name); });

}  // namespace
}  // namespace penumbra::shadows
