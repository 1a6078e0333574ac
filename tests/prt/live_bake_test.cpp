
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "prt/prt.h"

namespace penumbra::prt {
namespace {

const Character& live_walker() {
  static const Character c = make_walker({.5f, .5f, .5f});
  return c;
}

LiveBakeOptions options_with_floor(int bands = 3) {
  Mesh mesh;
  deform(live_walker(), rest_pose(live_walker()), mesh);
  return {bands, Receiver{fit_ground_grid(mesh, 0, 24), {.4f, .4f, .4f}}};
}

CharacterPose walking(double seconds) {
  return sample(live_walker(), live_walker().clips[0], seconds);
}
// Neither clip has this pose.
CharacterPose waving_as_it_walks(double seconds) {
  return blend(walking(seconds), sample(live_walker(), live_walker().clips[1], seconds), .5f);
}

BakedObject baked(const CharacterPose& pose, const LiveBakeOptions& o) {
  Mesh mesh;
  deform(live_walker(), pose, mesh);
  BakeOptions options;
  options.bands = o.bands;
  options.rays = options.ground_rays = 1024;
  options.receiver = o.receiver;
  auto out = bake(std::move(mesh), options);
  EXPECT_TRUE(out);
  return std::move(*out);
}

// Points within others are not seen, and soles on the floor hardly.
bool is_seen(const BakedObject& o, std::size_t p) {
  return o.report.quality[p].behind < .1f && o.mesh.positions[p].y > .02f;
}

// RMS of what lights of the mean environment would show, relative.
double rendered_error(const Transfer& is, const BakedObject& should) {
  double wrong = 0, all = 0;
  for (std::size_t p = 0; p < is.points; ++p) {
    if (!is_seen(should, p)) continue;
    for (int l = 0; l < is.bands; ++l)
      for (int n = l * l; n < (l + 1) * (l + 1); ++n) {
        const double energy = mean_band_energy()[static_cast<std::size_t>(l)];
        wrong += energy * std::pow(is.value(0, n, p) - should.transfer.value(0, n, p), 2);
        all += energy * std::pow(should.transfer.value(0, n, p), 2);
      }
  }
  return std::sqrt(wrong / all);
}

// RMS error of the fraction that the character takes of an even sky's light on the floor, where
// that is more than 5 %.
double shadow_error(const BakedObject& is, const BakedObject& should) {
  constexpr double kOpen = .28209;
  double wrong = 0, count = 0;
  for (std::size_t t = 0; t < is.ground_deficit.points; ++t) {
    const double truth = should.ground_deficit.value(0, 0, t) / kOpen;
    if (truth < .05) continue;
    wrong += std::pow(is.ground_deficit.value(0, 0, t) / kOpen - truth, 2);
    ++count;
  }
  return std::sqrt(wrong / count);
}

LiveBake begin(const LiveBakeOptions& options) {
  auto live = LiveBake::create(live_walker(), options);
  EXPECT_TRUE(live);
  return std::move(*live);
}

TEST(LiveBake, ConvergesToTheBakeOfAPoseThatHolds) {
  const LiveBakeOptions options = options_with_floor();
  LiveBake live = begin(options);
  const CharacterPose pose = waving_as_it_walks(.3);
  BakedObject out;
  const BakedObject truth = baked(pose, options);
  live.update(pose, live.points(), out);
  const double at_once = rendered_error(out.transfer, truth);
  live.update(pose, 40 * live.points(), out);
  RecordProperty("error_after_one_visit_percent", std::to_string(100 * at_once));
  RecordProperty("error_percent", std::to_string(100 * rendered_error(out.transfer, truth)));
  RecordProperty("shadow_error", std::to_string(shadow_error(out, truth)));
  EXPECT_LT(at_once, .3);  // no reflected light yet
  EXPECT_LT(rendered_error(out.transfer, truth), .02);
  EXPECT_LT(shadow_error(out, truth), .02);
  EXPECT_LT(rendered_error(out.transfer, truth), .2 * at_once);  // rays of all visits count
}

// A second of walking and waving at 60 frames a second, every point visited in every other frame.
TEST(LiveBake, FollowsAMovingCharacterWhereItsPastAloneWouldNot) {
  const LiveBakeOptions options = options_with_floor();
  LiveBake live = begin(options), past = begin(options);
  BakedObject out, stale;
  past.update(waving_as_it_walks(0), 16 * past.points(), stale);
  for (int frame = 0; frame <= 60; ++frame)
    live.update(waving_as_it_walks(frame / 60.), live.points() / 2, out);
  const CharacterPose pose = waving_as_it_walks(1);
  past.update(pose, 0, stale);  // what it knew of another pose, turned with the bones
  const BakedObject truth = baked(pose, options);
  const double follows = rendered_error(out.transfer, truth);
  RecordProperty("error_percent", std::to_string(100 * follows));
  RecordProperty("shadow_error_of_another_pose", std::to_string(shadow_error(stale, truth)));
  RecordProperty("error_of_another_pose_percent",
                 std::to_string(100 * rendered_error(stale.transfer, truth)));
  RecordProperty("shadow_error", std::to_string(shadow_error(out, truth)));
  EXPECT_LT(follows, .06);
  EXPECT_LT(follows, .6 * rendered_error(stale.transfer, truth));
  EXPECT_LT(shadow_error(out, truth), .5 * shadow_error(stale, truth));
}

TEST(LiveBake, GivesTheSameForTheSameVisits) {
  const LiveBakeOptions options = options_with_floor();
  BakedObject out[2];
  for (BakedObject& o : out) {
    LiveBake live = begin(options);
    for (int frame = 0; frame < 3; ++frame) live.update(walking(.1 * frame), live.points() / 3, o);
  }
  EXPECT_EQ(out[0].transfer.values, out[1].transfer.values);
  EXPECT_EQ(out[0].ground_deficit.values, out[1].ground_deficit.values);
}

// Few visits are late, not wrong in kind: what was not visited yet is lit as if nothing stood about
// it.
TEST(LiveBake, LightsWhatItHasNotVisitedYet) {
  LiveBake live = begin(options_with_floor());
  BakedObject out;
  live.update(walking(0), 1, out);
  double visited = 0;
  for (std::size_t p = 0; p < out.transfer.points; ++p) {
    ASSERT_TRUE(std::isfinite(out.transfer.value(0, 0, p)));
    visited += std::abs(out.transfer.value(0, 0, p) - .28209f) > 1e-3;
  }
  EXPECT_LE(visited, 1);
}

// A procedure that fails for one frame must not spoil all later ones.
TEST(LiveBake, APoseThatIsNotFiniteIsNotTaken) {
  const LiveBakeOptions options = options_with_floor();
  LiveBake live = begin(options), unharmed = begin(options);
  CharacterPose broken = walking(.1);
  broken.nodes[3].translation.y = std::numeric_limits<float>::quiet_NaN();
  BakedObject out, expected;
  live.update(broken, live.points(), out);  // with nothing before it: at rest
  for (const auto& pose : {walking(0), broken, walking(.1)}) live.update(pose, live.points(), out);
  for (std::size_t p = 0; p < out.transfer.points; ++p) {
    ASSERT_TRUE(std::isfinite(out.transfer.value(0, 0, p)));
    ASSERT_TRUE(std::isfinite(out.mesh.positions[p].y));
  }
  const BakedObject truth = baked(walking(.1), options);
  EXPECT_LT(rendered_error(out.transfer, truth), .12);
}

// Colour of the floor on the body's underside, and of the body on the floor.
TEST(LiveBake, CarriesColourByReflection) {
  LiveBakeOptions options = options_with_floor();
  options.receiver->albedo = {.8f, .1f, .1f};
  LiveBake live = begin(options);
  BakedObject out;
  live.update(walking(0), 8 * live.points(), out);
  const BakedObject truth = baked(walking(0), options);
  ASSERT_EQ(out.reflected.channels, 3);
  for (int c = 0; c < 3; ++c) {
    double is = 0, should = 0;
    for (std::size_t p = 0; p < out.transfer.points; ++p) {
      if (!is_seen(truth, p)) continue;
      is += out.reflected.value(c, 0, p);
      should += truth.reflected.value(c, 0, p);
    }
    EXPECT_NEAR(is / should, 1, .04) << c;
  }
}

TEST(LiveBake, RefusesWhatItCannotTrace) {
  EXPECT_EQ(LiveBake::create(Character{}, {}).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(LiveBake::create(live_walker(), {0, {}}).error().code, ErrorCode::kInvalid);
  LiveBakeOptions options = options_with_floor();
  options.receiver->grid.half_extent = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(LiveBake::create(live_walker(), options).error().code, ErrorCode::kInvalid);
}

}  // namespace
}  // namespace penumbra::prt
