#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "calib/calib.h"
#include "capture/capture.h"
#include "capture/ring/internal/table_merger.h"
#include "core/half.h"
#include "tests/support/brackets.h"

namespace penumbra::capture {
namespace {

constexpr double kTwoStops[] = {1. / 16, 1, 1. / 64, 1. / 4};  // in no order
constexpr float kDarkest = .005f, kBrightest = 50;

calib::Response three_gammas() {
  std::array<std::vector<float>, 3> decode;
  for (std::size_t c = 0; c < 3; ++c)
    for (int i = 0; i < 256; ++i)
      decode[c].push_back(static_cast<float>(std::pow(i / 255., 1.8 + .2 * double(c))));
  auto response = calib::Response::from_table(decode);
  EXPECT_TRUE(response);
  return *response;
}

Sensor sensor_with(calib::Response response, double black_level) {
  Sensor s;
  s.response = std::move(response);
  s.black_level = black_level;
  return s;
}

CameraInfo camera_of(const ExposureStack& stack) {
  CameraInfo camera;
  camera.projection = {
      calib::ProjectionKind::kLatLong, width(*stack.frames[0]), height(*stack.frames[0]), {}, {}};
  camera.response = stack.response;
  camera.noise = stack.noise;
  camera.noise_known = true;
  camera.black_level = stack.black_level;
  return camera;
}

MergedImage by_table(const ExposureStack& stack) {
  MergedImage out;
  const auto camera = camera_of(stack);
  auto order = std::vector<std::size_t>(stack.exposures.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::sort(order, std::greater{},
                    [&](std::size_t k) { return stack.exposures[k].product(); });
  std::vector<Exposure> exposures;
  std::vector<TableMerger::MergeSlot> slots;
  for (const std::size_t k : order) {
    exposures.push_back(stack.exposures[k]);
    slots.push_back({&std::get<Image<Rgb8>>(*stack.frames[k]), stack.exposures[k], 0});
  }
  auto merger = TableMerger::make(exposures, camera);
  EXPECT_TRUE(merger);
  if (merger) merger->update(slots, nullptr, out);
  return out;
}

using test::radiance_of;

/// RMSE of the tables over RMSE of the full estimate, relative errors; the worst decade of the
/// worst channel.
double cost_of_tables(const Sensor& sensor, std::span<const Exposure> exposures, int width,
                      int height, unsigned seed) {
  const auto truth = test::log_uniform_radiance(width, height, kDarkest, kBrightest, seed);
  const auto stack = test::bracket(sensor, truth, exposures, seed);
  const auto full = merge(stack);
  EXPECT_TRUE(full);
  const MergedImage table = by_table(stack);
  EXPECT_EQ(table.pixels.width(), width);
  EXPECT_EQ(table.pixels.height(), height);
  double ours[3][4] = {}, best[3][4] = {}, worst = 0;
  for (std::size_t i = 0; full && i < truth.area(); ++i) {
    EXPECT_EQ(table.pixels.pixels()[i].a == 0, full->clipped.pixels()[i] == 1) << i;
    for (int c = 0; c < 3; ++c) {
      const double x = truth.pixels()[i][c];
      const auto decade = static_cast<std::size_t>(std::log10(x / double(kDarkest)));
      ours[c][std::min<std::size_t>(3, decade)] += std::pow(radiance_of(table, i)[c] / x - 1, 2);
      best[c][std::min<std::size_t>(3, decade)] +=
          std::pow(full->radiance.pixels()[i][c] / x - 1, 2);
    }
  }
  for (int c = 0; c < 3; ++c)
    for (int decade = 0; decade < 4; ++decade) {
      const double ratio = std::sqrt(ours[c][decade] / best[c][decade]);
      if (!(ratio <= worst)) worst = ratio;  // NaN is the worst
    }
  return worst;
}

TEST(TableMerger, CostsAtMostFivePerCentOfTheFullEstimate) {
  const auto exposures = test::exposures_of(kTwoStops);
  for (const double black : {0., .02}) {
    const double srgb =
        cost_of_tables(sensor_with(calib::Response::srgb(), black), exposures, 521, 303, 1);
    const double linear =
        cost_of_tables(sensor_with(calib::Response::linear(), black), exposures, 521, 303, 2);
    const double gammas =
        cost_of_tables(sensor_with(three_gammas(), black), exposures, 521, 303, 3);
    std::printf(
        "black %.2f: RMSE of the tables over the full estimate: sRGB %.4f, linear %.4f, three "
        "gammas %.4f\n",
        black, srgb, linear, gammas);
    for (const double ratio : {srgb, linear, gammas}) EXPECT_LE(ratio, 1.05) << black;
  }
}

TEST(TableMerger, CountsClippedPixelsLikeTheFullEstimate) {
  Image<Rgb> truth(37, 29, {1, 1, 1});
  for (int y = 0; y < 7; ++y) truth.at(3, y).b = 1e4f;
  const auto stack = test::bracket(sensor_with(calib::Response::srgb(), 0), truth,
                                   test::exposures_of(kTwoStops), 4);
  const auto full = merge(stack);
  ASSERT_TRUE(full);
  EXPECT_NEAR(full->clipped_fraction, 7. / (37 * 29), 1e-9);
  EXPECT_NEAR(by_table(stack).clipped_fraction, full->clipped_fraction, .003);
}

TEST(TableMerger, AnySizeComesOutWhole) {
  // Neither a multiple of the vector width nor of the block; the last pixels as right as the first
  // ones.
  for (const auto& [width, height] :
       {std::pair{1, 1}, {7, 1}, {255, 1}, {256, 1}, {257, 3}, {37, 29}}) {
    Sensor sensor = sensor_with(calib::Response::srgb(), 0);
    sensor.noisy = false;
    const auto truth = test::log_uniform_radiance(width, height, .1, 30, 5);
    const MergedImage table =
        by_table(test::bracket(sensor, truth, test::exposures_of(kTwoStops), 5));
    ASSERT_EQ(table.pixels.area(), truth.area());
    for (std::size_t i = 0; i < truth.area(); ++i)
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(radiance_of(table, i)[c] / truth.pixels()[i][c], 1, .03)
            << width << 'x' << height << ' ' << i;
  }
}

TEST(TableMerger, ChannelsOfDifferentResponseDoNotMix) {
  Sensor sensor = sensor_with(three_gammas(), 0);
  sensor.noisy = false;
  const Image<Rgb> truth(300, 3, {.3f, 3, 12});
  const MergedImage table =
      by_table(test::bracket(sensor, truth, test::exposures_of(kTwoStops), 6));
  for (std::size_t i = 0; i < truth.area(); ++i) {
    ASSERT_NEAR(radiance_of(table, i).r / .3, 1, .01) << i;
    ASSERT_NEAR(radiance_of(table, i).g / 3, 1, .01) << i;
    ASSERT_NEAR(radiance_of(table, i).b / 12, 1, .01) << i;
  }
}

TEST(TableMerger, RefusesExposuresThatShareTheInformation) {
  const auto make = [](std::vector<double> times) {
    CameraInfo camera;
    camera.response = calib::Response::srgb();
    return TableMerger::make(test::exposures_of(times), camera).has_value();
  };
  EXPECT_FALSE(make({1, 1. / 2, 1. / 4, 1. / 8})) << "one stop apart: two of four hold 80 %";
  EXPECT_FALSE(make({1, 1, 1})) << "equal exposures";
  EXPECT_FALSE(make({}));
  EXPECT_TRUE(make({1, 1. / 4, 1. / 16}));
  EXPECT_TRUE(make({1, 1. / 2})) << "two are two";
  EXPECT_TRUE(make({1}));
}

}  // namespace
}  // namespace penumbra::capture
