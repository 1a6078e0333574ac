// Real pictures that are not part of the repository: a test that needs one and lacks it is skipped,
// and says which.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string_view>

namespace penumbra::test {

/// The file (or folder) under $PENUMBRA_SHARED_DATA, else under ../shared/data beside the sources.
inline std::optional<std::filesystem::path> shared_data(std::string_view relative) {
  const char* set = std::getenv("PENUMBRA_SHARED_DATA");
  const std::filesystem::path root =
      set && *set ? std::filesystem::path(set)
                  : std::filesystem::path(PENUMBRA_SOURCE_DIR) / ".." / "shared" / "data";
  std::error_code ignored;
  const std::filesystem::path path = (root / relative).lexically_normal();
  if (!std::filesystem::exists(path, ignored)) return std::nullopt;
  return path;
}

}  // namespace penumbra::test

// Declares `var` as the path of a shared file, or skips the test.
#define PENUMBRA_NEED_SHARED(var, relative)                                    \
  const auto var##_found = ::penumbra::test::shared_data(relative);            \
  if (!var##_found) {                                                          \
    GTEST_SKIP() << "shared data file absent: " << (relative)                  \
                 << " (set PENUMBRA_SHARED_DATA to the folder that holds it)"; \
  }                                                                            \
  const std::filesystem::path& var = *var##_found
