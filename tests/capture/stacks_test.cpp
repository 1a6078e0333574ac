// Stacks as people take them: times that are not known, cameras held by hand, people who walk
// through.
#include "calib/calib.h"
#include "capture/capture.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "codec/codec.h"
#include "tests/support/brackets.h"
#include "tests/support/shared_data.h"

namespace penumbra::capture {
namespace {

ResponseTable srgb() {
  return make_response_table(calib::Response::srgb(), 8, 0);
}

Image<Rgb> room() {
  Image<Rgb> map = make_room_environment(320, 160);
  for (Rgb& p : map.pixels()) p = p * .4f;
  return map;
}

const Image<Rgb8>& bytes(const std::shared_ptr<const FramePixels>& f) {
  return std::get<Image<Rgb8>>(*f);
}

TEST(ExposureRatio, IsFoundWithAnIntervalThatHoldsIt) {
  Sensor sensor;
  sensor.response = calib::Response::srgb();
  int held = 0;
  constexpr int kRuns = 200;
  for (std::uint64_t n = 0; n < kRuns; ++n) {
    const double truth = 1.3 + .03 * static_cast<double>(n);
    Image<Rgb> scene = make_random_environment(192, 96, static_cast<std::uint32_t>(n % 20));
    for (Rgb& p : scene.pixels()) p = p * .3f;
    const auto a = test::shot(sensor, scene, {Seconds(.1), Gain(1)}, 2 * n + 1),
               b = test::shot(sensor, scene, {Seconds(.1 * truth), Gain(1)}, 2 * n + 2);
    const auto found = estimate_exposure_ratio(bytes(a), bytes(b), srgb());
    ASSERT_TRUE(found) << found.error().detail;
    EXPECT_NEAR(found->ratio / truth, 1, .01) << truth;
    held += found->low <= truth && truth <= found->high;
  }
  std::printf("the interval held the true ratio in %d of %d\n", held, kRuns);
  // 95 %, of which chance alone takes or gives 3.
  EXPECT_GE(held, kRuns * 92 / 100);
  EXPECT_LE(held, kRuns * 98 / 100);
}

// The base of a film, or glare inside a camera: dark parts look alike in both pictures.
TEST(ExposureRatio, LightThatIsAddedToBothHasNoSay) {
  const ResponseTable curve = srgb();
  const Image<Rgb> scene = room();
  const auto exposed = [&](float time) {
    Image<Rgb8> out(scene.width(), scene.height());
    for (std::size_t i = 0; i < out.area(); ++i) {
      const Rgb y = scene.pixels()[i] * (time * .1f) + Rgb{.012f, .008f, .006f};
      const auto code = [&](float v, int c) { return curve.encode8(c, v); };
      out.pixels()[i] = {code(y.r, 0), code(y.g, 1), code(y.b, 2)};
    }
    return out;
  };
  const Image<Rgb8> a = exposed(.2f), b = exposed(.4f);
  std::vector<double> logs;
  for (std::size_t i = 0; i < a.area(); ++i)
    if (b.pixels()[i].g < 240)
      logs.push_back(double(curve.decode(1, b.pixels()[i].g)) /
                     double(curve.decode(1, a.pixels()[i].g)));
  std::ranges::nth_element(logs, logs.begin() + std::ptrdiff_t(logs.size() / 2));
  EXPECT_LT(logs[logs.size() / 2], 1.9) << "the median of ratios would do: the test shows nothing";
  const auto found = estimate_exposure_ratio(a, b, curve);
  ASSERT_TRUE(found) << found.error().detail;
  EXPECT_NEAR(found->ratio, 2, .02);
}

TEST(ExposureRatio, AWrongCurveWidensTheInterval) {
  Sensor sensor;
  sensor.response = calib::Response::gamma(1.6);
  const auto scene = room();
  const auto a = test::shot(sensor, scene, {Seconds(.1), Gain(1)}, 1),
             b = test::shot(sensor, scene, {Seconds(.4), Gain(1)}, 2);
  const ResponseTable right = make_response_table(sensor.response, 8, 0);
  const auto good = estimate_exposure_ratio(bytes(a), bytes(b), right),
             bad = estimate_exposure_ratio(bytes(a), bytes(b), srgb());
  ASSERT_TRUE(good && bad);
  EXPECT_NEAR(good->ratio, 4, .05);
  EXPECT_GT((bad->high - bad->low) / bad->ratio, 5 * (good->high - good->low) / good->ratio);
}

TEST(ExposureRatio, WhatMovedHasNoSay) {
  Sensor sensor;
  sensor.response = calib::Response::srgb();
  Image<Rgb> scene = room();
  const auto a = test::shot(sensor, scene, {Seconds(.1), Gain(1)}, 1);
  const auto still = estimate_exposure_ratio(
      bytes(a), bytes(test::shot(sensor, scene, {Seconds(.3), Gain(1)}, 3)), srgb());
  ASSERT_TRUE(still);
  EXPECT_LT(still->moved_fraction, .001);
  for (int y = 40; y < 120; ++y)
    for (int x = 100; x < 180; ++x) scene.at(x, y) = scene.at(x, y) * .3f;
  const auto b = test::shot(sensor, scene, {Seconds(.3), Gain(1)}, 2);
  const auto found = estimate_exposure_ratio(bytes(a), bytes(b), srgb());
  ASSERT_TRUE(found);
  EXPECT_NEAR(found->ratio, 3, .05);
  EXPECT_GT(found->moved_fraction, .05) << "an eighth of the picture moved";
}

TEST(ExposureRatio, WithoutOverlapThereIsNone) {
  const Image<Rgb8> black(64, 64), white(64, 64, {255, 255, 255});
  const auto none = estimate_exposure_ratio(black, white, srgb());
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::kUndetermined);
  EXPECT_FALSE(estimate_exposure_ratio(black, Image<Rgb8>(32, 64), srgb()));
}

/// Tiles of many sizes and shades: something to find everywhere.
Image<Rgb> tiles(int width, int height) {
  std::mt19937 rng(4);
  std::uniform_real_distribution<float> shade(.05f, .9f), place(0, 1), size(6, 50);
  Image<Rgb> out(width, height, {.4f, .4f, .4f});
  for (int n = 0; n < 900; ++n) {
    const int x0 = int(place(rng) * float(width)), y0 = int(place(rng) * float(height)),
              w = int(size(rng)), h = int(size(rng));
    const float v = shade(rng);
    for (int y = y0; y < std::min(height, y0 + h); ++y)
      for (int x = x0; x < std::min(width, x0 + w); ++x) out.at(x, y) = {v, .9f * v, .8f * v};
  }
  return out;
}

TEST(AlignStack, BringsAHandHeldStackBackToAFractionOfAPixel) {
  Sensor sensor;
  sensor.response = calib::Response::srgb();
  const Image<Rgb> scene = tiles(640, 480);
  cv::Mat picture(480, 640, CV_32FC3, const_cast<Rgb*>(scene.pixels().data()));
  const cv::Mat turn = (cv::Mat_<double>(3, 3) << std::cos(.02), -std::sin(.02), 14, std::sin(.02),
                        std::cos(.02), -9, 0, 0, 1);
  Image<Rgb> turned(640, 480);
  cv::Mat target(480, 640, CV_32FC3, turned.pixels().data());
  cv::warpPerspective(picture, target, turn, target.size(), cv::INTER_CUBIC);
  ExposureStack stack{{}, {}, sensor.response, sensor.noise, 0};
  stack.frames = {test::shot(sensor, scene, {Seconds(.5), Gain(1)}, 1),
                  test::shot(sensor, turned, {Seconds(1), Gain(1)}, 2)};
  stack.exposures = {{Seconds(.5), Gain(1)}, {Seconds(1), Gain(1)}};
  const auto before = stack.frames[1];
  const auto alignment = align_stack(stack, 0);
  ASSERT_TRUE(alignment) << alignment.error().detail;
  EXPECT_EQ(alignment->moved_px[0], 0);
  EXPECT_GT(alignment->moved_px[1], 8);
  // What is left, by the brightness of the two pictures in the middle.
  const auto off = [&](const std::shared_ptr<const FramePixels>& f) {
    double sum = 0, n = 0;
    const ResponseTable curve = srgb();
    for (int y = 60; y < 420; ++y)
      for (int x = 60; x < 580; ++x) {
        const double truth = double(scene.at(x, y).g);
        if (truth > .8) continue;
        sum += std::abs(double(curve.decode(1, bytes(f).at(x, y).g)) - truth), ++n;
      }
    return sum / n;
  };
  EXPECT_LT(off(stack.frames[1]), .02);
  EXPECT_GT(off(before), .1) << "without it";
}

// Above three megapixels features are found in small pictures first. What is left has to be a
// fraction of a pixel of the large ones, not of the small.
TEST(AlignStack, LargePicturesAreAlignedToAFractionOfTheirOwnPixels) {
  Sensor sensor;
  sensor.response = calib::Response::srgb();
  constexpr int kWidth = 3600, kHeight = 2400;
  const Image<Rgb> part = tiles(720, 480);
  Image<Rgb> scene(kWidth, kHeight);
  cv::Mat small(480, 720, CV_32FC3, const_cast<Rgb*>(part.pixels().data())),
      large(kHeight, kWidth, CV_32FC3, scene.pixels().data());
  // Shades that differ from place to place, and edges as sharp as the pixels.
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      scene.at(x, y) =
          part.at((x + y / 480 * 97) % 720, y % 480) * (.6f + .4f * static_cast<float>(x) / kWidth);
  const cv::Mat turn = (cv::Mat_<double>(3, 3) << std::cos(.01), -std::sin(.01), 24, std::sin(.01),
                        std::cos(.01), -19, 0, 0, 1);
  Image<Rgb> turned(kWidth, kHeight);
  cv::Mat target(kHeight, kWidth, CV_32FC3, turned.pixels().data());
  cv::warpPerspective(large, target, turn, target.size(), cv::INTER_CUBIC);
  ExposureStack stack{{}, {}, sensor.response, sensor.noise, 0};
  stack.frames = {test::shot(sensor, scene, {Seconds(.5), Gain(1)}, 1),
                  test::shot(sensor, turned, {Seconds(1), Gain(1)}, 2)};
  stack.exposures = {{Seconds(.5), Gain(1)}, {Seconds(1), Gain(1)}};
  const auto alignment = align_stack(stack, 0);
  ASSERT_TRUE(alignment) << alignment.error().detail;
  const ResponseTable curve = srgb();
  double sum = 0, n = 0;
  for (int y = 200; y < kHeight - 200; y += 3)
    for (int x = 200; x < kWidth - 200; x += 3) {
      const double truth = double(scene.at(x, y).g);
      if (truth > .8) continue;
      sum += std::abs(double(curve.decode(1, bytes(stack.frames[1]).at(x, y).g)) - truth), ++n;
    }
  std::printf("large pictures: off by %.4f in the mean\n", sum / n);
  EXPECT_LT(sum / n, .015);
}

TEST(AlignStack, PicturesOfNothingInCommonAreNamed) {
  ExposureStack stack{{}, {}, calib::Response::srgb(), {}, 0};
  stack.frames = {std::make_shared<const FramePixels>(Image<Rgb8>(64, 64, {90, 90, 90})),
                  std::make_shared<const FramePixels>(Image<Rgb8>(64, 64, {9, 9, 9}))};
  stack.exposures = {{Seconds(1), Gain(1)}, {Seconds(.1), Gain(1)}};
  const auto none = align_stack(stack, 0);
  ASSERT_FALSE(none);
  EXPECT_NE(none.error().where.find("picture 2"), std::string::npos);
  EXPECT_FALSE(align_stack(stack, 2)) << "no such reference";
}

// ------------------------------------------------------------------------------ real pictures

ExposureStack read_stack(const std::vector<std::filesystem::path>& paths,
                         const std::vector<double>& times) {
  ExposureStack stack;
  for (std::size_t k = 0; k < paths.size(); ++k) {
    auto frame = codec::read_frame(paths[k]);
    EXPECT_TRUE(frame) << frame.error().detail;
    if (frame) stack.frames.push_back(std::make_shared<const FramePixels>(std::move(*frame)));
    stack.exposures.push_back({Seconds(times[k]), Gain(1)});
  }
  return stack;
}

Result<calib::Response> response_of(const ExposureStack& stack) {
  std::vector<const Image<Rgb8>*> pictures;
  std::vector<Seconds> times;
  for (std::size_t k = 0; k < stack.frames.size(); ++k)
    pictures.push_back(&bytes(stack.frames[k])), times.push_back(stack.exposures[k].time);
  return calib::estimate_response(pictures, times);
}

/// Contrast against the reference picture where that one is well exposed, by blocks of 16 pixels:
/// the fraction of blocks beyond 5 %.
double ghosts(const Image<Rgb>& merged, const Image<Rgb8>& reference, const ResponseTable& curve,
              double time) {
  constexpr int kBlock = 16;
  int all = 0, off = 0;
  for (int y = 0; y + kBlock <= merged.height(); y += kBlock)
    for (int x = 0; x + kBlock <= merged.width(); x += kBlock) {
      double ours = 0, right = 0;
      bool usable = true;
      for (int i = 0; i < kBlock * kBlock && usable; ++i) {
        const int px = x + i % kBlock, py = y + i / kBlock;
        const Rgb8& p = reference.at(px, py);
        usable = std::min({p.r, p.g, p.b}) > 30 && std::max({p.r, p.g, p.b}) < 225;
        ours += double(merged.at(px, py).g);
        right += double(curve.decode(1, p.g)) / time;
      }
      if (!usable) continue;
      ++all;
      off += std::abs(ours / right - 1) > .05;
    }
  EXPECT_GT(all, 500);
  return double(off) / all;
}

// A part of a scene, exposed; what lies at x of one picture lies at x + dx of another.
Image<Rgb8> seen_from(const Image<Rgb>& scene, int dx, int dy, double time, std::uint64_t seed) {
  Sensor sensor;
  sensor.response = calib::Response::srgb();
  constexpr int kMargin = 60;
  Image<Rgb> part(scene.width() - 2 * kMargin, scene.height() - 2 * kMargin);
  for (int y = 0; y < part.height(); ++y)
    for (int x = 0; x < part.width(); ++x)
      part.at(x, y) = .4f * scene.at(x + kMargin - dx, y + kMargin - dy);
  return bytes(test::shot(sensor, part, {Seconds(time), Gain(1)}, seed));
}

// With stones of 10 px.
Image<Rgb> paved(Image<Rgb> scene, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> shade(.4f, 1.6f);
  constexpr int kStone = 10;
  for (int y0 = 0; y0 < scene.height(); y0 += kStone)
    for (int x0 = 0; x0 < scene.width(); x0 += kStone) {
      const float s = shade(random);
      for (int y = y0; y < y0 + kStone; ++y)
        for (int x = x0; x < x0 + kStone; ++x) scene.at(x, y) = s * scene.at(x, y);
    }
  return scene;
}

TEST(CameraShift, IsFoundBetweenExposuresAndNotWhereTheCameraStands) {
  for (std::uint32_t n = 0; n < 8; ++n) {
    const Image<Rgb> scene = paved(make_random_environment(800, 400, 40 + n), n);
    const Image<Rgb8> a = seen_from(scene, 0, 0, .1, 2 * n), same = seen_from(scene, 0, 0, .4, 90),
                      moved = seen_from(scene, 34, -12, .4, 2 * n + 1);
    const auto still = find_camera_shift(a, same), shift = find_camera_shift(a, moved);
    ASSERT_TRUE(still) << n;
    EXPECT_FALSE(still->moved()) << still->moved_px[0] << ' ' << still->moved_px[1];
    ASSERT_TRUE(shift) << n;
    EXPECT_TRUE(shift->moved());
    EXPECT_NEAR(shift->moved_px[0], 34, 2 * shift->sigma_px);
    EXPECT_NEAR(shift->moved_px[1], -12, 2 * shift->sigma_px);
    // Of another place nothing can be said.
    const Image<Rgb> other = paved(make_random_environment(800, 400, 140 + n), 50 + n);
    const auto none = find_camera_shift(a, seen_from(other, 0, 0, .1, 91));
    EXPECT_FALSE(none && none->moved()) << none->moved_px[0] << ' ' << none->moved_px[1];
  }
  const Image<Rgb8> grey(300, 200);
  const auto nothing = find_camera_shift(grey, grey);
  EXPECT_FALSE(nothing && nothing->moved());
  EXPECT_FALSE(find_camera_shift(Image<Rgb8>(8, 8), Image<Rgb8>(8, 8)));
}

TEST(RealStack, PersonInPingpongLeavesNoGhost) {
  PENUMBRA_NEED_SHARED(first, "eval-only/stacks/pingpong/Img1.JPG");
  const auto folder = first.parent_path();
  ExposureStack stack =
      read_stack({first, folder / "Img2.JPG", folder / "Img3.JPG"}, {1. / 1000, 1. / 250, 1. / 60});
  ExposureStack naive = stack;
  const Image<Rgb8> reference = bytes(stack.frames[1]);
  const auto alignment = align_stack(stack, 1);
  ASSERT_TRUE(alignment) << alignment.error().detail;
  const auto response = response_of(stack);
  ASSERT_TRUE(response) << response.error().detail;
  stack.response = naive.response = *response;
  stack.first_code = naive.first_code = calib::kFirstReliableCode;
  stack.last_code = naive.last_code = calib::kLastReliableCode;
  stack.priority = {1, 0, 2};
  stack.noise_known = false;
  const auto merged = merge(stack), plain = merge(naive);
  ASSERT_TRUE(merged && plain);
  const ResponseTable curve = make_response_table(*response, 8, 0);
  const double ours = ghosts(merged->radiance, reference, curve, 1. / 250),
               without = ghosts(plain->radiance, reference, curve, 1. / 250);
  std::printf(
      "pingpong: moved by %.0f and %.0f px; %.2f %% of the blocks differ from the reference by "
      "more than 5 %%, "
      "%.0f %% without alignment and rejection\n",
      alignment->moved_px[0], alignment->moved_px[2], 100 * ours, 100 * without);
  EXPECT_LE(ours, .003);
  EXPECT_GT(without, .1);
}

TEST(RealStack, TaipeiMergesOverItsWholeRange) {
  PENUMBRA_NEED_SHARED(first, "eval-only/stacks/taipei/DSC_0058.png");
  std::vector<std::filesystem::path> paths;
  std::vector<double> times;
  for (int k = 58; k <= 67; ++k) {
    paths.push_back(first.parent_path() / ("DSC_00" + std::to_string(k) + ".png"));
    times.push_back(std::exp2(63 - k));
  }
  ExposureStack stack = read_stack(paths, times);
  const auto response = response_of(stack);
  ASSERT_TRUE(response) << response.error().detail;
  stack.response = *response;
  stack.first_code = calib::kFirstReliableCode, stack.last_code = calib::kLastReliableCode;
  const auto merged = merge(stack);
  ASSERT_TRUE(merged);
  EXPECT_LT(merged->clipped_fraction, .001);
  // Each picture is what the merge predicts for its exposure, where it is well exposed.
  const ResponseTable curve = make_response_table(*response, 8, 0);
  for (std::size_t k = 0; k < paths.size(); ++k) {
    double square = 0, n = 0;
    for (std::size_t i = 0; i < merged->radiance.area(); ++i) {
      const unsigned code = bytes(stack.frames[k]).pixels()[i].g;
      if (code < 30 || code > 225) continue;
      const double predicted = double(merged->radiance.pixels()[i].g) * times[k];
      square += std::pow(std::log10(predicted / double(curve.decode(1, code))), 2), ++n;
    }
    if (n < 20000) continue;  // lamps and their halos, which traffic changed
    std::printf("taipei %.3g s: log10 RMSE %.4f over %.0f pixels\n", times[k],
                std::sqrt(square / n), n);
    EXPECT_LT(std::sqrt(square / n), .08) << times[k];
  }
}

// No pair of a stack whose times are right may be called wrong, and the intervals hold the truth.
void expect_believable(const ExposureStack& stack, std::size_t may_miss) {
  std::size_t pairs = 0, missed = 0;
  const ResponseTable curve = make_response_table(stack.response, 8, 0);
  for (std::size_t k = 1; k < stack.frames.size(); ++k) {
    const double truth = stack.exposures[k - 1].time / stack.exposures[k].time;
    const auto found = estimate_exposure_ratio(bytes(stack.frames[k]), bytes(stack.frames[k - 1]),
                                               curve, kEstimatedExponentSigma);
    if (!found) continue;  // too little overlaps
    ++pairs;
    missed += truth < found->low || found->high < truth;
    const bool warned = found->fraction > .2 && std::abs(found->ratio / truth - 1) > .1 &&
                        (truth < found->low || truth > found->high);
    EXPECT_FALSE(warned) << k << ": " << found->ratio << " in " << found->low << " to "
                         << found->high;
  }
  std::printf("%zu of %zu intervals hold the told ratio\n", pairs - missed, pairs);
  EXPECT_LE(missed, may_miss);
  EXPECT_GE(pairs, stack.frames.size() / 2);
}

// Pictures that are numbered in order, each exposed for half as long as the one before.
ExposureStack halving_stack(const std::filesystem::path& folder, const std::string& name, int first,
                            int last, double first_time) {
  std::vector<std::filesystem::path> paths;
  std::vector<double> times;
  for (int k = first; k <= last; ++k) {
    paths.push_back(folder / (name + std::to_string(k) + ".png"));
    times.push_back(std::ldexp(first_time, first - k));
  }
  ExposureStack stack = read_stack(paths, times);
  const auto response = response_of(stack);
  EXPECT_TRUE(response) << response.error().detail;
  if (response) stack.response = *response;
  return stack;
}

TEST(RealStack, MemorialsTimesAreBelieved) {
  PENUMBRA_NEED_SHARED(first, "eval-only/stacks/memorial/memorial0061.png");
  expect_believable(halving_stack(first.parent_path(), "memorial00", 61, 76, 32), 1);
}

TEST(RealStack, TaipeisTimesAreBelieved) {
  PENUMBRA_NEED_SHARED(first, "eval-only/stacks/taipei/DSC_0058.png");
  expect_believable(halving_stack(first.parent_path(), "DSC_00", 58, 67, 32), 1);
}

// Nothing but a few codes next to black is well exposed in both: no ratio, or one of which the
// interval says that it is none.
TEST(RealStack, BridesPicturesHardlyOverlapAndSaySo) {
  PENUMBRA_NEED_SHARED(first, "eval-only/exposure-video/bride/001_0.jpg");
  for (const calib::Response& response : {calib::Response::srgb(), calib::Response::gamma(2.2)})
    for (int n = 1; n <= 14; ++n) {
      char name[16];
      std::snprintf(name, sizeof name, "%03d_", n);
      const ExposureStack stack = read_stack({first.parent_path() / (std::string(name) + "0.jpg"),
                                              first.parent_path() / (std::string(name) + "1.jpg")},
                                             {1, 1});
      const auto ratio = estimate_exposure_ratio(bytes(stack.frames[0]), bytes(stack.frames[1]),
                                                 make_response_table(response, 8, 0));
      if (!ratio) continue;
      EXPECT_TRUE(ratio->fraction < .005 || ratio->high > 1.5 * ratio->low)
          << name << response.describe();
    }
}

}  // namespace
}  // namespace penumbra::capture
