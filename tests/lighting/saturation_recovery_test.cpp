// Sources clipped in every exposure: flagged at any fraction, and completed from what they light.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "lighting/lighting.h"
#include "tests/support/reflectance_patch.h"

namespace penumbra::lighting {
namespace {

using glm::dvec3;

constexpr int kWidth = 512, kHeight = 256;
constexpr double kDegree = kPi / 180;
const dvec3 kUp(0, 1, 0);

struct Lamp {
  dvec3 direction;
  double radius_rad;
  Rgb radiance;
  Rgb power() const {
    return radiance * static_cast<float>(4 * kPi * std::pow(std::sin(radius_rad / 2), 2));
  }
};

// A room of radiance about 1, floor darker, with lamps painted by 8 x 8 samples a pixel near them.
Image<Rgb> room_with(std::span<const Lamp> lamps) {
  Image<Rgb> map(kWidth, kHeight);
  constexpr int kFine = 8;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const dvec3 d = latlong_direction(x + .5, y + .5, kWidth, kHeight);
      Rgb& c = map.at(x, y) = Rgb{1, .9f, .8f} * static_cast<float>(1 + .4 * d.y);
      for (const Lamp& lamp : lamps) {
        if (glm::dot(d, lamp.direction) < std::cos(lamp.radius_rad + .02)) continue;
        int hits = 0;
        for (int k = 0; k < kFine * kFine; ++k)
          hits += glm::dot(latlong_direction(x + (k % kFine + .5) / kFine,
                                             y + (k / kFine + .5) / kFine, kWidth, kHeight),
                           lamp.direction) > std::cos(lamp.radius_rad);
        const float fraction = static_cast<float>(hits) / (kFine * kFine);
        c = c * (1 - fraction) + lamp.radiance * fraction;
      }
    }
  return map;
}

// Every channel ends at `level`.
Environment clip(const Image<Rgb>& map, float level) {
  Environment e;
  e.radiance = map;
  for (std::uint32_t i = 0; i < map.area(); ++i) {
    bool clipped = false;
    for (int c = 0; c < 3; ++c) {
      float& v = e.radiance.pixels()[i][c];
      clipped |= v > level;
      v = std::min(v, level);
    }
    if (clipped) e.clipped.push_back(i);
  }
  return e;
}

Rgb exact_irradiance(const Image<Rgb>& map, const dvec3& normal) {
  double sum[3] = {};
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      const double w =
          latlong_solid_angle(y, map.width(), map.height()) *
          std::max(0.,
                   glm::dot(normal, latlong_direction(x + .5, y + .5, map.width(), map.height())));
      for (int c = 0; c < 3; ++c) sum[c] += w * double(map.at(x, y)[c]);
    }
  return {float(sum[0]), float(sum[1]), float(sum[2])};
}

// A patch of the mean of a thousand noisy pixels: half a percent.
test::ReflectancePatch patch(const Image<Rgb>& map, const dvec3& normal, std::mt19937& rng) {
  std::normal_distribution<float> noise(1, .005f);
  const Rgb albedo{.5f, .48f, .45f};
  Rgb seen = exact_irradiance(map, normal) * albedo * static_cast<float>(1 / kPi);
  for (int c = 0; c < 3; ++c) seen[c] *= noise(rng);
  return {normal, seen, albedo};
}

LightEstimate estimate(const Environment& e) {
  const auto out = LightEstimator({}).estimate(e);
  EXPECT_TRUE(out);
  return *out;
}

Rgb power(const DistantLight& d) {
  return d.radiance * static_cast<float>(d.solid_angle_sr());
}

void expect_power(const Rgb& got, const Rgb& truth, double tolerance) {
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(got[c] / truth[c], 1, tolerance) << c;
}

const Lamp kSun{glm::normalize(dvec3(.4, .8, -.3)), .2666 * kDegree, {46000, 43000, 38000}};
const Lamp kLamp{glm::normalize(dvec3(-.6, .6, .3)), 4 * kDegree, {300, 250, 180}};
const Lamp kOther{glm::normalize(dvec3(.7, .5, .2)), 3 * kDegree, {200, 260, 330}};

TEST(ClippedLight, NothingClippedIsTheSameToTheBit) {
  const Lamp lamps[] = {kSun, kLamp, kOther};
  const auto map = room_with(lamps);
  LightExtraction plain, listed;
  ASSERT_TRUE(extract_lights(map, {}, plain));
  ASSERT_TRUE(extract_lights(map, {}, listed, {}));
  EXPECT_EQ(plain.residual.whole(), listed.residual.whole());
  const auto a = estimate(clip(map, 1e9f));
  const auto b = estimate_map(map, {});
  ASSERT_TRUE(b);
  EXPECT_TRUE(std::ranges::equal(a.light.terms(), b->light.terms()));
  ASSERT_EQ(a.lights.size(), b->lights.size());
  for (std::size_t i = 0; i < a.lights.size(); ++i) {
    EXPECT_EQ(a.lights[i].radiance, b->lights[i].radiance);
    EXPECT_FALSE(a.lights[i].clipped);
  }
}

TEST(ClippedLight, EnergyOfRestAndLightsIsTheMaps) {
  const Lamp lamps[] = {kSun, kLamp};
  const Environment e = clip(room_with(lamps), 8);
  LightExtraction split;
  ASSERT_TRUE(extract_lights(e.radiance, {}, split, e.clipped));
  for (const dvec3& n : {kUp, glm::normalize(dvec3(1, 1, -1)), dvec3(-1, 0, 0)}) {
    Rgb sum = exact_irradiance(split.residual.whole(), n);
    for (const DistantLight& d : split.lights) sum += irradiance(d, n);
    expect_power(sum, exact_irradiance(e.radiance, n), 2e-3);
  }
}

TEST(ClippedLight, IsALightBelowEveryShareAndBelowSixTimesTheMean) {
  for (const float level : {8.f, 3.f}) {  // of a room of about 1
    const Environment e = clip(room_with({&kSun, 1}), level);
    const auto light = estimate(e);
    ASSERT_EQ(light.lights.size(), 1U) << level;
    EXPECT_TRUE(light.lights[0].clipped);
    EXPECT_GT(glm::dot(light.lights[0].direction, kSun.direction), std::cos(.6 * kDegree));
    EXPECT_LT(luminance(power(light.lights[0])), .02 * luminance(kSun.power()));
    Environment silent = e;
    silent.clipped.clear();
    EXPECT_TRUE(estimate(silent).lights.empty());
  }
}

TEST(ClippedLight, LeavesTheGlowToALightOfItsOwn) {
  const Lamp lamps[] = {{kSun.direction, 5 * kDegree, {20, 20, 20}}, kSun};
  const auto light = estimate(clip(room_with(lamps), 40));
  const auto clipped = std::ranges::find_if(light.lights, &DistantLight::clipped);
  ASSERT_NE(clipped, light.lights.end());
  EXPECT_EQ(std::ranges::count_if(light.lights, &DistantLight::clipped), 1);
  EXPECT_LT(clipped->radius.value(), 1 * kDegree);
  EXPECT_GT(light.lights[0].radius.value(), 4 * kDegree) << "the glow";
}

TEST(ClippedLight, ComesBeforeStrongerOnesWhenThereAreTooMany) {
  const Lamp lamps[] = {kLamp, kOther, kSun};
  const Environment e = clip(room_with(lamps), 1000);  // the lamps are not clipped
  const auto light = LightEstimator({.lights = {.max_count = 1}}).estimate(e);
  ASSERT_TRUE(light);
  ASSERT_EQ(light->lights.size(), 1U);
  EXPECT_TRUE(light->lights[0].clipped);
}

TEST(ClippedLight, PixelsOutsideTheMapAreRefused) {
  Environment e = clip(room_with({&kSun, 1}), 8);
  e.clipped = {kWidth * kHeight};
  EXPECT_EQ(LightEstimator({}).estimate(e).error().code, ErrorCode::kInvalid);
  e.clipped = {7, 3};
  EXPECT_EQ(LightEstimator({}).estimate(e).error().code, ErrorCode::kInvalid);
}

TEST(SaturationRecovery, APatchGivesTheSun) {
  std::mt19937 rng(1);
  const auto map = room_with({&kSun, 1});
  const auto light = estimate(clip(map, 8));
  ASSERT_EQ(light.lights.size(), 1U);
  for (int trial = 0; trial < 10; ++trial) {
    const dvec3 normal = trial % 2 ? kUp : glm::normalize(dvec3(0, .5, -.5));
    const auto got = test::recover_from_patch(light, patch(map, normal, rng));
    ASSERT_TRUE(got) << got.error().detail;
    EXPECT_EQ((*got)[0].source, light.lights[0].id);
    expect_power((*got)[0].power, kSun.power(), .05);
    const DistantLight sun = completed(light.lights[0], (*got)[0].power);
    EXPECT_EQ(sun.radius, kSunRadius);
    EXPECT_TRUE(sun.shape.empty());
    expect_power(power(sun), (*got)[0].power, 1e-4);
  }
}

// Irradiance by an estimate whose lights were completed.
Rgb irradiance_with(const LightEstimate& light, std::span<const SaturationRecovery> completions,
                    const dvec3& normal) {
  Rgb sum = evaluate(irradiance(light.light), normal);
  for (const DistantLight& d : light.lights) {
    const auto c = std::ranges::find(completions, d.id, &SaturationRecovery::source);
    sum += irradiance(c == completions.end() ? d : completed(d, c->power), normal);
  }
  return sum;
}

TEST(SaturationRecovery, OnePatchGivesSeveralSourcesTheirLightTogether) {
  std::mt19937 rng(4);
  const Lamp lamps[] = {kLamp, kOther};
  const auto map = room_with(lamps);
  const auto light = estimate(clip(map, 8));
  ASSERT_EQ(light.lights.size(), 2U);
  const test::ReflectancePatch floor = patch(map, kUp, rng);
  const auto got = test::recover_from_patch(light, floor);
  ASSERT_TRUE(got) << got.error().detail;
  EXPECT_EQ(got->size(), 2U);
  for (const SaturationRecovery& r : *got) EXPECT_TRUE(r.is_guess) << r.source;
  const Rgb truth = exact_irradiance(map, kUp);
  expect_power(irradiance_with(light, *got, kUp), truth, .02);
  EXPECT_LT(luminance(irradiance_with(light, {}, kUp)), .6f * luminance(truth)) << "lost without";
}

// A window that saturates by little must not become a second sun.
TEST(SaturationRecovery, ASunTakesWhatAWindowBesideItCannotHold) {
  std::mt19937 rng(5);
  const Lamp window{glm::normalize(dvec3(-.6, .6, .3)), 9 * kDegree, {11, 11, 12}};
  const Lamp lamps[] = {kSun, window};
  const auto map = room_with(lamps);
  const auto light = estimate(clip(map, 8));
  ASSERT_EQ(light.lights.size(), 2U);
  const auto got = test::recover_from_patch(light, patch(map, kUp, rng));
  ASSERT_TRUE(got) << got.error().detail;
  ASSERT_EQ(got->size(), 1U);
  expect_power((*got)[0].power, kSun.power(), .1);
  expect_power(irradiance_with(light, *got, kUp), exact_irradiance(map, kUp), .02);
}

TEST(SaturationRecovery, OnePatchSaysWhyItCannot) {
  std::mt19937 rng(6);
  const auto map = room_with({&kSun, 1});
  const auto light = estimate(clip(map, 8));
  EXPECT_EQ(test::recover_from_patch(estimate(clip(map, 1e9f)), patch(map, kUp, rng)).error().code,
            ErrorCode::kInvalid);
  EXPECT_EQ(test::recover_from_patch(light, patch(map, -kUp, rng)).error().code,
            ErrorCode::kUndetermined);
  test::ReflectancePatch black = patch(map, kUp, rng);
  black.radiance = {};
  EXPECT_EQ(test::recover_from_patch(light, black).error().code, ErrorCode::kUndetermined);
  black.albedo.g = 0;
  EXPECT_EQ(test::recover_from_patch(light, black).error().code, ErrorCode::kInvalid);
}

// The floor gets less of one channel than what is unsaturated already brings: noise, and no reason
// for light that is less than none.
TEST(SaturationRecovery, NoChannelGetsNegativeLight) {
  std::mt19937 rng(3);
  const auto map = room_with({&kSun, 1}), dark = room_with({});
  const auto light = estimate(clip(map, 8));
  test::ReflectancePatch floor = patch(map, kUp, rng);
  floor.radiance.b = .8f * patch(dark, kUp, rng).radiance.b;
  const auto got = test::recover_from_patch(light, floor);
  ASSERT_TRUE(got) << got.error().detail;
  EXPECT_NEAR(got->front().power.b, power(light.lights[0]).b, 1e-5f) << "what was measured";
  EXPECT_GT(got->front().power.r, 0);
}

TEST(SaturationRecovery, AShadowEdgeGivesTheSunAtAnyScale) {
  std::mt19937 rng(4);
  std::normal_distribution<float> noise(1, .005f);
  const auto map = room_with({&kSun, 1}), dark = room_with({});
  const auto light = estimate(clip(map, 8));
  ASSERT_EQ(light.lights.size(), 1U);
  for (const dvec3& n : {kUp, glm::normalize(dvec3(.3, 1, .2))}) {
    const Rgb albedo = Rgb{.3f, .2f, .6f} * 17.f;  // unknown, and in other units
    const float by_pi = static_cast<float>(1 / kPi);
    const int id = light.lights[0].id;
    ShadowRegion regions[] = {
        {exact_irradiance(map, n) * albedo * by_pi},
        {exact_irradiance(dark, n) * albedo * by_pi, {1, 1, 1}, {}, {{id, {}}}}};
    for (ShadowRegion& r : regions)
      for (int c = 0; c < 3; ++c) r.radiance[c] *= noise(rng);
    const auto got = recover_from_shadows(light, {n, regions});
    ASSERT_TRUE(got) << got.error().detail;
    ASSERT_EQ(got->powers.size(), 1u);
    expect_power(got->powers[0].power, kSun.power(), .05);
    expect_power(got->albedo, albedo, .02);
    // What casts the shadow keeps a part of the other light from it, and less from the lit side.
    const Rgb others = exact_irradiance(dark, n), all = exact_irradiance(map, n);
    ShadowRegion beside[] = {{{}, {.9f, .8f, .7f}}, {{}, {.6f, .5f, .4f}, {}, {{id, {}}}}};
    for (int c = 0; c < 3; ++c) {
      beside[0].radiance[c] =
          (all[c] - others[c] + beside[0].others[c] * others[c]) * albedo[c] * by_pi;
      beside[1].radiance[c] = beside[1].others[c] * others[c] * albedo[c] * by_pi;
    }
    const auto by_parts = recover_from_shadows(light, {n, beside});
    ASSERT_TRUE(by_parts) << by_parts.error().detail;
    expect_power(by_parts->powers[0].power, kSun.power(), .05);
  }
}

TEST(SaturationRecovery, SaysInOneLineWhyItCannot) {
  std::mt19937 rng(5);
  const Lamp lamps[] = {kLamp, kOther};
  const auto map = room_with(lamps), dark = room_with({});
  const auto light = estimate(clip(map, 12));
  ASSERT_EQ(light.lights.size(), 2U);
  const test::ReflectancePatch up = patch(map, kUp, rng), down = patch(map, dvec3(0, -1, 0), rng),
                               unlit = patch(dark, kUp, rng);
  const auto error = [](const LightEstimate& e, const test::ReflectancePatch& on) {
    const auto got = test::recover_from_patch(e, on);
    if (got) return std::string("none");
    EXPECT_EQ(got.error().detail.find('\n'), std::string::npos);
    return std::string(got.error().code == ErrorCode::kUndetermined ? "" : "invalid ") +
           got.error().detail;
  };
  const auto has = [](const std::string& text, const char* part) {
    EXPECT_NE(text.find(part), std::string::npos) << text;
  };
  has(error(light, down), "does not face");
  test::ReflectancePatch lower = unlit;
  lower.radiance = lower.radiance * .8f;
  has(error(light, lower), "shows none of the saturated light");
  test::ReflectancePatch bad = up;
  bad.albedo.g = 0;
  has(error(light, bad), "invalid has an albedo");
  bad = up, bad.normal = {0, 2, 0};
  has(error(light, bad), "invalid has a normal");
  has(error(estimate(clip(map, 1e9f)), up), "invalid has no saturated light");

  const int id = light.lights[0].id;
  const auto shadow_error = [&](std::initializer_list<int> ids, const dvec3& n, float lit,
                                float shadowed) {
    ShadowRegion regions[] = {{{lit, lit, lit}}, {{shadowed, shadowed, shadowed}}};
    for (const int source : ids) regions[1].parts.push_back({source, {}});
    const auto got = recover_from_shadows(light, {n, regions});
    return got ? std::string("none") : got.error().detail;
  };
  const int other = light.lights[1].id;
  has(shadow_error({99}, kUp, 2, 1), "is not saturated");
  has(shadow_error({id, other}, kUp, 1, 2), "shows none of the saturated light");
  has(shadow_error({id, other}, kUp, 1, 0), "black in one channel");
  has(shadow_error({id, other}, -kUp, 2, 1), "does not face");
  has(shadow_error({id}, kUp, 2, 1), "tell its albedo and the saturated lights apart");
}

// Two shadows for four lamps, or a dark shadow beside a bright floor: what can be told is told, and
// no lamp gets less than was measured of it at another's cost.
TEST(SaturationRecovery, SaysWhatRegionsTellAndKeepsToTheBounds) {
  const Lamp strong{kOther.direction, kOther.radius_rad, kOther.radiance * 4.f};
  const Lamp lamps[] = {kLamp, strong};
  const auto map = room_with(lamps);
  const auto light = estimate(clip(map, 12));
  ASSERT_EQ(light.lights.size(), 2U);
  const Rgb albedo{.3f, .2f, .6f};
  const auto seen = [&](const Image<Rgb>& lit) {
    return ShadowRegion{exact_irradiance(lit, kUp) * albedo * static_cast<float>(1 / kPi)};
  };
  // The shadow of the strong lamp is a hundredth too dark for what was measured of the other.
  ShadowRegion regions[] = {seen(map), seen(room_with({}))};
  const int other = glm::dot(light.lights[0].direction, kLamp.direction) > .99 ? light.lights[1].id
                                                                               : light.lights[0].id;
  regions[1].parts.push_back({other, {}});
  regions[1].radiance = regions[1].radiance * .99f;
  const auto got = recover_from_shadows(light, {kUp, regions, albedo});
  ASSERT_TRUE(got) << got.error().detail;
  for (const SaturationRecovery& r : got->powers) {
    const auto& measured = *std::ranges::find(light.lights, r.source, &DistantLight::id);
    EXPECT_GE(luminance(r.power), .9f * luminance(power(measured))) << r.source;
  }
  Rgb sum = exact_irradiance(room_with({}), kUp);
  for (const SaturationRecovery& r : got->powers) {
    const auto& d = *std::ranges::find(light.lights, r.source, &DistantLight::id);
    sum += r.power * static_cast<float>(glm::dot(d.direction, kUp));
  }
  EXPECT_NEAR(luminance(sum) / luminance(exact_irradiance(map, kUp)), 1, .1)
      << "the floor's light comes out right";
}

// A wall beside the surface sends some of the lamp's light there, and some of its own.
TEST(SaturationRecovery, WhatThingsReflectThereIsNotTheLampsPower) {
  const auto map = room_with({&kSun, 1}), dark = room_with({});
  const auto light = estimate(clip(map, 8));
  const Rgb albedo{.3f, .2f, .6f}, more{.1f, .2f, .15f}, wall{.4f, .3f, .2f};
  const Rgb others = exact_irradiance(dark, kUp), all = exact_irradiance(map, kUp);
  ShadowRegion region{{}, {.9f, .9f, .9f}, wall, {{light.lights[0].id, Rgb{1, 1, 1} + more}}};
  for (int c = 0; c < 3; ++c)
    region.radiance[c] = static_cast<float>(albedo[c] / kPi) *
                         (.9f * others[c] + wall[c] + (1 + more[c]) * (all[c] - others[c]));
  const auto got = recover_from_shadows(light, {kUp, {&region, 1}, albedo});
  ASSERT_TRUE(got) << got.error().detail;
  expect_power(got->powers[0].power, kSun.power(), .05);
  const auto naive = test::recover_from_patch(light, {kUp, region.radiance, albedo});
  ASSERT_TRUE(naive);
  EXPECT_GT(naive->front().power.g / kSun.power().g, 1.15) << "the test shows nothing";
}

// One patch divides what is missing by what was measured, which of clipped lamps says nothing.
// Their shadows tell them apart, with the albedo or without.
TEST(SaturationRecovery, ShadowsTellSeveralLampsApart) {
  std::mt19937 rng(6);
  std::normal_distribution<float> noise(1, .005f);
  const Lamp strong{kOther.direction, kOther.radius_rad, kOther.radiance * 4.f};
  const Lamp lamps[] = {kLamp, strong};
  const auto map = room_with(lamps);
  const auto light = estimate(clip(map, 12));
  ASSERT_EQ(light.lights.size(), 2U);
  const auto id_of = [&](const Lamp& lamp) {
    return glm::dot(light.lights[0].direction, lamp.direction) >
                   glm::dot(light.lights[1].direction, lamp.direction)
               ? light.lights[0].id
               : light.lights[1].id;
  };
  const Rgb albedo{.3f, .2f, .6f};
  const auto seen = [&](const Image<Rgb>& lit, std::initializer_list<int> hidden) {
    ShadowRegion out{exact_irradiance(lit, kUp) * albedo * static_cast<float>(1 / kPi)};
    for (int c = 0; c < 3; ++c) out.radiance[c] *= noise(rng);
    for (const int source : hidden) out.parts.push_back({source, {}});
    return out;
  };
  const ShadowRegion regions[] = {seen(map, {}), seen(room_with({&strong, 1}), {id_of(kLamp)}),
                                  seen(room_with({&kLamp, 1}), {id_of(strong)})};
  const auto power_of = [&](const std::vector<SaturationRecovery>& powers, const Lamp& lamp) {
    return std::ranges::find(powers, id_of(lamp), &SaturationRecovery::source)->power;
  };
  for (const bool known : {true, false}) {
    const auto got =
        recover_from_shadows(light, {kUp, regions, known ? std::optional(albedo) : std::nullopt});
    ASSERT_TRUE(got) << got.error().detail;
    ASSERT_EQ(got->powers.size(), 2u);
    expect_power(power_of(got->powers, kLamp), kLamp.power(), .06);
    expect_power(power_of(got->powers, strong), strong.power(), .06);
  }
  const auto naive = test::recover_from_patch(light, {kUp, regions[0].radiance, albedo});
  ASSERT_TRUE(naive);
  const auto off = [&](const Lamp& lamp) {
    return std::abs(std::log(luminance(power_of(*naive, lamp)) / luminance(lamp.power())));
  };
  EXPECT_GT(std::max(off(kLamp), off(strong)), .2) << "the test shows nothing";
}

// ------------------------------------------------------------------------------------ memory

Environment at(Environment e, int map) {
  e.time = {map * 33'000'000LL};
  return e;
}

TEST(RecoveryMemory, KeepsTheEnergyWhileTheSourceStaysClipped) {
  std::mt19937 rng(6);
  const auto map = room_with({&kSun, 1});
  LightEstimator estimator({});
  const auto first = estimator.estimate(at(clip(map, 8), 0));
  ASSERT_TRUE(first);
  const test::ReflectancePatch floor = patch(map, kUp, rng);
  const auto got = test::recover_from_patch(*first, floor);
  ASSERT_TRUE(got);
  ASSERT_TRUE(estimator.add_recovery((*got)[0]));
  // Shorter exposures later raise the lower bound, not the sun.
  for (int k = 1; k < 10; ++k) {
    const auto later = estimator.estimate(at(clip(map, k < 5 ? 8.f : 16.f), k));
    ASSERT_TRUE(later);
    ASSERT_EQ(later->lights.size(), 1U);
    EXPECT_TRUE(later->lights[0].clipped);
    EXPECT_EQ(later->lights[0].id, got->front().source);
    EXPECT_EQ(later->lights[0].radius, kSunRadius);
    expect_power(power(later->lights[0]), kSun.power(), .05);
    // Completed again from the same patch, the answer is the same.
    const auto again = test::recover_from_patch(*later, floor);
    ASSERT_TRUE(again);
    expect_power((*again)[0].power, (*got)[0].power, .01);
  }
}

// The governor's prediction starts from the light as it was measured: over a lower bound it is
// none.
TEST(RecoveryMemory, NothingIsPromisedUntilASaturatedLightIsRecovered) {
  const auto map = room_with({&kSun, 1});
  LightEstimator estimator({});
  GovernorConfig config;
  config.limits.max_error = .9;  // any prediction would keep to it
  config.probes.deficit.assign(kMaxCoefficients, 0);
  estimator.set_governor(config);
  const auto first = estimator.estimate(at(clip(map, 8), 0));
  ASSERT_TRUE(first && first->plan && first->lights.size() == 1);
  EXPECT_TRUE(first->lights[0].is_lower_bound());
  EXPECT_TRUE(first->plan->lower_bound);
  EXPECT_FALSE(first->plan->within_budget);
  ASSERT_TRUE(estimator.add_recovery({first->lights[0].id, kSun.power()}));
  const auto second = estimator.estimate(at(clip(map, 8), 1));
  ASSERT_TRUE(second && second->lights.size() == 1);
  EXPECT_TRUE(second->lights[0].recovered);
  EXPECT_FALSE(second->plan->lower_bound);
  EXPECT_TRUE(second->plan->within_budget);
  // Harmonics alone have no place for it.
  EstimateOptions alone;
  alone.lights.max_count = 0;
  LightEstimator harmonics(alone);
  harmonics.set_governor(config);
  const auto blurred = harmonics.estimate(clip(map, 8));
  ASSERT_TRUE(blurred && blurred->plan);
  EXPECT_TRUE(blurred->plan->lower_bound);
}

// A warm and a cool lamp on two sides, one patch between them: what each sends nobody can tell.
TEST(RecoveryMemory, AGuessCompletesTheLightsAndPromisesNothing) {
  std::mt19937 rng(9);
  const Lamp lamps[] = {kLamp, kOther};
  const auto map = room_with(lamps);
  LightEstimator estimator({});
  GovernorConfig config;
  config.limits.max_error = .9;
  config.probes.deficit.assign(kMaxCoefficients, 0);
  estimator.set_governor(config);
  const auto first = estimator.estimate(at(clip(map, 8), 0));
  ASSERT_TRUE(first && first->lights.size() == 2);
  const auto got = test::recover_from_patch(*first, patch(map, kUp, rng));
  ASSERT_TRUE(got && got->size() == 2);
  for (const SaturationRecovery& r : *got) ASSERT_TRUE(estimator.add_recovery(r));
  const auto second = estimator.estimate(at(clip(map, 8), 1));
  ASSERT_TRUE(second && second->lights.size() == 2);
  for (const DistantLight& d : second->lights) {
    EXPECT_TRUE(d.is_lower_bound());
    EXPECT_GT(luminance(power(d)),
              1.5f * luminance(power(*std::ranges::find(first->lights, d.id, &DistantLight::id))));
  }
  EXPECT_TRUE(second->plan->lower_bound);
  EXPECT_FALSE(second->plan->within_budget);
}

// A sun that no camera sees and that nobody has told the power of is carried along: it takes no
// place among the lights of the plan, and no fine shadow.
TEST(RecoveryMemory, AnUnseenSunWithoutPowerCostsNoLight) {
  using namespace std::chrono;
  const SunSite site{50, 8, 0, sys_days{2026y / June / 21} + 10h};
  const dvec3 sun = sun_direction(site);
  const Lamp lamps[] = {kLamp, kOther};
  Environment environment = clip(room_with(lamps), 1e9f);
  environment.confidence = Image<float>(kWidth, kHeight, 1.f);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      if (glm::dot(latlong_direction(x + .5, y + .5, kWidth, kHeight), sun) > std::cos(.2))
        environment.confidence.at(x, y) = 0, environment.radiance.at(x, y) = {};
  GovernorConfig config;
  config.limits.max_error = .9;
  config.probes.deficit.assign(kMaxCoefficients, 0);
  EstimateOptions with;
  with.sun = site;
  LightEstimator plain({}), known(with);
  plain.set_governor(config), known.set_governor(config);
  const auto a = plain.estimate(environment), b = known.estimate(environment);
  ASSERT_TRUE(a && b && a->plan && b->plan);
  EXPECT_EQ(b->plan->lights, a->plan->lights);
  EXPECT_EQ(b->plan->fine_lights, a->plan->fine_lights);
  ASSERT_EQ(b->lights.size(), a->lights.size() + 1);
  EXPECT_EQ(b->lights.back().id, kUnseenSun);
  EXPECT_TRUE(b->plan->lower_bound) << "and nothing is promised";
  known.look_for_unseen_sun(false);
  const auto early = known.estimate(environment);
  ASSERT_TRUE(early);
  EXPECT_EQ(early->lights.size(), a->lights.size()) << "a camera has yet to come";
}

// A sun that comes out is handed over to the lights bit by bit; what a floor misses at that time is
// what neither part has.
TEST(RecoveryMemory, ALightThatIsFadingInIsRecoveredWhole) {
  std::mt19937 rng(9);
  // Clipped at a third: what the harmonics still have of it counts.
  const Lamp veiled{kSun.direction, 3 * kDegree, {100, 95, 90}};
  const auto map = room_with({&veiled, 1});
  LightEstimator estimator({});
  ASSERT_TRUE(estimator.estimate(at(clip(room_with({}), 30), 0)));
  const auto fading = estimator.estimate(at(clip(map, 30), 2));
  ASSERT_TRUE(fading && fading->lights.size() == 1);
  const auto whole = LightEstimator({}).estimate(clip(map, 30));
  ASSERT_LT(luminance(power(fading->lights[0])), .8f * luminance(power(whole->lights[0])))
      << "not fading: the test shows nothing";
  const auto got = test::recover_from_patch(*fading, patch(map, kUp, rng));
  ASSERT_TRUE(got);
  const auto taken = estimator.add_recovery((*got)[0]);
  ASSERT_TRUE(taken) << taken.error().detail;
  for (int k = 3; k < 60; ++k) {
    const auto later = estimator.estimate(at(clip(map, 30), k));
    ASSERT_TRUE(later && later->lights.size() == 1);
    if (k == 59) expect_power(power(later->lights[0]), veiled.power(), .15);
  }
}

TEST(RecoveryMemory, RefusesLessThanWasMeasuredAndUnknownLights) {
  LightEstimator estimator({});
  const auto light = estimator.estimate(clip(room_with({&kSun, 1}), 8));
  ASSERT_TRUE(light);
  const DistantLight& sun = light->lights[0];
  EXPECT_EQ(estimator.add_recovery({sun.id + 1, {1, 1, 1}}).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(estimator.add_recovery({sun.id, power(sun) * .5f}).error().code,
            ErrorCode::kUndetermined);
  EXPECT_EQ(estimator.add_recovery({sun.id, {NAN, 1, 1}}).error().code, ErrorCode::kNonFinite);
  EXPECT_TRUE(estimator.add_recovery({sun.id, power(sun)}));
}

TEST(RecoveryMemory, ForgetsASourceThatIsMeasuredAgain) {
  const Lamp dim{kLamp.direction, kLamp.radius_rad, {14, 14, 14}},
      bright{kLamp.direction, kLamp.radius_rad, {90, 90, 90}};
  const Environment clipped = clip(room_with({&bright, 1}), 16);
  LightEstimator estimator({});
  const auto first = estimator.estimate(at(clipped, 0));
  ASSERT_TRUE(first && first->lights.size() == 1);
  ASSERT_TRUE(estimator.add_recovery({first->lights[0].id, bright.power()}));
  const auto second = estimator.estimate(at(clipped, 1));
  expect_power(power(second->lights[0]), bright.power(), .1);
  const auto third = estimator.estimate(at(clip(room_with({&dim, 1}), 16), 2));
  ASSERT_EQ(third->lights.size(), 1U);
  EXPECT_FALSE(third->lights[0].clipped);
  EXPECT_LT(luminance(power(third->lights[0])), luminance(dim.power()));
  const auto fourth = estimator.estimate(at(clipped, 3));
  EXPECT_LT(luminance(power(fourth->lights[0])), .3 * luminance(bright.power()))
      << "a lower bound again";
}

}  // namespace
}  // namespace penumbra::lighting
