// Baked objects. An even length: a whole file with bytes changed, three bytes a change and one the
// value; an odd one: a file.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/io/files.h"
#include "prt/prt.h"
#include "tests/fuzz/file_input.h"

namespace {

using namespace penumbra;

// The smallest file that has every part.
const std::vector<unsigned char>& whole_file() {
  static const std::vector<unsigned char> file = [] {
    prt::Mesh mesh = prt::make_knot(.4f, 12, 5, {.5f, .4f, .3f});
    prt::BakeOptions o;
    o.bands = 2;
    o.bounces = 1;
    o.rays = o.ground_rays = 64;
    o.visibility = true;
    o.receiver = prt::Receiver{prt::fit_ground_grid(mesh, -.01f, 8), {.4f, .4f, .4f}};
    const auto path = test::as_file({}, ".glb");
    (void)prt::write_baked(path, *prt::bake(std::move(mesh), o));
    return *read_bytes(path);
  }();
  return file;
}

// What is read is used: light and look-ups stay within it.
void use(const prt::BakedObject& o) {
  const std::size_t count = o.mesh.positions.size();
  RadianceSh light(o.transfer.bands);
  light[0] = {1, 1, 1};
  std::vector<float> relit(3 * o.transfer.stride);
  prt::relight(o.transfer, light, relit);
  if (o.visibility.empty()) return;
  std::vector<prt::CosineSums> sums(count);
  const prt::VisibilityLookup lookup(o.visibility, o.mesh);
  for (const int cells : {prt::VisibilityMap::kCells, prt::VisibilityMap::kFineCells}) {
    prt::VisibilitySamples samples;
    samples.clear(cells);
    for (std::size_t k = 0; k < prt::VisibilitySamples::kMax; ++k)
      samples.add({.6f, k % 2 == 0 ? .8f : -.8f, 0}, true);
    lookup.look_up(samples, 0, count, sums);
  }
  for (const prt::CosineSums& s : sums)
    if (std::isnan(s.seen + s.open)) __builtin_trap();
}

}  // namespace

// libFuzzer's entry point, by its own name and types.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::vector<unsigned char> bytes(data, data + size);
  if (size % 2 == 0) bytes = test::edited(whole_file(), data, size);
  if (const auto read = prt::read_baked(test::as_file(bytes, ".glb"))) use(*read);
  return 0;
}
