#include "core/io/log.h"

#include <gtest/gtest.h>

#include <chrono>
#include <string>
#include <thread>
#include <vector>

namespace penumbra {
namespace {

// Each test leaves an empty sink: nothing of it may reach the next one.
class Log : public testing::Test {
 protected:
  void SetUp() override {
    set_log_sink([this](LogLevel level, std::string_view line) {
      lines_.push_back((level == LogLevel::kWarning ? "w " : "i ") + std::string(line));
    });
  }
  void TearDown() override { set_log_sink({}); }

  std::vector<std::string> lines_;
};

TEST_F(Log, LinesReachTheSinkWithTheirLevel) {
  log_info("bakes {} vertices", 12);
  log_warning("{}: {} triangles are left out", "a.obj", 3);
  EXPECT_EQ(lines_,
            (std::vector<std::string>{"i bakes 12 vertices", "w a.obj: 3 triangles are left out"}));
}

TEST_F(Log, AnEmptySinkDropsThem) {
  set_log_sink({});
  log_warning("{}", "nobody reads this");
  EXPECT_TRUE(lines_.empty());
}

TEST_F(Log, ALineThatRepeatsPassesOnceAndSaysLaterHowOftenItCame) {
  limit_log_rate(.2);
  for (int i = 0; i < 5; ++i) log_info("again");
  log_info("another");
  EXPECT_EQ(lines_, (std::vector<std::string>{"i again", "i another"}));
  std::this_thread::sleep_for(std::chrono::milliseconds(250));
  log_info("again");
  log_info("another");
  EXPECT_EQ(lines_, (std::vector<std::string>{"i again", "i another", "i again (4 times more)",
                                              "i another"}));
}

TEST_F(Log, ThreadsTakeTurns) {
  constexpr int kThreads = 4, kLines = 200;
  {
    std::vector<std::jthread> threads;
    for (int t = 0; t < kThreads; ++t)
      threads.emplace_back([t] {
        for (int i = 0; i < kLines; ++i) log_info("{} {}", t, i);
      });
  }
  EXPECT_EQ(lines_.size(), std::size_t{kThreads} * kLines);
}

}  // namespace
}  // namespace penumbra
