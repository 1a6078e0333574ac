#include "core/threads/processor_time.h"

#include <gtest/gtest.h>

#include <ctime>
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
  EXPECT_LT(spent.pipeline_ms + spent.cameras_ms, 1);
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
  EXPECT_LT(spent.pipeline_ms, 130);
  EXPECT_GE(spent.other_ms, 39);
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
