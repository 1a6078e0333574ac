// Bytes of the fuzzer as a file, for readers that open one.
#pragma once

#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <span>
#include <string>

namespace penumbra::test {

/// One file a process, written anew each time.
inline std::filesystem::path as_file(std::span<const std::uint8_t> bytes,
                                     const std::string& suffix) {
  static const std::filesystem::path path =
      std::filesystem::temp_directory_path() /
      ("penumbra_fuzz_" + std::to_string(::getpid()) + suffix);
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()), std::ssize(bytes));
  return path;
}

}  // namespace penumbra::test
