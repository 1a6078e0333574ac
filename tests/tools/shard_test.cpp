#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>
#include <string>

#include "core/io/files.h"
#include "tests/support/temp_folder.h"
#include "tools/farm/shard_choice.h"
#include "tools/farm/shard_file.h"

namespace penumbra::tools {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using Variables = std::map<std::string, std::string>;

VariableOf told_by(const Variables& variables) {
  return [variables](const char* name) -> const char* {
    const auto found = variables.find(name);
    return found == variables.end() ? nullptr : found->second.c_str();
  };
}

Variables array(int id, int first, int last, int count) {
  return {{"SLURM_ARRAY_TASK_ID", std::to_string(id)},
          {"SLURM_ARRAY_TASK_MIN", std::to_string(first)},
          {"SLURM_ARRAY_TASK_MAX", std::to_string(last)},
          {"SLURM_ARRAY_TASK_COUNT", std::to_string(count)}};
}

TEST(ShardChoice, TasksOfAnArrayAreAllShardsOnceWhereverItBegins) {
  for (const int first : {0, 1, 17}) {
    std::set<int> seen;
    for (int id = first; id < first + 12; ++id)
      for (const char* const text : {"auto", "auto/12"}) {
        const auto shard = read_shard(text, told_by(array(id, first, first + 11, 12)));
        ASSERT_TRUE(shard) << shard.error().detail;
        EXPECT_EQ(shard->count, 12);
        seen.insert(shard->index);
      }
    EXPECT_EQ(seen.size(), 12U);
    EXPECT_EQ(*seen.begin(), 0);
    EXPECT_EQ(*seen.rbegin(), 11);
  }
}

TEST(ShardChoice, WithoutAQueueTheTextTells) {
  const auto shard = read_shard("12/12", told_by(array(0, 0, 1, 2)));
  ASSERT_TRUE(shard);
  EXPECT_EQ(shard->index, 11);
  EXPECT_EQ(shard->count, 12);
}

TEST(ShardChoice, PodsOfAnIndexedJobCountFromZero) {
  const auto shard = read_shard("auto/3", told_by({{"JOB_COMPLETION_INDEX", "2"}}));
  ASSERT_TRUE(shard);
  EXPECT_EQ(shard->index, 2);
  EXPECT_EQ(shard->count, 3);
}

TEST(ShardChoice, SlurmWithinKubernetesIsSlurm) {
  Variables both = array(3, 1, 4, 4);
  both["JOB_COMPLETION_INDEX"] = "0";
  const auto shard = read_shard("auto/4", told_by(both));
  ASSERT_TRUE(shard);
  EXPECT_EQ(shard->index, 2);
}

TEST(ShardChoice, WhatWouldBakeTheWrongFramesIsRefused) {
  Variables without_count = array(1, 1, 2, 2);
  without_count.erase("SLURM_ARRAY_TASK_COUNT");
  Variables with_nonsense = array(1, 1, 2, 2);
  with_nonsense["SLURM_ARRAY_TASK_MIN"] = "nan";
  const std::vector<std::pair<std::string, Variables>> cases = {
      {"auto", {}},
      {"auto", {{"JOB_COMPLETION_INDEX", "0"}}},
      {"auto/2", {{"JOB_COMPLETION_INDEX", "2"}}},
      {"auto/2", {{"JOB_COMPLETION_INDEX", "-1"}}},
      {"auto/2", {{"JOB_COMPLETION_INDEX", "1 "}}},
      {"auto/2", {{"JOB_COMPLETION_INDEX", ""}}},
      {"auto/2", {{"JOB_COMPLETION_INDEX", "99999999999"}}},
      {"auto", array(3, 1, 3, 2)},  // submitted again: 1 and 3 alone
      {"auto", array(9, 1, 9, 5)},  // every other number
      {"auto", array(0, 1, 2, 2)},
      {"auto/3", array(1, 1, 2, 2)},
      {"auto", array(1, 1, 5000, 5000)},
      {"auto", without_count},
      {"auto", with_nonsense},
      {"0/2", {}},
      {"3/2", {}},
      {"1/0", {}},
      {"1/4097", {}},
      {"1", {}},
      {"", {}},
      {"/", {}},
      {"1/2/3", {}},
      {"1/2 ", {}},
      {"auto/", {}},
      {"auto/0", {}},
      {"Auto", {}},
      {"-1/2", {}},
      {"+1/2", {}},
  };
  for (const auto& [text, variables] : cases) {
    const auto shard = read_shard(text, told_by(variables));
    ASSERT_FALSE(shard) << text;
    EXPECT_FALSE(shard.error().where.empty());
    EXPECT_FALSE(shard.error().detail.empty());
  }
}

TEST(ShardChoice, ATaskTellsItsCores) {
  EXPECT_EQ(cores_of_task(told_by({})), 0);
  EXPECT_EQ(cores_of_task(told_by({{"SLURM_CPUS_PER_TASK", "3"}})), 3);
  EXPECT_EQ(cores_of_task(told_by({{"SLURM_CPUS_PER_TASK", "three"}})), 0);
}

// A shard whose file is a line for each frame, three in all.
class Shard {
 public:
  explicit Shard(const fs::path& folder) : file_(folder / "out.shard-1-of-2") {}

  const fs::path& file() const { return file_; }
  int baked() const { return baked_; }
  // Stops after so many frames.
  Result<void> make(int frames = 3) {
    return make_shard(
        file_,
        [](const fs::path& path) -> Result<bool> {
          PENUMBRA_ASSIGN(text, read_text(path));
          if (!text.starts_with("frame")) return fail(ErrorCode::kInvalid, path.string(), "other");
          return std::ranges::count(text, '\n') == 3;
        },
        [&](const fs::path& path) -> Result<void> {
          std::string text = fs::exists(path) ? read_text(path).value_or("") : "";
          while (std::ranges::count(text, '\n') < 3) {
            if (frames-- == 0) return fail(ErrorCode::kUnavailable, path.string(), "killed");
            text += "frame\n";
            ++baked_;
            PENUMBRA_TRY(write_bytes(path, text));
            if (during) during(path);
          }
          return {};
        });
  }
  std::function<void(const fs::path&)> during;

 private:
  fs::path file_;
  int baked_ = 0;
};

std::size_t files_in(const fs::path& folder) {
  return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder), {}));
}

TEST(ShardFile, IsThereAsAWholeOrNotAtAll) {
  const test::TempFolder folder;
  Shard shard(folder.path());
  EXPECT_FALSE(shard.make(2));
  EXPECT_FALSE(fs::exists(shard.file()));
  EXPECT_TRUE(shard.make());
  EXPECT_EQ(shard.baked(), 3);  // two, then the third
  EXPECT_EQ(read_text(shard.file()), "frame\nframe\nframe\n");
  EXPECT_EQ(files_in(folder.path()), 1U);
}

TEST(ShardFile, OneThatIsWholeIsLeftAlone) {
  const test::TempFolder folder;
  Shard shard(folder.path());
  ASSERT_TRUE(shard.make());
  const auto written = fs::last_write_time(shard.file());
  EXPECT_TRUE(shard.make());
  EXPECT_EQ(shard.baked(), 3);
  EXPECT_EQ(fs::last_write_time(shard.file()), written);
}

TEST(ShardFile, GoesOnFromTheAttemptThatCameFurthest) {
  const test::TempFolder folder;
  Shard shard(folder.path());
  ASSERT_TRUE(write_bytes(shard.file().string() + ".attempt-a-1", "frame\n"));
  ASSERT_TRUE(write_bytes(shard.file().string() + ".attempt-b-1", "frame\nframe\n"));
  ASSERT_TRUE(write_bytes(shard.file().string() + ".attempt-c-1", ""));
  EXPECT_TRUE(shard.make());
  EXPECT_EQ(shard.baked(), 1);
  EXPECT_EQ(files_in(folder.path()), 1U);
}

// Left by a task of another setting that was cancelled: it must not block the shard for ever.
TEST(ShardFile, AnAttemptOfAnotherBakeIsPassedOver) {
  const test::TempFolder folder;
  Shard shard(folder.path());
  ASSERT_TRUE(write_bytes(shard.file().string() + ".attempt-a-1", "another bake's many frames\n"));
  EXPECT_TRUE(shard.make());
  EXPECT_EQ(shard.baked(), 3);
  EXPECT_EQ(files_in(folder.path()), 1U);
}

TEST(ShardFile, CountIsThatOfTheShardsThatAreThere) {
  const test::TempFolder folder;
  const std::string output = (folder.path() / "walk.shlm").string();
  EXPECT_EQ(count_of_shards(output), 0);
  ASSERT_TRUE(write_bytes(output + ".shard-2-of-34.round-1", "x"));
  ASSERT_TRUE(write_bytes(output + ".shard-3-of-34.attempt-a-1-0000beef", "x"));
  ASSERT_TRUE(write_bytes((folder.path() / "run.shlm.shard-1-of-5").string(), "x"));
  EXPECT_EQ(count_of_shards(output), 34);
  ASSERT_TRUE(write_bytes(output + ".shard-1-of-33", "x"));
  EXPECT_EQ(count_of_shards(output), 0) << "of two counts none is the one";
}

TEST(ShardFile, OneThatWasCutOffIsMadeWhole) {
  const test::TempFolder folder;
  Shard shard(folder.path());
  ASSERT_TRUE(write_bytes(shard.file(), "frame\n"));
  EXPECT_TRUE(shard.make());
  EXPECT_EQ(shard.baked(), 2);
}

TEST(ShardFile, OneOfAnotherBakeStays) {
  const test::TempFolder folder;
  Shard shard(folder.path());
  ASSERT_TRUE(write_bytes(shard.file(), "something else"));
  const auto made = shard.make();
  ASSERT_FALSE(made);
  EXPECT_EQ(made.error().detail, "other");
  EXPECT_EQ(read_text(shard.file()), "something else");
}

TEST(ShardFile, AnAttemptWhoseFileAnotherTookAwayHasDoneItsWork) {
  const test::TempFolder folder;
  Shard slow(folder.path()), fast(folder.path());
  // What a node that was given up and lives on sees: the other attempt ends first.
  slow.during = [&](const fs::path& own) {
    if (slow.baked() < 3) return;
    ASSERT_TRUE(write_bytes(fast.file(), "frame\nframe\nframe\n"));
    fs::remove(own);
  };
  EXPECT_TRUE(slow.make());
  fs::remove(fast.file());
  slow.during = nullptr;
  Shard alone(folder.path());
  alone.during = [&](const fs::path& own) {
    if (alone.baked() == 3) fs::remove(own);
  };
  const auto made = alone.make();
  ASSERT_FALSE(made);
  EXPECT_EQ(made.error().code, ErrorCode::kUnwritable);
  EXPECT_THAT(made.error().where, HasSubstr("shard-1-of-2"));
}

TEST(ShardFile, NamesTellOutputShardAndRound) {
  EXPECT_EQ(shard_file("a/walk.shlm", 0, 12), "a/walk.shlm.shard-1-of-12");
  EXPECT_EQ(shard_file("a/walk.shlm", 11, 12, 2), "a/walk.shlm.shard-12-of-12.round-2");
  EXPECT_EQ(shard_files("x", 3).size(), 3U);
  // An attempt at one shard is none at another, whose name begins alike.
  const test::TempFolder folder;
  const std::string output = (folder.path() / "x").string();
  ASSERT_TRUE(write_bytes(output + ".shard-1-of-12.attempt-a-1", "frame\n"));
  remove_shards(shard_files(output, 1));
  EXPECT_EQ(files_in(folder.path()), 1U);
  remove_shards({shard_file(output, 0, 12)});
  EXPECT_EQ(files_in(folder.path()), 0U);
}

}  // namespace
}  // namespace penumbra::tools
