// Meshes other than glTF. The first byte, a digit, says which kind, the others are the file.
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "prt/geometry/mesh.h"
#include "tests/fuzz/file_input.h"

namespace {

using namespace penumbra;

constexpr std::array<const char*, 5> kSuffixes = {".obj", ".ply", ".stl", ".fbx", ".dae"};

// What is read is sound.
void check(const prt::Mesh& mesh) {
  const std::size_t n = mesh.positions.size();
  bool sound = !mesh.triangles.empty() && mesh.normals.size() == n && mesh.albedo.size() == n;
  for (const auto& t : mesh.triangles)
    for (const auto i : t) sound &= i < n;
  if (!sound) __builtin_trap();
}

}  // namespace

// libFuzzer's entry point, by its own name and types.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const auto path =
      test::as_file(std::span(data + 1, size - 1), kSuffixes[(data[0] + 2u) % kSuffixes.size()]);
  if (const auto import = prt::import_mesh(path, {.5f, .5f, .5f})) check(import->mesh);
  return 0;
}
