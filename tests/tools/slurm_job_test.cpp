#include "tools/farm/slurm_job.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <string>
#include <vector>

#include "core/io/files.h"
#include "core/io/log.h"
#include "tests/support/temp_folder.h"

namespace penumbra::tools {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// A folder with programs of Slurm's names before all others: sbatch runs `on_submit`, which finds
// the array or the merge in $what, and the submission in $n.
class SlurmJob : public ::testing::Test {
 protected:
  void SetUp() override {
    path_ = std::getenv("PATH");
    setenv("PATH", (folder_.path().string() + ":" + path_).c_str(), 1);
    set_log_sink([this](LogLevel, std::string_view line) { log_.emplace_back(line); });
    plan_.title = "clip.shlm";
    plan_.program = "penumbra";
    plan_.folder = folder_.path().string();
    plan_.logs = "clip.shlm.slurm";
    plan_.stages = {{"shards", {"bake"}, 2, 1, 1}, {"merge", {"bake"}, 0, 1, 1}};
    for (const char* const name : {"one", "two"}) shards_.push_back(folder_.path() / name);
    program("scancel", "exit 0");
    program("squeue", "exit 0");
    fs::current_path(folder_.path());
  }
  void TearDown() override {
    setenv("PATH", path_.c_str(), 1);
    set_log_sink(nullptr);
    fs::current_path("/");
  }
  void program(const std::string& name, const std::string& text) {
    const fs::path file = folder_.path() / name;
    ASSERT_TRUE(write_bytes(file, "#!/bin/bash\n" + text + "\n"));
    fs::permissions(file, fs::perms::owner_all);
  }
  void on_submit(const std::string& text) {
    program("sbatch",
            "[[ $1 == --version ]] && exit\ncat >/dev/null\n"
            "what=merge; [[ $* == *--array* ]] && what=array && echo >>submissions\n"
            "n=$(wc -l <submissions)\nprintf '%s ' \"$@\" >>\"asked-$n\"\n" +
                text + "\necho $((n * 10))");
  }
  Result<SlurmOutcome> run() {
    SlurmWait wait;
    wait.interval = std::chrono::milliseconds(1);
    wait.progress = [this](double done) { progress_.push_back(done); };
    return run_on_slurm(plan_, {folder_.path() / "clip.shlm", {shards_}}, wait);
  }

  const test::TempFolder folder_;
  SlurmPlan plan_;
  std::vector<fs::path> shards_;
  std::vector<std::string> log_;
  std::vector<double> progress_;

 private:
  std::string path_;
};

TEST_F(SlurmJob, EndsWhenTheOutputIsNew) {
  ASSERT_TRUE(write_bytes(folder_.path() / "clip.shlm", "old"));
  on_submit("[[ $what == array ]] && touch one two || echo new >clip.shlm");
  const auto outcome = run();
  ASSERT_TRUE(outcome) << outcome.error().detail;
  EXPECT_EQ(outcome->submissions, 1);
  EXPECT_THAT(outcome->jobs, ::testing::ElementsAre("10", "10"));
  EXPECT_FALSE(fs::exists(folder_.path() / "clip.shlm.slurm"));
}

TEST_F(SlurmJob, AnOldOutputIsNoResult) {
  ASSERT_TRUE(write_bytes(folder_.path() / "clip.shlm", "old"));
  on_submit("[[ $what == array ]] && touch one two");
  const auto outcome = run();
  ASSERT_FALSE(outcome);
  EXPECT_THAT(outcome.error().detail, HasSubstr("submitted 3 times"));
}

TEST_F(SlurmJob, WhatIsLostIsSubmittedAgain) {
  on_submit(
      "[[ $what == array ]] && { touch one; ((n < 2)) || touch two; }\n"
      "[[ $what == merge && -e two ]] && echo new >clip.shlm");
  const auto outcome = run();
  ASSERT_TRUE(outcome) << outcome.error().detail;
  EXPECT_EQ(outcome->submissions, 2);
  EXPECT_THAT(log_, ::testing::Contains(HasSubstr("two: submitted again")));
  EXPECT_THAT(progress_, ::testing::Contains(.5));
}

TEST_F(SlurmJob, WhatIsLostAgainAndAgainIsGivenUpByName) {
  on_submit("touch two");
  const auto outcome = run();
  ASSERT_FALSE(outcome);
  EXPECT_EQ(outcome.error().code, ErrorCode::kUnavailable);
  EXPECT_THAT(outcome.error().detail, HasSubstr("submitted 3 times"));
  EXPECT_THAT(outcome.error().detail, HasSubstr("/one"));
}

TEST_F(SlurmJob, TheProgramsOwnRefusalIsTheErrorAtOnce) {
  on_submit("echo 'penumbra: fox.glb: no such file' >clip.shlm.slurm/shards-2.log; touch one");
  const auto outcome = run();
  ASSERT_FALSE(outcome);
  EXPECT_EQ(outcome.error().where, "clip.shlm.slurm/shards-2.log");
  EXPECT_EQ(outcome.error().detail, "fox.glb: no such file");
  EXPECT_EQ(read_text(folder_.path() / "submissions"), "\n");
}

TEST_F(SlurmJob, ItWaitsWhileJobsAreLeftOrSlurmIsSilent) {
  on_submit("[[ $what == array ]] && touch one two");
  program("squeue",
          "[[ $* == *--me* ]] && exit\necho >>asked; case $(wc -l <asked) in 1) echo 'PENDING "
          "Resources';; 2) echo 'RUNNING "
          "None';;\n3) echo 'Unable to contact slurm controller' >&2; exit 1;; 4) echo 'RUNNING "
          "None'; echo new >clip.shlm;;\n5) echo 'slurm_load_jobs error: Invalid job id specified' "
          ">&2; exit 1;; esac");
  const auto outcome = run();
  ASSERT_TRUE(outcome) << outcome.error().detail;
  EXPECT_EQ(read_text(folder_.path() / "asked"), "\n\n\n\n\n");
  EXPECT_THAT(log_, ::testing::Contains(HasSubstr("Unable to contact")));
}

TEST_F(SlurmJob, WhatSomebodyCancelsIsNotSubmittedAgain) {
  on_submit("touch one");
  program("squeue", "[[ $* == *--states=all* ]] && printf '10 FAILED\\n10 CANCELLED\\n'; exit 0");
  const auto outcome = run();
  ASSERT_FALSE(outcome);
  EXPECT_EQ(outcome.error().code, ErrorCode::kUnavailable);
  EXPECT_THAT(outcome.error().detail, HasSubstr("job 10 was cancelled"));
  EXPECT_EQ(read_text(folder_.path() / "submissions"), "\n");
}

// The naive way asks for as little again, and loses the same shards three times.
TEST_F(SlurmJob, WhatWasShortIsAskedForTwice) {
  plan_.stages[0].bytes = std::uint64_t{700} << 20;
  plan_.stages[0].seconds = 60;  // less than the least that is asked for
  on_submit(
      "[[ $what == array ]] && { touch one; ((n < 2)) || touch two; }\n"
      "[[ $what == merge && -e two ]] && echo new >clip.shlm");
  program("squeue",
          "[[ $* == *--states=all* ]] && printf '10 OUT_OF_MEMORY\\n10 TIMEOUT\\n'; exit 0");
  const auto outcome = run();
  ASSERT_TRUE(outcome) << outcome.error().detail;
  const auto first = read_text(folder_.path() / "asked-1"),
             second = read_text(folder_.path() / "asked-2");
  ASSERT_TRUE(first && second);
  EXPECT_THAT(*first, HasSubstr("--time=5 --mem=700M"));
  EXPECT_THAT(*second, HasSubstr("--time=10 --mem=1400M"));
  EXPECT_THAT(log_, ::testing::Contains(HasSubstr("twice the memory")));
}

TEST_F(SlurmJob, NothingIsSubmittedBesideJobsOfAnEarlierWait) {
  plan_.mark = "penumbra-12";
  on_submit("[[ $what == array ]] && touch one two || echo new >clip.shlm");
  program("squeue", "[[ $* == *--me* ]] && printf '7 (null)\\n8 penumbra-13\\n'; exit 0");
  EXPECT_TRUE(run());
  EXPECT_THAT(*read_text(folder_.path() / "asked-1"), HasSubstr("--comment=penumbra-12"));
  fs::remove(folder_.path() / "clip.shlm");
  program("squeue",
          "[[ $* == *--me* ]] && printf '9 penumbra-12\\n9 penumbra-12\\n11 penumbra-12\\n'; "
          "exit 0");
  const auto outcome = run();
  ASSERT_FALSE(outcome);
  EXPECT_THAT(outcome.error().detail, HasSubstr("scancel 9 11"));
  EXPECT_EQ(read_text(folder_.path() / "submissions"), "\n");
}

TEST_F(SlurmJob, AnOutputThatASharedFolderShowsLateIsWaitedFor) {
  on_submit("[[ $what == array ]] && touch one two");
  program("squeue",
          "[[ $* == *--states=all* ]] || exit 0\necho '10 COMPLETED'\n"
          "(sleep .2; echo new >clip.shlm) </dev/null >/dev/null 2>&1 &");
  const auto outcome = run();
  ASSERT_TRUE(outcome) << outcome.error().detail;
  EXPECT_EQ(outcome->submissions, 1);
}

TEST_F(SlurmJob, WhatSlurmRefusesIsTold) {
  on_submit("echo 'sbatch: error: invalid partition specified: none' >&2; exit 1");
  const auto outcome = run();
  ASSERT_FALSE(outcome);
  EXPECT_EQ(outcome.error().where, "sbatch");
  EXPECT_THAT(outcome.error().detail, HasSubstr("invalid partition"));
}

TEST(SlurmLog, OnlyALastLineOfOursIsARefusal) {
  EXPECT_EQ(refusal_in("info: x\npenumbra: a: b\n"), "a: b");
  EXPECT_EQ(refusal_in("penumbra: a: b\nattempt 1 ended by signal 9\n"), "");
  EXPECT_EQ(refusal_in(""), "");
}

}  // namespace
}  // namespace penumbra::tools
