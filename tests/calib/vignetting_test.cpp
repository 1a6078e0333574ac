#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "calib/calib.h"

namespace penumbra::calib {
namespace {

constexpr int kWallWidth = 640, kWallHeight = 480;

CameraModel lens() {
  CameraModel p = *make_projection(ProjectionKind::kPinhole, kWallWidth, kWallHeight);
  p.principal_px += glm::dvec2(14, -9);
  return p;
}

const std::array<double, 3> kTerms{-.42, .15, -.08};

// Paper under a light that is slanted, and brighter about `spot` where `hot` is not 0.
EvenPicture paper(double brightness, const glm::dvec2& slope, std::uint32_t seed, double hot = 0,
                  const glm::dvec2& spot = {0, 0}) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> noise;
  const Vignetting truth = vignetting_of(lens(), kTerms);
  const Response response = Response::srgb();
  Image<Rgb8> out(kWallWidth, kWallHeight);
  for (int y = 0; y < kWallHeight; ++y)
    for (int x = 0; x < kWallWidth; ++x) {
      const glm::dvec2 px(x + .5, y + .5), off = (px - truth.centre_px) / truth.half_diagonal_px;
      const double near = glm::length(off - spot);
      const double light =
          brightness * (1 + glm::dot(slope, off)) * (1 + hot * std::exp(-4 * near * near));
      const auto code = [&](int c) {
        const double signal = light * truth.at(px) + .01 * noise(rng);
        return static_cast<std::uint8_t>(std::lround(255 * response.encode(signal, c)));
      };
      out.at(x, y) = {code(0), code(1), code(2)};
    }
  return {"paper" + std::to_string(seed), std::move(out)};
}

TEST(Vignetting, IsFoundUnderSlantedLight) {
  const std::vector<EvenPicture> pictures{paper(.5, {.1, -.05}, 1), paper(.4, {-.12, .1}, 2)};
  const auto found = calibrate_vignetting(pictures, lens(), Response::srgb(), 0);
  ASSERT_TRUE(found) << found.error().where << ": " << found.error().detail;
  const Vignetting truth = vignetting_of(lens(), kTerms);
  for (double p = 0; p <= 1; p += .05)
    EXPECT_NEAR(found->vignetting.at_squared(p * p), truth.at_squared(p * p), .004) << p;
  EXPECT_LT(std::abs(found->corner - (1 - .42 + .15 - .08)), 4 * found->corner_sigma + .002);
  EXPECT_LT(found->residual, .01);
  EXPECT_GT(found->rings.size(), 15u);
}

TEST(Vignetting, LightThatIsBrighterInItsMiddleIsToldFromALensByASecondPicture) {
  const std::vector<EvenPicture> one{paper(.4, {0, 0}, 3, .25)};
  const auto fooled = calibrate_vignetting(one, lens(), Response::srgb(), 0);
  EXPECT_TRUE(!fooled || std::abs(fooled->corner - .65) > .03) << "one picture cannot tell";
  const std::vector<EvenPicture> two{paper(.4, {0, 0}, 4, .25),
                                     paper(.4, {0, 0}, 5, .25, {.6, .3})};
  const auto refused = calibrate_vignetting(two, lens(), Response::srgb(), 0);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUndetermined);
}

TEST(Vignetting, PicturesThatTellNothingAreRefusedByName) {
  const auto refuse = [](EvenPicture picture, const std::string& why) {
    const std::vector<EvenPicture> pictures{std::move(picture)};
    const auto found = calibrate_vignetting(pictures, lens(), Response::srgb(), 0);
    ASSERT_FALSE(found) << why;
    EXPECT_NE(found.error().detail.find(why), std::string::npos) << found.error().detail;
    EXPECT_EQ(found.error().where, pictures[0].name);
  };
  refuse(paper(.02, {0, 0}, 6), "too dark");
  refuse(paper(1.1, {0, 0}, 7), "clipped");
  refuse({"small", Image<Rgb8>(64, 48, {99, 99, 99})}, "instead of 640x480");
  refuse({"narrow", Image<Rgb8>(4000, 1, {99, 99, 99})}, "instead of 640x480");
  EvenPicture warm = paper(.5, {0, 0}, 9);
  for (Rgb8& p : std::get<Image<Rgb8>>(warm.pixels).pixels())
    p.r = static_cast<std::uint8_t>(std::min(255, p.r * 3 / 2));
  refuse(std::move(warm), "clipped");
  EvenPicture stripes = paper(.4, {0, 0}, 8);
  auto& image = std::get<Image<Rgb8>>(stripes.pixels);
  for (int y = 0; y < kWallHeight; ++y)
    for (int x = 0; x < kWallWidth; ++x)
      if (x / 60 % 2 == 0) image.at(x, y) = {90, 90, 90};
  refuse(std::move(stripes), "fall-off of a lens");
  EXPECT_FALSE(calibrate_vignetting({}, lens(), Response::srgb(), 0));
}

TEST(Vignetting, PicturesWithoutRoomForALensAreRefused) {
  for (const auto& [w, h] : {std::pair{4000, 1}, {1, 1}, {3, 3}, {8, 2}}) {
    const std::vector<EvenPicture> pictures{{"small", Image<Rgb8>(w, h, {140, 140, 140})}};
    const auto camera = *make_projection(ProjectionKind::kPinhole, w, h);
    const auto found = calibrate_vignetting(pictures, camera, Response::srgb(), 0);
    ASSERT_FALSE(found) << w << ' ' << h;
    EXPECT_EQ(found.error().code, ErrorCode::kUndetermined);
  }
}

TEST(Vignetting, FileReadsBackAndBadOnesAreRefused) {
  VignettingCalibration c;
  c.vignetting = vignetting_of(lens(), kTerms);
  const auto back = parse_vignetting_file(print_vignetting_file(c), "v.toml");
  ASSERT_TRUE(back);
  EXPECT_EQ(*back, kTerms);
  for (const char* text : {"", "version = 1", "version = 1\n[vignetting]\nterms = [1, 2]",
                           "version = 1\n[vignetting]\nterms = [1, 2, nan]",
                           "version = 1\n[vignetting]\nterms = [0, 0, 0]\nother = 1", "\xff"})
    EXPECT_FALSE(parse_vignetting_file(text, "v.toml")) << text;
  EXPECT_FALSE(is_plausible(vignetting_of(lens(), {-1.2, 0, 0}), lens()));
  EXPECT_FALSE(is_plausible(vignetting_of(lens(), {.8, 0, 0}), lens()));
}

}  // namespace
}  // namespace penumbra::calib
