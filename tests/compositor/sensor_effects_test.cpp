// Inserted things must not be cleaner or sharper than what the camera sees.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "compositor/composite/compositor.h"
#include "prt/prt.h"
#include "tests/support/leaning_wall.h"
#include "tests/support/scenes.h"

namespace penumbra::compositor {
namespace {

using test::kSceneHeight, test::kSceneWidth;

// Noise of an ordinary camera, strong enough to be measured.
constexpr double kElectrons = 4000, kRead = .002;

RadianceSh light_from_side() {
  return test::sloped_light(1, {.5, .6, .1}, 3);
}

/// A sensor of its own for these tests: Poisson and Gaussian from the standard library.
template <class Code>
Code exposed(const ResponseTable& curve, int channel, double signal, std::mt19937& random) {
  std::normal_distribution<double> read(0, kRead);
  double electrons = 0;
  if (signal > 0)
    electrons = std::poisson_distribution<int>(std::min(signal, 4.) * kElectrons)(random);
  return static_cast<Code>(
      curve.encode(channel, static_cast<float>(electrons / kElectrons + read(random))));
}

template <class Pixel>
Image<Pixel> photograph(const ResponseTable& curve, const Image<Rgb>& signal,
                        std::mt19937& random) {
  Image<Pixel> out(signal.width(), signal.height());
  for (std::size_t i = 0; i < out.area(); ++i) {
    const Rgb s = signal.pixels()[i];
    using Code = decltype(Pixel::r);
    out.pixels()[i] = {exposed<Code>(curve, 0, s.r, random), exposed<Code>(curve, 1, s.g, random),
                       exposed<Code>(curve, 2, s.b, random)};
  }
  return out;
}

/// Variance over frames, pixel by pixel, in signal; the mean over chosen samples.
class DirectionSet {
 public:
  template <class Pixel>
  void add(const ResponseTable& curve, const Image<Pixel>& frame) {
    sum_.resize(3 * frame.area());
    square_.resize(3 * frame.area());
    for (std::size_t i = 0; i < frame.area(); ++i) {
      const Pixel p = frame.pixels()[i];
      const unsigned codes[3] = {p.r, p.g, p.b};
      for (std::size_t c = 0; c < 3; ++c) {
        const double y = curve.decode(static_cast<int>(c), codes[c]);
        sum_[3 * i + c] += y;
        square_[3 * i + c] += y * y;
      }
    }
    ++count_;
  }
  double variance(const std::vector<std::size_t>& pixels) const {
    double total = 0;
    for (const std::size_t i : pixels)
      for (std::size_t k = 3 * i; k < 3 * i + 3; ++k)
        total += (square_[k] - sum_[k] * sum_[k] / count_) / (count_ - 1);
    return total / (3. * static_cast<double>(pixels.size()));
  }
  double mean(const std::vector<std::size_t>& pixels) const {
    double total = 0;
    for (const std::size_t i : pixels)
      for (std::size_t k = 3 * i; k < 3 * i + 3; ++k) total += sum_[k] / count_;
    return total / (3. * static_cast<double>(pixels.size()));
  }

 private:
  std::vector<double> sum_, square_;
  double count_ = 0;
};

class SensorEffectsTest : public testing::Test {
 protected:
  void SetUp() override { start(); }
  void start(int oversampling = 2) {
    compositor_.reset();  // one GL context at a time
    auto made = Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen,
                                   oversampling);
    if (!made && made.error().code == ErrorCode::kUnavailable)
      GTEST_SKIP() << "no OpenGL ES 3.1: " << made.error().detail;
    ASSERT_TRUE(made) << made.error().detail;
    compositor_ = std::move(*made);
  }
  View view(const ResponseTable* curve = nullptr, float signal = .5f) const {
    return {test::scene_camera(), curve, signal, {}};
  }
  static SensorEffects noise(std::uint64_t frame) {
    return {0, static_cast<float>(1 / kElectrons), static_cast<float>(kRead), frame};
  }
  FramePixels composited(FramePixels frame, const View& v, CompositeStats* touched = nullptr) {
    const auto done = compositor_->composite(v, frame);
    EXPECT_TRUE(done) << done.error().detail;
    if (done && touched) *touched = *done;
    return frame;
  }
  Image<Rgb> floats(const Image<Rgb>& frame, const View& v) {
    return std::get<Image<Rgb>>(composited(frame, v));
  }
  /// V and T of every pixel without blur.
  Image<Rgb> added(const View& v) { return floats(Image<Rgb>(kSceneWidth, kSceneHeight), v); }
  Image<Rgb> left(const View& v) {
    View dark = v;
    dark.signal_per_radiance = 0;
    return floats(Image<Rgb>(kSceneWidth, kSceneHeight, {1, 1, 1}), dark);
  }

  std::unique_ptr<Compositor> compositor_;
  const ResponseTable curve8_ = test::srgb_curve(8), curve16_ = test::srgb_curve(16);
};

// ------------------------------------------------------------------------------------- off

TEST_F(SensorEffectsTest, WithoutALookEveryPixelIsTheFormulaBitForBit) {
  test::add_lit(*compositor_, test::baked_sphere(true), light_from_side());
  const View v = view(&curve8_);
  const Image<Rgb> plus = added(v), times = left(v);
  const auto frame = test::noise_frame<Rgb8>(1);
  View numbered = v;
  numbered.effects.frame = 7;
  ASSERT_TRUE(numbered.effects.none());
  const auto out = std::get<Image<Rgb8>>(composited(frame, numbered));
  int objects = 0, shadows = 0;
  for (std::size_t i = 0; i < frame.area(); ++i) {
    const Rgb8 in = frame.pixels()[i];
    const std::uint8_t code[3] = {in.r, in.g, in.b};
    std::uint8_t expected[3];
    if (times.pixels()[i] == Rgb{}) {
      ++objects;
      for (int c = 0; c < 3; ++c) expected[c] = curve8_.encode8(c, plus.pixels()[i][c]);
    } else if (plus.pixels()[i] == Rgb{}) {
      shadows += times.pixels()[i] != Rgb{1, 1, 1};
      for (int c = 0; c < 3; ++c)
        expected[c] = times.pixels()[i] == Rgb{1, 1, 1}
                          ? code[c]
                          : curve8_.encode8(c, times.pixels()[i][c] * curve8_.decode(c, code[c]));
    } else {
      continue;  // the rim: V + (1 - a) s y rounds in its own way
    }
    ASSERT_EQ(out.pixels()[i], (Rgb8{expected[0], expected[1], expected[2]})) << i;
  }
  EXPECT_GT(objects, 1000);
  EXPECT_GT(shadows, 500);
}

// An object in the border of the picture is as dim there as what is real; a shadow is a ratio and
// stays.
TEST_F(SensorEffectsTest, VignettingDimsTheObjectAndNotItsShadow) {
  test::add_lit(*compositor_, test::baked_sphere(true), light_from_side());
  const View plain = view();
  View dim = plain;
  dim.vignetting = {{-.3, -.1, 0}, {20, 30}, 200};
  const Image<Rgb> bright = added(plain), less = added(dim);
  int objects = 0;
  for (int y = 0; y < kSceneHeight; ++y)
    for (int x = 0; x < kSceneWidth; ++x) {
      if (bright.at(x, y) == Rgb{}) continue;
      ++objects;
      const double left = dim.vignetting.at({x + .5, y + .5});
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(less.at(x, y)[c], left * double(bright.at(x, y)[c]), 1e-5) << x << ' ' << y;
    }
  EXPECT_GT(objects, 1000);
  EXPECT_TRUE(this->left(plain) == this->left(dim));
  // With noise the other pass draws it.
  View noisy = dim;
  noisy.effects = {0, 1e-9f, 0, 1};
  const Image<Rgb> again = added(noisy);
  for (std::size_t i = 0; i < less.area(); ++i)
    ASSERT_NEAR(again.pixels()[i].g, less.pixels()[i].g, 2e-3) << i;
}

// ------------------------------------------------------------------------------------- noise

TEST_F(SensorEffectsTest, ObjectHasTheNoiseOfTheSensorAtTheSameSignal) {
  constexpr int kFrames = 24;
  test::add_lit(*compositor_, test::baked_sphere(false), test::constant_light({1, 1, 1}, 3));
  const auto check = [&]<class Pixel>(const ResponseTable& curve, float signal, Pixel) {
    View v = view(&curve, signal);
    const Image<Rgb> clean = added(v), times = left(v);
    std::vector<std::size_t> inside;
    for (std::size_t i = 0; i < times.area(); ++i)
      if (times.pixels()[i] == Rgb{}) inside.push_back(i);
    ASSERT_GT(inside.size(), 1000U);
    std::mt19937 random(5);
    DirectionSet ours, real, naive;
    const Image<Pixel> black(kSceneWidth, kSceneHeight);
    for (int k = 0; k < kFrames; ++k) {
      v.effects = noise(static_cast<std::uint64_t>(k));
      ours.add(curve, std::get<Image<Pixel>>(composited(black, v)));
      v.effects = {};
      naive.add(curve, std::get<Image<Pixel>>(composited(black, v)));
      real.add(curve, photograph<Pixel>(curve, clean, random));
    }
    const double ratio = ours.variance(inside) / real.variance(inside);
    std::printf("object, %d bits, signal %.3f: variance %.3f of the sensor's, %.3f without\n",
                8 * int(sizeof(Pixel::r)), double(signal), ratio,
                naive.variance(inside) / real.variance(inside));
    EXPECT_NEAR(ratio, 1, .1) << signal;
    EXPECT_NEAR(ours.mean(inside) / real.mean(inside), 1, .01) << signal;
    EXPECT_LT(naive.variance(inside), .1 * real.variance(inside)) << "what is tested is seen";
  };
  for (const float signal : {.02f, .15f, .6f}) {
    check(curve8_, signal, Rgb8{});
    check(curve16_, signal, Rgb16{});
  }
}

TEST_F(SensorEffectsTest, ShadowedFloorHasTheNoiseOfADarkerFloor) {
  constexpr int kFrames = 24;
  test::add_lit(*compositor_, test::baked_sphere(true), test::sloped_light(1, {.3, .9, .1}, 3));
  const View v = view();
  const Image<Rgb> plus = added(v), times = left(v);
  const auto check = [&]<class Pixel>(const ResponseTable& curve, float level, Pixel) {
    std::vector<std::size_t> deep, light;
    Image<Rgb> open(kSceneWidth, kSceneHeight, {level, level, level}), darker = open;
    for (std::size_t i = 0; i < times.area(); ++i) {
      const float s = times.pixels()[i].g;
      darker.pixels()[i] = level * times.pixels()[i];
      if (plus.pixels()[i] == Rgb{} && s > .2f && s < .65f) deep.push_back(i);
      if (plus.pixels()[i] == Rgb{} && s > .7f && s < .9f) light.push_back(i);
    }
    ASSERT_GT(deep.size(), 100U);
    ASSERT_GT(light.size(), 100U);
    std::mt19937 random(6);
    DirectionSet ours, naive, real;
    View with = view(&curve);
    for (int k = 0; k < kFrames; ++k) {
      const auto frame = photograph<Pixel>(curve, open, random);
      with.effects = {};
      naive.add(curve, std::get<Image<Pixel>>(composited(frame, with)));
      with.effects = noise(static_cast<std::uint64_t>(k));
      ours.add(curve, std::get<Image<Pixel>>(composited(frame, with)));
      real.add(curve, photograph<Pixel>(curve, darker, random));
    }
    const double ratio = ours.variance(deep) / real.variance(deep),
                 without = naive.variance(deep) / real.variance(deep),
                 in_light = ours.variance(light) / real.variance(light);
    std::printf(
        "shadow, %d bits, floor %.2f: variance %.3f of a darker floor's in the deep part (only "
        "multiplied %.3f), %.3f in the light part (%.3f)\n",
        8 * int(sizeof(Pixel::r)), double(level), ratio, without, in_light,
        naive.variance(light) / real.variance(light));
    EXPECT_NEAR(ratio, 1, .15) << level;
    EXPECT_NEAR(in_light, 1, .15) << level;
    EXPECT_LT(without, .8) << "what is tested is seen";
    EXPECT_NEAR(ours.mean(deep) / real.mean(deep), 1, .01) << level;
  };
  for (const float level : {.08f, .3f, .7f}) {
    check(curve8_, level, Rgb8{});
    check(curve16_, level, Rgb16{});
  }
}

TEST_F(SensorEffectsTest, NoiseOfNeighboursChannelsAndFramesHasNothingInCommon) {
  test::add_lit(*compositor_, test::baked_sphere(false), test::constant_light({1, 1, 1}, 3));
  View v = view(nullptr, .3f);
  const Image<Rgb> clean = added(v), times = left(v);
  v.effects = noise(3);
  const Image<Rgb> a = added(v);
  v.effects = noise(4);
  const Image<Rgb> b = added(v);
  double square = 0, beside = 0, below = 0, channel = 0, next = 0;
  for (int y = 0; y + 1 < kSceneHeight; ++y)
    for (int x = 0; x + 1 < kSceneWidth; ++x) {
      if (times.at(x, y) != Rgb{} || times.at(x + 1, y) != Rgb{} || times.at(x, y + 1) != Rgb{})
        continue;
      const auto n = [&](const Image<Rgb>& of, int i, int j, int c) {
        return double(of.at(i, j)[c] - clean.at(i, j)[c]);
      };
      const double here = n(a, x, y, 1);
      square += here * here;
      beside += here * n(a, x + 1, y, 1);
      below += here * n(a, x, y + 1, 1);
      channel += here * n(a, x, y, 2);
      next += here * n(b, x, y, 1);
    }
  for (const double sum : {beside, below, channel, next}) EXPECT_LT(std::abs(sum / square), .1);
}

TEST_F(SensorEffectsTest, SameFrameNumberGivesTheSameBytesAndAnotherOneDoesNot) {
  const auto object = test::baked_sphere(true);
  test::add_lit(*compositor_, object, light_from_side());
  const FramePixels frame = test::noise_frame<Rgb8>(2);
  View v = view(&curve8_);
  v.effects = noise(11);
  v.effects.psf_sigma_px = .8f;
  const auto first = composited(frame, v);
  EXPECT_EQ(composited(frame, v), first);
  v.effects.frame = 12;
  EXPECT_NE(composited(frame, v), first);
  v.effects.frame = 11;
  EXPECT_EQ(composited(frame, v), first);
  start();
  test::add_lit(*compositor_, object, light_from_side());
  EXPECT_EQ(composited(frame, v), first) << "by another compositor";
}

// ------------------------------------------------------------------------------------- blur

/// Where a rising edge passes 10 and 90 % of `full`, from samples (distance, value).
double width_10_90(const std::vector<std::pair<double, double>>& samples, double full) {
  constexpr double kBin = .125, kFrom = -12;
  std::vector<double> sum(192), count(192);
  for (const auto& [d, value] : samples) {
    const double at = (d - kFrom) / kBin;
    if (at < 0 || at >= double(sum.size())) continue;
    sum[std::size_t(at)] += value / full;
    count[std::size_t(at)] += 1;
  }
  const auto crossing = [&](double level) {
    for (std::size_t i = 1; i < sum.size(); ++i) {
      const double before = sum[i - 1] / count[i - 1], here = sum[i] / count[i];
      if (before < level && here >= level)
        return kFrom + kBin * (double(i) - .5 + (level - before) / (here - before));
    }
    return std::nan("");
  };
  return crossing(.9) - crossing(.1);
}

TEST_F(SensorEffectsTest, InsertedEdgeIsAsWideAsARealOne) {
  start(4);  // the edge's own steps must not count
  const double lean = .09;
  test::add_lit(*compositor_, test::leaning_wall(lean), test::constant_light({1, 1, 1}, 3));
  View v = view(nullptr, .5f);
  v.camera.world_from_camera = {};
  const auto distance = [&](double px, double py) {  // from the edge, in pixels
    return (px - v.camera.principal_px.x) * std::cos(lean) +
           (py - v.camera.principal_px.y) * std::sin(lean);
  };
  for (const float sigma : {.6f, .8f, 1.5f, 3.f}) {
    std::vector<std::pair<double, double>> real, ours, naive;
    v.effects = {};
    const Image<Rgb> sharp = added(v);
    v.effects.psf_sigma_px = sigma;
    const Image<Rgb> blurred = added(v);
    for (int y = 20; y < kSceneHeight - 20; ++y)
      for (int x = 0; x < kSceneWidth; ++x) {
        const double d = distance(x + .5, y + .5);
        double mean = 0;  // over the pixel, of the edge seen through the lens
        for (int k = 0; k < 64; ++k)
          mean += std::erfc(-distance(x + (k % 8 + .5) / 8, y + (double(k / 8) + .5) / 8) /
                            double(sigma) / std::numbers::sqrt2) /
                  128;
        real.emplace_back(d, mean);
        ours.emplace_back(d, blurred.at(x, y).g);
        naive.emplace_back(d, sharp.at(x, y).g);
      }
    const double level = double(sharp.at(140, 60).g), expected = width_10_90(real, 1),
                 width = width_10_90(ours, level), without = width_10_90(naive, level);
    std::printf("edge, sigma %.1f: %.2f pixels from 10 to 90 %%, a real one %.2f, unblurred %.2f\n",
                double(sigma), width, expected, without);
    EXPECT_NEAR(width / expected, 1, .1) << sigma;
    EXPECT_LT(without, .75 * expected) << "what is tested is seen";
    for (int y = 0; y < kSceneHeight; ++y)
      ASSERT_NEAR(blurred.at(kSceneWidth - 1, y).g, level, .01 * level)
          << "beyond the picture's edge the object goes on";
  }
}

TEST_F(SensorEffectsTest, ObjectAndShadowAreBlurredTogetherAndRealPixelsNotAtAll) {
  test::add_lit(*compositor_, test::baked_sphere(true), light_from_side());
  const double sigma = 2;
  const int radius = 6;
  View v = view();
  const Image<Rgb> plus = added(v), times = left(v);
  const Image<Rgb> frame = test::noise_frame<Rgb>(4);
  v.effects.psf_sigma_px = float(sigma);
  const Image<Rgb> out = floats(frame, v);
  double worst = 0, unblurred = 0;
  for (int y = radius; y < kSceneHeight - radius; ++y)
    for (int x = radius; x < kSceneWidth - radius; ++x) {
      Rgb vs, ts;
      float weight = 0;
      for (int j = -radius; j <= radius; ++j)
        for (int i = -radius; i <= radius; ++i) {
          const auto w = static_cast<float>(std::exp(-(i * i + j * j) / (2 * sigma * sigma)));
          vs += plus.at(x + i, y + j) * w;
          ts += times.at(x + i, y + j) * w;
          weight += w;
        }
      for (int c = 0; c < 3; ++c) {
        const float b = frame.at(x, y)[c], expected = (vs[c] + ts[c] * b) / weight;
        worst = std::max(worst, double(std::abs(out.at(x, y)[c] - expected)));
        unblurred = std::max(unblurred,
                             double(std::abs(plus.at(x, y)[c] + times.at(x, y)[c] * b - expected)));
      }
    }
  EXPECT_LT(worst, .01) << "a sampled Gaussian differs by that much";
  EXPECT_GT(unblurred, .2) << "what is tested is seen";
}

TEST_F(SensorEffectsTest, PixelsOutOfReachComeOutBitForBitAndTheRimOfTheBlurDoesNot) {
  const int handle = test::add_lit(*compositor_, test::baked_sphere(true), light_from_side());
  for (const glm::dvec3& at : {glm::dvec3(0), glm::dvec3(-.9, 0, .5), glm::dvec3(1.2, .3, 0)}) {
    compositor_->set_pose(handle, {{1, 0, 0, 0}, at});
    View v = view(&curve8_);
    const Image<Rgb> plus = added(v), times = left(v);
    for (const float sigma : {0.f, .7f, 2.5f}) {
      const int radius = static_cast<int>(std::ceil(3 * sigma));
      v.effects = noise(1);
      v.effects.psf_sigma_px = sigma;
      const auto f8 = test::noise_frame<Rgb8>(3);
      CompositeStats touched;
      const auto out8 = std::get<Image<Rgb8>>(composited(f8, v, &touched));
      const auto f32 = test::noise_frame<Rgb>(3);
      const auto out32 = floats(f32, v);
      std::size_t reached = 0, rim = 0;
      for (int y = 0; y < kSceneHeight; ++y)
        for (int x = 0; x < kSceneWidth; ++x) {
          bool near = false;
          for (int j = std::max(0, y - radius); j <= std::min(kSceneHeight - 1, y + radius); ++j)
            for (int i = std::max(0, x - radius); i <= std::min(kSceneWidth - 1, x + radius); ++i)
              near |= plus.at(i, j) != Rgb{} || times.at(i, j) != Rgb{1, 1, 1};
          reached += near;
          if (near) {
            rim += plus.at(x, y) == Rgb{} && times.at(x, y) == Rgb{1, 1, 1} &&
                   out32.at(x, y) != f32.at(x, y);
            continue;
          }
          ASSERT_EQ(out8.at(x, y), f8.at(x, y)) << x << ' ' << y << ' ' << sigma;
          ASSERT_EQ(out32.at(x, y), f32.at(x, y)) << x << ' ' << y << ' ' << sigma;
        }
      EXPECT_LE(touched.pixels, reached);
      EXPECT_GT(touched.pixels, 500U);
      if (sigma > 0) {
        EXPECT_GT(rim, 100U);
      }
    }
  }
}

// ------------------------------------------------------------------------------------- edges

TEST_F(SensorEffectsTest, NoLightGivesNoNan) {
  compositor_->add_object(test::baked_sphere(true));  // never lit
  test::add_lit(*compositor_, test::baked_sphere(true), test::constant_light({0, 0, 0}, 3),
                {{1, 0, 0, 0}, {.5, 0, 0}});
  View v = view(&curve8_);
  for (const float sigma : {0.f, 1.f})
    for (const float b : {0.f, -.01f, 1e-30f, 1e6f}) {
      v.effects = noise(1);
      v.effects.psf_sigma_px = sigma;
      const Image<Rgb> out = floats(Image<Rgb>(kSceneWidth, kSceneHeight, {b, b, b}), v);
      for (const Rgb& p : out.pixels())
        for (int c = 0; c < 3; ++c) ASSERT_TRUE(std::isfinite(p[c])) << sigma << ' ' << b;
    }
}

TEST_F(SensorEffectsTest, NothingVirtualChangesNothing) {
  View v = view(&curve8_);
  v.effects = noise(1);
  v.effects.psf_sigma_px = 2;
  const FramePixels frame = test::noise_frame<Rgb8>(5);
  CompositeStats touched;
  EXPECT_EQ(composited(frame, v, &touched), frame);
  EXPECT_EQ(touched.pixels, 0U);
}

TEST_F(SensorEffectsTest, ImpossibleLooksAreRefusedAndTheFrameIsLeftAlone) {
  test::add_lit(*compositor_, test::baked_sphere(true), light_from_side());
  const float nan = std::nanf("");
  for (const SensorEffects& look :
       {SensorEffects{-1, 0, 0, 0}, SensorEffects{nan, 0, 0, 0}, SensorEffects{21, 0, 0, 0},
        SensorEffects{0, -1e-3f, 0, 0}, SensorEffects{0, nan, 0, 0}, SensorEffects{0, 0, -1, 0},
        SensorEffects{0, 0, nan, 0}}) {
    FramePixels frame = test::noise_frame<Rgb8>(1);
    const FramePixels before = frame;
    View v = view(&curve8_);
    v.effects = look;
    const auto done = compositor_->composite(v, frame);
    EXPECT_TRUE(!done && done.error().code == ErrorCode::kInvalid);
    EXPECT_EQ(frame, before);
  }
}

}  // namespace
}  // namespace penumbra::compositor
