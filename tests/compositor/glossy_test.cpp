// Surfaces with materials as the compositor draws them, against closed forms: a ball alone in known
// surroundings, whose every pixel is known.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <memory>

#include "compositor/composite/compositor.h"
#include "lighting/lighting.h"
#include "lighting/reflections/ggx.h"
#include "lighting/reflections/octahedral_map.h"
#include "lighting/reflections/reflection_map.h"
#include "tests/support/scenes.h"

namespace penumbra::compositor {
namespace {

using glm::dvec3;
using lighting::ReflectionMap;
using test::kSceneHeight, test::kSceneWidth;

constexpr double kRadius = .4;
const dvec3 kCentre{0, .4, 0};

RadianceSh even_light(Rgb radiance) {
  RadianceSh light(3);
  light[0] = radiance * static_cast<float>(std::sqrt(4 * kPi));
  return light;
}

Image<Rgb> even_map(Rgb radiance) {
  Image<Rgb> map(256, 128);
  std::ranges::fill(map.pixels(), radiance);
  return map;
}

// Bright above, dark below, red to the right and blue behind: every direction tells itself.
Image<Rgb> striped_map() {
  Image<Rgb> map(1024, 512);
  for (int y = 0; y < 512; ++y)
    for (int x = 0; x < 1024; ++x) {
      const dvec3 d = latlong_direction(x + .5, y + .5, 1024, 512);
      map.at(x, y) = {static_cast<float>(1 + .8 * d.x), static_cast<float>(1 + .8 * d.y),
                      static_cast<float>(1 + .8 * std::sin(6 * d.z))};
    }
  return map;
}

std::shared_ptr<const ReflectionMap> reflections_of(const Image<Rgb>& map) {
  lighting::SurfaceRoughness all;
  all.add_range(0, 1);
  auto out = std::make_shared<ReflectionMap>();
  lighting::ReflectionFilter(all).filter(map, {}, RadianceSh(1), *out);
  return out;
}

// The normal where a pixel meets the ball; nothing beside it, and at its very edge.
std::optional<dvec3> normal_at(const prt::PinholeView& v, double px, double py) {
  const dvec3 eye = v.world_from_camera.translation, d = test::pixel_ray(v, px, py);
  const double b = glm::dot(eye - kCentre, d),
               c = glm::dot(eye - kCentre, eye - kCentre) - kRadius * kRadius, root = b * b - c;
  if (root < .12 * kRadius * kRadius) return std::nullopt;
  return glm::normalize(eye + d * (-b - std::sqrt(root)) - kCentre);
}

class GlossyBall : public testing::Test {
 protected:
  void SetUp() override {
    auto made = Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen, 4);
    if (!made && made.error().code == ErrorCode::kUnavailable)
      GTEST_SKIP() << "no OpenGL ES 3.1: " << made.error().detail;
    ASSERT_TRUE(made) << made.error().detail;
    compositor_ = std::move(*made);
    object_ = test::baked_sphere(false);
  }

  void add(const prt::Material& material, const RadianceSh& light,
           const Surroundings& surroundings) {
    prt::SurfaceMaterials surface;
    surface.materials = {material};
    surface.material.assign(object_.mesh.positions.size(), 0);
    for (const glm::vec3& n : object_.mesh.normals) {
      const glm::vec3 along = glm::cross(glm::vec3(0, 1, 0), n);
      surface.tangents.emplace_back(
          glm::length(along) > 1e-4f ? glm::normalize(along) : glm::vec3(1, 0, 0), 1.f);
      surface.coordinates[0].emplace_back(.5f + .5f * n.x, .5f - .5f * n.y);
    }
    object_.surface = std::make_shared<const prt::SurfaceMaterials>(std::move(surface));
    compositor_->set_surroundings(surroundings);
    handle_ = test::add_lit(*compositor_, object_, light);
  }
  Image<Rgb> drawn(Rgb behind = {0, 0, 0}) {
    FramePixels frame = Image<Rgb>(kSceneWidth, kSceneHeight, behind);
    const View v{test::scene_camera(), nullptr, 1};
    EXPECT_TRUE(compositor_->composite(v, frame));
    return std::get<Image<Rgb>>(frame);
  }
  // Calls what(normal, towards the eye, pixel's value) over the ball.
  template <class What>
  static void over_ball(const Image<Rgb>& picture, const What& what) {
    const prt::PinholeView v = test::scene_camera();
    for (int y = 0; y < kSceneHeight; ++y)
      for (int x = 0; x < kSceneWidth; ++x)
        if (const auto n = normal_at(v, x + .5, y + .5))
          what(*n, -test::pixel_ray(v, x + .5, y + .5), picture.at(x, y));
  }

  std::unique_ptr<Compositor> compositor_;
  prt::BakedObject object_;
  int handle_ = 0;
};

TEST_F(GlossyBall, WhiteMetalIsUnseenInEvenLightAtEveryRoughness) {
  const Surroundings even{reflections_of(even_map({1, 1, 1})), {}, even_light({1, 1, 1})};
  for (const float roughness : {0.f, .2f, .5f, .8f, 1.f}) {
    SetUp();
    add({.metallic = 1, .roughness = roughness}, even.light, even);
    double worst = 0;
    over_ball(drawn(), [&](const dvec3&, const dvec3&, const Rgb& c) {
      worst = std::max(worst, std::abs(double(c.g) - 1));
    });
    EXPECT_LT(worst, .01) << roughness;
  }
}

TEST_F(GlossyBall, WhitePlasticIsUnseenInEvenLight) {
  const Surroundings even{reflections_of(even_map({1, 1, 1})), {}, even_light({1, 1, 1})};
  for (const float roughness : {.1f, .5f, 1.f}) {
    SetUp();
    add({.metallic = 0, .roughness = roughness}, even.light, even);
    double worst = 0;
    over_ball(drawn(), [&](const dvec3&, const dvec3&, const Rgb& c) {
      worst = std::max(worst, std::abs(double(c.g) - 1));
    });
    EXPECT_LT(worst, .01) << roughness;
  }
}

TEST_F(GlossyBall, AMirrorReturnsTheMap) {
  const Image<Rgb> map = striped_map();
  const Surroundings striped{reflections_of(map), {}, even_light({1, 1, 1})};
  add({.metallic = 1, .roughness = 0}, striped.light, striped);
  double squares = 0;
  int count = 0;
  over_ball(drawn(), [&](const dvec3& n, const dvec3& v, const Rgb& c) {
    const glm::dvec2 p = latlong_pixel(2 * glm::dot(n, v) * n - v, 1024, 512);
    const Rgb truth = map.at(std::min(int(p.x), 1023), std::min(int(p.y), 511));
    squares += std::pow(c.r - truth.r, 2) + std::pow(c.g - truth.g, 2) + std::pow(c.b - truth.b, 2);
    count += 3;
  });
  ASSERT_GT(count, 3000);
  EXPECT_LT(std::sqrt(squares / count), .04);  // the ball has 1,280 triangles
}

// A Lambertian ball of the same albedo shows what it shows without a material, less what a
// dielectric reflects: the naive way, chalk.
TEST_F(GlossyBall, PlasticIsChalkPlusItsReflection) {
  const Image<Rgb> map = striped_map();
  const RadianceSh light = lighting::project_latlong(map, 3)->light;
  const Surroundings striped{reflections_of(map), {}, light};
  add({.base_colour = {.2f, .2f, .2f}, .metallic = 0, .roughness = .3f}, light, striped);
  const auto e = lighting::irradiance(light);
  double squares = 0, mean = 0, of_chalk = 0;
  int count = 0;
  over_ball(drawn(), [&](const dvec3& n, const dvec3& v, const Rgb& c) {
    const double n_dot_v = glm::dot(n, v);
    const glm::vec2 even = lighting::reflected_of_even(float(n_dot_v), .3f);
    const double again = lighting::more_than_once(even.x + even.y, .04f),
                 share = (.04 * even.x + even.y) * again;
    const dvec3 r = 2 * n_dot_v * n - v;
    const double mirrored = striped.reflections->place_of(.3f);
    const int low = int(mirrored);
    const double to_next = mirrored - low;
    const auto of = [&](int level) {
      return lighting::sample_octahedral(striped.reflections->levels[std::size_t(level)].picture, r)
          .g;
    };
    const double chalk = .2 * lighting::evaluate(e, n).g / kPi;
    const double truth =
        chalk * (1 - share) + share * (of(low) * (1 - to_next) + of(low + 1) * to_next);
    squares += std::pow(c.g - truth, 2), mean += truth, of_chalk += std::pow(chalk - truth, 2);
    ++count;
  });
  EXPECT_LT(std::sqrt(squares / count), .02 * mean / count);
  EXPECT_GT(std::sqrt(of_chalk / count), .15 * mean / count);
}

// The disc's highlight sends on what falls on it: its sum over the ball is that of the lobe.
TEST_F(GlossyBall, ALightsHighlightStandsWhereItMirrors) {
  Surroundings one{reflections_of(even_map({0, 0, 0})), {}, RadianceSh(3)};
  const dvec3 towards = glm::normalize(dvec3(1, 2, 2));
  one.lights.push_back({towards, .0047, {3, 3, 3}});
  add({.metallic = 1, .roughness = .4f}, RadianceSh(3), one);
  dvec3 middle(0);
  double most = 0;
  over_ball(drawn(), [&](const dvec3& n, const dvec3& v, const Rgb& c) {
    middle += double(c.g) * (2 * glm::dot(n, v) * n - v);
    most = std::max(most, double(c.g));
  });
  EXPECT_GT(glm::dot(glm::normalize(middle), towards), std::cos(.05));
  // Over a mirror direction: E D G / (4 n.l n.v) n.l with D = 1/(pi alpha^2).
  EXPECT_NEAR(most, 3 / (4 * kPi * std::pow(.4, 4)), .12 * most);
  // In shade there is none.
  std::vector<std::array<float, 4>> none(object_.mesh.positions.size(), {0, 0, 0, 0});
  compositor_->set_light_fractions(handle_, none);
  double left = 0;
  over_ball(drawn(), [&](const dvec3&, const dvec3&, const Rgb& c) { left += c.g; });
  EXPECT_LT(left, 1e-3);
}

// The naive way shows the floor that the camera of the surroundings saw, in full light.
TEST_F(GlossyBall, AMirrorShowsItsOwnShadowOnTheFloor) {
  object_ = test::baked_sphere(true);
  const RadianceSh light = even_light({1, 1, 1});
  const Surroundings even{reflections_of(even_map({1, 1, 1})), {}, light};
  for (const float roughness : {0.f, .5f}) {
    compositor_ = std::move(
        *Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen, 4));
    add({.metallic = 1, .roughness = roughness}, light, even);
    const test::Lit shown = test::lit(object_, light);
    double squares = 0, naive = 0;
    int count = 0;
    over_ball(drawn(), [&](const dvec3& n, const dvec3& v, const Rgb& c) {
      const dvec3 r = 2 * glm::dot(n, v) * n - v, at = kCentre + kRadius * n;
      if (r.y > -.3) return;
      const dvec3 floor = at - r * (at.y / r.y);
      const Rgb s =
          shadows::ratio_at(shown.shadow, object_.receiver->grid, glm::vec2(floor.x, floor.z));
      squares += std::pow(c.g - s.g, 2), naive += std::pow(1 - s.g, 2), ++count;
    });
    ASSERT_GT(count, 300);
    // Around a rough lobe's middle the floor is not one ratio.
    EXPECT_LT(std::sqrt(squares / count), roughness == 0 ? .05 : .15) << roughness;
    EXPECT_GT(std::sqrt(naive / count), .2) << roughness;
  }
}

// A neighbour is not in the mirror; the floor below it would be a black spot there.
TEST_F(GlossyBall, TheFloorBelowANeighbourIsNoBlackSpot) {
  object_ = test::baked_sphere(true);
  const RadianceSh light = even_light({1, 1, 1});
  add({.metallic = 1, .roughness = 0}, light, {reflections_of(even_map({1, 1, 1})), {}, light});
  const Image<Rgb> alone = drawn();
  const prt::BakedObject neighbour = test::baked_sphere(true);
  test::add_lit(*compositor_, neighbour, light, {{1, 0, 0, 0}, {1.3, 0, .2}});
  const Image<Rgb> both = drawn();
  double worst = 0;
  int below = 0;
  const prt::PinholeView v = test::scene_camera();
  for (int y = 0; y < kSceneHeight; ++y)
    for (int x = 0; x < kSceneWidth; ++x) {
      const auto n = normal_at(v, x + .5, y + .5);
      if (!n) continue;
      worst = std::max(worst, std::abs(double(both.at(x, y).g) - alone.at(x, y).g));
      const dvec3 towards = -test::pixel_ray(v, x + .5, y + .5),
                  r = 2 * glm::dot(*n, towards) * *n - towards, at = kCentre + kRadius * *n;
      if (r.y >= 0) continue;
      const dvec3 floor = at - r * (at.y / r.y);
      below += glm::length(floor - dvec3(1.3, 0, .2)) < .1 ? 1 : 0;
    }
  ASSERT_GT(below, 0);
  EXPECT_LT(worst, .01);
}

std::shared_ptr<const prt::TexturePicture> picture_of(Image<prt::Rgba8> codes) {
  auto out = std::make_shared<prt::TexturePicture>();
  out->codes = std::move(codes);
  return out;
}

TEST_F(GlossyBall, ATextureLiesWhereItsCoordinatesSay) {
  Image<prt::Rgba8> halves(64, 64);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x)
      halves.at(x, y) = x < 32 ? prt::Rgba8{255, 0, 0} : prt::Rgba8{0, 188, 0};
  const Surroundings even{reflections_of(even_map({1, 1, 1})), {}, even_light({1, 1, 1})};
  prt::Material m{.metallic = 0, .roughness = 1, .specular = 0};
  m.base_colour_map = {.picture = picture_of(std::move(halves))};
  add(m, even.light, even);
  over_ball(drawn(), [&](const dvec3& n, const dvec3&, const Rgb& c) {
    if (n.x < -.1) {
      EXPECT_NEAR(c.r, 1, .03);
      EXPECT_NEAR(c.g, 0, .03);
    }
    if (n.x > .1) {
      EXPECT_NEAR(c.g, .5, .03);  // 188 is .5 in sRGB
      EXPECT_NEAR(c.r, 0, .03);
    }
  });
}

TEST_F(GlossyBall, MaskedPlacesShowWhatIsBehindAndBlendedOnesAShareOfIt) {
  const Surroundings even{reflections_of(even_map({1, 1, 1})), {}, even_light({1, 1, 1})};
  Image<prt::Rgba8> halves(64, 64);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x) halves.at(x, y) = {255, 255, 255, std::uint8_t(x < 32 ? 0 : 255)};
  prt::Material masked{.metallic = 0, .roughness = 1, .specular = 0};
  masked.base_colour_map = {.picture = picture_of(std::move(halves))};
  masked.alpha = prt::Material::Alpha::kMask;
  add(masked, even.light, even);
  const auto front_of = [](const dvec3& n, const dvec3& v) { return glm::dot(n, v) > .5; };
  over_ball(drawn({7, 7, 7}), [&](const dvec3& n, const dvec3& v, const Rgb& c) {
    if (!front_of(n, v)) return;
    if (n.x > .1) {
      EXPECT_NEAR(c.g, 1, .02);
    }
  });
  SetUp();
  prt::Material half{.opacity = .5f, .metallic = 0, .roughness = 1, .specular = 0};
  half.alpha = prt::Material::Alpha::kBlend;
  add(half, even.light, even);
  over_ball(drawn({3, 3, 3}), [&](const dvec3&, const dvec3&, const Rgb& c) {
    EXPECT_NEAR(c.g, .5 * 1 + .5 * 3, .02);
  });
}

// Half red towards the eye, half green beyond, in the order of the materials and against it.
TEST_F(GlossyBall, BlendedMaterialsLieOverWhateverIsFarther) {
  const dvec3 to_eye = glm::normalize(test::scene_camera().world_from_camera.translation - kCentre);
  for (const std::uint16_t near : {0, 1}) {
    SetUp();
    prt::Material glass{.opacity = .5f, .unlit = true};
    glass.alpha = prt::Material::Alpha::kBlend;
    glass.double_sided = true;
    prt::SurfaceMaterials surface;
    surface.materials = {glass, glass};
    surface.materials[near].base_colour = {1, 0, 0};
    surface.materials[1 - near].base_colour = {0, 1, 0};
    for (const glm::vec3& n : object_.mesh.normals)
      surface.material.push_back(glm::dot(dvec3(n), to_eye) > 0 ? near : std::uint16_t(1 - near));
    object_.surface = std::make_shared<const prt::SurfaceMaterials>(std::move(surface));
    compositor_->set_surroundings({reflections_of(even_map({0, 0, 0})), {}, RadianceSh(3)});
    handle_ = test::add_lit(*compositor_, object_, RadianceSh(3));
    over_ball(drawn(), [&](const dvec3& n, const dvec3& v, const Rgb& c) {
      if (glm::dot(n, v) < .7) return;
      EXPECT_NEAR(c.r, .5, .02) << near;
      EXPECT_NEAR(c.g, .25, .02) << near;
    });
  }
}

TEST_F(GlossyBall, WhatGlowsIsSeenInTheDark) {
  Surroundings dark{reflections_of(even_map({0, 0, 0})), {}, RadianceSh(3), 2};
  add({.emission = {.5f, .25f, 0}}, RadianceSh(3), dark);
  over_ball(drawn(), [&](const dvec3&, const dvec3&, const Rgb& c) {
    EXPECT_NEAR(c.r, 1, .01);
    EXPECT_NEAR(c.g, .5, .01);
    EXPECT_NEAR(c.b, 0, .01);
  });
}

// A normal map that leans everywhere the same way shows the ball turned: the diffuse light follows.
TEST_F(GlossyBall, ANormalMapTurnsTheDiffuseLight) {
  const RadianceSh light = test::sloped_light(1, {.9, 0, 0}, 3);
  const Surroundings sloped{reflections_of(even_map({0, 0, 0})), {}, light};
  prt::Material m{.metallic = 0, .roughness = 1, .specular = 0};
  m.normal_map = {.picture = picture_of(Image<prt::Rgba8>(1, 1, {218, 128, 218, 255}))};
  add(m, light, sloped);
  const auto e = lighting::irradiance(light);
  double squares = 0, naive = 0;
  int count = 0;
  over_ball(drawn(), [&](const dvec3& n, const dvec3&, const Rgb& c) {
    const dvec3 along = glm::normalize(glm::cross(dvec3(0, 1, 0), n));
    const dvec3 leaning = glm::normalize(n + along);
    const double truth = lighting::evaluate(e, leaning).g / kPi;
    squares += std::pow(c.g - truth, 2);
    naive += std::pow(lighting::evaluate(e, n).g / kPi - truth, 2);
    ++count;
  });
  EXPECT_LT(std::sqrt(squares / count), .03);
  EXPECT_GT(std::sqrt(naive / count), .1);
}

// A sun's part turns by its cosines, and what faces away from it stays in the shade however its
// bumps lean. As a factor of the open surroundings, sun and all, the shade glows.
TEST_F(GlossyBall, ANormalMapLetsNoSunIntoTheShade) {
  const dvec3 towards = glm::normalize(dvec3(1, .3, .6));
  constexpr float kSky = .2f, kSun = 4;  // irradiance/pi
  RadianceSh sky(3);
  sky[0] = Rgb{kSky, kSky, kSky} * static_cast<float>(std::sqrt(4 * kPi));
  Surroundings around{reflections_of(even_map({0, 0, 0})), {}, sky};
  around.lights.push_back({towards, .0047, Rgb{1, 1, 1} * static_cast<float>(kSun * kPi)});
  prt::Material m{.metallic = 0, .roughness = 1, .specular = 0};
  m.normal_map = {.picture = picture_of(Image<prt::Rgba8>(1, 1, {218, 128, 218, 255}))};
  add(m, sky, around);
  const std::size_t stride = object_.transfer.stride;
  std::vector<float> relit(3 * stride, kSky);
  for (std::size_t v = 0; v < object_.mesh.normals.size(); ++v)
    for (std::size_t c = 0; c < 3; ++c)
      relit[c * stride + v] +=
          kSun * float(std::max(0., glm::dot(dvec3(object_.mesh.normals[v]), towards)));
  compositor_->set_light(handle_, relit, {});
  int lit = 0, shaded = 0;
  over_ball(drawn(), [&](const dvec3& n, const dvec3&, const Rgb& c) {
    const double facing = glm::dot(n, towards);
    const dvec3 leaning = glm::normalize(n + glm::normalize(glm::cross(dvec3(0, 1, 0), n)));
    if (facing > .3 && std::abs(n.y) < .9) {
      const double truth = kSky + kSun * std::max(0., glm::dot(leaning, towards));
      EXPECT_NEAR(c.g, truth, .03 * truth + .03);
      ++lit;
    } else if (facing < -.1) {
      EXPECT_NEAR(c.g, kSky, .02);
      shaded += glm::dot(leaning, towards) > .1;
    }
  });
  EXPECT_GT(lit, 100);
  EXPECT_GT(shaded, 20) << "bumps that lean to the sun, on the side away from it";
}

// The side of a sheet that its transfer does not know is lit by the sun that shines on it.
TEST_F(GlossyBall, BothSidesOfASheetHaveTheirOwnSun) {
  prt::Mesh sheet;
  for (const glm::vec2 c : {glm::vec2(-.4f, -.4f), {.4f, -.4f}, {.4f, .4f}, {-.4f, .4f}})
    sheet.positions.emplace_back(c.x, .4f + c.y, 0);
  // It is seen from behind.
  const dvec3 eye = test::scene_camera().world_from_camera.translation;
  const float away = eye.z > 0 ? -1.f : 1.f;
  sheet.normals.assign(4, {0, 0, away});
  sheet.albedo.assign(4, {1, 1, 1});
  sheet.triangles = {{0, 1, 2}, {0, 2, 3}};
  if (away < 0)
    for (auto& t : sheet.triangles) std::swap(t[1], t[2]);
  object_ = {};
  object_.mesh = sheet;
  object_.transfer = prt::Transfer(3, 1, 4);
  constexpr float kSky = .2f, kSun = 4;
  RadianceSh sky(3);
  sky[0] = Rgb{kSky, kSky, kSky} * static_cast<float>(std::sqrt(4 * kPi));
  for (const double side : {1., -1.}) {
    SetUp();
    object_ = {};
    object_.mesh = sheet;
    object_.transfer = prt::Transfer(3, 1, 4);
    const dvec3 towards = glm::normalize(dvec3(.2, .3, double(away) * side));
    Surroundings around{reflections_of(even_map({0, 0, 0})), {}, sky};
    around.lights.push_back({towards, .0047, Rgb{1, 1, 1} * static_cast<float>(kSun * kPi)});
    add({.metallic = 0, .roughness = 1, .double_sided = true, .specular = 0}, sky, around);
    const double front = std::max(0., glm::dot(dvec3(sheet.normals[0]), towards));
    std::vector<float> relit(3 * object_.transfer.stride, static_cast<float>(kSky + kSun * front));
    compositor_->set_light(handle_, relit, {});
    const double back = std::max(0., -glm::dot(dvec3(sheet.normals[0]), towards));
    EXPECT_NEAR(drawn().at(kSceneWidth / 2, kSceneHeight / 2).g, kSky + kSun * back,
                .03 * (kSky + kSun * back))
        << side;
  }
}

}  // namespace
}  // namespace penumbra::compositor
