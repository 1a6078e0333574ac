#include "runtime/scene/bake_cache.h"

#include <gtest/gtest.h>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "core/io/files.h"
#include "runtime/scene/scene.h"
#include "tests/support/temp_folder.h"

namespace penumbra::runtime {
namespace {

namespace fs = std::filesystem;

TEST(BakeCache, WhatWasUsedLongestAgoGoesFirst) {
  const test::TempFolder folder;
  const std::string kilobyte(1024, 'x');
  const auto now = fs::file_time_type::clock::now();
  for (int i = 0; i < 5; ++i) {
    const fs::path file = folder.path() / (std::to_string(i) + ".glb");
    ASSERT_TRUE(write_bytes(file, kilobyte));
    fs::last_write_time(file, now - std::chrono::hours(i));
  }
  ASSERT_TRUE(write_bytes(folder.path() / "notes.txt", kilobyte));
  prune_cache(folder.path(), 3 * 1024);
  for (int i = 0; i < 5; ++i)
    EXPECT_EQ(fs::exists(folder.path() / (std::to_string(i) + ".glb")), i < 3) << i;
  EXPECT_TRUE(fs::exists(folder.path() / "notes.txt")) << "not a baked file";
}

TEST(BakeCache, FolderThatIsNotThereIsNoError) {
  EXPECT_NO_THROW(prune_cache("/no/such/folder", 1));
  EXPECT_FALSE(fs::exists("/no/such/folder"));
}

// XDG_CACHE_HOME in a folder of its own, as long as it lives.
class OwnCache {
 public:
  OwnCache() {
    if (const char* const before = std::getenv("XDG_CACHE_HOME")) before_ = before;
    ::setenv("XDG_CACHE_HOME", folder_.path().c_str(), 1);
  }
  ~OwnCache() {
    if (before_)
      ::setenv("XDG_CACHE_HOME", before_->c_str(), 1);
    else
      ::unsetenv("XDG_CACHE_HOME");
  }
  OwnCache(const OwnCache&) = delete;
  OwnCache& operator=(const OwnCache&) = delete;

 private:
  const test::TempFolder folder_;
  std::optional<std::string> before_;
};

prt::BakeOptions few_rays() {
  prt::BakeOptions options;
  options.rays = options.ground_rays = 64;
  return options;
}

TEST(BakeCache, TwoThatWantTheSameBakeItOnce) {
  const OwnCache cache;
  const auto asset = load_asset("builtin:ball", {.7f, .7f, .7f}, 0);
  ASSERT_TRUE(asset) << asset.error().detail;
  std::array<std::vector<double>, 2> told;  // of its progress
  std::vector<Result<prt::BakedObject>> results;
  for (int i = 0; i < 2; ++i)
    results.push_back(fail(ErrorCode::kNotFound, "ball", "is not there yet"));
  {
    std::vector<std::jthread> threads;
    for (std::size_t i = 0; i < 2; ++i)
      threads.emplace_back([&, i] {
        prt::BakeOptions options = few_rays();
        options.progress = [&, i](double done) { told[i].push_back(done); };
        results[i] = bake_or_recall("ball", asset->mesh, options, BakeCache::kUsed);
      });
  }
  int baked = 0;
  for (const std::vector<double>& one : told) {
    ASSERT_GE(one.size(), 2u);
    EXPECT_EQ(one.front(), 0) << "who waits is seen to, too";
    EXPECT_EQ(one.back(), 1);
    baked += one.size() > 2;
  }
  EXPECT_EQ(baked, 1);
  ASSERT_TRUE(results[0] && results[1]);
  EXPECT_EQ(results[0]->transfer.values, results[1]->transfer.values);
  for (const auto& file : fs::directory_iterator(*cache_folder()))
    EXPECT_EQ(file.path().extension(), ".glb") << file.path();
}

TEST(BakeCache, ABakeThatFailsIsOver) {
  const OwnCache cache;
  std::vector<double> told;
  prt::BakeOptions options = few_rays();
  options.progress = [&](double done) { told.push_back(done); };
  EXPECT_FALSE(bake_or_recall("nothing", prt::Mesh(), options, BakeCache::kUsed));
  EXPECT_EQ(told, (std::vector<double>{0, 1}));
}

TEST(BakeCache, WhoeverDiedWhileItBakedHoldsNobodyUp) {
  const OwnCache cache;
  const auto asset = load_asset("builtin:ball", {.7f, .7f, .7f}, 0);
  ASSERT_TRUE(asset);
  // The lock's name is found where a bake has been.
  ASSERT_TRUE(bake_or_recall("ball", asset->mesh, few_rays(), BakeCache::kUsed));
  fs::path file = fs::directory_iterator(*cache_folder())->path();
  fs::remove(file);
  const fs::path lock = fs::path(file).replace_extension(".lock");
  const int held = ::open(lock.c_str(), O_CREAT | O_RDWR | O_CLOEXEC, 0644);
  ASSERT_EQ(::flock(held, LOCK_EX | LOCK_NB), 0);
  std::atomic<bool> is_baked = false;
  std::jthread waits([&] {
    is_baked = bake_or_recall("ball", asset->mesh, few_rays(), BakeCache::kUsed).has_value();
  });
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  EXPECT_FALSE(fs::exists(file)) << "it did not wait";
  ::close(held);  // as the system does for a program that ends
  waits.join();
  EXPECT_TRUE(is_baked);
  EXPECT_TRUE(fs::exists(file));
}

}  // namespace
}  // namespace penumbra::runtime
