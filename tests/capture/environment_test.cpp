#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "calib/calib.h"
#include "capture/capture.h"
#include "codec/codec.h"
#include "core/conventions.h"
#include "tests/support/temp_folder.h"

namespace penumbra::capture {
namespace {

using calib::ProjectionKind;

Image<Rgb> random_map(int width, int height, unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<float> value(.1f, 3);
  Image<Rgb> map(width, height);
  for (Rgb& p : map.pixels()) p = {value(rng), value(rng), value(rng)};
  return map;
}

// ------------------------------------------------------------------------------------- floor

TEST(FloorWorld, IrradianceOfTheFloorIsTheIntegralOverTheSky) {
  const auto world = FloorWorld::make(random_map(32, 17, 1));  // odd: a row crosses the horizon
  ASSERT_TRUE(world);
  const Image<Rgb>& map = (*world)->environment();
  constexpr int kFine = 12;
  double irradiance[3] = {}, mean = 0;
  for (int y = 0; y < 17 * kFine; ++y)
    for (int x = 0; x < 32; ++x) {
      const double w = latlong_solid_angle(y, 32, 17 * kFine);
      const double cosine = latlong_direction(x + .5, y + .5, 32, 17 * kFine).y;
      for (int c = 0; c < 3; ++c)
        irradiance[c] += w * std::max(0., cosine) * double(map.at(x, y / kFine)[c]);
      mean += w * double(luminance(map.at(x, y / kFine))) / (4 * kPi);
    }
  for (int c = 0; c < 3; ++c) EXPECT_NEAR((*world)->floor_irradiance()[c] / irradiance[c], 1, 1e-3);
  EXPECT_NEAR(mean, FloorWorld::kMeanLuminance, 1e-3 * FloorWorld::kMeanLuminance);
}

TEST(FloorWorld, FloorReflectsItsAlbedoOfItsIrradiance) {
  const auto world = FloorWorld::make(make_room_environment(128, 64));
  ASSERT_TRUE(world);
  std::mt19937 rng(2);
  std::uniform_real_distribution<double> place(-1.5, 1.5);
  for (int i = 0; i < 100; ++i) {
    const glm::dvec3 eye(place(rng), 1.2, place(rng)), foot(place(rng), 0, place(rng));
    const Rgb seen = (*world)->radiance(eye, glm::normalize(foot - eye)),
              albedo = (*world)->floor_albedo(foot);
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(double(seen[c]) * kPi,
                  double(albedo[c]) * double((*world)->floor_irradiance()[c]),
                  1e-3 * double((*world)->floor_irradiance()[c]));
      EXPECT_TRUE(albedo[c] >= .02f && albedo[c] <= .92f) << albedo[c];
    }
    const glm::dvec3 up = glm::normalize(glm::dvec3(place(rng), .4, place(rng)));
    EXPECT_EQ((*world)->radiance(eye, up), (*world)->far_radiance(up));
  }
}

TEST(FloorWorld, RefusesMapsThatCannotLight) {
  const auto code = [](Image<Rgb> map) {
    const auto world = FloorWorld::make(std::move(map));
    return world ? std::optional<ErrorCode>() : world.error().code;
  };
  EXPECT_EQ(code({}), ErrorCode::kInvalid);
  EXPECT_EQ(code(Image<Rgb>(8, 4)), ErrorCode::kUndetermined);
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    Image<Rgb> map(8, 4, {1, 1, 1});
    map.at(5, 2).g = bad;
    EXPECT_EQ(code(map), ErrorCode::kNonFinite);
  }
}

TEST(SkyEnvironment, SunHasItsPowerOnAnyGrid) {
  const double source = 2 * kPi * (1 - std::cos(.2666 * kPi / 180));
  for (const int height : {64, 128, 512})
    for (const double elevation : {.3, .8, 1.4}) {
      const Image<Rgb> map = make_sky_environment(2 * height, height, elevation);
      double power = 0;
      for (int y = 0; y < height; ++y)
        for (const Rgb& p : map.row(y))
          if (p.r > 2) power += latlong_solid_angle(y, 2 * height, height) * double(p.r);
      EXPECT_NEAR(power / (46000 * source), 1, .03) << height << " rows, elevation " << elevation;
    }
}

// A map of the sky alone shows sky below as well, which is no ground to put things on.
TEST(FloorWorld, SkyBelowTheHorizonBecomesGreyStoneWhereThatIsAskedFor) {
  const Image<Rgb> sky(64, 32, {.3f, .8f, 1.2f});
  Image<Rgb> meadow = sky;
  for (int y = 16; y < 32; ++y)
    for (Rgb& c : meadow.row(y)) c = {.08f, .16f, .05f};
  const auto near_origin = [](const Image<Rgb>& map, FloorWorld::Ground ground) {
    return (*FloorWorld::make(map, ground))->mean_floor_albedo();
  };
  // The same light from everywhere is reflected by everything white, in each channel alike: what is
  // blue over red is the ground of a sky under a neutral sun.
  Image<Rgb> sunny = sky;
  sunny.at(20, 4) = {2000, 1500, 900};
  const Rgb blue = near_origin(sunny, FloorWorld::Ground::kOfTheMap),
            grey = near_origin(sunny, FloorWorld::Ground::kGreyUnderSky);
  ASSERT_GT(blue.b, FloorWorld::kSkyBlue * blue.r);
  EXPECT_NEAR(grey.r, .3f, .02f);
  EXPECT_NEAR(grey.g, grey.r, 1e-3f);
  EXPECT_NEAR(grey.b, grey.r, 1e-3f);
  EXPECT_EQ(near_origin(meadow, FloorWorld::Ground::kGreyUnderSky),
            near_origin(meadow, FloorWorld::Ground::kOfTheMap));
}

// ------------------------------------------------------------------------------------- files

class EnvironmentFileTest : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& name, int width, int height,
                              std::optional<codec::EnvironmentAttribute> attribute = std::nullopt) {
    const auto path = folder_.path() / name;
    const auto written =
        codec::write_hdr(path, random_map(width, height, 3), codec::Depth::kFloat, attribute);
    EXPECT_TRUE(written) << name;
    return path;
  }
  test::TempFolder folder_;
};

double solid_angle(const EnvironmentFile& file) {
  double sum = 0;
  for (const float w : file.table.solid_angle_sr) sum += double(w);
  return sum;
}

TEST_F(EnvironmentFileTest, ShapeTellsTheProjection) {
  const std::tuple<int, int, ProjectionKind> shapes[] = {{64, 32, ProjectionKind::kLatLong},
                                                         {48, 64, ProjectionKind::kVerticalCross},
                                                         {64, 64, ProjectionKind::kAngular}};
  for (const auto& [width, height, kind] : shapes)
    for (const char* name : {"map.exr", "map.hdr"}) {
      const auto file = read_environment(write(name, width, height), std::nullopt);
      ASSERT_TRUE(file) << file.error().detail;
      EXPECT_EQ(file->projection.kind, kind) << width << 'x' << height;
      EXPECT_NEAR(solid_angle(*file), 4 * kPi, 1e-4);
      EXPECT_EQ(file->non_finite, 0U);
    }
  const auto odd = read_environment(write("odd.exr", 50, 32), std::nullopt);
  ASSERT_FALSE(odd);
  EXPECT_EQ(odd.error().code, ErrorCode::kInvalid);
  EXPECT_NE(odd.error().where.find("odd.exr"), std::string::npos);
}

TEST_F(EnvironmentFileTest, AttributeOfTheFileTellsMoreThanItsShape) {
  using codec::EnvironmentAttribute;
  const auto a = read_environment(write("cube.exr", 16, 96, EnvironmentAttribute::kCube), {}),
             b = read_environment(write("latlong.exr", 64, 32, EnvironmentAttribute::kLatLong), {});
  ASSERT_TRUE(a) << a.error().detail;
  ASSERT_TRUE(b) << b.error().detail;
  EXPECT_EQ(a->projection.kind, ProjectionKind::kExrCube);
  EXPECT_EQ(b->projection.kind, ProjectionKind::kExrLatLong);
  EXPECT_NEAR(solid_angle(*a), 4 * kPi, 1e-4);
  EXPECT_NEAR(solid_angle(*b), 4 * kPi, 1e-4);
}

// Programs write the attribute and mean the other handedness: whoever looks at the map knows.
TEST_F(EnvironmentFileTest, CallerTellsMoreThanTheAttribute) {
  const auto path = write("mirrored.exr", 64, 32, codec::EnvironmentAttribute::kLatLong);
  const auto file = read_environment(path, ProjectionKind::kLatLong);
  ASSERT_TRUE(file);
  EXPECT_EQ(file->projection.kind, ProjectionKind::kLatLong);
  EXPECT_EQ(file->attribute, ProjectionKind::kExrLatLong);
  EXPECT_EQ(to_latlong(*file)->radiance.pixels()[5], file->radiance.pixels()[5]);
}

TEST_F(EnvironmentFileTest, TurnsCounterClockwiseSeenFromAbove) {
  // A lamp straight ahead, -z, in a map whose columns a quarter turn moves by a whole number.
  Image<Rgb> map(64, 32);
  map.at(32, 15) = {1, 2, 3};
  const auto path = folder_.path() / "lamp.exr";
  ASSERT_TRUE(codec::write_hdr(path, map, codec::Depth::kFloat));
  auto file = read_environment(path, std::nullopt);
  ASSERT_TRUE(file);
  const auto lamp = static_cast<std::size_t>(15 * 64 + 32);
  ASSERT_LT(file->table.direction[lamp].z, -.9);
  turn(*file, Radians(kPi / 2));
  EXPECT_LT(file->table.direction[lamp].x, -.9) << "ahead becomes left";
  const auto turned = to_latlong(*file);
  ASSERT_TRUE(turned);
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 64; ++x)
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(turned->radiance.at(x, y)[c], map.at((x + 16) % 64, y)[c], 1e-5f)
            << x << ' ' << y;
}

TEST_F(EnvironmentFileTest, CallerTellsMoreThanTheShape) {
  const auto file = read_environment(write("ball.exr", 64, 64), ProjectionKind::kMirrorBall);
  ASSERT_TRUE(file);
  EXPECT_EQ(file->projection.kind, ProjectionKind::kMirrorBall);
}

TEST_F(EnvironmentFileTest, NonFinitePixelsAreCountedAndGetNoSolidAngle) {
  Image<Rgb> map = random_map(64, 32, 4);
  map.at(10, 7).r = std::numeric_limits<float>::quiet_NaN();
  map.at(11, 20).b = std::numeric_limits<float>::infinity();
  const auto path = folder_.path() / "holes.exr";
  ASSERT_TRUE(codec::write_hdr(path, map, codec::Depth::kFloat));
  const auto file = read_environment(path, std::nullopt);
  ASSERT_TRUE(file);
  EXPECT_EQ(file->non_finite, 2U);
  for (const auto& [x, y] : {std::pair{10, 7}, {11, 20}}) {
    const auto i = static_cast<std::size_t>(y * 64 + x);
    EXPECT_EQ(file->table.solid_angle_sr[i], 0);
    EXPECT_EQ(file->table.confidence[i], 0);
  }
  for (const Rgb& p : file->radiance.pixels()) ASSERT_TRUE(is_finite(p));
  EXPECT_NEAR(solid_angle(*file),
              4 * kPi - latlong_solid_angle(7, 64, 32) - latlong_solid_angle(20, 64, 32), 1e-4);
}

// Black by itself is night; where alpha is 0 as well, no camera looked.
TEST_F(EnvironmentFileTest, BlackPixelsOfAlphaZeroAreUnseen) {
  Image<Rgb> map(64, 32, {1, 2, 3});
  Image<float> alpha(64, 32, 1);
  const auto index = [](int x, int y) { return static_cast<std::size_t>(y * 64 + x); };
  for (int x = 0; x < 32; ++x) map.at(x, 9) = {}, alpha.at(x, 9) = 0;
  map.at(40, 9) = {};   // seen, and black
  alpha.at(41, 9) = 0;  // glows
  const auto path = folder_.path() / "half.exr";
  ASSERT_TRUE(codec::write_hdr(path, map, codec::Depth::kFloat, {}, alpha));
  auto file = read_environment(path, std::nullopt);
  ASSERT_TRUE(file);
  EXPECT_EQ(file->unseen, 32U);
  EXPECT_EQ(file->table.confidence[index(3, 9)], 0);
  EXPECT_GT(file->table.confidence[index(40, 9)], 0);
  EXPECT_GT(file->table.confidence[index(41, 9)], 0);
  EXPECT_NEAR(solid_angle(*file), 4 * kPi - 32 * latlong_solid_angle(9, 64, 32), 1e-4);
  const auto plain = to_latlong(*file);
  ASSERT_TRUE(plain);
  EXPECT_EQ(plain->confidence.at(3, 9), 0);
  EXPECT_EQ(plain->confidence.at(40, 9), 1);
  // Turned by half a pixel, what is beside a hole does not darken.
  turn(*file, Radians(2 * kPi / 64 / 2));
  const auto turned = to_latlong(*file);
  ASSERT_TRUE(turned);
  EXPECT_EQ(std::ranges::count(turned->confidence.pixels(), 0.f), 31);
  for (int x = 0; x < 34; ++x) {
    if (turned->confidence.at(x, 9) == 0) continue;
    EXPECT_NEAR(turned->radiance.at(x, 9).g, 2, 1e-5) << x;
  }
}

// A file that forgets what clipped promises a sun of whatever the camera could hold.
TEST_F(EnvironmentFileTest, WhatIsClippedTravelsWithTheFile) {
  Environment seen;
  seen.radiance = Image<Rgb>(64, 32, {1, 2, 3});
  seen.clipped = {9 * 64 + 32, 9 * 64 + 33};
  const auto path = folder_.path() / "sun.exr";
  ASSERT_TRUE(
      codec::write_hdr(path, seen.radiance, codec::Depth::kFloat, {}, {}, clipped_pixels(seen)));
  auto file = read_environment(path, std::nullopt);
  ASSERT_TRUE(file);
  const auto plain = to_latlong(*file);
  ASSERT_TRUE(plain);
  EXPECT_EQ(plain->clipped, seen.clipped);
  EXPECT_NEAR(plain->clipped_fraction, 2 * latlong_solid_angle(9, 64, 32) / (4 * kPi), 1e-6);
  turn(*file, Radians(kPi / 2));  // ahead becomes left
  const auto turned = to_latlong(*file);
  ASSERT_TRUE(turned);
  EXPECT_EQ(turned->clipped, (std::vector<std::uint32_t>{9 * 64 + 16, 9 * 64 + 17}));
  EXPECT_FALSE(codec::write_hdr(folder_.path() / "sun.hdr", seen.radiance, codec::Depth::kFloat, {},
                                {}, clipped_pixels(seen)));
}

TEST_F(EnvironmentFileTest, ResampledConstantStaysConstant) {
  for (const auto& [kind, width, height] : {std::tuple{ProjectionKind::kVerticalCross, 48, 64},
                                            {ProjectionKind::kAngular, 64, 64},
                                            {ProjectionKind::kMirrorBall, 64, 64},
                                            {ProjectionKind::kExrLatLong, 64, 32},
                                            {ProjectionKind::kExrCube, 16, 96}}) {
    EnvironmentFile file;
    file.projection = *calib::make_projection(kind, width, height);
    file.table = calib::make_projection_table(file.projection);
    file.radiance = Image<Rgb>(width, height, {2, 3, 4});
    const auto map = to_latlong(file);
    ASSERT_TRUE(map);
    EXPECT_TRUE(map->confidence.empty()) << calib::projection_name(kind);
    EXPECT_EQ(map->radiance.width(), 2 * map->radiance.height());
    for (const Rgb& p : map->radiance.pixels())
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(p[c], float(2 + c), 1e-5f) << calib::projection_name(kind);
  }
}

TEST_F(EnvironmentFileTest, AbsentFileIsNotFound) {
  const auto file = read_environment(folder_.path() / "nowhere.exr", std::nullopt);
  ASSERT_FALSE(file);
  EXPECT_EQ(file.error().code, ErrorCode::kNotFound);
}

}  // namespace
}  // namespace penumbra::capture
