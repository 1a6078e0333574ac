#include <gtest/gtest.h>

#include <cmath>

#include "compositor/compositor.h"
#include "prt/prt.h"
#include "tests/support/temp_folder.h"

namespace penumbra::compositor {
namespace {

prt::BakedSequence baked_walk(const prt::Character& walker, Rgb floor) {
  prt::SequenceOptions o;
  o.frames_per_second = 6;
  o.between = 0;
  o.bands = 4;
  o.bounces = 1;
  o.rays = o.ground_rays = 64;
  o.ground_size = 8;
  o.ground_albedo = floor;
  const test::TempFolder folder;
  const std::filesystem::path journals[] = {folder.path() / "j"};
  EXPECT_TRUE(prt::bake_frames(walker, 0, o, {}, journals[0]));
  auto out = prt::compress_frames(walker, 0, o, journals);
  EXPECT_TRUE(out);
  return std::move(*out);
}

RadianceSh coloured_light(int bands) {
  RadianceSh light(bands);
  for (int n = 0; n < light.size(); ++n) {
    const auto k = static_cast<float>(n);
    light[n] = {std::cos(k), std::cos(2 * k + 1), std::sin(3 * k)};
  }
  return light;
}

class GpuRelightTest : public testing::TestWithParam<Rgb> {};

// Grey transfer has one channel, a coloured floor makes three; light of fewer and of more bands than baked.
TEST_P(GpuRelightTest, GivesWhatTheCpuGives) {
  auto compositor = Compositor::create(64, 64, Compositor::Surface::kOffscreen);
  if (!compositor && compositor.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1: " << compositor.error().detail;
  ASSERT_TRUE(compositor);
  const prt::Character walker = prt::make_walker({.6f, .6f, .6f});
  const prt::BakedSequence clip = baked_walk(walker, GetParam());
  const auto turns = prt::bone_turns(walker, prt::sample(walker, walker.clips[0], .4));
  for (const prt::TransferSequence* s :
       {&clip.surface, &clip.surface_indirect, &clip.ground_deficit}) {
    const auto number = (*compositor)->add_clip(*s);
    ASSERT_TRUE(number) << number.error().detail;
    const auto used = s == &clip.ground_deficit ? std::span<const glm::mat3>()
                                                : std::span<const glm::mat3>(turns);
    for (const int bands : {2, 4, 9}) {
      const RadianceSh light = coloured_light(bands);
      // 7 where nothing may stay of what was there.
      std::vector<float> cpu(3 * s->stride(), 0.f), gpu(3 * s->stride(), 7.f);
      s->relight(1.7, light, used, cpu);
      ASSERT_TRUE((*compositor)->relight(*number, 1.7, light, used, gpu));
      float largest = 0;
      for (const float v : cpu) largest = std::max(largest, std::abs(v));
      EXPECT_GT(largest, .01f);
      for (std::size_t c = 0; c < 3; ++c)
        for (std::size_t p = 0; p < s->points(); ++p)
          ASSERT_NEAR(cpu[c * s->stride() + p], gpu[c * s->stride() + p], 1e-5f * largest)
              << "channel " << c << " of point " << p << ", " << bands << " bands";
    }
    (*compositor)->remove_clip(*number);
  }
}

INSTANTIATE_TEST_SUITE_P(Floors, GpuRelightTest,
                         testing::Values(Rgb{.5f, .5f, .5f}, Rgb{.7f, .3f, .1f}));

}  // namespace
}  // namespace penumbra::compositor
