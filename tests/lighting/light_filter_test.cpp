// Light over a stream: less noise, no lag.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "lighting/lighting.h"
#include "tests/support/lights.h"

namespace penumbra::lighting {
namespace {

using glm::dvec3;

constexpr std::int64_t kFilterMapNs = 33'333'333;
constexpr double kNoise = .01;

// A light with structure in all nine bands, turned about the vertical.
ShProjection turned(double angle_rad) {
  const double c = std::cos(angle_rad), s = std::sin(angle_rad);
  const ShRotation turn(glm::dmat3(dvec3(c, 0, -s), dvec3(0, 1, 0), dvec3(s, 0, c)), kMaxBands);
  return {turn * test::random_light(kMaxBands, 5), turn * test::random_light(kMaxBands, 6), 1};
}

void each_value(ShProjection& p, auto change) {
  for (RadianceSh* part : {&p.light, &p.upper_moments})
    for (Rgb& term : part->terms())
      for (int c = 0; c < 3; ++c) term[c] = static_cast<float>(change(double(term[c])));
}

ShProjection with_noise(ShProjection p, double sigma, std::mt19937& rng) {
  std::normal_distribution<double> gauss(0, sigma);
  each_value(p, [&](double v) { return v + gauss(rng); });
  return p;
}

struct Values {
  std::vector<double> v;
  explicit Values(ShProjection p) {
    each_value(p, [&](double x) { return v.push_back(x), x; });
  }
  double dot(const Values& o) const {
    double sum = 0;
    for (std::size_t i = 0; i < v.size(); ++i) sum += v[i] * o.v[i];
    return sum;
  }
  friend Values operator-(Values a, const Values& b) {
    for (std::size_t i = 0; i < a.v.size(); ++i) a.v[i] -= b.v[i];
    return a;
  }
  double rms() const { return std::sqrt(dot(*this) / static_cast<double>(v.size())); }
};

ShProjection filtered(LightFilter& filter, std::int64_t time_ns, ShProjection p) {
  filter.update(TimestampNs{time_ns}, p);
  return p;
}

// Naive: exponential smoothing with the gain that the filter has on a light that stands.
struct Smoothing {
  double gain;
  std::optional<Values> state;
  const Values& update(const ShProjection& p) {
    const Values z(p);
    if (!state) state = z;
    for (std::size_t i = 0; i < z.v.size(); ++i) state->v[i] += gain * (z.v[i] - state->v[i]);
    return *state;
  }
};

// -------------------------------------------------------------------------- a light that stands

TEST(LightFilter, NoiseOfAStaticLightFallsByTheGainsFactor) {
  for (const double noise : {.0005, .01, .2}) {
    std::mt19937 rng(1);
    LightFilter filter;
    const ShProjection truth = turned(0);
    double square_in = 0, square_out = 0, gain = 0, drift = 0;
    constexpr int kMaps = 400, kReady = 60;
    for (int i = 0; i < kMaps; ++i) {
      const ShProjection measured = with_noise(truth, noise, rng),
                         out = filtered(filter, i * kFilterMapNs, measured);
      if (i < kReady) continue;
      square_in += std::pow((Values(measured) - Values(truth)).rms(), 2);
      square_out += std::pow((Values(out) - Values(truth)).rms(), 2);
      gain += filter.gain() / (kMaps - kReady);
      drift += out.light[0].g - truth.light[0].g;
    }
    // A constant gain k leaves k/(2 - k) of the variance.
    const double factor = std::sqrt(square_out / square_in), due = std::sqrt(gain / (2 - gain));
    std::printf("noise %g: gain %.3f, falls to %.3f, expected %.3f\n", noise, gain, factor, due);
    EXPECT_NEAR(factor, due, .05 * due);
    if (noise > .005) {
      EXPECT_LT(factor, .33);
    }
    EXPECT_LT(std::abs(drift / (kMaps - kReady)), 3 * noise / std::sqrt(kMaps - kReady))
        << "energy";
  }
}

double rms_irradiance(const RadianceSh& light) {
  double square = 0;
  for (int l = 0; l < light.bands(); ++l)
    for (int n = coefficient_count(l); n < coefficient_count(l + 1); ++n)
      square += std::pow(cosine_coefficient(l) * double(luminance(light[n])), 2);
  return std::sqrt(square / (4 * kPi));
}

TEST(LightFilter, TellsTheNoiseOfTheIrradianceThatItLeaves) {
  const ShProjection truth = turned(0);
  for (const double noise : {.0005, .01, .2}) {
    double error = 0, told = 0;
    constexpr int kRuns = 40, kLongest = 40;
    for (int run = 0; run < kRuns; ++run) {
      std::mt19937 rng(static_cast<unsigned>(run));
      LightFilter filter;
      EXPECT_FALSE(filter.irradiance_noise());
      ShProjection last;
      for (int i = 0; i < kLongest; ++i)
        last = filtered(filter, i * kFilterMapNs, with_noise(truth, noise, rng));
      for (int n = 0; n < last.light.size(); ++n) last.light[n] += -1.f * truth.light[n];
      error += std::pow(rms_irradiance(last.light), 2) / kRuns;
      ASSERT_TRUE(filter.irradiance_noise());
      told += std::pow(*filter.irradiance_noise(), 2) / kRuns;
    }
    std::printf("noise %g: irradiance off by %.3g, told %.3g\n", noise, std::sqrt(error),
                std::sqrt(told));
    // The filter expects the light to drift a little, which this one does not.
    EXPECT_GT(told, error) << noise;
    EXPECT_LT(told, 1.6 * 1.6 * error) << noise;
  }
}

TEST(LightFilter, EachCoefficientHasItsOwnNoise) {
  // The even part trembles a hundred times as much as the rest: the rest must not be kept from it.
  std::mt19937 rng(2);
  std::normal_distribution<float> gauss(0, .1f);
  LightFilter filter;
  const ShProjection truth = turned(0);
  double mean_in = 0, mean_out = 0, rest_out = 0;
  for (int i = 0; i < 400; ++i) {
    ShProjection p = with_noise(truth, .001, rng);
    for (int c = 0; c < 3; ++c) p.light[0][c] += gauss(rng);
    const double in = p.light[0].g - truth.light[0].g;
    filter.update(TimestampNs{i * kFilterMapNs}, p);
    if (i < 100) continue;
    mean_in += in * in;
    mean_out += std::pow(p.light[0].g - truth.light[0].g, 2);
    rest_out += std::pow(p.light[40].g - truth.light[40].g, 2);
  }
  std::printf("mean falls to %.2f, another coefficient to %.2f\n", std::sqrt(mean_out / mean_in),
              std::sqrt(rest_out / 300) / .001);
  EXPECT_LT(std::sqrt(mean_out / mean_in), .5);
  EXPECT_LT(std::sqrt(rest_out / 300), .6 * .001);
}

TEST(LightFilter, NoiselessLightPassesBitForBitWhetherItStandsOrChanges) {
  LightFilter filter;
  for (int i = 0; i < 60; ++i) {
    const ShProjection in = turned(i < 20 ? 0 : i < 40 ? .01 * i : 1.5 + .3 * (i % 2));
    const ShProjection out = filtered(filter, i * kFilterMapNs, in);
    ASSERT_LT((Values(out) - Values(in)).rms(), 1e-6 * Values(in).rms()) << i;
    if (i < 20) {
      ASSERT_EQ(out.light, in.light) << i;
      ASSERT_EQ(out.upper_moments, in.upper_moments) << i;
    }
  }
}

// -------------------------------------------------------------------------- another light

TEST(LightFilter, SwitchedLampIsFollowedInTheNextMapWhereSmoothingLags) {
  constexpr int kOn = 90, kOff = 140, kEnd = 170;
  for (const double lamp : {.2, .05}) {  // per coefficient: 20 and 5 sigma
    std::mt19937 rng(3);
    LightFilter filter;
    Smoothing naive{.12, {}};
    const ShProjection off = turned(0);
    ShProjection on = off;
    double sign = 1;
    each_value(on, [&](double v) { return v + lamp * (sign = -sign); });
    for (int i = 0; i < kEnd; ++i) {
      const bool is_on = i >= kOn && i < kOff;
      const ShProjection measured = with_noise(is_on ? on : off, kNoise, rng),
                         out = filtered(filter, i * kFilterMapNs, measured);
      const Values& smooth = naive.update(measured);
      const Values truth(is_on ? on : off);
      if (i == kOn || i == kOff) {
        EXPECT_EQ(out.light, measured.light);
        EXPECT_EQ(out.upper_moments, measured.upper_moments);
        EXPECT_GT((smooth - truth).rms(), .5 * lamp) << "smoothing would do";
      }
      if (i == kOn - 1 || i == kOff - 1 || i == kEnd - 1) {
        EXPECT_LT((Values(out) - truth).rms(), .5 * kNoise) << i;
      }
    }
  }
}

TEST(LightFilter, EvenLightThatIsDimmedIsFollowedThoughOnlyItsMeanChanges) {
  std::mt19937 rng(4);
  LightFilter filter;
  const ShProjection bright{test::constant_light({1, 1, 1}, 9), test::constant_light({1, 1, 1}, 9),
                            1};
  ShProjection dim = bright;
  dim.light[0] = dim.light[0] * .97f;
  for (int i = 0; i < 80; ++i) filtered(filter, i * kFilterMapNs, with_noise(bright, kNoise, rng));
  const ShProjection measured = with_noise(dim, kNoise, rng),
                     out = filtered(filter, 80 * kFilterMapNs, measured);
  EXPECT_EQ(out.light, measured.light);
}

TEST(LightFilter, GrownNoiseIsLearnedAndDoesNotSwitchTheFilterOff) {
  std::mt19937 rng(5);
  LightFilter filter;
  const ShProjection truth = turned(0);
  int i = 0;
  for (; i < 100; ++i) filtered(filter, i * kFilterMapNs, with_noise(truth, .001, rng));
  for (; i < 200; ++i) filtered(filter, i * kFilterMapNs, with_noise(truth, .02, rng));
  double square = 0;
  for (; i < 300; ++i)
    square += std::pow(
        (Values(filtered(filter, i * kFilterMapNs, with_noise(truth, .02, rng))) - Values(truth))
            .rms(),
        2);
  EXPECT_LT(std::sqrt(square / 100), .4 * .02);
}

// -------------------------------------------------------------------------- a light that moves

// Lag in maps along the way that the light takes, and the change of one map over the noise.
struct Lag {
  double maps, change_sigma, naive_maps;
};

Lag lag_of_turn(double rad_per_map, double noise) {
  std::mt19937 rng(6);
  LightFilter filter;
  Smoothing naive{.12, {}};
  double along = 0, naive_along = 0, way = 0;
  double angle = 0, change = 0;
  for (int i = 0; i < 160; ++i) {
    const ShProjection before = turned(angle);
    if (i >= 60) angle += rad_per_map;  // from rest
    const ShProjection now = turned(angle), measured = with_noise(now, noise, rng);
    const Values out(filtered(filter, i * kFilterMapNs, measured)), smooth = naive.update(measured);
    if (i < 61) continue;
    const Values step = Values(now) - Values(before);
    along += step.dot(Values(now) - out);
    naive_along += step.dot(Values(now) - smooth);
    way += step.dot(step);
    change = step.rms();
  }
  return {along / way, change / noise, naive_along / way};
}

TEST(LightFilter, SteadyTurnLagsLessThanOneMapsChange) {
  for (const double noise : {1e-5, .001, .01, .05})
    for (const double degrees : {.05, .2, .5, 1., 3.}) {
      const Lag lag = lag_of_turn(degrees * kPi / 180, noise);
      std::printf("noise %g, %g deg a map = %.2f sigma: lag %.2f maps, smoothing %.1f\n", noise,
                  degrees, lag.change_sigma, lag.maps, lag.naive_maps);
      // What is slower than a third of the noise in a map cannot be told from it: there the lag is
      // below the noise of one map.
      if (lag.change_sigma > .35) {
        EXPECT_LT(std::abs(lag.maps), 1) << noise << ' ' << degrees;
      } else {
        EXPECT_LT(std::abs(lag.maps) * lag.change_sigma, .6) << noise << ' ' << degrees;
      }
      if (degrees == .5) {
        EXPECT_GT(lag.naive_maps, 4) << "smoothing would do";
      }
    }
}

TEST(LightFilter, StandsStillAgainAfterATurn) {
  std::mt19937 rng(7);
  LightFilter filter;
  double angle = 0;
  for (int i = 0; i < 200; ++i) {
    if (i >= 60 && i < 120) angle += .01;
    filtered(filter, i * kFilterMapNs, with_noise(turned(angle), kNoise, rng));
  }
  EXPECT_LT(filter.gain(), .25);
}

// -------------------------------------------------------------------------- time

TEST(LightFilter, IrregularStepsMeasureTheSameNoise) {
  std::mt19937 rng(8);
  std::uniform_real_distribution<double> step(.2, 2.5);
  LightFilter filter;
  const ShProjection truth = turned(0);
  double square = 0, time = 0;
  for (int i = 0; i < 300; ++i) {
    time += step(rng) * kFilterMapNs;
    const auto out =
        filtered(filter, static_cast<std::int64_t>(time), with_noise(truth, kNoise, rng));
    if (i >= 60) square += std::pow((Values(out) - Values(truth)).rms(), 2) / 240;
  }
  EXPECT_LT(std::sqrt(square), .35 * kNoise);
  // After a long gap, the newest map counts.
  ShProjection later = with_noise(truth, kNoise, rng);
  filter.update(TimestampNs{static_cast<std::int64_t>(time) + 60'000'000'000}, later);
  EXPECT_GT(filter.gain(), .9);
}

TEST(LightFilter, RepeatedTimestampsNeitherDivideByZeroNorMoveAKnownLight) {
  std::mt19937 rng(9);
  LightFilter filter;
  const ShProjection truth = turned(0);
  ShProjection last;
  for (int i = 0; i < 100; ++i) {
    const ShProjection measured = with_noise(truth, kNoise, rng);
    for (int again = 0; again < 3; ++again) {
      last = filtered(filter, i / 2 * kFilterMapNs, measured);
      for (const double v : Values(last).v) ASSERT_TRUE(std::isfinite(v)) << i;
    }
  }
  EXPECT_LT((Values(last) - Values(truth)).rms(), .6 * kNoise);
  LightFilter still;  // maps without time pass as they are
  for (int i = 0; i < 10; ++i) {
    const ShProjection p = turned(.3 * i);
    EXPECT_EQ(filtered(still, 0, p).light, p.light);
  }
}

TEST(LightFilter, TimeThatGoesBackOrOtherBandsStartAgain) {
  std::mt19937 rng(10);
  LightFilter filter;
  for (int i = 0; i < 50; ++i)
    filtered(filter, i * kFilterMapNs, with_noise(turned(0), kNoise, rng));
  const ShProjection first = with_noise(turned(0), kNoise, rng);
  EXPECT_EQ(filtered(filter, 0, first).light, first.light);
  const ShProjection fewer{first.light.with_bands(3), first.upper_moments.with_bands(3), 1};
  EXPECT_EQ(filtered(filter, kFilterMapNs, fewer).light, fewer.light);
}

// -------------------------------------------------------------------------- bad input

TEST(LightFilter, NanNeverSticks) {
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), -std::numeric_limits<float>::infinity()}) {
    std::mt19937 rng(11);
    LightFilter filter;
    const ShProjection truth = turned(0);
    for (int i = 0; i < 90; ++i) {
      ShProjection p = with_noise(truth, kNoise, rng);
      if (i == 0 || i == 2 || i == 40) p.upper_moments[7].g = bad;
      filter.update(TimestampNs{i * kFilterMapNs}, p);
      if (i == 0) continue;  // nothing is known yet
      for (const double v : Values(p).v) ASSERT_TRUE(std::isfinite(v)) << bad << ' ' << i;
      if (i == 40) {
        EXPECT_LT((Values(p) - Values(truth)).rms(), .5 * kNoise) << "what was known stands in";
      }
      if (i == 89) {
        EXPECT_LT((Values(p) - Values(truth)).rms(), .5 * kNoise) << bad;
      }
    }
  }
}

TEST(LightFilter, NoLightStaysNoLight) {
  LightFilter filter;
  const ShProjection none{RadianceSh(9), RadianceSh(9), 1};
  for (int i = 0; i < 20; ++i)
    EXPECT_EQ(filtered(filter, i * kFilterMapNs, none).light, none.light);
  const ShProjection lamp = turned(0);
  EXPECT_EQ(filtered(filter, 20 * kFilterMapNs, lamp).light, lamp.light);
  EXPECT_EQ(filtered(filter, 21 * kFilterMapNs, none).light, none.light);
}

// -------------------------------------------------------------------------- in the estimator

Environment noisy_room(std::mt19937& rng, std::int64_t time_ns, double noise) {
  std::normal_distribution<float> gauss(1, static_cast<float>(noise));
  Environment e;
  e.radiance = Image<Rgb>(64, 32);
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 64; ++x) {
      const dvec3 d = latlong_direction(x + .5, y + .5, 64, 32);
      const float l = (d.y > 0 ? 1.f : .4f) + (d.x > .9 ? 1.5f : 0.f);
      e.radiance.at(x, y) = Rgb{l, .8f * l, .6f * l} * std::max(0.f, gauss(rng));
    }
  e.time = TimestampNs{time_ns};
  return e;
}

TEST(EstimateStream, FilteredLightHasLessNoiseTheSameEnergyAndIsRepeatable) {
  LightEstimator with({}), again({}), without({.filter = false});
  std::mt19937 rng(12);
  std::vector<double> a, b;
  for (int i = 0; i < 200; ++i) {
    const Environment e = noisy_room(rng, i * kFilterMapNs, .3);
    const auto x = with.estimate(e), y = without.estimate(e), z = again.estimate(e);
    ASSERT_TRUE(x && y && z);
    EXPECT_EQ(x->light, z->light);
    EXPECT_EQ(x->upper_hemisphere_light, z->upper_hemisphere_light);
    if (i == 0) {
      EXPECT_EQ(x->light, y->light);
      EXPECT_EQ(x->upper_hemisphere_light, y->upper_hemisphere_light);
      const auto still = estimate_map(e.radiance, {});
      ASSERT_TRUE(still);
      EXPECT_EQ(still->light, y->light);
    }
    if (i < 50) continue;
    a.push_back(luminance(evaluate(irradiance(whole_upper_hemisphere_light(*x)), {0, 1, 0})));
    b.push_back(luminance(evaluate(irradiance(whole_upper_hemisphere_light(*y)), {0, 1, 0})));
  }
  const auto mean = [](const std::vector<double>& v) {
    double sum = 0;
    for (const double x : v) sum += x;
    return sum / static_cast<double>(v.size());
  };
  const auto flicker = [&](const std::vector<double>& v) {
    double sum = 0;
    for (std::size_t i = 1; i < v.size(); ++i) sum += std::pow(v[i] - v[i - 1], 2);
    return std::sqrt(sum / static_cast<double>(v.size() - 1)) / mean(v);
  };
  std::printf("flicker %.3f %%, unfiltered %.3f %%, energy off by %.4f %%\n", 100 * flicker(a),
              100 * flicker(b), 100 * (mean(a) / mean(b) - 1));
  EXPECT_LT(flicker(a), .4 * flicker(b));
  EXPECT_NEAR(mean(a) / mean(b), 1, .001);
}

}  // namespace
}  // namespace penumbra::lighting
