#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <functional>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/conventions.h"
#include "tests/support/brackets.h"

// What moves or changes between the exposures of a ring, frame by frame against the truth of that
// frame.
namespace penumbra::capture {
namespace {

constexpr int kGhostWidth = 256, kGhostHeight = 128;
const std::vector<double> kBracket = {1, 1. / 4, 1. / 16, 1. / 64};

Sensor sensor_of(int bits) {
  Sensor s;
  s.response = calib::Response::srgb();
  s.bits = bits;
  return s;
}

CameraInfo camera_of(const Sensor& sensor) {
  return test::environment_camera(sensor, kGhostWidth, kGhostHeight);
}

using test::radiance_of;

/// A wall of soft pattern, from .05 to .5.
Image<Rgb> wall() {
  Image<Rgb> out(kGhostWidth, kGhostHeight);
  for (int y = 0; y < kGhostHeight; ++y)
    for (int x = 0; x < kGhostWidth; ++x) {
      const auto v =
          static_cast<float>(.05 + .225 * (2 + std::sin(x * .2) + std::cos(y * .15)) / 2);
      out.at(x, y) = {v, .8f * v, .7f * v};
    }
  return out;
}

void add_distant_light(Image<Rgb>& to, double x, double y, double radius, Rgb radiance) {
  for (int row = 0; row < kGhostHeight; ++row)
    for (int column = 0; column < kGhostWidth; ++column)
      if (std::hypot(column + .5 - x, row + .5 - y) < radius) to.at(column, row) = radiance;
}

/// Luminance times solid angle over the sphere.
double energy(const std::function<Rgb(std::size_t)>& radiance_at) {
  double sum = 0;
  for (int y = 0; y < kGhostHeight; ++y)
    for (int x = 0; x < kGhostWidth; ++x)
      sum += latlong_solid_angle(y, kGhostWidth, kGhostHeight) *
             static_cast<double>(
                 luminance(radiance_at(static_cast<std::size_t>(y * kGhostWidth + x))));
  return sum;
}
double energy(const MergedImage& image) {
  return energy([&](std::size_t i) { return radiance_of(image, i); });
}
double energy(const Image<Rgb>& image) {
  return energy([&](std::size_t i) { return image.pixels()[i]; });
}

/// A ring, and beside it the naive one: the newest frame of each exposure, merged as if nothing had
/// moved.
struct Rings {
  explicit Rings(const Sensor& s, std::vector<double> bracket = kBracket)
      : sensor(s), times(std::move(bracket)), ring(camera_of(s), 8) {
    naive.response = s.response;
    naive.noise = s.noise;
  }
  const MergedImage* add(const Image<Rgb>& truth, double gain = 1) {
    const std::size_t k = count % times.size();
    Frame frame;
    frame.sequence = count++;
    frame.exposure = {Seconds(times[k]), Gain(gain)};
    frame.pixels = test::shot(sensor, truth, frame.exposure, 77 * count);
    if (naive.frames.size() < times.size()) {
      naive.frames.push_back(frame.pixels);
      naive.exposures.push_back(frame.exposure);
    } else {
      naive.frames[k] = frame.pixels, naive.exposures[k] = frame.exposure;
    }
    const auto merged = ring.add(frame);
    EXPECT_TRUE(merged) << merged.error().detail;
    return merged ? *merged : nullptr;
  }
  MergedFloat merged_naively() const { return *merge(naive); }
  Sensor sensor;
  std::vector<double> times;
  HdrRing ring;
  ExposureStack naive;
  std::uint64_t count = 0;
};

TEST(Ghosts, StillSceneIsMergedAsIfNothingCouldMove) {
  Image<Rgb> truth = wall();
  add_distant_light(truth, 60, 50, 9, {30, 25, 20});
  Rings rings(sensor_of(8));
  double ours = 0, full = 0;
  for (int n = 0; n < 24; ++n) {
    const MergedImage* merged = rings.add(truth);
    if (n < 8) continue;
    const MergedFloat all = rings.merged_naively();
    for (std::size_t i = 0; i < truth.area(); ++i)
      for (int c = 0; c < 3; ++c) {
        ours += std::pow(double(radiance_of(*merged, i)[c] / truth.pixels()[i][c]) - 1, 2);
        full += std::pow(double(all.radiance.pixels()[i][c] / truth.pixels()[i][c]) - 1, 2);
      }
  }
  std::printf("still scene: RMSE of the ring over the maximum-likelihood merge %.4f\n",
              std::sqrt(ours / full));
  EXPECT_LE(std::sqrt(ours / full), 1.05);
}

TEST(Ghosts, MovingLampKeepsItsLight) {
  for (const double step_px : {3., 11., 40.}) {  // within itself, next to itself, far away
    Rings rings(sensor_of(8));
    double worst = 0, worst_naive = 0;
    for (int n = 0; n < 40; ++n) {
      Image<Rgb> truth = wall();
      const double moved = n < 12 ? 0 : (n - 12) * step_px;
      add_distant_light(truth, 40 + std::fmod(moved, 170), 64, 5.5, {40, 36, 30});
      const MergedImage* merged = rings.add(truth);
      if (n < 4) continue;
      const double right = energy(truth);
      worst = std::max(worst, std::abs(energy(*merged) / right - 1));
      const MergedFloat naive = rings.merged_naively();
      worst_naive = std::max(worst_naive, std::abs(energy(naive.radiance) / right - 1));
    }
    std::printf(
        "lamp moves by %g px a frame: total off by at most %.2f %%, without rejection %.1f %%\n",
        step_px, 100 * worst, 100 * worst_naive);
    EXPECT_LE(worst, .02) << step_px;
    EXPECT_GT(worst_naive, .05) << "the naive ring fails here";
  }
}

TEST(Ghosts, LampSwitchedOffIsGoneInTheNextFrameWhicheverExposureThatIs) {
  for (const int bits : {8, 16}) {
    double worst_naive = 0;
    for (int phase = 0; phase < 4; ++phase) {
      Rings rings(sensor_of(bits));
      const Image<Rgb> dark = wall();
      Image<Rgb> lit = wall();
      add_distant_light(lit, 100, 60, 12, {50, 50, 50});
      for (int n = 0; n < 8 + phase; ++n) rings.add(lit);
      for (int n = 0; n < 4; ++n) {
        const MergedImage* merged = rings.add(dark);
        EXPECT_NEAR(energy(*merged) / energy(dark), 1, .02)
            << bits << " bit, phase " << phase << '+' << n;
        worst_naive = std::max(worst_naive, energy(rings.merged_naively().radiance) / energy(dark));
      }
    }
    EXPECT_GT(worst_naive, 1.5);
  }
}

TEST(Ghosts, LampSwitchedOnIsWholeOnceAnExposureHasSeenIt) {
  for (int phase = 0; phase < 4; ++phase) {
    Rings rings(sensor_of(8));
    const Image<Rgb> dark = wall();
    Image<Rgb> lit = wall();
    add_distant_light(lit, 100, 60, 12, {50, 50, 50});
    for (int n = 0; n < 8 + phase; ++n) rings.add(dark);
    double before = 0;
    bool seen = false;
    for (int n = 0; n < 6; ++n) {
      const double now = energy(*rings.add(lit)) / energy(lit);
      EXPECT_LE(now, 1.02) << phase << '+' << n;
      EXPECT_GE(now, before - .02) << "never darker again: " << phase << '+' << n;
      seen |= (rings.count - 1) % 4 == 3;
      if (seen) {
        EXPECT_NEAR(now, 1, .02) << phase << '+' << n;
      }
      before = now;
    }
  }
}

TEST(Ghosts, PersonWhoWalksByLeavesNone) {
  // Twice as bright as the wall behind, four pixels a frame. Where the newest exposure can tell,
  // ghosts stay under the 5 % that show.
  for (const int bits : {8, 16}) {
    Rings rings(sensor_of(bits));
    double ghost = 0, ghost_naive = 0;
    for (int n = 0; n < 40; ++n) {
      Image<Rgb> truth(kGhostWidth, kGhostHeight, {.3f, .3f, .3f});
      const int at = 20 + 4 * n;
      for (int y = 40; y < 100; ++y)
        for (int x = at; x < at + 20; ++x) truth.at(x, y) = {.65f, .55f, .5f};
      const MergedImage* merged = rings.add(truth);
      if (n < 6) continue;
      const MergedFloat naive = rings.merged_naively();
      // Columns, so that noise averages out and a ghost does not.
      for (int x = 0; x < kGhostWidth; ++x) {
        double ours = 0, plain = 0, right = 0;
        for (int y = 41; y < 99; ++y) {
          const auto i = static_cast<std::size_t>(y * kGhostWidth + x);
          ours += double(radiance_of(*merged, i).g);
          plain += double(naive.radiance.pixels()[i].g);
          right += double(truth.pixels()[i].g);
        }
        ghost = std::max(ghost, std::abs(ours / right - 1));
        ghost_naive = std::max(ghost_naive, std::abs(plain / right - 1));
      }
    }
    std::printf("%d bit: contrast of the strongest ghost %.1f %%, without rejection %.1f %%\n",
                bits, 100 * ghost, 100 * ghost_naive);
    EXPECT_LE(ghost, .05);
    EXPECT_GT(ghost_naive, .2);
  }
}

TEST(Ghosts, FlickerThatTheLabelsTellIsNoChangeAndNoError) {
  // Lamps on mains: every frame 15 % brighter or darker, and its gain says so.
  Image<Rgb> truth = wall();
  add_distant_light(truth, 60, 50, 9, {30, 25, 20});
  Rings rings(sensor_of(8));
  double worst = 0;
  for (int n = 0; n < 40; ++n) {
    const double gain = 1 + .15 * std::sin(n * 2.1);
    const MergedImage* merged = rings.add(truth, gain);
    if (n >= 4) worst = std::max(worst, std::abs(energy(*merged) / energy(truth) - 1));
  }
  std::printf("flicker of 15 %%: total off by at most %.2f %%\n", 100 * worst);
  EXPECT_LE(worst, .005);
  EXPECT_EQ(rings.ring.exposures(), 4u) << "one exposure stays one, whatever its flicker";
}

TEST(Ghosts, PicturesOfOddSizesCountTheirPixelsOnce) {
  // 40x20: three whole blocks and an eighth of one, all of it mixed while the ring fills.
  Sensor sensor = sensor_of(8);
  CameraInfo camera = camera_of(sensor);
  camera.projection.width = 40, camera.projection.height = 20;
  HdrRing ring(camera, 8);
  for (std::uint64_t n = 0; n < 8; ++n) {
    Frame frame;
    frame.sequence = n;
    frame.exposure = {Seconds(kBracket[n % 4]), Gain(1)};
    const float radiance = n == 0 ? .3f : 1e4f;  // then all of it clips in every exposure
    frame.pixels =
        test::shot(sensor, Image<Rgb>(40, 20, {radiance, radiance, radiance}), frame.exposure, n);
    const auto merged = ring.add(frame);
    if (merged) {
      EXPECT_LE((*merged)->clipped_fraction, 1);
      EXPECT_LE((*merged)->black_fraction, 1);
    }
    EXPECT_EQ(merged.has_value(), n == 0) << n << ": what was not clipped is contradicted";
  }
}

TEST(Ghosts, WrongNoiseModelDoesNotTearAStillSceneApart) {
  // A camera twice as noisy as the guess.
  Sensor sensor = sensor_of(8);
  sensor.noise.full_well_electrons /= 4;
  sensor.noise.read_noise *= 2;
  CameraInfo camera = camera_of(sensor);
  camera.noise = calib::NoiseModel{};
  camera.noise_known = false;
  const Image<Rgb> truth = wall();
  HdrRing ring(camera, 8);
  ExposureStack naive{{}, {}, camera.response, camera.noise, 0, {}};
  double worst = 0, worst_naive = 0;
  for (std::uint64_t n = 0; n < 16; ++n) {
    Frame frame;
    frame.sequence = n;
    frame.exposure = {Seconds(kBracket[n % 4]), Gain(1)};
    frame.pixels = test::shot(sensor, truth, frame.exposure, n);
    naive.frames.insert(naive.frames.begin(), frame.pixels);
    naive.exposures.insert(naive.exposures.begin(), frame.exposure);
    const auto merged = ring.add(frame);
    ASSERT_TRUE(merged);
    if (n < 4) continue;
    naive.frames.resize(4), naive.exposures.resize(4);
    const auto off = [&](double sum) { return std::abs(sum / energy(truth) - 1); };
    worst = std::max(worst, off(energy(**merged)));
    worst_naive = std::max(worst_naive, off(energy(merge(naive)->radiance)));
  }
  std::printf("twice as noisy as guessed: total off by %.2f %%, without rejection %.2f %%\n",
              100 * worst, 100 * worst_naive);
  EXPECT_LE(worst, .005);
}

}  // namespace
}  // namespace penumbra::capture
