// Bytes of the fuzzer as a file, for readers that open one.
#pragma once

#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <span>
#include <string>
#include <vector>

namespace penumbra::test {

/// One file a process and suffix, written anew each time.
inline std::filesystem::path as_file(std::span<const std::uint8_t> bytes,
                                     const std::string& suffix) {
  static const std::string start =
      (std::filesystem::temp_directory_path() / "penumbra_fuzz_").string() +
      std::to_string(::getpid());
  const std::filesystem::path path = start + suffix;
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()), std::ssize(bytes));
  return path;
}

/// A good file with some bytes changed: each four of the fuzzer's say where, and to what.
inline std::vector<unsigned char> edited(std::vector<unsigned char> file, const std::uint8_t* data,
                                         std::size_t size) {
  for (std::size_t i = 0; i + 3 < size; i += 4)
    file[(data[i] | std::size_t{data[i + 1]} << 8 | std::size_t{data[i + 2]} << 16) % file.size()] =
        data[i + 3];
  return file;
}

}  // namespace penumbra::test
