#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/conventions.h"

namespace penumbra::capture {
namespace {

/// The same radiance everywhere.
class EvenWorld : public RadianceWorld {
 public:
  explicit EvenWorld(float radiance) : radiance_(radiance) {}
  Rgb radiance(const glm::dvec3&, const glm::dvec3&) const override {
    return {radiance_, radiance_, radiance_};
  }
  Rgb far_radiance(const glm::dvec3&) const override { return {radiance_, radiance_, radiance_}; }

 private:
  float radiance_;
};

StudioOptions small_options() {
  StudioOptions o;
  o.environment_width = 32, o.environment_height = 16;
  o.view_width = 40, o.view_height = 30;
  o.view_focal_px = 40;
  o.world_from_view.translation = {0, 1, 2};
  o.schedule = {{Seconds(.9), Gain(1)}, {Seconds(.3), Gain(1)}, {Seconds(.1), Gain(1)}};
  o.view_exposure = Exposure{Seconds(.5), Gain(1)};
  o.view_frames = 12;
  return o;
}

std::vector<Frame> all_frames(Studio& studio) {
  std::vector<Frame> frames;
  for (;;) {
    auto frame = studio.next();
    EXPECT_TRUE(frame);
    if (!frame || !*frame) return frames;
    frames.push_back(std::move(**frame));
  }
}

std::vector<Frame> frames_of(const StudioOptions& options, float radiance = .8f) {
  Studio studio(std::make_shared<EvenWorld>(radiance), options);
  return all_frames(studio);
}

// ------------------------------------------------------------------------------------- frames

TEST(Studio, FramesComeInOrderOfTimeFromBothCameras) {
  const auto frames = frames_of(small_options());
  std::map<int, std::uint64_t> count;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (i) {
      EXPECT_LE(frames[i - 1].time, frames[i].time);
    }
    EXPECT_EQ(frames[i].sequence, count[frames[i].camera]++);
  }
  EXPECT_EQ(count[1], 12U);
  EXPECT_GE(count[0], 12U);
  EXPECT_EQ(frames.front().camera, 0) << "light comes before the first view frame";
}

// Under a lamp's orange light: white is white in the codes, and the light is what it was.
TEST(Studio, WhiteBalanceIsOfThePictureAndNotOfTheLight) {
  Image<Rgb> map(64, 32, {3, 1.4f, .5f});
  for (int y = 16; y < 32; ++y)
    for (Rgb& c : map.row(y)) c = c * .3f;
  const auto world = *FloorWorld::make(std::move(map));
  StudioOptions o = small_options();
  o.view_width = 160, o.view_height = 90, o.view_focal_px = 120;
  o.world_from_view = look_at({.25, .8, 1.75}, {.02, .3, 0});
  o.sensor.response = calib::Response::srgb();
  o.view_exposure.reset();
  o.white = world->floor_irradiance();
  Studio studio(world, o);
  const CameraInfo& view = studio.cameras()[1];
  const auto& gains = view.response.white_balance();
  const Rgb white = world->floor_irradiance();
  for (int c = 1; c < 3; ++c)
    EXPECT_NEAR(double(white[c]) * gains[static_cast<std::size_t>(c)], double(white[0]) * gains[0],
                1e-3 * double(white[0]));
  EXPECT_EQ(studio.cameras()[0].response.white_balance(), (std::array<double, 3>{1, 1, 1}));
  const auto frames = all_frames(studio);
  const auto shot = std::ranges::find(frames, 1, &Frame::camera);
  ASSERT_NE(shot, frames.end());
  const auto& codes = std::get<Image<Rgb8>>(*shot->pixels);
  double clipped = 0, count = 0, sum[3] = {}, truth[3] = {};
  for (int y = 45; y < 90; ++y)
    for (int x = 0; x < 160; ++x) {
      const unsigned p[] = {codes.at(x, y).r, codes.at(x, y).g, codes.at(x, y).b};
      clipped += std::max({p[0], p[1], p[2]}) == 255;
      ++count;
      for (int c = 0; c < 3; ++c) {
        sum[c] += view.response.decode(p[c] / 255., c) / shot->exposure.product();
        truth[c] += double(studio.view_radiance().at(x, y)[c]);
      }
    }
  EXPECT_LT(clipped, .025 * count);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum[c] / truth[c], 1, .01) << c;
}

// The panorama has no border; the view camera tells its own, so that it can be taken out.
TEST(Studio, ViewCameraTellsItsVignetting) {
  const auto world = *FloorWorld::make(Image<Rgb>(64, 32, {1, 1, 1}));
  StudioOptions o = small_options();
  o.sensor.noisy = false;
  o.view_exposure = Exposure{Seconds(.008), Gain(1)};
  Studio even(world, o);
  o.sensor.vignetting = .4;
  Studio dark(world, o);
  EXPECT_EQ(dark.cameras()[0].vignetting, (std::array<double, 3>{}));
  const auto taken_out =
      calib::vignetting_of(dark.cameras()[1].projection, dark.cameras()[1].vignetting);
  EXPECT_NEAR(taken_out.at({0, 0}), .6, 1e-6);
  const auto left = all_frames(even), right = all_frames(dark);
  ASSERT_EQ(left.size(), right.size());
  for (std::size_t i = 0; i < left.size(); ++i) {
    const auto& a = std::get<Image<Rgb8>>(*left[i].pixels);
    const auto& b = std::get<Image<Rgb8>>(*right[i].pixels);
    const int x = a.width() - 1, y = a.height() - 1;
    const double part = left[i].camera == 0 ? 1 : taken_out.at({x + .5, y + .5});
    const calib::Response& response =
        even.cameras()[static_cast<std::size_t>(left[i].camera)].response;
    EXPECT_NEAR(response.decode(b.at(x, y).g / 255., 1),
                part * response.decode(a.at(x, y).g / 255., 1), .01)
        << i;
  }
}

TEST(Studio, LabelsSayTheExposureThatWasAppliedWhateverTheDelay) {
  for (const int delay : {0, 1, 2, 5}) {
    StudioOptions options = small_options();
    options.control_delay_frames = delay;
    options.sensor.noisy = false;
    options.sensor.bits = 16;
    for (const Frame& f : frames_of(options)) {
      if (f.camera != 0) continue;
      const auto request =
          f.sequence >= std::uint64_t(delay) ? f.sequence - std::uint64_t(delay) : 0;
      EXPECT_EQ(f.exposure.time, options.schedule[request % 3].time) << delay << ' ' << f.sequence;
      const double signal = std::get<Image<Rgb16>>(*f.pixels).at(3, 3).g / 65535.;
      EXPECT_NEAR(signal, .8 * f.exposure.product(), 2e-5) << "the picture does not fit its label";
    }
  }
}

TEST(Studio, EveryNthFrameNeverArrives) {
  for (const int n : {2, 3, 7}) {
    StudioOptions options = small_options();
    options.drop_every = n;
    options.view_frames = 30;
    std::map<int, std::vector<std::uint64_t>> seen;
    for (const Frame& f : frames_of(options)) seen[f.camera].push_back(f.sequence);
    for (const auto& [camera, sequences] : seen) {
      std::vector<std::uint64_t> expected;
      for (std::uint64_t i = 0; expected.size() < sequences.size(); ++i)
        if ((i + 1) % std::uint64_t(n) != 0) expected.push_back(i);
      EXPECT_EQ(sequences, expected) << "camera " << camera << ", every " << n;
    }
  }
}

TEST(Studio, SameSeedGivesTheSameBytesAndAnotherOneDoesNot) {
  StudioOptions options = small_options();
  const auto a = frames_of(options), b = frames_of(options);
  options.seed = 2;
  const auto other = frames_of(options);
  ASSERT_EQ(a.size(), b.size());
  ASSERT_EQ(a.size(), other.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(*a[i].pixels, *b[i].pixels) << i;
    EXPECT_NE(*a[i].pixels, *other[i].pixels) << i;
    if (i >= 2 && a[i].camera == a[i - 2].camera) {
      EXPECT_NE(*a[i].pixels, *a[i - 2].pixels) << "frozen noise";
    }
  }
}

TEST(Studio, ClipRepeatsItsFilmedFramesOnly) {
  StudioOptions options = small_options();
  options.clip = 2;
  std::vector<Frame> views, environments;
  for (const Frame& f : frames_of(options)) (f.camera == 1 ? views : environments).push_back(f);
  ASSERT_EQ(views.size(), 12U);
  for (std::size_t i = 2; i < views.size(); ++i) EXPECT_EQ(*views[i].pixels, *views[i - 2].pixels);
  EXPECT_NE(*views[0].pixels, *views[1].pixels);
  const std::size_t exposures = options.schedule.size(), period = 2 * exposures;
  ASSERT_GT(environments.size(), period);
  // Equal exposures in a bracket: noise of its own for each.
  options.schedule.assign(3, options.schedule[0]);
  std::vector<std::shared_ptr<const FramePixels>> bracket;
  for (const Frame& f : frames_of(options))
    if (f.camera == 0 && bracket.size() < 3) bracket.push_back(f.pixels);
  EXPECT_NE(*bracket[0], *bracket[1]);
  EXPECT_NE(*bracket[1], *bracket[2]);
  for (std::size_t i = exposures; i < environments.size(); ++i) {
    const Frame& f = environments[i];
    EXPECT_EQ(f.exposure.time, environments[i - exposures].exposure.time);
    EXPECT_NE(*f.pixels, *environments[i - exposures].pixels) << "each exposure is filmed anew";
    if (i < period) continue;
    EXPECT_EQ(*f.pixels, *environments[i - period].pixels);
  }
}

// ------------------------------------------------------------------------------------- sensor

Image<Rgb16> exposed16(const Sensor& sensor, const Image<Rgb>& radiance, Exposure exposure,
                       std::uint64_t seed) {
  FramePixels out;
  expose(sensor, radiance, exposure, seed, out);
  EXPECT_TRUE(std::holds_alternative<Image<Rgb16>>(out));
  return std::get<Image<Rgb16>>(out);
}

struct Moments {
  double mean = 0, variance = 0;
};
Moments moments_of(const Image<Rgb16>& codes, double black_level) {
  double sum = 0, square = 0;
  const double n = 3 * double(codes.area());
  for (const Rgb16& p : codes.pixels())
    for (const std::uint16_t code : {p.r, p.g, p.b}) {
      const double y = code / 65535. - black_level;
      sum += y, square += y * y;
    }
  return {sum / n, square / n - sum / n * (sum / n)};
}

TEST(Sensor, NoiseHasTheMeanAndTheVarianceOfItsModel) {
  Sensor sensor;
  sensor.bits = 16;
  sensor.black_level = .1;
  double worst = 0;
  std::uint64_t seed = 0;
  for (const double gain : {1., 4.})
    for (const double y : {0., .0003, .0012, .0018, .005, .05, .3, .6}) {
      const Exposure exposure{Seconds(.02), Gain(gain)};
      const auto radiance = static_cast<float>(y / exposure.product());
      const auto codes =
          exposed16(sensor, Image<Rgb>(512, 512, {radiance, radiance, radiance}), exposure, ++seed);
      const Moments found = moments_of(codes, sensor.black_level);
      const double variance = sensor.noise.variance(y, gain) + std::pow(1 / 65535., 2) / 12;
      EXPECT_NEAR(found.variance / variance, 1, .03) << "gain " << gain << " signal " << y;
      EXPECT_NEAR(found.mean, y, 5 * std::sqrt(variance / (3 * 512 * 512)) + 1e-6)
          << "gain " << gain;
      worst = std::max(worst, std::abs(found.variance / variance - 1));
    }
  std::printf("largest distance of the variance from its model: %.2f %%\n", 100 * worst);
}

TEST(Sensor, NoiseOfNeighboursAndChannelsIsIndependent) {
  Sensor sensor;
  sensor.bits = 16;
  sensor.black_level = .1;
  const Image<Rgb16> codes =
      exposed16(sensor, Image<Rgb>(512, 512, {.2f, .2f, .2f}), {Seconds(1), Gain(1)}, 3);
  const Moments m = moments_of(codes, 0);
  double right = 0, below = 0, colour = 0;
  for (int y = 0; y < 511; ++y)
    for (int x = 0; x < 511; ++x) {
      const auto v = [&](int i, int j) { return codes.at(i, j).g / 65535. - m.mean; };
      right += v(x, y) * v(x + 1, y), below += v(x, y) * v(x, y + 1);
      colour += v(x, y) * (codes.at(x, y).r / 65535. - m.mean);
    }
  for (const double sum : {right, below, colour})
    EXPECT_LT(std::abs(sum / (511. * 511) / m.variance), .01);
}

TEST(Sensor, WithoutNoiseCodesFollowTheResponse) {
  for (const int bits : {8, 16})
    for (const auto& response : {calib::Response::linear(), calib::Response::srgb()}) {
      Sensor sensor;
      sensor.noisy = false;
      sensor.bits = bits;
      sensor.response = response;
      sensor.black_level = .04;
      const double full = bits == 8 ? 255 : 65535;
      for (const double y : {0., .001, .1, .5, .9, 1.5}) {
        FramePixels out;
        expose(sensor, Image<Rgb>(3, 2, Rgb{1, 1, 1} * static_cast<float>(y / .02)),
               {Seconds(.01), Gain(2)}, 1, out);
        const double code = bits == 8 ? double(std::get<Image<Rgb8>>(out).at(1, 1).g)
                                      : double(std::get<Image<Rgb16>>(out).at(1, 1).g);
        EXPECT_NEAR(code, full * response.encode(std::min(1., y + .04), 1), .75)
            << bits << ' ' << y;
      }
    }
}

TEST(Sensor, TwelveBitsAreSpreadOverSixteen) {
  Sensor sensor;
  sensor.noisy = false;
  sensor.bits = 12;
  Image<Rgb> ramp(1000, 1);
  for (int x = 0; x < 1000; ++x) ramp.at(x, 0) = Rgb{1, 1, 1} * (static_cast<float>(x) / 999);
  const auto codes = exposed16(sensor, ramp, {Seconds(1), Gain(1)}, 1);
  EXPECT_EQ(codes.at(0, 0).g, 0);
  EXPECT_EQ(codes.at(999, 0).g, 65535);
  for (int x = 0; x < 1000; ++x) {
    const double code = codes.at(x, 0).g / 65535. * 4095;
    EXPECT_NEAR(code, std::round(code), .04) << x;
    EXPECT_NEAR(code, 4095 * x / 999., .55) << x;
  }
}

TEST(Sensor, VignettingTakesItsShareInTheCornersAndNothingInTheMiddle) {
  Sensor sensor;
  sensor.noisy = false;
  sensor.bits = 16;
  sensor.vignetting = .4;
  const auto codes =
      exposed16(sensor, Image<Rgb>(401, 201, {.8f, .8f, .8f}), {Seconds(1), Gain(1)}, 1);
  EXPECT_NEAR(codes.at(200, 100).g / 65535., .8, 1e-4);
  for (const auto& [x, y] : {std::pair{0, 0}, {400, 0}, {0, 200}, {400, 200}})
    EXPECT_NEAR(codes.at(x, y).g / 65535., .8 * .6, .005);
  for (int x = 1; x <= 200; ++x) EXPECT_GE(codes.at(x, 100).g, codes.at(x - 1, 100).g);
}

// ------------------------------------------------------------------------------------- schedule

constexpr double kShortestTime = 1. / 64000;  // capture.h: times within [1/64000, 1/30] at gain 1

/// Signal from which on a sample has a signal-to-noise ratio of 3, and the largest that counts.
std::pair<double, double> usable_range(const Sensor& s) {
  for (unsigned code = 1; code < 255; ++code) {
    const double y = s.response.decode(code / 255., 1),
                 step = s.response.decode((code + 1) / 255., 1) - y;
    if (y > 3 * std::sqrt(s.noise.variance(y, 1) + step * step / 12)) return {y, .9};
  }
  return {1, 1};
}

TEST(ChooseSchedule, CoversTheLightWithTheFewestExposures) {
  Sensor sensor;
  sensor.response = calib::Response::srgb();
  const auto [low, full] = usable_range(sensor);
  for (Image<Rgb> map : {make_room_environment(256, 128), make_sky_environment(256, 128, .8)}) {
    const auto world = FloorWorld::make(std::move(map));
    ASSERT_TRUE(world);
    const Image<Rgb>& light = (*world)->environment();
    float brightest = 0;
    for (const Rgb& p : light.pixels()) brightest = std::max({brightest, p.r, p.g, p.b});
    const auto schedule = choose_schedule(light, sensor);
    ASSERT_FALSE(schedule.empty());
    const double longest = schedule.front().product(), shortest = schedule.back().product();
    std::printf("%zu exposures, %.3g to %.3g ms\n", schedule.size(), 1e3 * longest, 1e3 * shortest);
    EXPECT_LE(shortest, std::max(.95 / double(brightest), kShortestTime))
        << "the brightest pixel is clipped everywhere";
    EXPECT_GE(longest * .01 * FloorWorld::kMeanLuminance, .99 * std::min(low, .6 / 30))
        << "the dark is lost";
    for (std::size_t k = 0; k < schedule.size(); ++k) {
      EXPECT_EQ(schedule[k].gain, Gain(1));
      EXPECT_LE(schedule[k].time.count(), 1. / 30 * 1.000001);
      if (k == 0) continue;
      const double ratio = schedule[k - 1].product() / schedule[k].product();
      EXPECT_GT(ratio, 1) << "longest first";
      EXPECT_LE(ratio, full / low * 1.001) << "a gap between two exposures";
    }
    if (schedule.size() > 1) {
      EXPECT_GT(longest / shortest, std::pow(full / low, double(schedule.size()) - 2))
          << "one fewer would do";
    }
  }
}

TEST(ChooseSchedule, StaysWithinItsPromisedTimes) {
  Sensor sensor;
  sensor.response = calib::Response::srgb();
  for (const float radiance : {1e-6f, 1.f, 1e9f})
    for (const Exposure& e :
         choose_schedule(Image<Rgb>(16, 8, {radiance, radiance, radiance}), sensor)) {
      EXPECT_GE(e.time.count(), kShortestTime * .999999) << radiance;
      EXPECT_LE(e.time.count(), 1. / 30 * 1.000001) << radiance;
    }
}

}  // namespace
}  // namespace penumbra::capture
