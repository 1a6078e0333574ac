#include "tools/farm/slurm_script.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "tools/common/child_program.h"

namespace penumbra::tools {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

SlurmPlan plan_with(const std::string& output) {
  SlurmPlan plan;
  plan.title = "clip";
  plan.program = "/opt/a program";
  plan.folder = "/srv/it's here";
  plan.logs = output + ".slurm";
  plan.cores = 3;
  plan.stages = {{"shards", {"bake", output, "--shard", "auto/12"}, 12, 1800, 300 << 20},
                 {"round-1", {"bake", output, "--round", "1"}, 12, 1, 1},
                 {"merge", {"bake", output, "--merge", "12"}, 0, 3601, (300 << 20) + 1}};
  return plan;
}

std::string script_of(const SlurmPlan& plan) {
  const auto script = slurm_script(plan);
  EXPECT_TRUE(script) << script.error().detail;
  return script.value_or("");
}

// Of the line that submits a stage.
std::string request_of(const std::string& script, const std::string& stage) {
  const std::size_t at = script.find("job_" + stage + "=$(sbatch");
  return at == std::string::npos ? "" : script.substr(at, script.find('\n', at) - at);
}

TEST(SlurmScript, ArraysAreAsLargeAsTheirShardsAndTheLastJobIsOne) {
  const std::string script = script_of(plan_with("out.shlm"));
  EXPECT_THAT(request_of(script, "shards"), HasSubstr(" --array=1-12 "));
  EXPECT_THAT(request_of(script, "round_1"), HasSubstr(" --array=1-12 "));
  EXPECT_THAT(request_of(script, "merge"), HasSubstr("--output=out.shlm.slurm/merge.log "));
  EXPECT_THAT(request_of(script, "merge"), Not(HasSubstr("--array")));
}

TEST(SlurmScript, EachStageWaitsForTheOneBeforeHoweverItEnds) {
  const std::string script = script_of(plan_with("out.shlm"));
  EXPECT_THAT(request_of(script, "shards"), Not(HasSubstr("--dependency")));
  EXPECT_THAT(request_of(script, "round_1"), HasSubstr("--dependency=\"afterany:$job_shards\""));
  EXPECT_THAT(request_of(script, "merge"), HasSubstr("--dependency=\"afterany:$job_round_1\""));
}

TEST(SlurmScript, TimeAndMemoryAreRoundedUp) {
  const std::string script = script_of(plan_with("out.shlm"));
  EXPECT_THAT(request_of(script, "shards"), HasSubstr(" --time=30 --mem=300M "));
  EXPECT_THAT(request_of(script, "round_1"), HasSubstr(" --time=5 --mem=1M "));
  EXPECT_THAT(request_of(script, "merge"), HasSubstr(" --time=61 --mem=301M "));
  EXPECT_THAT(script, HasSubstr(" --cpus-per-task=3 --requeue "));
}

TEST(SlurmScript, NamesOfLogsHoldNoPatternsOfSlurm) {
  const std::string script = script_of(plan_with("50%a.shlm"));
  EXPECT_THAT(request_of(script, "shards"), HasSubstr("--output=50%%a.shlm.slurm/shards-%a.log"));
}

TEST(SlurmScript, AnyWordComesOutOfTheShellAsItWent) {
  for (const std::string word : {"", "plain", "two words", "it's", "$HOME `id` \"x\" \\ ! *", "-o",
                                 "caf\xc3\xa9", "#", "~", "a;b&c|d"}) {
    const auto answer = run_child({"bash", "-s"}, "printf %s " + shell_quoted(word));
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->status, 0);
    EXPECT_EQ(answer->output, word);
  }
}

TEST(SlurmScript, BashReadsItWhateverThePathsAre) {
  SlurmPlan plan = plan_with("it's $(touch no) & \"more\".shlm");
  plan.copied = "a 'copied'.glb";
  plan.stages[0].arguments.push_back(plan.copied);
  const std::string script = script_of(plan);
  const auto answer = run_child({"bash", "-n"}, script);
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->status, 0) << answer->complaint;
  EXPECT_THAT(script, HasSubstr("sbcast --force 'a '\\''copied'\\''.glb' \"$copies\"/"));
  EXPECT_THAT(script, HasSubstr("--shard auto/12 \"$copies\"/'a '\\''copied'\\''.glb' && exit 0"));
}

TEST(SlurmScript, ARefusedJobTakesTheEarlierOnesBack) {
  // sbatch as a function: it takes the first job and refuses the second.
  const std::string fake =
      "sbatch() { cat >/dev/null; case $* in *array=1-12*after*) return 1;; *) echo 7;; esac; }\n"
      "scancel() { echo \"cancelled $*\"; }\nmkdir() { :; }\ncd() { :; }\n";
  const auto answer = run_child({"bash", "-s"}, fake + script_of(plan_with("out.shlm")));
  ASSERT_TRUE(answer);
  EXPECT_NE(answer->status, 0);
  EXPECT_EQ(answer->output, "cancelled 7\n");
}

TEST(SlurmScript, AJobGoesOnAfterASignalThriceAndNotAfterARefusal) {
  const auto runs = [](const std::string& program, const std::string& folder = "/") {
    SlurmPlan plan = plan_with("x");
    plan.folder = folder;
    plan.program = "bash";
    plan.stages = {{"merge", {"-c", program}, 0, 1, 1}};
    const std::string script = script_of(plan);
    const std::size_t from = script.find("#!/usr/bin/env bash", 1);
    const auto answer =
        run_child({"bash", "-s"}, script.substr(from, script.find("END_OF_JOB\n)") - from));
    EXPECT_TRUE(answer);
    return answer ? std::pair{answer->status, answer->output} : std::pair{-1, std::string()};
  };
  EXPECT_EQ(runs("echo run"), std::pair(0, std::string("run\n")));
  EXPECT_EQ(runs("echo run; exit 2"), std::pair(2, std::string("run\n")));
  EXPECT_EQ(runs("echo run; kill -KILL $$"), std::pair(137, std::string("run\nrun\nrun\n")));
  // Where the shared folder is not there, Slurm would have it run elsewhere.
  EXPECT_EQ(runs("echo run", "/no such folder"), std::pair(1, std::string()));
}

TEST(SlurmScript, WhatAScriptCannotHoldIsRefused) {
  SlurmPlan plan = plan_with("two\nlines.shlm");
  const auto script = slurm_script(plan);
  ASSERT_FALSE(script);
  EXPECT_EQ(script.error().code, ErrorCode::kInvalid);
  EXPECT_THAT(script.error().detail, HasSubstr("control character"));
  plan = plan_with("out.shlm");
  plan.stages.clear();
  EXPECT_FALSE(slurm_script(plan));
}

TEST(ChildProgram, TellsWhatWasSaidAndHowItEnded) {
  const auto said = run_child({"bash", "-c", "cat; echo bad >&2; exit 3"}, "in");
  ASSERT_TRUE(said);
  EXPECT_EQ(said->output, "in");
  EXPECT_EQ(said->complaint, "bad\n");
  EXPECT_EQ(said->status, 3);
  const auto killed = run_child({"bash", "-c", "kill -TERM $$"});
  ASSERT_TRUE(killed);
  EXPECT_EQ(killed->status, 128 + 15);
  const auto none = run_child({"no-such-program-of-ours"});
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::kUnavailable);
}

}  // namespace
}  // namespace penumbra::tools
