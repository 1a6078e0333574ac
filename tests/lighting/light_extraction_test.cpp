// Cutting sources out of a map: row sums in vectors, and what is left without a copy of the map.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "lighting/lighting.h"
#include "lighting/sh/latlong_kernel.h"

namespace penumbra::lighting {
namespace {

Image<Rgb> noise(int width, int height, float mean) {
  std::mt19937 random(width);
  std::exponential_distribution<float> value(1 / mean);
  Image<Rgb> map(width, height);
  for (Rgb& c : map.pixels()) c = {value(random), value(random), value(random)};
  return map;
}

// A small sun near the seam.
Image<Rgb> with_sun(Image<Rgb> map, float radiance) {
  const int y = map.height() / 4;
  for (const int x : {0, 1, map.width() - 1}) map.at(x, y) = {radiance, radiance, radiance};
  return map;
}

TEST(RowLuminance, IsThatOfPixelByPixelForAnyWidth) {
  for (const int width : {1, 3, 7, 8, 17, 63, 64, 65, 100, 128, 200}) {
    const Image<Rgb> map = noise(width, 1, 3);
    double sum = 0, upper_moments = 0;
    std::vector<float> peaks(static_cast<std::size_t>(width + kPeakBlock - 1) / kPeakBlock),
        found(peaks);
    for (int x = 0; x < width; ++x) {
      const float l = luminance(map.at(x, 0));
      sum += double(l);
      upper_moments += std::max(0., double(l) - 2);
      float& peak = peaks[static_cast<std::size_t>(x / kPeakBlock)];
      peak = std::max(peak, l);
    }
    EXPECT_NEAR(row_luminance(&map.row(0)[0].r, width, found.data()), sum, 1e-5 * sum) << width;
    for (std::size_t b = 0; b < peaks.size(); ++b)
      EXPECT_NEAR(found[b], peaks[b], 1e-5 * double(peaks[b])) << width << ", " << b;
    EXPECT_NEAR(row_luminance_above(&map.row(0)[0].r, width, 2), upper_moments, 1e-5 * sum)
        << width;
  }
}

TEST(RowLuminance, TellsEveryPixelThatIsNotFinite) {
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), HUGE_VALF, -HUGE_VALF})
    for (const int width : {5, 8, 33})
      for (int x = 0; x < width; ++x)
        for (int c = 0; c < 3; ++c) {
          Image<Rgb> map = noise(width, 1, 1);
          map.at(x, 0)[c] = bad;
          float peak = 0;
          EXPECT_FALSE(std::isfinite(row_luminance(&map.row(0)[0].r, width, &peak)));
        }
}

// Every width has another rest after whole vectors.
TEST(CutRow, TakesWhatIsAboveTheLevelAndNothingElse) {
  for (const int width : {1, 2, 5, 8, 15, 16, 17, 33, 64, 100}) {
    SCOPED_TRACE(width);
    const auto count = static_cast<std::size_t>(width);
    const Image<Rgb> before = noise(width, 1, 3);
    Image<Rgb> map = before;
    std::vector<float> across(count), along(count), excess_luminance(count), brightness(count + 1);
    brightness.back() = -7;
    for (std::size_t x = 0; x < count; ++x)
      across[x] = static_cast<float>(std::cos(double(x))),
      along[x] = static_cast<float>(std::sin(double(x)));
    std::vector<Rgb> excess(count);
    constexpr float kLevel = 4;
    CutSums sums;
    sums.square = 1;  // is added to, in squares of 2
    cut_row(&map.row(0)[0].r, width, kLevel, 2, across.data(), along.data(), &excess[0].r,
            excess_luminance.data(), sums);
    pixel_luminance(&before.row(0)[0].r, width, brightness.data());
    EXPECT_EQ(brightness.back(), -7);
    double red = 0, square = 1, x_sum = 0, z_sum = 0;
    for (std::size_t x = 0; x < count; ++x) {
      const Rgb& was = before.row(0)[x];
      const Rgb& is = map.row(0)[x];
      EXPECT_NEAR(brightness[x], luminance(was), 1e-5f * luminance(was));
      EXPECT_NEAR(luminance(is), std::min(kLevel, luminance(was)), 1e-5f * kLevel);
      EXPECT_NEAR(excess_luminance[x], luminance(excess[x]), 1e-5f * luminance(was));
      if (luminance(was) < kLevel) {
        EXPECT_EQ(is, was);
      }
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(is[c] + excess[x][c], was[c], 1e-5f * was[c]);
      const auto e = static_cast<double>(luminance(excess[x]));
      red += static_cast<double>(excess[x].r), square += e * e / 4;
      x_sum += e * double(across[x]), z_sum += e * double(along[x]);
    }
    const double all = 1e-5 * (1 + square);
    EXPECT_NEAR(sums.rgb[0], red, all);
    EXPECT_NEAR(sums.square, square, all);
    EXPECT_NEAR(sums.x, x_sum, all);
    EXPECT_NEAR(sums.z, z_sum, all);
  }
}

// Sources over the border of two blocks of a row, in its last one, which is narrower, and over the
// seam.
TEST(Peeling, FindsSourcesInEveryBlockOfARow) {
  Image<Rgb> map(200, 100);
  for (Rgb& c : map.pixels()) c = {1, 1, 1};
  for (const auto& [x, y] : {std::pair(63, 20), {64, 20}, {196, 40}, {197, 40}, {199, 60}, {0, 60}})
    map.at(x, y) = {2000, 1000, 500};
  for (int turn : {0, 17, 70}) {
    Image<Rgb> turned(200, 100);
    for (int y = 0; y < 100; ++y)
      std::ranges::rotate_copy(map.row(y), map.row(y).begin() + turn, turned.row(y).begin());
    LightExtraction split;
    ASSERT_TRUE(extract_lights(turned, {8, .001}, split));
    ASSERT_EQ(split.lights.size(), 3u) << turn;
    double found = 0, there = 0;
    for (const DistantLight& d : split.lights)
      found += double(luminance(d.radiance)) * d.solid_angle_sr();
    for (const int y : {20, 40, 60})
      there += 2 * latlong_solid_angle(y, 200, 100) * double(luminance(Rgb{2000, 1000, 500}));
    EXPECT_NEAR(found, there, .01 * there) << turn;
  }
}

TEST(RowOverlay, ChangesRowsOfItsOwnAlone) {
  const Image<Rgb> map = noise(12, 6, 1);
  Image<Rgb> expected = map;
  RowOverlay patched(map);
  for (const int y : {4, 1, 4, 5}) {
    patched.row_to_change(y)[3] += Rgb{1, 2, 3};
    expected.at(3, y) += Rgb{1, 2, 3};
  }
  EXPECT_EQ(patched.whole(), expected);
  EXPECT_EQ(patched.row(0).data(), map.row(0).data());
  patched.reset(map);
  EXPECT_EQ(patched.whole(), map);
  EXPECT_EQ(patched.row(4).data(), map.row(4).data());
}

// The same split again and again, of maps of other sizes between, gives the same; the map itself
// stays as it is.
TEST(Peeling, RemembersNothingOfTheMapBefore) {
  const Image<Rgb> first = with_sun(noise(64, 32, 1), 4e4f),
                   second = with_sun(noise(50, 26, .2f), 900);
  LightExtraction fresh, reused;
  for (const Image<Rgb>* map : {&first, &second, &first, &first, &second}) {
    const Image<Rgb> before = *map;
    fresh = {};
    ASSERT_TRUE(extract_lights(*map, {}, fresh));
    ASSERT_TRUE(extract_lights(*map, {}, reused));
    EXPECT_EQ(*map, before);
    ASSERT_EQ(fresh.lights.size(), 1u);
    ASSERT_EQ(reused.lights.size(), 1u);
    EXPECT_EQ(fresh.lights[0].direction, reused.lights[0].direction);
    EXPECT_EQ(fresh.residual.whole(), reused.residual.whole());
    EXPECT_FALSE(fresh.residual.whole() == *map);
  }
}

TEST(Peeling, TheRestIsProjectedAsACopyOfItWouldBe) {
  // Two suns of which only one has a place: what was cut of the other is put back.
  Image<Rgb> map = with_sun(noise(64, 32, 1), 1e5f);
  map.at(30, 20) = {3e4f, 3e4f, 3e4f};
  LatLongProjector projector(64, 32, 5);
  MapLuminance read;
  LightExtraction split;
  ASSERT_TRUE(projector.read(map, read));
  ASSERT_TRUE(extract_lights(map, read, {.max_count = 1}, split));
  const auto patched = projector.project_read(split.residual),
             copied = project_latlong(split.residual.whole(), 5), all = project_latlong(map, 5);
  ASSERT_TRUE(patched && copied && all);
  EXPECT_TRUE(patched->light == copied->light);
  EXPECT_TRUE(patched->upper_moments == copied->upper_moments);
  EXPECT_LT(luminance(patched->light[0]), .5f * luminance(all->light[0]));
}

// A square of sky, seen through a window: its corners are a fifth farther out than the rim of a
// round light.
TEST(Peeling, ALargeWindowKeepsItsCorners) {
  const auto window = [](double half) {
    Image<Rgb> map(256, 128, {.1f, .1f, .1f});
    for (int y = 0; y < map.height(); ++y)
      for (int x = 0; x < map.width(); ++x) {
        const dvec3 d = latlong_direction(x + .5, y + .5, map.width(), map.height());
        if (d.z < 0 && std::abs(d.x / d.z) < half && std::abs(d.y / d.z - -.5) < half)
          map.at(x, y) = {10, 10, 10};
      }
    return map;
  };
  LightExtraction split;
  const Image<Rgb> large_window = window(.4);
  ASSERT_TRUE(extract_lights(large_window, {}, split));
  ASSERT_EQ(split.lights.size(), 1u);
  const DistantLight& large = split.lights[0];
  ASSERT_FALSE(large.shape.empty());
  double farthest = 0;
  for (const dvec3& d : large.shape)
    farthest = std::max(farthest, std::acos(glm::dot(d, large.direction)));
  EXPECT_GT(farthest, large.radius.value());
  const Image<Rgb> small_window = window(.05);
  ASSERT_TRUE(extract_lights(small_window, {}, split));
  ASSERT_EQ(split.lights.size(), 1u);
  EXPECT_TRUE(split.lights[0].shape.empty()) << "nobody sees the corners of a small one";
}

// In float the square of a faint sun's radiance is nothing, and that of an absurd one no number.
TEST(Peeling, ASourceIsAsWideInAnyUnit) {
  const Image<Rgb> map = with_sun(noise(64, 32, 1), 1e4f);
  LightExtraction split;
  ASSERT_TRUE(extract_lights(map, {}, split));
  ASSERT_EQ(split.lights.size(), 1u);
  const DistantLight usual = split.lights[0];
  EXPECT_LT(usual.radius.value(), .15);
  for (const float scale : {1e-30f, 1e-20f, 1e20f}) {
    SCOPED_TRACE(scale);
    Image<Rgb> scaled = map;
    for (Rgb& c : scaled.pixels()) c = c * scale;
    ASSERT_TRUE(extract_lights(scaled, {}, split));
    ASSERT_EQ(split.lights.size(), 1u);
    EXPECT_NEAR(split.lights[0].radius.value(), usual.radius.value(), 1e-5);
    EXPECT_NEAR(double(split.lights[0].radiance.g) / double(scale), double(usual.radiance.g),
                1e-4 * double(usual.radiance.g));
  }
}

// A map that is read first and projected with its changes, again and again with other rows changed,
// is as that of a copy: what the projector expects to change may stay, and what it does not expect
// may change.
TEST(Projector, OfAMapThatWasReadSumsTheChangesAlone) {
  constexpr int kWidth = 64, kHeight = 32;
  LatLongProjector projector(kWidth, kHeight, 5);
  MapLuminance luminance_of_rows;
  const std::vector<std::vector<int>> changed_rows = {{}, {3, 4}, {4, 30}, {}, {0, 31}, {7}};
  for (std::size_t i = 0; i < changed_rows.size(); ++i) {
    Image<Rgb> map = noise(kWidth, kHeight, 1 + static_cast<float>(i));
    ASSERT_TRUE(projector.read(map, luminance_of_rows));
    for (int y = 0; y < kHeight; ++y) {
      double sum = 0;
      for (const Rgb& c : map.row(y)) sum += static_cast<double>(luminance(c));
      EXPECT_NEAR(luminance_of_rows.row_sum[static_cast<std::size_t>(y)], sum, 1e-5 * sum);
    }
    RowOverlay patched(map);
    for (const int y : changed_rows[i]) patched.row_to_change(y)[5] = {};
    const auto read = projector.project_read(patched);
    const auto copied = project_latlong(patched.whole(), 5);
    ASSERT_TRUE(read && copied);
    EXPECT_TRUE(read->light == copied->light) << i;
    EXPECT_TRUE(read->upper_moments == copied->upper_moments) << i;
  }
  EXPECT_FALSE(projector.read(noise(kWidth / 2, kHeight, 1), luminance_of_rows));
}

// What an error or another use left of the maps before does not show.
TEST(Projector, ReadsAndProjectionsInAnyOrder) {
  LatLongProjector projector(64, 32, 4);
  MapLuminance read;
  Image<Rgb> first = noise(64, 32, 1), second = noise(64, 32, 5);
  const auto expect_right = [&](const Image<Rgb>& map, int changed_row, int times) {
    RowOverlay patched(map);
    if (changed_row >= 0) patched.row_to_change(changed_row)[9] = {};
    const auto copied = project_latlong(patched.whole(), 4);
    for (int i = 0; i < times; ++i) {
      const auto projected = projector.project_read(patched);
      ASSERT_TRUE(projected && copied);
      EXPECT_TRUE(projected->light == copied->light) << changed_row << ", " << i;
    }
  };
  ASSERT_TRUE(projector.read(first, read));
  expect_right(first, 5, 2);
  ASSERT_TRUE(projector.read(second, read));  // and left, as after an error in between
  ASSERT_TRUE(projector.read(first, read));
  expect_right(first, 7, 1);
  ASSERT_TRUE(projector.project(second));
  ASSERT_TRUE(projector.read(second, read));
  expect_right(second, -1, 2);
  Image<Rgb> bad = first;
  bad.at(3, 7).g = std::numeric_limits<float>::quiet_NaN();
  ASSERT_TRUE(projector.read(bad, read));
  EXPECT_FALSE(projector.project_read(RowOverlay(bad)));
  ASSERT_TRUE(projector.read(first, read));
  expect_right(first, 0, 1);
}

// An estimate that is filled again holds nothing of before; after an error it is what it was.
TEST(Estimator, AReusedEstimateIsAsAFreshOne) {
  const EstimateOptions options{.bands = 4, .filter = false};
  const Image<Rgb> sunny = with_sun(noise(64, 32, 1), 1e4f), even = Image<Rgb>(64, 32, {1, 1, 1}),
                   other_size = with_sun(noise(50, 26, .2f), 900);
  Image<Rgb> bad = sunny;
  bad.at(1, 1).r = std::numeric_limits<float>::quiet_NaN();
  LightEstimator estimator(options);
  LightEstimate reused;
  std::int64_t second = 0;
  for (const Image<Rgb>* map : {&sunny, &even, &other_size, &even, &sunny}) {
    // Long after each other, so that no source is remembered.
    const auto at = [&](const Image<Rgb>& m) {
      return Environment{m, {}, TimestampNs{++second * 10'000'000'000}, 0, 0};
    };
    ASSERT_TRUE(estimator.estimate(at(*map), reused));
    const LightEstimate before = reused;
    EXPECT_FALSE(estimator.estimate(at(bad), reused));
    EXPECT_TRUE(reused.light == before.light);
    EXPECT_EQ(reused.lights.size(), before.lights.size());
    EXPECT_EQ(reused.time.value, before.time.value);
    const auto fresh = LightEstimator(options).estimate(at(*map));
    ASSERT_TRUE(fresh);
    EXPECT_TRUE(reused.light == fresh->light);
    EXPECT_TRUE(reused.upper_hemisphere_light == fresh->upper_hemisphere_light);
    ASSERT_EQ(reused.lights.size(), fresh->lights.size());
    for (std::size_t i = 0; i < reused.lights.size(); ++i) {
      EXPECT_EQ(reused.lights[i].direction, fresh->lights[i].direction);
      EXPECT_TRUE(reused.lights[i].shape == fresh->lights[i].shape);
    }
    EXPECT_EQ(reused.truncation_error.has_value(), fresh->truncation_error.has_value());
    EXPECT_FALSE(reused.plan);
  }
}

// What is left of the mean is then rounding, which may be less than nothing.
TEST(Peeling, ASourceInABlackRoomLeavesNothingAndLosesNothing) {
  for (int i = 0; i < 100; ++i) {
    Image<Rgb> map(64, 32);
    for (int y = i % 29; y < i % 29 + 3; ++y)
      for (int x = i / 3; x < i / 3 + 2; ++x)
        map.at(x, y) = {900.f + float(i), 1000.f + 7 * float(i), 800};
    LightExtraction split;
    ASSERT_TRUE(extract_lights(map, {}, split));
    const auto residual = project_latlong(split.residual, 1), all = project_latlong(map, 1);
    ASSERT_TRUE(residual && all) << i;
    float sum = luminance(residual->light[0]);
    for (const DistantLight& d : split.lights) sum += luminance(project_distant_light(d, 1)[0]);
    EXPECT_NEAR(sum, luminance(all->light[0]), 1e-4f * sum) << i;
    ASSERT_EQ(split.lights.size(), 1u);
  }
}

}  // namespace
}  // namespace penumbra::lighting
