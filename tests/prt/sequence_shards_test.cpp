// A clip's frames shared out over shards, those between the rate's among them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <ctime>
#include <filesystem>
#include <string>
#include <vector>

#include "core/io/files.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/animation.h"
#include "tests/support/temp_folder.h"

namespace penumbra::prt {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// Faster than a rate of nine frames a second follows.
Character hasty_walker() {
  Character c = make_walker({.5f, .5f, .5f});
  for (Clip::NodeTracks& t : c.clips[0].nodes) {
    for (auto& key : t.rotation) key.seconds *= .3;
    for (auto& key : t.translation) key.seconds *= .3;
  }
  return c;
}

SequenceOptions coarse_options() {
  SequenceOptions o;
  o.frames_per_second = 9;
  o.bands = 2;
  o.bounces = 0;
  o.rays = o.ground_rays = 64;
  o.interpolation_error = .04;
  return o;
}

class SequenceShards : public ::testing::Test {
 protected:
  fs::path file(const std::string& name) const { return folder_.path() / name; }
  std::vector<fs::path> shards(int count) {
    std::vector<fs::path> out;
    for (int i = 0; i < count; ++i) {
      out.push_back(file("shard" + std::to_string(i)));
      EXPECT_TRUE(bake_frames(character_, 0, options_, {i, count}, out.back()));
    }
    return out;
  }
  std::vector<unsigned char> bytes_of(std::span<const fs::path> journals) {
    const auto sequence = compress_frames(character_, 0, options_, journals);
    EXPECT_TRUE(sequence) << (sequence ? "" : sequence.error().detail);
    if (!sequence) return {};
    EXPECT_TRUE(write_sequence(file("out.shlm"), character_, 0, *sequence));
    return *read_bytes(file("out.shlm"));
  }

  const test::TempFolder folder_;
  const Character character_ = hasty_walker();
  SequenceOptions options_ = coarse_options();
};

TEST_F(SequenceShards, RoundsBakeWhatLiesBetweenAndLeaveStragglers) {
  const fs::path whole[] = {file("whole")};
  ASSERT_TRUE(bake_frames(character_, 0, options_, {}, whole[0]));
  const auto expected = bytes_of(whole);
  std::vector<fs::path> journals = shards(2);
  std::uintmax_t baked_between = 0;
  for (int round = 1; round <= kRounds; ++round) {
    std::vector<fs::path> own;
    for (const int i : {2, 0, 1}) {  // in any order, in other numbers than before
      own.push_back(file("round" + std::to_string(round) + std::to_string(i)));
      ASSERT_TRUE(bake_round(character_, 0, options_, {i, 3}, journals, own.back()));
      EXPECT_EQ(missing_frames(character_, 0, options_, {i, 3}, journals, own.back()), 0U);
      baked_between += fs::file_size(own.back());
    }
    journals.insert(journals.end(), own.begin(), own.end());
  }
  EXPECT_GT(baked_between, fs::file_size(journals[0]));
  if (*bake_between(character_, 0, options_, journals, file("between"))) {
    EXPECT_LT(fs::file_size(file("between")), baked_between / 5);
    journals.push_back(file("between"));
  }
  EXPECT_EQ(bytes_of(journals), expected);
}

TEST_F(SequenceShards, ARoundThatWasStoppedGoesOn) {
  const std::vector<fs::path> journals = shards(2);
  ASSERT_TRUE(bake_round(character_, 0, options_, {0, 1}, journals, file("round")));
  const auto whole = *read_bytes(file("round"));
  fs::resize_file(file("round"), whole.size() / 2);
  const auto missing = missing_frames(character_, 0, options_, {0, 1}, journals, file("round"));
  ASSERT_TRUE(missing);
  EXPECT_GT(*missing, 0U);
  const auto kept = *read_bytes(file("round"));
  ASSERT_TRUE(bake_round(character_, 0, options_, {0, 1}, journals, file("round")));
  const auto again = *read_bytes(file("round"));
  EXPECT_EQ(again.size(), whole.size());
  EXPECT_EQ(missing_frames(character_, 0, options_, {0, 1}, journals, file("round")), 0U);
  const std::size_t head = 32;
  EXPECT_TRUE(std::equal(again.begin(), again.begin() + head, kept.begin()));
}

TEST_F(SequenceShards, FaultyOnesAreNamedAllAtOnce) {
  std::vector<fs::path> journals = shards(4);
  EXPECT_TRUE(check_shards(character_, 0, options_, journals));
  const auto good = *read_bytes(journals[1]);
  fs::remove(journals[1]);
  fs::remove(journals[3]);
  const auto missing = check_shards(character_, 0, options_, journals);
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::kNotFound);
  EXPECT_EQ(missing.error().where, journals[1].string());
  EXPECT_THAT(missing.error().detail, HasSubstr("of 4 shards: 4)"));
  // Another shard's frames, under this one's name.
  fs::copy_file(journals[2], journals[1]);
  ASSERT_TRUE(bake_frames(character_, 0, options_, {3, 4}, journals[3]));
  const auto foreign = check_shards(character_, 0, options_, journals);
  ASSERT_FALSE(foreign);
  EXPECT_EQ(foreign.error().where, journals[1].string());
  EXPECT_THAT(foreign.error().detail, HasSubstr("lacks "));
  // Of other settings.
  SequenceOptions other = options_;
  other.bounces = 1;
  fs::remove(journals[1]);
  ASSERT_TRUE(bake_frames(character_, 0, other, {1, 4}, journals[1]));
  const auto stale = check_shards(character_, 0, options_, journals);
  ASSERT_FALSE(stale);
  EXPECT_EQ(stale.error().code, ErrorCode::kInvalid);
  EXPECT_THAT(stale.error().detail, HasSubstr("another bake"));
}

TEST_F(SequenceShards, TheTimeOfCoresIsKnownBeforehandToAFactorOfTwo) {
  options_.rays = 1024;
  options_.interpolation_error = 0;
  const auto work = estimate_work(character_, 0, options_);
  ASSERT_TRUE(work);
  const std::clock_t start = std::clock();
  ASSERT_TRUE(bake_frames(character_, 0, options_, {}, file("whole")));
  const double baked_s = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
  EXPECT_LT(work->core_seconds, 2 * baked_s);
  EXPECT_GT(work->core_seconds, baked_s / 2);
}

TEST_F(SequenceShards, ARoundNeedsAllOfTheFramesOfTheRate) {
  std::vector<fs::path> journals = shards(2);
  journals.pop_back();
  EXPECT_FALSE(bake_round(character_, 0, options_, {0, 1}, journals, file("round")));
  EXPECT_FALSE(fs::exists(file("round")));
  EXPECT_FALSE(bake_round(character_, 0, options_, {1, 1}, journals, file("round")));
}

}  // namespace
}  // namespace penumbra::prt
