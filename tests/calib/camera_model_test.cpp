#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <random>
#include <string>
#include <vector>

#include "calib/calib.h"
#include "core/conventions.h"
#include "tests/calib/projections.h"

namespace penumbra::calib {
namespace {

TEST(CameraModel, NamesRoundTrip) {
  for (const auto kind : {kLatLong, kAngular, kMirrorBall, kEquidistant, kKannalaBrandt,
                          kDoubleSphere, kPinhole, kVerticalCross, kExrLatLong, kExrCube}) {
    const auto back = projection_kind(projection_name(kind));
    ASSERT_TRUE(back.has_value());
    EXPECT_EQ(*back, kind);
  }
  const auto bad = projection_kind("fishy");
  ASSERT_FALSE(bad.has_value());
  EXPECT_EQ(bad.error().code, ErrorCode::kInvalid);
  EXPECT_EQ(bad.error().where, "fishy");
  EXPECT_NE(bad.error().detail.find("mirror-ball"), std::string::npos);
}

TEST(CameraModel, RefusesImpossibleShapes) {
  struct Shape {
    ProjectionKind kind;
    int width, height;
  };
  for (const Shape s : {Shape{kLatLong, 0, 4}, Shape{kPinhole, 4, -1}, Shape{kAngular, 40000, 4},
                        Shape{kVerticalCross, 9, 16}, Shape{kExrCube, 4, 16}, Shape{kExrCube, 1, 6},
                        Shape{kExrLatLong, 8, 1}}) {
    const auto p = make_projection(s.kind, s.width, s.height);
    ASSERT_FALSE(p.has_value()) << projection_name(s.kind);
    EXPECT_EQ(p.error().code, ErrorCode::kInvalid);
    EXPECT_EQ(p.error().where, projection_name(s.kind));
  }
}

TEST(CameraModel, DefaultIntrinsicsSpanTheStatedAngles) {
  const CameraModel fisheye = projection(kEquidistant, 400, 300);
  const auto top = direction_from_pixel(fisheye, {200, 0});
  ASSERT_TRUE(top.has_value());
  EXPECT_NEAR(top->y, 1, 1e-12);
  EXPECT_NEAR(top->z, 0, 1e-12);
  const CameraModel pinhole = projection(kPinhole, 400, 300);
  const auto edge = direction_from_pixel(pinhole, {200, 0});
  ASSERT_TRUE(edge.has_value());
  EXPECT_NEAR(std::acos(-edge->z), kPi / 6, 1e-12);
}

// Six axis patches: where each axis must land, in continuous pixels. A flipped axis or a face in
// the wrong place cannot pass.
TEST(CameraModel, AxesLandWhereTheConventionSays) {
  struct Landing {
    CameraModel projection;
    glm::dvec3 direction;
    glm::dvec2 pixel;
  };
  const CameraModel latlong = projection(kLatLong, 400, 200);
  const CameraModel angular = projection(kAngular, 400, 200);
  const CameraModel ball = projection(kMirrorBall, 400, 200);
  const CameraModel fisheye = projection(kEquidistant, 400, 400);
  const CameraModel cross = projection(kVerticalCross, 300, 400);
  const CameraModel exr = projection(kExrLatLong, 401, 201);
  const CameraModel cube = projection(kExrCube, 101, 606);
  const double ring = 100 * std::sqrt(.5);  // R sin 45 degrees
  const std::vector<Landing> landings{
      {latlong, {0, 0, -1}, {200, 100}},     {latlong, {1, 0, 0}, {300, 100}},
      {latlong, {-1, 0, 0}, {100, 100}},     {latlong, {1e-9, 0, 1}, {400, 100}},
      {latlong, {0, 1, -1e-9}, {200, 0}},    {latlong, {0, -1, -1e-9}, {200, 200}},
      {angular, {0, 0, -1}, {200, 100}},     {angular, {1, 0, 0}, {250, 100}},
      {angular, {-1, 0, 0}, {150, 100}},     {angular, {0, 1, 0}, {200, 50}},
      {angular, {0, -1, 0}, {200, 150}},     {angular, {0, 1e-9, 1}, {200, 0}},
      {ball, {0, 0, 1}, {200, 100}},         {ball, {1, 0, 0}, {200 + ring, 100}},
      {ball, {-1, 0, 0}, {200 - ring, 100}}, {ball, {0, 1, 0}, {200, 100 - ring}},
      {ball, {0, -1, 0}, {200, 100 + ring}}, {ball, {1e-9, 0, -1}, {300, 100}},
      {fisheye, {0, 0, -1}, {200, 200}},     {fisheye, {1, 0, 0}, {400, 200}},
      {fisheye, {-1, 0, 0}, {0, 200}},       {fisheye, {0, 1, 0}, {200, 0}},
      {fisheye, {0, -1, 0}, {200, 400}},     {cross, {0, 1, 0}, {150, 50}},
      {cross, {-1, 0, 0}, {50, 150}},        {cross, {0, 0, -1}, {150, 150}},
      {cross, {1, 0, 0}, {250, 150}},        {cross, {0, -1, 0}, {150, 250}},
      {cross, {0, 0, 1}, {150, 350}},        {exr, {0, 0, 1}, {200.5, 100.5}},
      {exr, {1, 0, 0}, {100.5, 100.5}},      {exr, {-1, 0, 0}, {300.5, 100.5}},
      {exr, {1e-9, 0, -1}, {.5, 100.5}},     {exr, {0, 1, 0}, {200.5, .5}},
      {exr, {0, -1, 0}, {200.5, 200.5}},     {cube, {1, 0, 0}, {50.5, 50.5}},
      {cube, {-1, 0, 0}, {50.5, 151.5}},     {cube, {0, 1, 0}, {50.5, 252.5}},
      {cube, {0, -1, 0}, {50.5, 353.5}},     {cube, {0, 0, 1}, {50.5, 454.5}},
      {cube, {0, 0, -1}, {50.5, 555.5}},
  };
  for (const Landing& l : landings) {
    const std::string label = name_of(l.projection) + " axis " + std::to_string(l.direction.x) +
                              " " + std::to_string(l.direction.y) + " " +
                              std::to_string(l.direction.z);
    const auto pixel = pixel_from_direction(l.projection, l.direction);
    ASSERT_TRUE(pixel.has_value()) << label;
    EXPECT_NEAR(pixel->x, l.pixel.x, 1e-5) << label;
    EXPECT_NEAR(pixel->y, l.pixel.y, 1e-5) << label;
    const auto direction = direction_from_pixel(l.projection, l.pixel);
    ASSERT_TRUE(direction.has_value()) << label;
    EXPECT_LT(glm::length(*direction - glm::normalize(l.direction)), 1e-7) << label;
  }
}

// The turn of each face about its centre: a direction a little right of and above each centre.
TEST(CameraModel, CubeFacesAreTurnedAsDocumented) {
  struct Turn {
    glm::dvec3 direction;
    int right, down;  // sign of the offset from the face's centre in the picture
  };
  const auto check = [](const CameraModel& p, int size, double inset,
                        const std::vector<std::pair<glm::dvec2, Turn>>& turns) {
    for (const auto& [centre, turn] : turns) {
      const auto pixel = pixel_from_direction(p, turn.direction);
      ASSERT_TRUE(pixel.has_value());
      // Offset .2 towards the first and .4 towards the second axis, in half faces.
      EXPECT_NEAR(pixel->x, centre.x + turn.right * .2 * (size / 2. - inset), 1e-9);
      EXPECT_NEAR(pixel->y, centre.y + turn.down * .4 * (size / 2. - inset), 1e-9);
    }
  };
  check(projection(kVerticalCross, 300, 400), 100, 0,
        {{{150, 50}, {{.2, 1, -.4}, 1, 1}},    // top: x to the right, -z (the front) below
         {{50, 150}, {{-1, .4, -.2}, 1, -1}},  // left: -z (the front) to the right, y up
         {{150, 150}, {{.2, .4, -1}, 1, -1}},
         {{250, 150}, {{1, .4, .2}, 1, -1}},   // right: +z to the right
         {{150, 250}, {{.2, -1, .4}, 1, 1}},   // bottom: +z below
         {{150, 350}, {{.2, .4, 1}, 1, 1}}});  // back: upside down, x still to the right
  check(projection(kExrCube, 101, 606), 101, .5,
        {{{50.5, 50.5}, {{1, .4, .2}, 1, -1}},
         {{50.5, 151.5}, {{-1, .4, .2}, -1, -1}},
         {{50.5, 252.5}, {{.2, 1, .4}, 1, -1}},
         {{50.5, 353.5}, {{.2, -1, .4}, 1, 1}},
         {{50.5, 454.5}, {{.2, .4, 1}, -1, -1}},
         {{50.5, 555.5}, {{.2, .4, -1}, 1, -1}}});
}

TEST(CameraModel, CrossFacesJoinWithoutASeam) {
  const CameraModel p = projection(kVerticalCross, 300, 400);
  // Across each fold of the cross the direction is continuous.
  for (const auto& [a, b] :
       std::vector<std::pair<glm::dvec2, glm::dvec2>>{{{130, 99.99}, {130, 100.01}},
                                                      {{130, 199.99}, {130, 200.01}},
                                                      {{130, 299.99}, {130, 300.01}},
                                                      {{99.99, 170}, {100.01, 170}},
                                                      {{199.99, 170}, {200.01, 170}}}) {
    const auto da = direction_from_pixel(p, a), db = direction_from_pixel(p, b);
    ASSERT_TRUE(da && db);
    EXPECT_LT(glm::length(*da - *db), 1e-3);
  }
  // The bottom of the picture (end of the back face) meets its top (start of the top face).
  const auto end = direction_from_pixel(p, {130, 400}), start = direction_from_pixel(p, {130, 0});
  ASSERT_TRUE(end && start);
  EXPECT_LT(glm::length(*end - *start), 1e-9);
  EXPECT_FALSE(direction_from_pixel(p, {50, 50}).has_value());
  EXPECT_FALSE(direction_from_pixel(p, {250, 350}).has_value());
}

TEST(CameraModel, EquidistantIsClosedForm) {
  CameraModel p = projection(kEquidistant, 640, 480);
  p.focal_px = {150, 160};
  p.principal_px = {310, 250};
  for (const double theta : {.01, .7, 1.5, 1.7}) {
    for (const double phi : {0., .5, 2.5, -1.2}) {
      const glm::dvec3 d{std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi),
                         -std::cos(theta)};
      const glm::dvec2 expected{310 + 150 * theta * std::cos(phi),
                                250 - 160 * theta * std::sin(phi)};
      const auto pixel = pixel_from_direction(p, d);
      const bool inside =
          expected.x >= 0 && expected.x <= 640 && expected.y >= 0 && expected.y <= 480;
      ASSERT_EQ(pixel.has_value(), inside);
      if (inside) {
        EXPECT_LT(glm::length(*pixel - expected), 1e-9);
      }
    }
  }
  EXPECT_FALSE(pixel_from_direction(projection(kPinhole, 64, 48), {0, 0, 1}).has_value());
  EXPECT_FALSE(pixel_from_direction(projection(kPinhole, 64, 48), {1, 0, 0}).has_value());
}

TEST(CameraModel, NothingOutsideThePictureOrForNonsense) {
  const double nan = std::nan("");
  for (const CameraModel& p : all_kinds()) {
    EXPECT_FALSE(direction_from_pixel(p, {-1, 3}).has_value()) << name_of(p);
    EXPECT_FALSE(direction_from_pixel(p, {3, p.height + 1.}).has_value()) << name_of(p);
    EXPECT_FALSE(direction_from_pixel(p, {nan, 3}).has_value()) << name_of(p);
    EXPECT_FALSE(pixel_from_direction(p, {0, 0, 0}).has_value()) << name_of(p);
    EXPECT_FALSE(pixel_from_direction(p, {nan, 0, 1}).has_value()) << name_of(p);
  }
  EXPECT_FALSE(direction_from_pixel(projection(kAngular, 100, 100), {2, 2}).has_value());
  EXPECT_FALSE(direction_from_pixel(projection(kMirrorBall, 100, 100), {2, 2}).has_value());
}

TEST(CameraModel, PixelToDirectionToPixelIsIdentity) {
  std::mt19937 random(7);
  for (const CameraModel& p : all_kinds()) {
    std::uniform_real_distribution<double> x(.5, p.width - .5), y(.5, p.height - .5);
    int seen = 0;
    for (int i = 0; i < 2000; ++i) {
      const glm::dvec2 pixel{x(random), y(random)};
      const auto d = direction_from_pixel(p, pixel);
      if (!d) continue;
      ++seen;
      ASSERT_NEAR(glm::length(*d), 1, 1e-12) << name_of(p);
      const auto back = pixel_from_direction(p, *d * 3.);
      ASSERT_TRUE(back.has_value()) << name_of(p);
      ASSERT_LT(glm::length(*back - pixel), 1e-5) << name_of(p) << " " << pixel.x << " " << pixel.y;
    }
    EXPECT_GT(seen, 700) << name_of(p);
  }
}

}  // namespace
}  // namespace penumbra::calib
