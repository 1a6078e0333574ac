#include "runtime/scene/bake_cache.h"

#include <gtest/gtest.h>

#include "core/io/files.h"
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

}  // namespace
}  // namespace penumbra::runtime
