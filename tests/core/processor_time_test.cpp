#include "core/threads/processor_time.h"

#include <gtest/gtest.h>

#include <pthread.h>

#include <ctime>
#include <latch>
#include <stdexcept>
#include <thread>

#include "core/threads/background_task.h"
#include "core/threads/parallel.h"

namespace penumbra {
namespace {

double thread_ms() {
  timespec now{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

// Of processor time, however busy the machine is.
void spin(double ms) {
  const double until = thread_ms() + ms;
  while (thread_ms() < until) {
  }
}

TEST(ProcessorTime, CountsForTheInnermostUse) {
  const ProcessorTimes before = processor_times();
  {
    const SpendingOn pipeline(ProcessorUse::kPipeline);
    spin(20);
    {
      const SpendingOn other(ProcessorUse::kOther);
      spin(40);
    }
    const SpendingOn cameras(ProcessorUse::kCameras);
    spin(30);
  }
  EXPECT_EQ(spending_on(), ProcessorUse::kOther);
  spin(10);
  const ProcessorTimes spent = processor_times() - before;
  EXPECT_GE(spent.pipeline_ms, 19.9);
  EXPECT_LT(spent.pipeline_ms, 25);
  EXPECT_GE(spent.cameras_ms, 29.9);
  EXPECT_LT(spent.cameras_ms, 35);
  EXPECT_GE(spent.other_ms, 49);
}

TEST(ProcessorTime, ThreadsThatSayNothingAreOther) {
  const ProcessorTimes before = processor_times();
  std::thread([] { spin(30); }).join();
  const ProcessorTimes spent = processor_times() - before;
  EXPECT_GE(spent.other_ms, 29);
  EXPECT_LT(spent.cameras_ms, 1);
  EXPECT_LT(spent.pipeline_ms, 10);  // threads of loops that idle count for the last one
}

TEST(ProcessorTime, WhoeverDoesAPartOfALoopSpendsForWhoStartedIt) {
  const ProcessorTimes before = processor_times();
  {
    const SpendingOn pipeline(ProcessorUse::kPipeline);
    parallel_for(0, 16, [](int) { spin(5); });
    BackgroundTask aside;
    aside.run([] { parallel_for(0, 4, [](int) { spin(5); }); });
    aside.wait();
  }
  std::thread other([] { parallel_for(0, 8, [](int) { spin(5); }); });
  other.join();
  const ProcessorTimes spent = processor_times() - before;
  EXPECT_GE(spent.pipeline_ms, 99);
  EXPECT_LT(spent.pipeline_ms, 140);
  EXPECT_GE(spent.other_ms, 39);
}

// While it lives: up to now.
TEST(ProcessorTime, SoftwareDrawingIsKnownByItsThreadsName) {
  std::latch named(1), begin(1), spun(1), read(1);
  std::thread drawing([&] {
    ::pthread_setname_np(::pthread_self(), "llvmpipe-7");
    named.count_down();
    begin.wait();
    spin(40);
    spun.count_down();
    read.wait();
  });
  named.wait();
  const ProcessorTimes before = processor_times();
  begin.count_down();
  spun.wait();
  const ProcessorTimes spent = processor_times() - before;
  read.count_down();
  drawing.join();
  EXPECT_GE(spent.drawing_ms, 39.9);
  EXPECT_LT(spent.drawing_ms, 60);
  EXPECT_LT(spent.other_ms, 20);
}

TEST(ProcessorTime, AThreadThatStillSpendsIsCountedUpToNow) {
  std::latch spun(1), read(1);
  const ProcessorTimes before = processor_times();
  std::thread encoder([&] {
    const SpendingOn encoding(ProcessorUse::kEncoding);
    spin(30);
    spun.count_down();
    read.wait();
  });
  spun.wait();
  EXPECT_GE((processor_times() - before).encoding_ms, 29.9);
  read.count_down();
  encoder.join();
  EXPECT_GE((processor_times() - before).encoding_ms, 29.9);
  EXPECT_LT((processor_times() - before).encoding_ms, 35);
}

TEST(ProcessorTime, ALoopThatThrowsLeavesItsCallerAsItWas) {
  for (const ProcessorUse use : {ProcessorUse::kOther, ProcessorUse::kCameras}) {
    const SpendingOn spending(use);
    EXPECT_THROW(parallel_for(0, 100, [](int) { throw std::runtime_error("body"); }),
                 std::runtime_error);
    EXPECT_EQ(spending_on(), use);
  }
}

TEST(ProcessorTime, AnExceptionEndsAUse) {
  EXPECT_THROW(
      {
        const SpendingOn pipeline(ProcessorUse::kPipeline);
        throw std::runtime_error("body");
      },
      std::runtime_error);
  EXPECT_EQ(spending_on(), ProcessorUse::kOther);
}

}  // namespace
}  // namespace penumbra
