
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <glm/geometric.hpp>
#include <random>
#include <set>

#include "core/io/files.h"
#include "prt/clip/internal/frame_bake.h"
#include "prt/clip/internal/sequence_codec.h"
#include "prt/prt.h"
#include "tests/support/characters.h"
#include "tests/support/temp_folder.h"

namespace penumbra::prt {
namespace {

namespace fs = std::filesystem;

constexpr Rgb kGreyAlbedo{.5f, .5f, .5f};

const Character& grey_walker() {
  static const Character c = make_walker(kGreyAlbedo);
  return c;
}

SequenceOptions quick(double fps = 6) {
  SequenceOptions o;
  o.frames_per_second = fps;
  o.bands = 3;
  o.bounces = 1;
  o.rays = o.ground_rays = 64;
  o.interpolation_error = 0;
  return o;
}

// Of a clip: raw frames and what they compress to.
struct Baked {
  std::vector<Transfer> frames;
  BakedSequence sequence;
};
Baked bake_clip(const Character& c, int clip, const SequenceOptions& o) {
  const test::TempFolder folder;
  const fs::path journal = folder.path() / "j";
  const auto baked = bake_frames(c, clip, o, {}, journal);
  EXPECT_TRUE(baked) << (baked ? "" : baked.error().detail);
  const fs::path journals[] = {journal};
  auto frames = baked_surface(c, clip, o, journals);
  auto sequence = compress_frames(c, clip, o, journals);
  EXPECT_TRUE(sequence) << (sequence ? "" : sequence.error().detail);
  return {std::move(*frames), std::move(*sequence)};
}

RadianceSh some_light(int bands, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  RadianceSh light(bands);
  for (int l = 0; l < bands; ++l)
    for (int m = -l; m <= l; ++m)
      for (int c = 0; c < 3; ++c)
        light[sh_index(l, m)][c] = std::sqrt(mean_band_energy()[static_cast<std::size_t>(l)]) *
                                   (l == 0 ? 1 : normal(random));
  return light;
}

double relative_rms(std::span<const float> a, std::span<const float> b) {
  double wrong = 0, all = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    wrong += std::pow(double(a[i]) - b[i], 2);
    all += std::pow(double(a[i]), 2);
  }
  return std::sqrt(wrong / all);
}

// Rendered error under average light, relative.
double transfer_error(const Transfer& exact, const Transfer& ours,
                      const std::vector<char>& left_out) {
  double wrong = 0, all = 0;
  for (int l = 0; l < exact.bands; ++l)
    for (int n = sh_index(l, -l); n <= sh_index(l, l); ++n)
      for (std::size_t p = 0; p < exact.points; ++p) {
        if (left_out[p]) continue;
        const double energy = mean_band_energy()[static_cast<std::size_t>(l)];
        wrong += energy * std::pow(exact.value(0, n, p) - ours.value(0, n, p), 2);
        all += energy * std::pow(exact.value(0, n, p), 2);
      }
  return std::sqrt(wrong / all);
}

// A knot that turns about an axis askew.
Character spinning_knot() {
  Character c = test::one_bone(make_knot(.5f, 60, 12, kGreyAlbedo));
  Clip clip{"Spin", 1, {{0, {}, {}, {}}}, {}};
  const glm::vec3 axis = glm::normalize(glm::vec3(.3f, 1, -.2f));
  for (int k = 0; k <= 8; ++k)
    clip.nodes[0].rotation.push_back(
        {k / 8., glm::angleAxis(.7853982f * static_cast<float>(k), axis)});
  c.clips.push_back(clip);
  c.clips.push_back({"Rest", 0, {}, {}});
  return c;
}

TEST(Sequence, ARigidSpinLeavesTransferAsItIsInTheMaterial) {
  const Baked b = bake_clip(spinning_knot(), 0, quick(8));
  ASSERT_EQ(b.frames.size(), 8u);
  // A ray in a hundred thousand grazes an edge and falls to the other side by the last bit of a
  // float.
  double sum = 0, values = 0, away = 0;
  for (const Transfer& t : b.frames)
    for (int n = 0; n < 9; ++n)
      for (std::size_t p = 0; p < t.points; ++p) {
        const double change = std::abs(double(t.value(0, n, p)) - b.frames[0].value(0, n, p));
        sum += change * change;
        away += change > 1e-3;
        ++values;
      }
  EXPECT_LT(std::sqrt(sum / values), 1e-3);
  EXPECT_LT(away / values, 2e-3);
  EXPECT_EQ(b.sequence.surface.max_components(), 0);
  // Without the material's frame the same light map would turn with the knot: two frames differ by
  // all there is.
  const CharacterPose pose = sample(spinning_knot(), spinning_knot().clips[0], .5);
  const auto turns = bone_turns(spinning_knot(), pose);
  std::vector<float> with(3 * b.sequence.surface.stride()), without(with.size());
  const RadianceSh light = some_light(3, 1);
  b.sequence.surface.relight(4, light, turns, with);
  b.sequence.surface.relight(4, light, {}, without);
  EXPECT_GT(relative_rms(with, without), .3);
  // And with it is what a bake of the turned knot gives.
  Mesh mesh;
  deform(spinning_knot(), pose, mesh);
  BakeOptions options;
  options.bands = 3;
  options.bounces = 1;
  options.rays = 1024;
  const auto direct = bake(mesh, options);
  std::vector<float> expected(with.size());
  relight(direct->transfer, light, expected);
  EXPECT_LT(relative_rms(expected, with), .05);  // noise of 64 rays
}

TEST(Sequence, AClipAtRestGivesTheSameBitsInEveryFrame) {
  Character still = grey_walker();
  still.clips[2].seconds = 1;  // "Rest" for a second
  const Baked b = bake_clip(still, 2, quick(4));
  ASSERT_EQ(b.frames.size(), 4u);
  for (const Transfer& t : b.frames) EXPECT_EQ(t.values, b.frames[0].values);
  EXPECT_EQ(b.sequence.surface.max_components(), 0);
  EXPECT_EQ(b.sequence.report.interpolation_error, 0);
}

TEST(Sequence, WhatABakeTakesIsKnownBeforehand) {
  SequenceOptions o = quick();
  o.rays = 128;
  o.ground_size = 16;
  const auto work = estimate_work(grey_walker(), 0, o);
  ASSERT_TRUE(work);
  const test::TempFolder folder;
  const fs::path journals[] = {folder.path() / "j"};
  ASSERT_TRUE(bake_frames(grey_walker(), 0, o, {}, journals[0]));
  EXPECT_NEAR(double(work->journal_bytes), double(fs::file_size(journals[0])),
              .02 * double(work->journal_bytes));
  const auto baked = compress_frames(grey_walker(), 0, o, journals);
  ASSERT_TRUE(baked);
  EXPECT_EQ(work->frames, baked->surface.frames());
  EXPECT_EQ(work->points, baked->surface.points());
  EXPECT_NEAR(double(work->rays), double(baked->report.rays), .5 * double(baked->report.rays));
  EXPECT_GT(work->seconds, 0);
  EXPECT_FALSE(estimate_work(grey_walker(), 99, o)) << "there is no such clip";
}

TEST(Sequence, AClipOfOnePoseIsOneFrame) {
  const Baked b = bake_clip(grey_walker(), 2, quick());
  EXPECT_EQ(b.sequence.surface.frames(), 1);
  EXPECT_EQ(b.sequence.frame_at(3.7), 0);
  std::vector<float> out(3 * b.sequence.surface.stride()), later(out.size());
  b.sequence.surface.relight(0, some_light(3, 2), {}, out);
  b.sequence.surface.relight(.6, some_light(3, 2), {}, later);
  EXPECT_EQ(out, later);
}

TEST(Sequence, CompressionKeepsItsError) {
  SequenceOptions o = quick(12);
  o.ground_size = 32;
  o.ground_albedo = {.4f, .4f, .4f};
  for (const double error : {.05, .01}) {
    o.error = error;
    const Baked b = bake_clip(grey_walker(), 0, o);
    EXPECT_LE(b.sequence.report.compression_error, error * 1.001);
    EXPECT_GT(b.sequence.report.compression_error, error * .8);
    // Promised for light of the mean energies: random light of them errs about as much.
    double sum = 0;
    int count = 0;
    std::vector<float> ours(3 * b.sequence.surface.stride()), exact(ours.size());
    for (std::size_t f = 0; f < b.frames.size(); f += 3)
      for (unsigned seed = 0; seed < 4; ++seed) {
        const RadianceSh light = some_light(3, seed);
        b.sequence.surface.relight(static_cast<double>(f), light, {}, ours);
        relight(b.frames[f], light, exact);
        sum += std::pow(relative_rms(exact, ours), 2);
        ++count;
      }
    EXPECT_LT(std::sqrt(sum / count), 1.3 * error);
    EXPECT_GT(std::sqrt(sum / count), .5 * error);
  }
}

// A clip's surface relit at one moment, and what is decoded there relit likewise.
struct Moment {
  Moment(const TransferSequence& surface, double at, std::span<const glm::mat3> bones)
      : s(surface), frame(at), turns(bones), fused(3 * s.stride()), decoded(fused.size()) {
    s.decode(frame, turns, transfer);
  }
  void relight_both(const RadianceSh& light) {
    s.relight(frame, light, turns, fused);
    relight(transfer, light, decoded);
  }

  const TransferSequence& s;
  double frame;
  std::span<const glm::mat3> turns;
  Transfer transfer{};
  std::vector<float> fused, decoded;
};

TEST(Sequence, ALongClipOfManyMovesKeepsItsErrorToo) {
  // Three hundred frames that have hardly anything in common: more components than one span may
  // have frames.
  constexpr std::size_t kFrames = 300, kPoints = 900;
  SurfaceLayout layout;
  layout.bone.assign(kPoints, 0);
  layout.vertices = kPoints;
  layout.neighbours.assign(kPoints,
                           {SurfaceLayout::kNone, SurfaceLayout::kNone, SurfaceLayout::kNone});
  std::mt19937 random(11);
  std::normal_distribution<float> normal;
  std::vector<Transfer> frames;
  for (std::size_t f = 0; f < kFrames; ++f) {
    Transfer t(2, 1, kPoints);
    for (int n = 0; n < 4; ++n)
      for (std::size_t p = 0; p < kPoints; ++p)
        t.set(0, n, p, (n == 0 ? .3f : 0) + .03f * normal(random));
    frames.push_back(std::move(t));
  }
  const CompressedSurface c = compress_surface(layout, frames, .01);
  const TransferSequence& s = c.sequence;
  EXPECT_GT(s.max_components(), 32);
  Transfer ours, next;
  const std::vector<char> all(kPoints, 0);
  for (const int f : {0, 99, 100, 101, 199, 200, 299}) {
    s.decode(f, {}, ours);
    EXPECT_LT(transfer_error(frames[static_cast<std::size_t>(f)], ours, all), .015) << f;
  }
  // As bytes.
  const StreamLayout stream = layout_of_surface(layout);
  const auto bytes = SequenceCodec::write(s, stream);
  const auto read = SequenceCodec::read(bytes, stream, "stream");
  ASSERT_TRUE(read) << read.error().detail;
  for (const double f : {0., 99.5, 150., 299.7}) {
    s.decode(f, {}, ours);
    read->decode(f, {}, next);
    EXPECT_EQ(ours.values, next.values) << f;
  }
  EXPECT_FALSE(SequenceCodec::read(std::span(bytes).first(bytes.size() / 300), stream, "stream"));
  // From the end of a span to the next, and from the clip's end to its begin.
  for (const int f : {99, 199, 299}) {
    Transfer half;
    s.decode(f, {}, ours);
    s.decode(f + 1, {}, next);
    s.decode(f + .5, {}, half);
    for (std::size_t p = 0; p < kPoints; p += 31)
      EXPECT_NEAR(half.value(0, 1, p), .5 * (ours.value(0, 1, p) + next.value(0, 1, p)), 2e-3);
  }
}

TEST(Sequence, RelightingIsRelightingWhatIsDecoded) {
  Character coloured = grey_walker();
  for (std::size_t i = 0; i < coloured.albedo.size(); ++i)
    coloured.albedo[i] = i % 2 ? Rgb{.8f, .3f, .2f} : Rgb{.2f, .4f, .7f};
  const Baked b = bake_clip(coloured, 0, quick(8));
  EXPECT_EQ(b.sequence.surface.channels(), 3);
  const auto turns = bone_turns(coloured, sample(coloured, coloured.clips[0], .41));
  const double frame = b.sequence.frame_at(.41);
  const RadianceSh light = some_light(3, 5);
  Moment m(b.sequence.surface, frame, turns);
  m.relight_both(light);
  EXPECT_LT(relative_rms(m.decoded, m.fused), 1e-3);  // halves
  // Fewer bands of light than were baked, and frames beyond the end.
  m.relight_both(light.with_bands(2));
  EXPECT_LT(relative_rms(m.decoded, m.fused), 1e-3);
  m.s.relight(frame + 5 * m.s.frames(), light, turns, m.decoded);
  m.s.relight(frame, light, turns, m.fused);
  EXPECT_LT(relative_rms(m.decoded, m.fused), 1e-5);
}

TEST(Sequence, WhatNobodySeesIsLeftOut) {
  const Character c = grey_walker();
  const Baked b = bake_clip(c, 0, quick(8));
  const TransferSequence& s = b.sequence.surface;
  const RadianceSh light = some_light(3, 5);
  const auto turns = bone_turns(c, sample(c, c.clips[0], .41));
  const double frame = b.sequence.frame_at(.41);
  RelightPlan plan;
  s.plan(frame, light, turns, plan);
  // Every band but the first dark: as many maps, most of them multiplied by nothing.
  RelightPlan even;
  s.plan(frame, light.with_bands(1), turns, even);
  EXPECT_LT(even.terms.size(), plan.terms.size());
  Moment m(s, frame, turns);
  m.relight_both(light);
  // In each part by itself: what is dark beside the rest is not lost.
  for (const RelightPlan::RelightPart& part : plan.parts) {
    double error = 0, all = 0;
    for (std::uint32_t i = 0; i < part.point_count; ++i)
      for (std::size_t k = 0; k < 3; ++k) {
        const std::size_t at = k * s.stride() + s.order()[part.first_point + i];
        error += std::pow(m.fused[at] - m.decoded[at], 2);
        all += std::pow(m.decoded[at], 2);
      }
    EXPECT_LT(std::sqrt(error / all), 3 * TransferSequence::kUnseen);
  }
}

TEST(Sequence, MapsThatDoNotFitEightBitsAreRelitToo) {
  SequenceOptions fine = quick(8);
  fine.error = 1e-4;
  const Character c = grey_walker();
  const Baked b = bake_clip(c, 0, fine);
  const TransferSequence& s = b.sequence.surface;
  const RadianceSh light = some_light(3, 5);
  const auto turns = bone_turns(c, sample(c, c.clips[0], .41));
  const double frame = b.sequence.frame_at(.41);
  RelightPlan plan;
  s.plan(frame, light, turns, plan);
  std::size_t wide = 0;
  for (const RelightPlan::RelightPart& part : plan.parts) {
    EXPECT_LE(part.wide_count, part.term_count);
    wide += part.wide_count;
  }
  EXPECT_GT(wide, 0u);
  EXPECT_LT(wide, plan.terms.size());
  Moment m(s, frame, turns);
  m.relight_both(light);
  EXPECT_LT(relative_rms(m.decoded, m.fused), 1e-3);
}

TEST(Sequence, ShardsMergeToTheSameBytes) {
  const test::TempFolder folder;
  const SequenceOptions o = quick(7);
  const auto bytes_of = [&](int shards, const std::string& name) {
    std::vector<fs::path> journals;
    for (int i = shards - 1; i >= 0; --i) {
      journals.push_back(folder.path() / (name + std::to_string(i)));
      EXPECT_TRUE(bake_frames(grey_walker(), 0, o, {i, shards}, journals.back()));
    }
    const auto sequence = compress_frames(grey_walker(), 0, o, journals);
    EXPECT_TRUE(sequence);
    EXPECT_TRUE(write_sequence(folder.path() / name, grey_walker(), 0, *sequence));
    return *read_bytes(folder.path() / name);
  };
  const auto whole = bytes_of(1, "whole");
  EXPECT_EQ(bytes_of(3, "three"), whole);
  EXPECT_EQ(bytes_of(8, "eight"), whole);
  // A shard that is missing is named by its frames.
  const fs::path some[] = {folder.path() / "three0", folder.path() / "three2"};
  const auto incomplete = compress_frames(grey_walker(), 0, o, some);
  ASSERT_FALSE(incomplete);
  EXPECT_THAT(incomplete.error().detail, testing::HasSubstr("frame 1 of 8"));
  EXPECT_FALSE(bake_frames(grey_walker(), 0, o, {3, 3}, folder.path() / "none"));
}

TEST(Sequence, AKilledBakeGoesOnWhereItStopped) {
  const test::TempFolder folder;
  SequenceOptions o = quick(6);
  const fs::path journal = folder.path() / "j";
  ASSERT_TRUE(bake_frames(grey_walker(), 0, o, {}, journal));
  const auto whole = *read_bytes(journal);
  const fs::path journals[] = {journal};
  const auto expected = compress_frames(grey_walker(), 0, o, journals);
  ASSERT_TRUE(write_sequence(folder.path() / "a", grey_walker(), 0, *expected));
  // Cut in the middle of the fourth frame, as a kill while writing leaves it.
  const std::size_t head = 32, record = (whole.size() - head) / 7;
  ASSERT_EQ(expected->surface.frames(), 7);
  fs::resize_file(journal, head + 3 * record + record / 2);
  std::set<int> worked_on;  // a frame's own progress lies between its begin and its end
  o.progress = [&](double done) {
    const double frame = 7 * done;
    if (frame - std::floor(frame) > .01) worked_on.insert(static_cast<int>(frame));
  };
  ASSERT_TRUE(bake_frames(grey_walker(), 0, o, {}, journal));
  EXPECT_THAT(worked_on, testing::ElementsAre(3, 4, 5, 6));
  const auto again = compress_frames(grey_walker(), 0, o, journals);
  ASSERT_TRUE(again) << again.error().detail;
  ASSERT_TRUE(write_sequence(folder.path() / "b", grey_walker(), 0, *again));
  EXPECT_EQ(*read_bytes(folder.path() / "a"), *read_bytes(folder.path() / "b"));
  EXPECT_EQ(again->report.rays, expected->report.rays);
  // The journal of another bake is not gone on with, nor lost.
  SequenceOptions other = quick(6);
  other.rays = 128;
  const auto refused = bake_frames(grey_walker(), 0, other, {}, journal);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().detail, testing::HasSubstr("another"));
  EXPECT_EQ(fs::file_size(journal), whole.size());
}

// Walks in the first third of the clip and stands for the rest.
Character hasty() {
  Character c = grey_walker();
  for (Clip::NodeTracks& t : c.clips[0].nodes) {
    for (auto& key : t.rotation) key.seconds *= .3;
    for (auto& key : t.translation) key.seconds *= .3;
  }
  return c;
}

// Points that lie within another part at one of the times: nobody sees what they are given.
std::vector<char> hidden_at(const Character& c, std::initializer_list<double> clips) {
  std::vector<char> out(c.positions.size());
  for (const double at : clips) {
    Mesh mesh;
    deform(c, sample(c, c.clips[0], at * c.clips[0].seconds), mesh);
    BakeOptions o;
    o.bands = o.bounces = 1;
    o.rays = 64;
    const auto baked = bake(std::move(mesh), o);
    for (std::size_t p = 0; p < out.size(); ++p) out[p] |= baked->report.quality[p].behind > .2f;
  }
  return out;
}

// At worst, against the same clip baked finely, of points that show.
double worst_between(const Character& c, const Baked& truth, const BakedSequence& s) {
  const auto at = [&](double frame) {
    return s.keys.at[static_cast<std::size_t>(frame) % s.keys.at.size()] / double(s.keys.parts);
  };
  const std::vector<glm::mat3> still(c.bones.size(), glm::mat3(1));  // as the material has it
  double worst = 0;
  Transfer ours;
  for (std::size_t k = 0; k < truth.frames.size() / 3; ++k) {
    const double clips = static_cast<double>(k) / static_cast<double>(truth.frames.size());
    const double frame = s.keys.frame_at(clips);
    s.surface.decode(frame, still, ours);
    const auto hidden = hidden_at(c, {clips, at(frame), at(frame + 1)});
    worst = std::max(worst, transfer_error(truth.frames[k], ours, hidden));
  }
  return worst;
}

TEST(Sequence, FramesAreBakedBetweenWhereLinesAreTooCoarse) {
  const Character c = hasty();
  SequenceOptions o = quick(15);
  o.ground_size = 16;
  o.error = 1e-3;
  const Baked even = bake_clip(c, 0, o);
  ASSERT_EQ(even.frames.size(), 17u);
  o.interpolation_error = .03;
  const Baked b = bake_clip(c, 0, o);
  const KeyFrames& keys = b.sequence.keys;
  ASSERT_EQ(keys.at.size(), b.frames.size());
  EXPECT_LT(b.frames.size(), 50u);
  // Where it stands those of the rate do.
  for (std::size_t i = 0; i < keys.at.size(); ++i)
    if (keys.at[i] > .4 * keys.parts && keys.at[i] < .9 * keys.parts) {
      EXPECT_EQ(keys.width(i), KeyFrames::kMaxParts) << i;
    }
  EXPECT_LT(b.sequence.report.worst_interpolation, .03);
  SequenceOptions fine = o;
  fine.interpolation_error = 0;
  fine.frames_per_second = 120;
  const Baked truth = bake_clip(c, 0, fine);
  EXPECT_GT(worst_between(c, truth, even.sequence), .08);
  EXPECT_LT(worst_between(c, truth, b.sequence), .045);  // at one moment, of the part that shows
}

TEST(Sequence, WhatIsBakedBetweenDependsOnNothingElse) {
  const test::TempFolder folder;
  const Character c = hasty();
  SequenceOptions o = quick(9);
  o.interpolation_error = .04;
  const auto file_of = [&](std::span<const fs::path> journals, const std::string& name) {
    const auto sequence = compress_frames(c, 0, o, journals);
    EXPECT_TRUE(sequence) << (sequence ? "" : sequence.error().detail);
    EXPECT_TRUE(write_sequence(folder.path() / name, c, 0, *sequence));
    return *read_bytes(folder.path() / name);
  };
  const fs::path whole[] = {folder.path() / "whole"};
  ASSERT_TRUE(bake_frames(c, 0, o, {}, whole[0]));
  const auto expected = file_of(whole, "a");
  // From shards.
  std::vector<fs::path> journals;
  for (int i = 0; i < 3; ++i) {
    journals.push_back(folder.path() / ("shard" + std::to_string(i)));
    ASSERT_TRUE(bake_frames(c, 0, o, {i, 3}, journals.back()));
  }
  const fs::path between = folder.path() / "between";
  ASSERT_TRUE(bake_between(c, 0, o, journals, between));
  journals.push_back(between);
  EXPECT_EQ(file_of(journals, "b"), expected);
  // Again when all is there, and after a kill.
  const std::span<const fs::path> shards = std::span(journals).first(3);
  const auto bytes = fs::file_size(between);
  EXPECT_TRUE(*bake_between(c, 0, o, shards, between));
  EXPECT_EQ(fs::file_size(between), bytes);
  fs::resize_file(between, bytes / 2);
  EXPECT_FALSE(compress_frames(c, 0, o, journals)) << "some are missing";
  EXPECT_TRUE(*bake_between(c, 0, o, shards, between));
  EXPECT_EQ(fs::file_size(between), bytes);
  EXPECT_EQ(file_of(journals, "b"), expected);
  // What another bound has asked for is not in the way, and not lost.
  SequenceOptions finer = o;
  finer.interpolation_error = .03;
  EXPECT_TRUE(*bake_between(c, 0, finer, shards, between));
  EXPECT_GT(fs::file_size(between), bytes);
  EXPECT_EQ(file_of(journals, "b"), expected);
  o.interpolation_error = 0;
  EXPECT_FALSE(*bake_between(c, 0, o, shards, folder.path() / "none"));
  EXPECT_FALSE(fs::exists(folder.path() / "none"));
  EXPECT_EQ(compress_frames(c, 0, o, journals)->keys.at.size(), 10u);
  o.interpolation_error = .04;
  EXPECT_FALSE(bake_between(c, 0, o, shards.first(2), folder.path() / "none"));
  EXPECT_FALSE(fs::exists(folder.path() / "none")) << "nothing is left of a refusal";
  // After a kill among the frames between.
  const std::size_t head = 32, frames = read_sequence(folder.path() / "a", c, 0)->keys.at.size();
  const std::size_t record = (fs::file_size(whole[0]) - head) / frames;
  ASSERT_GT(frames, 12u) << "some between the ten";
  fs::resize_file(whole[0], head + 11 * record + record / 2);
  ASSERT_TRUE(bake_frames(c, 0, o, {}, whole[0]));
  EXPECT_EQ(file_of(whole, "c"), expected);
}

TEST(Sequence, AFileComesBackWhole) {
  const test::TempFolder folder;
  SequenceOptions o = quick(8);
  o.ground_size = 16;
  o.map_width = o.map_height = 64;
  const Baked b = bake_clip(grey_walker(), 0, o);
  const fs::path file = folder.path() / "walk.shlm";
  ASSERT_TRUE(write_sequence(file, grey_walker(), 0, b.sequence));
  const auto read = read_sequence(file, grey_walker(), 0);
  ASSERT_TRUE(read) << read.error().detail;
  const RadianceSh light = some_light(3, 9);
  const auto turns = bone_turns(grey_walker(), sample(grey_walker(), grey_walker().clips[0], .5));
  for (const auto member : {&BakedSequence::surface, &BakedSequence::surface_reflected,
                            &BakedSequence::ground_deficit, &BakedSequence::ground_reflected}) {
    const TransferSequence &x = b.sequence.*member, &y = (*read).*member;
    ASSERT_EQ(x.points(), y.points());
    const bool ground = x.points() == 256;
    std::vector<float> p(3 * x.stride()), q(p.size());
    x.relight(3.3, light, ground ? std::span<const glm::mat3>() : turns, p);
    y.relight(3.3, light, ground ? std::span<const glm::mat3>() : turns, q);
    EXPECT_EQ(p, q);
  }
  EXPECT_EQ(read->seconds, b.sequence.seconds);
  EXPECT_EQ(read->keys.at, b.sequence.keys.at);
  EXPECT_EQ(read->keys.parts, b.sequence.keys.parts);
  EXPECT_EQ(read->map_width, 64);
  EXPECT_EQ(read->receiver->grid.half_extent, b.sequence.receiver->grid.half_extent);
  const auto info = read_sequence_info(file);
  ASSERT_TRUE(info);
  EXPECT_EQ(info->map_height, 64);
  EXPECT_EQ(info->ground_size, 16);
  EXPECT_EQ(info->key_frames, 9u);
  EXPECT_EQ(info->seconds, b.sequence.seconds);
  EXPECT_EQ(info->report.compression_error, b.sequence.report.compression_error);
  // Of another mesh, and of another clip of the same.
  Character other = grey_walker();
  other.positions[17].x += .01f;
  for (const auto& refused :
       {read_sequence(file, other, 0), read_sequence(file, grey_walker(), 1)}) {
    ASSERT_FALSE(refused);
    EXPECT_THAT(refused.error().detail, testing::HasSubstr("another mesh"));
  }
  // Where it stands is the scene's affair.
  other = grey_walker();
  other.frame[3] = glm::vec4(5, 0, 1, 1);
  EXPECT_TRUE(read_sequence(file, other, 0));
}

TEST(Sequence, DamageIsTold) {
  const test::TempFolder folder;
  SequenceOptions o = quick(4);
  o.ground_size = 8;
  const Baked b = bake_clip(grey_walker(), 0, o);
  const fs::path file = folder.path() / "walk.shlm";
  ASSERT_TRUE(write_sequence(file, grey_walker(), 0, b.sequence));
  const auto bytes = *read_bytes(file);
  const auto write = [&](std::span<const unsigned char> part) {
    std::ofstream(file, std::ios::binary)
        .write(reinterpret_cast<const char*>(part.data()),
               static_cast<std::streamsize>(part.size()));
  };
  for (std::size_t cut = 0; cut < bytes.size(); cut += 1 + bytes.size() / 97) {
    write(std::span(bytes).first(cut));
    const auto read = read_sequence(file, grey_walker(), 0);
    ASSERT_FALSE(read) << cut;
    EXPECT_EQ(read.error().where, file.string());
  }
  std::mt19937 random(3);
  for (int i = 0; i < 40; ++i) {
    auto wrong = bytes;
    wrong[random() % wrong.size()] ^= static_cast<unsigned char>(1 + random() % 255);
    write(wrong);
    EXPECT_FALSE(read_sequence(file, grey_walker(), 0));
    // Without the checksum's help damage is found or harmless, and never ends the program.
    const auto decoded = decode_sequence(wrong, grey_walker(), 0, "damaged");
    if (!decoded) continue;
    std::vector<float> out(3 * decoded->surface.stride());
    decoded->surface.relight(1.5, some_light(3, 1), {}, out);
  }
}

TEST(Sequence, KeyFramesThatMakeNoSenseAreTold) {
  const test::TempFolder folder;
  const Baked b = bake_clip(grey_walker(), 0, quick(4));
  ASSERT_EQ(b.sequence.keys.at.size(), 4u);
  for (const KeyFrames& wrong :
       {KeyFrames{0, {0, 8, 16, 24}}, KeyFrames{32, {0, 16, 8, 24}}, KeyFrames{32, {0, 8, 8, 24}},
        KeyFrames{32, {1, 8, 16, 24}}, KeyFrames{24, {0, 8, 16, 24}}, KeyFrames{32, {0, 8, 16}},
        KeyFrames{32, {0, 8, 16, 20, 24}}, KeyFrames{32, {}}}) {
    BakedSequence s = b.sequence;
    s.keys = wrong;
    ASSERT_TRUE(write_sequence(folder.path() / "k", grey_walker(), 0, s));
    const auto read = read_sequence(folder.path() / "k", grey_walker(), 0);
    ASSERT_FALSE(read) << wrong.parts << " " << wrong.at.size();
    EXPECT_THAT(read.error().detail, testing::HasSubstr("damaged"));
  }
}

TEST(Sequence, WhatLiesWithinAnotherPartDoesNotFlicker) {
  // A ball that dips into a box and comes out again: while it is inside its points see only backs
  // of walls.
  Mesh mesh = make_box({-1, -1, -1}, {1, 1, 1}, 6, kGreyAlbedo);
  const std::size_t box = mesh.positions.size();
  append(mesh, make_sphere({0, 0, 0}, .5f, 2, kGreyAlbedo));
  Character c = spinning_knot();
  c.positions = mesh.positions;
  c.normals = mesh.normals;
  c.albedo = mesh.albedo;
  c.triangles = mesh.triangles;
  c.nodes = {{"box", -1, {}}, {"ball", -1, {}}};
  c.bones = {{0, glm::mat4(1)}, {1, glm::mat4(1)}};
  c.influences.assign(mesh.positions.size(), {{0}, {1}});
  for (std::size_t i = box; i < mesh.positions.size(); ++i) c.influences[i].bone[0] = 1;
  Clip clip{"Dip", 2, {{1, {{0, {0, 3, 0}}, {1, {0, 0, 0}}, {2, {0, 3, 0}}}, {}, {}}}, {}};
  c.clips = {clip};
  const Baked b = bake_clip(c, 0, quick(5));
  ASSERT_EQ(b.frames.size(), 10u);
  // Inside in the middle; left to itself such a point would go to black and back.
  for (std::size_t p = box; p < mesh.positions.size(); p += 7)
    for (const Transfer& t : b.frames) {
      EXPECT_TRUE(std::isfinite(t.value(0, 0, p)));
      EXPECT_GT(t.value(0, 0, p), .05f);
    }
  // Points of the box that never show its inside are finite too.
  std::vector<float> out(3 * b.sequence.surface.stride());
  b.sequence.surface.relight(4.5, some_light(3, 2), {}, out);
  for (const float v : out) EXPECT_TRUE(std::isfinite(v));
}

TEST(Sequence, DenoisingHelpsAndLeavesExactThingsAlone) {
  SequenceOptions o = quick(2);
  o.map_width = o.map_height = 96;
  const auto error_against = [](const Baked& a, const Baked& reference) {
    double wrong = 0, all = 0;
    for (std::size_t f = 0; f < a.frames.size(); ++f)
      for (int n = 0; n < 9; ++n)
        for (std::size_t p = grey_walker().positions.size(); p < a.frames[f].points; ++p) {
          const double exact = reference.frames[f].value(0, n, p);
          wrong += std::pow(a.frames[f].value(0, n, p) - exact, 2);
          all += exact * exact;
        }
    return std::sqrt(wrong / all);
  };
  const Baked with = bake_clip(grey_walker(), 0, o);
  o.denoise = false;
  const Baked without = bake_clip(grey_walker(), 0, o);
  o.rays = 2048;
  const Baked reference = bake_clip(grey_walker(), 0, o);
  EXPECT_LT(error_against(with, reference), .85 * error_against(without, reference));
  // A convex thing blocks nothing: no noise, no change.
  Character ball = spinning_knot();
  const Mesh sphere = make_sphere({0, 0, 0}, 1, 3, kGreyAlbedo);
  ball.positions = sphere.positions;
  ball.normals = sphere.normals;
  ball.albedo = sphere.albedo;
  ball.triangles = sphere.triangles;
  ball.influences.assign(sphere.positions.size(), {{0}, {1}});
  ball = for_light_map(ball, 64, 64);
  o = quick();
  o.map_width = o.map_height = 64;
  const Baked denoised = bake_clip(ball, 1, o);
  o.denoise = false;
  EXPECT_EQ(denoised.frames[0].values, bake_clip(ball, 1, o).frames[0].values);
}

TEST(Sequence, BadOptionsAreNamed) {
  const test::TempFolder folder;
  const auto refusal = [&](const std::function<void(SequenceOptions&)>& change, int clip = 0) {
    SequenceOptions o = quick();
    change(o);
    const auto baked = bake_frames(grey_walker(), clip, o, {}, folder.path() / "j");
    return baked ? std::string() : baked.error().where;
  };
  EXPECT_EQ(refusal([](auto& o) { o.bands = 0; }), "bands");
  EXPECT_EQ(refusal([](auto& o) { o.rays = 65; }), "rays");
  EXPECT_EQ(refusal([](auto& o) { o.frames_per_second = 0; }), "frames per second");
  EXPECT_EQ(refusal([](auto& o) { o.frames_per_second = 9e3; }), "frames per second");
  EXPECT_EQ(refusal([](auto& o) { o.map_width = 64; }), "light map");
  EXPECT_EQ(refusal([](auto& o) { o.error = 0; }), "error");
  EXPECT_EQ(refusal([](auto&) {}, 3), "animation");
}

}  // namespace
}  // namespace penumbra::prt
