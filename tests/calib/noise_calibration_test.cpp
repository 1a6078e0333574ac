#include <gtest/gtest.h>

#include <cmath>

#include "calib/calib.h"
#include "capture/capture.h"
#include "tests/support/brackets.h"

namespace penumbra::calib {
namespace {

capture::Sensor sensor(int bits, Response response, NoiseModel noise, double black_level) {
  capture::Sensor out;
  out.bits = bits;
  out.response = std::move(response);
  out.noise = noise;
  out.black_level = black_level;
  return out;
}

// A still scene of four decades.
Image<Rgb> scene() {
  Image<Rgb> out(160, 96);
  for (int y = 0; y < 96; ++y)
    for (int x = 0; x < 160; ++x) {
      const auto v = static_cast<float>(1.2 * std::pow(1e-4, x / 159.));
      out.at(x, y) = {v, v * .8f, v * .6f};
    }
  return out;
}

StillSeries film(const capture::Sensor& s, const Image<Rgb>& radiance, int frames, unsigned seed,
                 double gain = 1, double flicker = 0, double time = 1) {
  StillSeries out(gain, time / gain);
  for (int n = 0; n < frames; ++n) {
    Image<Rgb> lit = radiance;
    const auto light = static_cast<float>(1 + flicker * std::sin(2.4 * n));
    for (Rgb& p : lit.pixels()) p = light * p;
    const auto frame = test::shot(s, lit, {Seconds(time / gain), Gain(gain)},
                                  seed * 1000 + static_cast<unsigned>(n));
    EXPECT_TRUE(out.add(*frame, "frame"));
  }
  return out;
}

TEST(NoiseCalibration, FindsFullWellReadNoiseAndBlackOfARawCamera) {
  const auto raw = sensor(16, Response::linear(), {8000, 2e-3}, .02);
  const std::vector<StillSeries> still = {film(raw, scene(), 24, 1), film(raw, scene(), 24, 2, 4)};
  const std::vector<StillSeries> capped = {film(raw, Image<Rgb>(160, 96), 24, 3)};
  const auto found = calibrate_noise(still, capped, raw.response, 0);
  ASSERT_TRUE(found) << found.error().detail;
  EXPECT_NEAR(found->model.full_well_electrons / 8000, 1, .02);
  EXPECT_NEAR(found->model.read_noise / 2e-3, 1, .03);
  EXPECT_NEAR(found->black_level, .02, 2e-5);
  EXPECT_LT(found->error, .03);
}

TEST(NoiseCalibration, SeesNoiseThroughTheCodesOfAnEightBitCamera) {
  const auto eight = sensor(8, Response::srgb(), {3000, 4e-3}, 0);
  const std::vector<StillSeries> still = {film(eight, scene(), 32, 1)};
  const auto found = calibrate_noise(still, {}, eight.response, 0);
  ASSERT_TRUE(found) << found.error().detail;
  EXPECT_NEAR(found->model.full_well_electrons / 3000, 1, .05);
  EXPECT_NEAR(found->model.read_noise / 4e-3, 1, .15);
}

// Taken for 0, a black level of .05 puts the full well a fifth off.
TEST(NoiseCalibration, WithoutACappedLensTwoExposuresTellTheBlackLevel) {
  const auto raw = sensor(16, Response::linear(), {8000, 1e-3}, .05);
  const std::vector<StillSeries> still = {film(raw, scene(), 24, 1),
                                          film(raw, scene(), 24, 2, 1, 0, 1 / 16.)};
  const auto found = calibrate_noise(still, {}, raw.response, 0);
  ASSERT_TRUE(found) << found.error().detail;
  EXPECT_TRUE(found->black_measured);
  EXPECT_NEAR(found->black_level, .05, 5e-4);
  EXPECT_NEAR(found->model.full_well_electrons / 8000, 1, .03);
  EXPECT_NEAR(found->model.read_noise / 1e-3, 1, .15);
  // Of one exposure the slope is right, and that black was not measured is said.
  const auto one = calibrate_noise(std::span(still).first(1), {}, raw.response, 0);
  ASSERT_TRUE(one) << one.error().detail;
  EXPECT_FALSE(one->black_measured);
  EXPECT_NEAR(one->model.full_well_electrons / 8000, 1, .05);
}

// Frames that a camera has smoothed say nothing of its sensor: 77,681 electrons for 8,163.
TEST(NoiseCalibration, FramesWithoutTheirNoiseAreFarOffTheModel) {
  const auto raw = sensor(8, Response::srgb(), {8000, 2e-3}, 0);
  StillSeries smoothed(1, 1);
  for (int n = 0; n < 40; ++n) {
    const auto frame = test::shot(raw, scene(), {Seconds(1), Gain(1)}, 900 + n);
    const Image<Rgb8>& codes = std::get<Image<Rgb8>>(*frame);
    Image<Rgb8> out(codes.width(), codes.height());
    // In the dark most of all, as cameras do.
    for (int y = 0; y < codes.height(); ++y)
      for (int x = 0; x < codes.width(); ++x)
        for (const auto channel : {&Rgb8::r, &Rgb8::g, &Rgb8::b}) {
          const int code = codes.at(x, y).*channel, radius = code < 60 ? 8 : code < 120 ? 2 : 0;
          int sum = 0, count = 0;
          for (int dy = -radius; dy <= radius; ++dy) {
            const int there = std::clamp(y + dy, 0, codes.height() - 1);
            sum += codes.at(x, there).*channel, ++count;
          }
          out.at(x, y).*channel = static_cast<std::uint8_t>((sum + count / 2) / count);
        }
    ASSERT_TRUE(smoothed.add(FramePixels(std::move(out)), "frame"));
  }
  const auto found = calibrate_noise({&smoothed, 1}, {}, raw.response, 0);
  ASSERT_TRUE(found) << found.error().detail;
  std::printf("smoothed: full well %.0f, %.1f %% off the model\n", found->model.full_well_electrons,
              100 * found->error);
  EXPECT_GT(found->model.full_well_electrons, 1.5 * 8000) << "the test shows nothing";
  EXPECT_GT(found->error, kMaxNoiseModelError);
}

// The mean of 3 x 3 pixels, or of a frame and those before it.
StillSeries smoothed_alike(const capture::Sensor& raw, bool in_time) {
  StillSeries out(1, 1);
  Image<Rgb> before(160, 96);
  for (int n = 0; n < 32; ++n) {
    const auto frame = test::shot(raw, scene(), {Seconds(1), Gain(1)}, 4000 + n);
    const Image<Rgb16>& codes = std::get<Image<Rgb16>>(*frame);
    Image<Rgb16> smooth(160, 96);
    for (int y = 0; y < 96; ++y)
      for (int x = 0; x < 160; ++x)
        for (const auto& [channel, kept] :
             {std::pair(&Rgb16::r, &Rgb::r), {&Rgb16::g, &Rgb::g}, {&Rgb16::b, &Rgb::b}}) {
          float sum = 0;
          for (int k = 0; k < 9; ++k)
            sum += codes.at(std::clamp(x + k % 3 - 1, 0, 159), std::clamp(y + k / 3 - 1, 0, 95)).*
                   channel;
          float& last = before.at(x, y).*kept;
          last = n == 0 ? codes.at(x, y).*channel : .6f * last + .4f * codes.at(x, y).*channel;
          smooth.at(x, y).*channel =
              static_cast<std::uint16_t>(std::lround(in_time ? last : sum / 9));
        }
    EXPECT_TRUE(out.add(FramePixels(std::move(smooth)), "frame"));
  }
  return out;
}

// It follows the model, with a full well that is too large: what tells it is that the noise of
// neighbours, or of successive frames, is no longer independent.
TEST(NoiseCalibration, SmoothingOfBrightAndDarkAlikeIsToldByItsCorrelation) {
  const auto raw = sensor(16, Response::linear(), {8000, 2e-3}, 0);
  const std::vector<StillSeries> still = {film(raw, scene(), 32, 1, 1, .05)};
  const auto white = calibrate_noise(still, {}, raw.response, 0);
  ASSERT_TRUE(white) << white.error().detail;
  EXPECT_NEAR(white->neighbour_correlation, 0, .02);
  EXPECT_NEAR(white->frame_correlation, 0, .02);
  for (const bool in_time : {false, true}) {
    const StillSeries series = smoothed_alike(raw, in_time);
    const auto found = calibrate_noise({&series, 1}, {}, raw.response, 0);
    ASSERT_TRUE(found) << found.error().detail;
    EXPECT_GT(found->model.full_well_electrons, 2 * 8000) << "the test shows nothing";
    EXPECT_LT(found->error, kMaxNoiseModelError) << "the model tells it";
    EXPECT_GT(in_time ? found->frame_correlation : found->neighbour_correlation, .4);
    EXPECT_NEAR(in_time ? found->neighbour_correlation : found->frame_correlation, 0, .05);
  }
}

TEST(NoiseCalibration, LampsThatFlickerAreNoNoiseOfTheCamera) {
  const auto raw = sensor(16, Response::linear(), {8000, 2e-3}, 0);
  const std::vector<StillSeries> still = {film(raw, scene(), 24, 1, 1, .05)};
  const auto found = calibrate_noise(still, {}, raw.response, 0);
  ASSERT_TRUE(found) << found.error().detail;
  EXPECT_NEAR(found->model.full_well_electrons / 8000, 1, .03);
  // Taken as it is, the light's changes are ten times the camera's noise in the bright.
  const auto& codes = still[0].codes();
  double sum = 0, square = 0;
  constexpr std::size_t kPixel = std::size_t{3} * 20;  // of about .4
  for (const auto& frame : codes)
    sum += frame[kPixel] / 65535., square += std::pow(frame[kPixel] / 65535., 2);
  const auto n = static_cast<double>(codes.size());
  const double naive = (square - sum * sum / n) / (n - 1), signal = sum / n;
  EXPECT_GT(naive, 5 * signal / 8000);
}

TEST(NoiseCalibration, SomeoneWhoWalksThroughChangesLittle) {
  const auto raw = sensor(16, Response::linear(), {8000, 2e-3}, 0);
  StillSeries series(1);
  for (int n = 0; n < 24; ++n) {
    Image<Rgb> now = scene();
    for (int y = 30; y < 50; ++y)
      for (int x = 6 * n; x < 6 * n + 12 && x < 160; ++x) now.at(x, y) = {.3f, .3f, .3f};
    ASSERT_TRUE(series.add(*test::shot(raw, now, {Seconds(1), Gain(1)}, 77 + n), "frame"));
  }
  const auto found = calibrate_noise({&series, 1}, {}, raw.response, 0);
  ASSERT_TRUE(found) << found.error().detail;
  EXPECT_NEAR(found->model.full_well_electrons / 8000, 1, .1);
}

TEST(NoiseCalibration, TheStatedUncertaintyCoversTheTruth) {
  const auto raw = sensor(16, Response::linear(), {8000, 2e-3}, .02);
  int well = 0, read = 0;
  constexpr int kRuns = 200;
  for (int run = 0; run < kRuns; ++run) {
    const auto seed = static_cast<unsigned>(run);
    const std::vector<StillSeries> still = {film(raw, scene(), 8, 10 + seed)};
    const std::vector<StillSeries> capped = {film(raw, Image<Rgb>(160, 96), 8, 500 + seed)};
    const auto found = calibrate_noise(still, capped, raw.response, 0);
    ASSERT_TRUE(found) << found.error().detail;
    well += std::abs(found->model.full_well_electrons - 8000) < 1.96 * found->full_well_sigma;
    read += std::abs(found->model.read_noise - 2e-3) < 1.96 * found->read_sigma;
  }
  // No less often than stated; the sigmas hold 2 % for what a real camera does between the points.
  EXPECT_GE(well, .93 * kRuns);
  EXPECT_GE(read, .93 * kRuns);
}

TEST(NoiseCalibration, RefusesWhatCannotTellTheAnswer) {
  const auto raw = sensor(16, Response::linear(), {8000, 2e-3}, 0);
  const auto refused = [](const StillSeries& series, const Response& response,
                          const std::string& word) {
    const auto found = calibrate_noise({&series, 1}, {}, response, 0);
    ASSERT_FALSE(found) << word;
    EXPECT_EQ(found.error().code, ErrorCode::kUndetermined);
    EXPECT_NE(found.error().detail.find(word), std::string::npos) << found.error().detail;
  };
  refused(film(raw, scene(), 5, 1), raw.response, "8 are needed");
  refused(film(raw, Image<Rgb>(160, 96, {.3f, .3f, .3f}), 16, 1), raw.response, "noise");
  const auto quiet = sensor(8, Response::srgb(), {1e9, 1e-7}, 0);
  refused(film(quiet, scene(), 16, 1), quiet.response, "quantisation of the codes");
  StillSeries series(1);
  EXPECT_TRUE(series.add(FramePixels(Image<Rgb8>(8, 8)), "a"));
  EXPECT_FALSE(series.add(FramePixels(Image<Rgb8>(9, 8)), "b"));
  EXPECT_FALSE(series.add(FramePixels(Image<Rgb>(8, 8)), "c"));
}

TEST(NoiseFile, ComesBackAndDamagedOnesAreRefused) {
  NoiseCalibration c;
  c.model = {12345, .00123};
  c.black_level = .0625;
  const auto back = parse_noise_file(print_noise_file(c), "noise.toml");
  ASSERT_TRUE(back) << back.error().detail;
  EXPECT_NEAR(back->model.full_well_electrons, 12345, .1);
  EXPECT_NEAR(back->model.read_noise, .00123, 1e-8);
  EXPECT_EQ(back->black_level, .0625);
  for (const char* const text :
       {"", "version = 1", "version = 1\n[noise]\nfull_well_electrons = 5\n",
        "version = 1\n[noise]\nfull_well_electrons = 0\nread_noise = 0\nblack_level = 0\n",
        "version = 1\n[noise]\nfull_well_electrons = 9\nread_noise = 2\nblack_level = 0\n",
        "version = 1\n[noise]\nfull_well_electrons = 9\nread_noise = 0\nblack_level = inf\n"})
    EXPECT_FALSE(parse_noise_file(text, "noise.toml")) << text;
}

}  // namespace
}  // namespace penumbra::calib
