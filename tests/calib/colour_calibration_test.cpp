#include <gtest/gtest.h>

#include <cmath>
#include <glm/matrix.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "calib/calib.h"

namespace penumbra::calib {
namespace {

// Of two real cameras' sensors, rows summing to about one.
const glm::dmat3 kMatrix =
    glm::transpose(glm::dmat3(1.9, -.25, .05, -.12, 1.4, -.2, .02, -.35, 2.1));

Rgb carried(const glm::dmat3& m, const Rgb& c) {
  const glm::dvec3 v = m * glm::dvec3(c.r, c.g, c.b);
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}

struct Scene {
  double noise = .01;     // of each measurement
  double saturation = 1;  // 0: grey things alone
  double strangers = 0;   // fraction of the pairs that show two surfaces
};

std::vector<ColourPair> surfaces(const Scene& scene, int count, unsigned seed) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> unit(0, 1);
  std::normal_distribution<double> gauss(0, scene.noise);
  const auto colour = [&] {
    const double brightness = std::exp(6 * unit(rng) - 3), grey = .5;
    Rgb out;
    for (int c = 0; c < 3; ++c)
      out[c] = static_cast<float>(brightness *
                                  (grey + scene.saturation * (.05 + .9 * unit(rng) - grey)));
    return out;
  };
  const auto measured = [&](Rgb c) {
    for (int n = 0; n < 3; ++n) c[n] *= static_cast<float>(1 + gauss(rng));
    return c;
  };
  std::vector<ColourPair> out;
  for (int i = 0; i < count; ++i) {
    const Rgb surface = colour();
    const bool stranger = unit(rng) < scene.strangers;
    out.push_back({measured(surface), measured(carried(kMatrix, stranger ? colour() : surface))});
  }
  return out;
}

double farthest(const glm::dmat3& a, const glm::dmat3& b) {
  double out = 0;
  for (int c = 0; c < 3; ++c)
    for (int r = 0; r < 3; ++r) out = std::max(out, std::abs(a[c][r] - b[c][r]));
  return out;
}

TEST(ColourCalibration, FindsTheMatrixAlsoWhereAQuarterOfThePairsShowTwoSurfaces) {
  for (const double strangers : {0., .25}) {
    const auto pairs = surfaces({.01, 1, strangers}, 400, 1);
    const auto found = calibrate_colour(pairs, ColourModel::kMatrix);
    ASSERT_TRUE(found) << found.error().detail;
    EXPECT_LT(farthest(found->matrix, kMatrix), .02) << strangers;
    EXPECT_LT(found->rms, .03);
    EXPECT_NEAR(static_cast<double>(std::ranges::count(found->used, true)) / 400, 1 - strangers,
                .08);
  }
  // Plain least squares believes them all: two brightnesses of three decades, any pair of them.
  const auto pairs = surfaces({.01, 1, .25}, 400, 1);
  cv::Mat a, b;
  for (const ColourPair& p : pairs) {
    a.push_back(cv::Mat(cv::Matx13d(p.source.r, p.source.g, p.source.b)));
    b.push_back(cv::Mat(cv::Matx13d(p.target.r, p.target.g, p.target.b)));
  }
  cv::Mat naive;
  cv::solve(a, b, naive, cv::DECOMP_SVD);
  EXPECT_GT(std::abs(naive.at<double>(0, 0) - kMatrix[0][0]), .1);
}

TEST(ColourCalibration, TheStatedUncertaintyCoversTheTruthInNinetyFivePercent) {
  int inside = 0, all = 0;
  for (unsigned seed = 0; seed < 200; ++seed) {
    const auto found =
        calibrate_colour(surfaces({.01, 1, 0}, 120, 100 + seed), ColourModel::kMatrix);
    ASSERT_TRUE(found);
    for (int c = 0; c < 3; ++c)
      for (int r = 0; r < 3; ++r) {
        inside += std::abs(found->matrix[c][r] - kMatrix[c][r]) < 1.96 * found->sigma[c][r];
        ++all;
      }
  }
  EXPECT_NEAR(static_cast<double>(inside) / all, .95, .025);
}

TEST(ColourCalibration, GreySurroundingsTellGainsButNoMatrix) {
  const auto grey = surfaces({.01, .02, 0}, 400, 3);
  const auto matrix = calibrate_colour(grey, ColourModel::kMatrix);
  ASSERT_FALSE(matrix);
  EXPECT_EQ(matrix.error().code, ErrorCode::kUndetermined);
  EXPECT_NE(matrix.error().detail.find("colour chart"), std::string::npos);
  const auto gains = calibrate_colour(grey, ColourModel::kGains);
  ASSERT_TRUE(gains) << gains.error().detail;
  const Rgb white = carried(gains->matrix, {1, 1, 1}), truth = carried(kMatrix, {1, 1, 1});
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(double(white[c] / truth[c]), 1, .01);
  EXPECT_EQ(gains->matrix[1][0], 0);
  EXPECT_FALSE(calibrate_colour(grey, ColourModel::kScale)) << "its gains differ by half";
}

TEST(ColourCalibration, RefusesWhatCannotTellTheAnswer) {
  EXPECT_EQ(calibrate_colour(surfaces({}, 7, 1), ColourModel::kGains).error().code,
            ErrorCode::kUndetermined);
  const auto strange = calibrate_colour(surfaces({.01, 1, 1}, 300, 5), ColourModel::kMatrix);
  ASSERT_FALSE(strange);
  EXPECT_EQ(strange.error().code, ErrorCode::kUndetermined);
  auto pairs = surfaces({}, 100, 1);
  pairs[7].target.g = std::nanf("");
  const auto broken = calibrate_colour(pairs, ColourModel::kMatrix);
  ASSERT_FALSE(broken);
  EXPECT_EQ(broken.error().code, ErrorCode::kNonFinite);
  EXPECT_EQ(broken.error().where, "colour pair 8");
}

TEST(ColourFile, ComesBackAndDamagedOnesAreRefused) {
  ColourCalibration c;
  c.matrix = kMatrix;
  c.used = {true};
  const auto back = parse_colour_file(print_colour_file(c, "fisheye", "left"), "colour.toml");
  ASSERT_TRUE(back) << back.error().detail;
  EXPECT_LT(farthest(*back, kMatrix), 1e-6);
  for (const char* const text : {"", "version = 1", "version = 1\n[colour]\nmatrix = [1, 2, 3]",
                                 "version = 1\n[colour]\nmatrix = [1, 0, 0, 0, 1, 0, 0, 0, nan]",
                                 "version = 1\n[colour]\nmatrix = [1, 1, 1, 1, 1, 1, 1, 1, 1]",
                                 "version = 1\n[colour]\nmatrix = [1e9, 0, 0, 0, 1, 0, 0, 0, 1]",
                                 "version = 1\n[colour]\nmatrix = [-1, 0, 0, 0, -1, 0, 0, 0, 1]",
                                 "version = 1\n[colour]\nmatrix = [0, 0, 0, 0, 0, 0, 0, 0, 0]",
                                 "version = 2\n[colour]\nmatrix = [1, 0, 0, 0, 1, 0, 0, 0, 1]"})
    EXPECT_FALSE(parse_colour_file(text, "colour.toml")) << text;
}

// A ColorChecker's patches in linear sRGB, measured by its maker, rounded.
constexpr Rgb kPatches[] = {
    {.17f, .08f, .05f}, {.54f, .30f, .22f}, {.11f, .20f, .33f}, {.11f, .15f, .05f},
    {.23f, .22f, .43f}, {.12f, .51f, .41f}, {.72f, .20f, .02f}, {.06f, .10f, .39f},
    {.55f, .09f, .12f}, {.11f, .04f, .14f}, {.34f, .50f, .05f}, {.78f, .36f, .02f},
    {.02f, .05f, .30f}, {.06f, .29f, .07f}, {.45f, .03f, .04f}, {.84f, .57f, .01f},
    {.51f, .09f, .30f}, {.01f, .24f, .37f}, {.87f, .88f, .85f}, {.58f, .59f, .58f},
    {.35f, .36f, .36f}, {.19f, .19f, .19f}, {.09f, .09f, .09f}, {.03f, .03f, .03f}};

// Tilted, on a grey wall, in units of its own.
Image<Rgb> picture_of_chart(float unit) {
  constexpr int kWidth = 900, kHeight = 640, kCell = 60, kEdge = 12;
  cv::Mat chart(4 * kCell + kEdge, 6 * kCell + kEdge, CV_32FC3, cv::Scalar(.01, .01, .01));
  for (int i = 0; i < 24; ++i) {
    const Rgb& p = kPatches[i];
    cv::rectangle(chart,
                  {i % 6 * kCell + kEdge, i / 6 * kCell + kEdge, kCell - kEdge, kCell - kEdge},
                  cv::Scalar(p.r, p.g, p.b), cv::FILLED);
  }
  const auto w = static_cast<float>(chart.cols), h = static_cast<float>(chart.rows);
  const cv::Mat view = cv::getPerspectiveTransform(
      std::vector<cv::Point2f>{{0, 0}, {w, 0}, {w, h}, {0, h}},
      std::vector<cv::Point2f>{{210, 130}, {650, 160}, {630, 470}, {190, 420}});
  cv::Mat picture(kHeight, kWidth, CV_32FC3, cv::Scalar(.25, .24, .22));
  cv::warpPerspective(chart, picture, view, picture.size(), cv::INTER_AREA, cv::BORDER_TRANSPARENT);
  Image<Rgb> out(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const auto& p = picture.at<cv::Vec3f>(y, x);
      out.at(x, y) = unit * Rgb{p[0], p[1], p[2]};
    }
  return out;
}

TEST(ColourChart, PatchesComeInTheirOrderInTheRadianceOfThePicture) {
  for (const float unit : {1.f, 250.f}) {
    const auto found = find_colour_chart(picture_of_chart(unit), {}, "view");
    ASSERT_TRUE(found) << found.error().detail;
    ASSERT_EQ(found->size(), 24u);
    for (std::size_t i = 0; i < 24; ++i)
      for (int c = 0; c < 3; ++c)
        EXPECT_NEAR(double((*found)[i].value()[c]) / double(unit), double(kPatches[i][c]), .004)
            << i << ' ' << c;
  }
}

TEST(ColourChart, PatchesThatClipAreLeftOut) {
  const Image<Rgb> picture = picture_of_chart(1);
  Image<std::uint8_t> clipped(picture.width(), picture.height());
  for (std::size_t i = 0; i < picture.area(); ++i)
    clipped.pixels()[i] = picture.pixels()[i].r > .8f;
  const auto found = find_colour_chart(picture, clipped, "view");
  ASSERT_TRUE(found);
  for (std::size_t i = 0; i < 24; ++i) EXPECT_EQ((*found)[i].has_value(), kPatches[i].r < .8f) << i;
  // A strip, which the detector would blow up.
  EXPECT_FALSE(find_colour_chart(Image<Rgb>(4000, 120, {.2f, .3f, .1f}), {}, "view"));
}

TEST(ColourChart, APictureWithoutOneIsRefused) {
  const auto found = find_colour_chart(Image<Rgb>(640, 480, {.2f, .3f, .1f}), {}, "view");
  ASSERT_FALSE(found);
  EXPECT_EQ(found.error().code, ErrorCode::kUndetermined);
  EXPECT_EQ(found.error().where, "view");
}

}  // namespace
}  // namespace penumbra::calib
