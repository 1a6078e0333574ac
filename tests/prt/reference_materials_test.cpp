// The path tracer's surfaces with materials, in worlds whose pictures are known.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <memory>
#include <vector>

#include "core/conventions.h"
#include "prt/geometry/material.h"
#include "prt/prt.h"
#include "prt/reference/materials.h"
#include "tests/support/lights.h"

namespace penumbra::prt {
namespace {

using glm::dvec3;

// Light by a map is sampled, so that both ways of finding it are at work.
EnvironmentLight even_environment(float radiance) {
  return *EnvironmentLight::from_map(Image<Rgb>(64, 32, {radiance, radiance, radiance}));
}

std::shared_ptr<const TexturePicture> picture_of(Image<Rgba8> codes) {
  auto out = std::make_shared<TexturePicture>();
  out->codes = std::move(codes);
  return out;
}

std::shared_ptr<SurfaceMaterials> surface_of(const Mesh& mesh, const Material& material) {
  auto out = std::make_shared<SurfaceMaterials>();
  out->materials = {material};
  out->material.assign(mesh.positions.size(), 0);
  return out;
}

// Lies in y = height, seen from above; its picture spans the square from its far left corner.
Mesh sheet(float half, float height) {
  Mesh mesh;
  mesh.positions = {
      {-half, height, -half}, {half, height, -half}, {half, height, half}, {-half, height, half}};
  mesh.normals.assign(4, {0, 1, 0});
  mesh.albedo.assign(4, {.5f, .5f, .5f});
  mesh.triangles = {{0, 2, 1}, {0, 3, 2}};
  return mesh;
}
std::shared_ptr<SurfaceMaterials> surface_of_sheet(const Mesh& mesh, const Material& material) {
  auto out = surface_of(mesh, material);
  out->coordinates[0] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  out->tangents.assign(4, {1, 0, 0, 1});
  return out;
}

constexpr int kSize = 16;
// From one above the origin, straight down, over a square of 1.
PinholeView from_above() {
  return {kSize,
          kSize,
          {kSize, kSize},
          {kSize / 2., kSize / 2.},
          {glm::angleAxis(-kPi / 2, dvec3(1, 0, 0)), {0, 1, 0}}};
}

Reference traced(const ReferenceWorld& world, const PinholeView& view, int samples,
                 std::uint64_t seed = 1) {
  ReferenceOptions options;
  options.error = 0;
  options.max_samples = samples;
  options.seed = seed;
  auto picture = render_reference(world, view, options);
  EXPECT_TRUE(picture) << (picture ? "" : picture.error().detail);
  return picture ? *picture : Reference{};
}

Rgb mean_of(const Image<Rgb>& picture) {
  Rgb sum;
  for (const Rgb& c : picture.pixels()) sum += c;
  return sum * (1 / static_cast<float>(picture.area()));
}

double light_under(const ReferenceWorld& world, const dvec3& place = {0, 0, 0}) {
  const std::vector<IrradiancePoint> point{{place, {0, 1, 0}}};
  const auto e = reference_irradiance(world, point, 16384, 7);
  EXPECT_TRUE(e);
  return e ? double((*e)[0].g) / kPi : NAN;
}

// ---------------------------------------------------------------------------------- energy

TEST(ReferenceMaterials, WhiteBallsAreUnseenInEvenLight) {
  const auto light = even_environment(1);
  ReferenceWorld world;
  world.light = &light;
  world.mesh = make_sphere({0, 0, -2}, 1.9f, 5, {0, 0, 0});
  const PinholeView view{kSize, kSize, {kSize, kSize}, {kSize / 2., kSize / 2.}, {}};
  for (const float metallic : {0.f, 1.f})
    for (const float roughness : {0.f, .1f, .3f, .6f, 1.f}) {
      world.surface = surface_of(world.mesh, {.metallic = metallic, .roughness = roughness});
      const Image<Rgb> picture = traced(world, view, 512).radiance;
      EXPECT_NEAR(mean_of(picture).g, 1, .003) << metallic << ' ' << roughness;
      for (const Rgb& p : picture.pixels())
        ASSERT_NEAR(p.g, 1, .01) << metallic << ' ' << roughness;
    }
}

TEST(ReferenceMaterials, AMirrorBallReturnsTheMap) {
  const auto radiance = [](const dvec3& d) {
    return Rgb{static_cast<float>(1 + .8 * d.x), static_cast<float>(1 + .8 * d.y),
               static_cast<float>(1 + .8 * std::sin(3 * d.z))};
  };
  Image<Rgb> map(1024, 512);
  for (int y = 0; y < 512; ++y)
    for (int x = 0; x < 1024; ++x)
      map.at(x, y) = radiance(latlong_direction(x + .5, y + .5, 1024, 512));
  const auto light = *EnvironmentLight::from_map(map);
  ReferenceWorld world;
  world.light = &light;
  world.mesh = make_sphere({0, 0, -4}, 1, 6, {0, 0, 0});
  world.surface = surface_of(world.mesh, {.metallic = 1, .roughness = 0});
  constexpr int kFine = 32;
  const PinholeView view{kFine, kFine, {2. * kFine, 2. * kFine}, {kFine / 2., kFine / 2.}, {}};
  const Image<Rgb> picture = traced(world, view, 256).radiance;
  double square = 0, naive = 0;
  int count = 0;
  for (int y = 0; y < kFine; ++y)
    for (int x = 0; x < kFine; ++x) {
      Rgb truth;
      bool inside = true;
      for (int k = 0; k < 64 && inside; ++k) {
        const dvec3 d =
            glm::normalize(dvec3((x + (k % 8 + .5) / 8 - kFine / 2.) / (2 * kFine),
                                 -(y + (k / 8 + .5) / 8 - kFine / 2.) / (2 * kFine), -1));
        const double along = -4 * d.z, root = along * along - 15;  // |d t - (0, 0, -4)| = 1
        inside = root > .2;
        if (!inside) break;
        const dvec3 n = glm::normalize(d * (along - std::sqrt(root)) - dvec3(0, 0, -4));
        truth += radiance(d - 2 * glm::dot(d, n) * n) * (1.f / 64);
      }
      if (!inside) continue;
      for (int c = 0; c < 3; ++c)
        square += std::pow(picture.at(x, y)[c] - truth[c], 2), naive += std::pow(1 - truth[c], 2);
      count += 3;
    }
  ASSERT_GT(count, 300);
  EXPECT_LT(std::sqrt(square / count), .01);
  EXPECT_GT(std::sqrt(naive / count), .2) << "an even ball";
}

// A picture is the sum over the map of what the lobes send of each pixel.
TEST(ReferenceMaterials, ASheetSendsWhatItsLobesSendOfEachPlaceOfTheMap) {
  Image<Rgb> map(64, 32, {.2f, .2f, .2f});
  map.at(20, 9) = {40, 40, 40};
  map.at(50, 4) = {0, 30, 0};
  const auto light = *EnvironmentLight::from_map(map);
  ReferenceWorld world;
  world.light = &light;
  world.mesh = sheet(10, 0);
  const dvec3 eye(0, 1, .6);
  const PinholeView view{
      1, 1, {200, 200}, {.5, .5}, {glm::angleAxis(-std::atan2(1., .6), dvec3(1, 0, 0)), eye}};
  for (const Material& m :
       {Material{.base_colour = {1, .7f, .3f}, .metallic = 1, .roughness = .4f},
        Material{.base_colour = {.5f, .1f, .1f}, .metallic = 0, .roughness = .3f},
        Material{.base_colour = {.2f, .2f, .2f},
        .metallic = 0,
        .roughness = .9f,
        .clearcoat = .8f,
        .clearcoat_roughness = .3f}}) {
    world.surface = surface_of_sheet(world.mesh, m);
    const MaterialLobes lobes(
        local_material(world.mesh, *world.surface, {world.mesh.triangles[0], .3f, .3f, true}),
        glm::vec3(glm::normalize(eye)));
    constexpr int kFine = 16;
    dvec3 truth(0);
    for (int y = 0; y < 32 * kFine; ++y)
      for (int x = 0; x < 64 * kFine; ++x) {
        const Rgb sent =
            map.at(x / kFine, y / kFine) *
            lobes.evaluate(glm::vec3(latlong_direction(x + .5, y + .5, 64 * kFine, 32 * kFine)));
        truth += latlong_solid_angle(y, 64 * kFine, 32 * kFine) * dvec3(sent.r, sent.g, sent.b);
      }
    const Rgb seen = traced(world, view, 65536).radiance.at(0, 0);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(seen[c], truth[c], .01 * truth[c]) << m.roughness << c;
  }
}

TEST(ReferenceMaterials, ALambertianMaterialIsThePlainSurface) {
  const auto light = EnvironmentLight::from_sh(test::random_light(3, 1));
  ReferenceWorld world;
  world.light = &light;
  world.mesh = make_knot(1, 60, 12, {.5f, .6f, .7f});
  world.planes = {Plane{}};
  world.planes[0].albedo = {.5f, .5f, .5f};
  const PinholeView view{
      kSize, kSize, {kSize, kSize}, {kSize / 2., kSize / 2.}, {{1, 0, 0, 0}, {0, .5, 1.5}}};
  const Image<Rgb> plain = traced(world, view, 1024).radiance;
  auto surface = surface_of(world.mesh, {.metallic = 0, .roughness = 1, .specular = 0});
  surface->tint = world.mesh.albedo;
  world.surface = surface;
  const Image<Rgb> same = traced(world, view, 1024).radiance;
  for (std::size_t i = 0; i < plain.area(); ++i)
    ASSERT_NEAR(plain.pixels()[i].g, same.pixels()[i].g, .01);
  EXPECT_NEAR(mean_of(plain).r, mean_of(same).r, .001);
}

TEST(ReferenceMaterials, TwoSeedsDifferByTheErrorThatTheyTell) {
  Image<Rgb> map(64, 32, {.3f, .3f, .3f});
  map.at(20, 9) = {60, 60, 60};
  const auto light = *EnvironmentLight::from_map(map);
  ReferenceWorld world;
  world.light = &light;
  world.mesh = make_knot(1, 60, 12, {0, 0, 0});
  world.surface = surface_of(world.mesh, {.metallic = 1, .roughness = .3f});
  world.planes = {Plane{}};
  world.planes[0].albedo = {.5f, .5f, .5f};
  const PinholeView view{
      kSize, kSize, {kSize, kSize}, {kSize / 2., kSize / 2.}, {{1, 0, 0, 0}, {0, .5, 1.5}}};
  const Reference a = traced(world, view, 2048, 5), b = traced(world, view, 2048, 6);
  double square = 0;
  for (std::size_t i = 0; i < a.radiance.area(); ++i)
    square += std::pow(luminance(a.radiance.pixels()[i]) - luminance(b.radiance.pixels()[i]), 2);
  const double mean = luminance(mean_of(a.radiance));
  const double apart = std::sqrt(square / static_cast<double>(a.radiance.area())) / mean;
  EXPECT_LT(apart, 1.6 * std::hypot(a.error, b.error));
  EXPECT_GT(apart, .6 * std::hypot(a.error, b.error));
  EXPECT_NEAR(luminance(mean_of(b.radiance)) / mean, 1, .01);
}

// ---------------------------------------------------------------------------------- pictures

// Pixels of a quad are those of its picture, decoded and mixed.
TEST(ReferenceMaterials, ATextureLiesWhereItsCoordinatesSay) {
  Image<Rgba8> codes(2, 2);
  codes.at(0, 0) = {255, 0, 188}, codes.at(1, 0) = {0, 255, 188};
  codes.at(0, 1) = {0, 0, 0}, codes.at(1, 1) = {255, 255, 188};
  const auto light = even_environment(1);
  ReferenceWorld world;
  world.light = &light;
  world.mesh = sheet(.5f, 0);
  Material m{.metallic = 0, .roughness = 1, .specular = 0};
  m.base_colour_map = {.picture = picture_of(codes),
                       .wrap_s = Texture::Wrap::kClamp,
                       .wrap_t = Texture::Wrap::kClamp};
  world.surface = surface_of_sheet(world.mesh, m);
  const Image<Rgb> picture = traced(world, from_above(), 1024).radiance;
  // Texels' middles lie at 4 and 12 of 16 pixels.
  const auto share = [](int i) { return std::clamp((i + .5 - 4) / 8, 0., 1.); };
  for (int y = 1; y < kSize - 1; ++y)
    for (int x = 1; x < kSize - 1; ++x) {
      const double u = share(x), v = share(y);
      ASSERT_NEAR(picture.at(x, y).r, (1 - u) * (1 - v) + u * v, .015) << x << ' ' << y;
      ASSERT_NEAR(picture.at(x, y).g, u, .015) << x << ' ' << y;
      ASSERT_NEAR(picture.at(x, y).b, .5028 * (1 - v * (1 - u)), .015) << x << ' ' << y;
    }
}

TEST(ReferenceMaterials, PicturesRepeatMirrorAndMoveByTheirTransform) {
  Image<Rgba8> codes(4, 1);
  for (int x = 0; x < 4; ++x) codes.at(x, 0) = {std::uint8_t(60 * x), 0, 0};
  Texture t{.picture = picture_of(codes)};
  const auto at = [&](float u) { return 255.f / 60 * sample(t, {u, .5f}, false).x; };
  EXPECT_NEAR(at(.375f), 1, 1e-4);
  EXPECT_NEAR(at(.5f), 1.5, 1e-4);
  EXPECT_NEAR(at(1.375f), 1, 1e-4);
  EXPECT_NEAR(at(-.625f), 1, 1e-4);
  EXPECT_NEAR(at(0), 1.5, 1e-4) << "between the last and the first";
  t.wrap_s = Texture::Wrap::kMirror;
  EXPECT_NEAR(at(1.375f), 2, 1e-4);
  EXPECT_NEAR(at(-.375f), 1, 1e-4);
  EXPECT_NEAR(at(0), 0, 1e-4);
  t.wrap_s = Texture::Wrap::kClamp;
  EXPECT_NEAR(at(7), 3, 1e-4);
  EXPECT_NEAR(at(-7), 0, 1e-4);
  t.nearest = true;
  EXPECT_NEAR(at(.49f), 1, 1e-4);
  t.transform = {.5f, 0, 0, 1, .25f, 0};
  EXPECT_NEAR(at(.2f), 1, 1e-4);
  EXPECT_NEAR(at(.6f), 2, 1e-4);
}

// A normal map that leans by 45 degrees towards x, in the light of a lamp far above.
TEST(ReferenceMaterials, ANormalMapLeansTheSurface) {
  const auto dark = EnvironmentLight::from_sh(RadianceSh(1));
  ReferenceWorld world;
  world.light = &dark;
  world.mesh = sheet(10, 0);
  Material m{.metallic = 0, .roughness = 1, .specular = 0};
  m.normal_map = {.picture = picture_of(Image<Rgba8>(1, 1, {218, 128, 218, 255}))};
  world.surface = surface_of_sheet(world.mesh, m);
  for (const double x : {-50., 0., 50.}) {
    const dvec3 lamp(x, 100, 0);
    world.lamps = {{lamp, 1, Rgb{1, 1, 1} * static_cast<float>(kPi * glm::dot(lamp, lamp))}};
    const double expected = glm::dot(glm::normalize(lamp), glm::normalize(dvec3(90, 90, 0)));
    EXPECT_NEAR(mean_of(traced(world, from_above(), 256).radiance).g, expected, .01) << x;
  }
}

// ---------------------------------------------------------------------------------- coverage

// A black sheet with a hole above a point: the sky shows through the hole's solid angle.
TEST(ReferenceMaterials, AMaskLetsLightThroughItsHole) {
  constexpr int kTexels = 128;
  Image<Rgba8> codes(kTexels, kTexels);
  for (int y = 0; y < kTexels; ++y)
    for (int x = 0; x < kTexels; ++x)
      codes.at(x, y).a = std::hypot(x - 63.5, y - 63.5) < 38.4 ? 0 : 255;
  ReferenceWorld world;
  const auto light = even_environment(1);
  world.light = &light;
  constexpr float kHeight = .3f;
  world.mesh = sheet(20, kHeight);
  Material m{.base_colour = {0, 0, 0}, .metallic = 0, .roughness = 1, .specular = 0};
  m.alpha = Material::Alpha::kMask;
  // The picture spans the square metre in the middle.
  m.base_colour_map = {.picture = picture_of(codes),
                       .wrap_s = Texture::Wrap::kClamp,
                       .wrap_t = Texture::Wrap::kClamp,
                       .transform = {40, 0, 0, 40, -19.5f, -19.5f}};
  world.surface = surface_of_sheet(world.mesh, m);
  const double hole = .3 * .3;
  EXPECT_NEAR(light_under(world), hole / (hole + double(kHeight) * kHeight), .01);
  EXPECT_NEAR(light_under(world, {5, 0, 0}), 0, .01);
  m.alpha = Material::Alpha::kOpaque;
  world.surface = surface_of_sheet(world.mesh, m);
  EXPECT_NEAR(light_under(world), 0, .005) << "opaque: its alpha does not count";
}

TEST(ReferenceMaterials, ABlendedSheetCoversByItsOpacity) {
  const auto light = even_environment(1);
  ReferenceWorld world;
  world.light = &light;
  world.mesh = sheet(40, .2f);
  Material m{
      .base_colour = {0, 0, 0}, .opacity = .3f, .metallic = 0, .roughness = 1, .specular = 0};
  m.alpha = Material::Alpha::kBlend;
  m.double_sided = true;
  world.surface = surface_of_sheet(world.mesh, m);
  EXPECT_NEAR(light_under(world), .7, .01);
  m.base_colour = {1, 1, 1};
  world.surface = surface_of_sheet(world.mesh, m);
  world.background = [](const glm::vec3&) { return Rgb{3, 3, 3}; };
  EXPECT_NEAR(mean_of(traced(world, from_above(), 4096).radiance).g, .3 * 1 + .7 * 3, .02);
  m.double_sided = false;
  world.surface = surface_of_sheet(world.mesh, m);
  EXPECT_NEAR(light_under(world), 1, .01) << "backs that are not there";
}

TEST(ReferenceMaterials, AClearSheetShowsWhatIsBehindIt) {
  const auto light = even_environment(1);
  ReferenceWorld world;
  world.light = &light;
  world.mesh = sheet(40, .2f);
  world.surface = surface_of_sheet(world.mesh, {.metallic = 0, .roughness = 0, .transmission = 1});
  world.background = [](const glm::vec3&) { return Rgb{3, 3, 3}; };
  // Four percent are mirrored ahead, a little more at the picture's edge.
  EXPECT_NEAR(mean_of(traced(world, from_above(), 4096).radiance).g, .04 * 1 + .96 * 3, .02);
}

TEST(ReferenceMaterials, BacksAreBlackUnlessDoubleSided) {
  const auto light = even_environment(1);
  ReferenceWorld world;
  world.light = &light;
  world.mesh = sheet(40, 2);
  Material m{.metallic = 0, .roughness = .5f};
  world.surface = surface_of_sheet(world.mesh, m);
  const PinholeView up{kSize,
                       kSize,
                       {kSize, kSize},
                       {kSize / 2., kSize / 2.},
                       {glm::angleAxis(kPi / 2, dvec3(1, 0, 0)), {0, 1, 0}}};
  EXPECT_EQ(mean_of(traced(world, up, 64).radiance), (Rgb{}));
  m.double_sided = true;
  world.surface = surface_of_sheet(world.mesh, m);
  EXPECT_NEAR(mean_of(traced(world, up, 1024).radiance).g, 1, .01);
}

// ---------------------------------------------------------------------------------- emission

TEST(ReferenceMaterials, WhatGlowsIsSeenAndLightsTheFloor) {
  const auto dark = EnvironmentLight::from_sh(RadianceSh(1));
  ReferenceWorld world;
  world.light = &dark;
  world.mesh = make_sphere({0, 1, 0}, .5f, 5, {0, 0, 0});
  world.surface = surface_of(
      world.mesh,
      {.base_colour = {0, 0, 0}, .metallic = 0, .emission = {.5f, .25f, 0}, .specular = 0});
  world.emission_unit = 4;
  const PinholeView view{
      kSize, kSize, {100, 100}, {kSize / 2., kSize / 2.}, {{1, 0, 0, 0}, {0, 1, 3}}};
  const Image<Rgb> picture = traced(world, view, 16).radiance;
  for (const Rgb& p : picture.pixels()) EXPECT_EQ(p, (Rgb{2, 1, 0}));
  // E = pi L (r/d)^2 cos below a sphere that is wholly in sight
  EXPECT_NEAR(light_under(world), 1 * .25, .01);
}

TEST(ReferenceMaterials, WhatIsUnlitSendsItsColourAlone) {
  const auto light = even_environment(5);
  ReferenceWorld world;
  world.light = &light;
  world.mesh = sheet(10, 0);
  world.surface = surface_of_sheet(world.mesh, {.base_colour = {.5f, .25f, 0}, .unlit = true});
  world.emission_unit = 2;
  const Image<Rgb> picture = traced(world, from_above(), 4).radiance;
  for (const Rgb& p : picture.pixels()) EXPECT_EQ(p, (Rgb{1, .5f, 0}));
}

// ---------------------------------------------------------------------------------- refusals

TEST(ReferenceMaterials, SurfacesThatDoNotFitTheMeshAreRefused) {
  const auto light = even_environment(1);
  ReferenceWorld world;
  world.light = &light;
  world.mesh = sheet(1, 0);
  const auto refused = [&](const SurfaceMaterials& surface) {
    world.surface = std::make_shared<const SurfaceMaterials>(surface);
    const auto picture = render_reference(world, from_above(), {});
    return !picture && picture.error().code == ErrorCode::kInvalid;
  };
  const SurfaceMaterials good = *surface_of_sheet(world.mesh, {});
  EXPECT_FALSE(refused(good));
  SurfaceMaterials bad = good;
  bad.material.pop_back();
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.material[2] = 1;
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.coordinates[1].resize(3);
  EXPECT_TRUE(refused(bad));
  bad = good;
  bad.materials[0].normal_map.picture = std::make_shared<TexturePicture>();
  EXPECT_TRUE(refused(bad));
  world.emission_unit = NAN;
  EXPECT_TRUE(refused(good));
}

}  // namespace
}  // namespace penumbra::prt
