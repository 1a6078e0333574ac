// Baked clips and sequences of RGBE maps. The first byte chooses the reader; of a baked clip the
// head, which names its asset, is put in, so that everything behind it is reached.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <vector>

#include "codec/codec.h"
#include "core/io/files.h"
#include "prt/prt.h"
#include "tools/chart/peers/rgbe_video.h"

namespace {

using namespace penumbra;

// A clip of the smallest size that has every stream, and its file.
struct Clip {
  prt::Character character = prt::make_walker({.5f, .5f, .5f});
  std::vector<unsigned char> file;

  Clip() {
    prt::SequenceOptions o;
    o.frames_per_second = 3;
    o.interpolation_error = 0;
    o.bands = 2;
    o.bounces = 1;
    o.rays = o.ground_rays = 64;
    o.ground_size = 8;
    const auto folder = std::filesystem::temp_directory_path();
    const std::filesystem::path journals[] = {folder / "penumbra-fuzz.journal"};
    std::filesystem::remove(journals[0]);
    (void)prt::bake_frames(character, 0, o, {}, journals[0]);
    const auto sequence = prt::compress_frames(character, 0, o, journals);
    (void)prt::write_sequence(folder / "penumbra-fuzz.shlm", character, 0, *sequence);
    file = *read_bytes(folder / "penumbra-fuzz.shlm");
  }
};

void read_clip(std::span<const std::uint8_t> data) {
  static const Clip clip;
  constexpr std::size_t kNames = 24;  // magic, asset, layout
  std::vector<unsigned char> bytes(clip.file.begin(), clip.file.begin() + kNames);
  if (data.size() % 2 == 0) {  // the whole file with bytes changed: three bytes a change
    bytes = clip.file;
    for (std::size_t i = 0; i + 3 < data.size(); i += 4) {
      const std::size_t at =
          kNames + (data[i] | std::size_t{data[i + 1]} << 8 | std::size_t{data[i + 2]} << 16) %
                       (bytes.size() - kNames);
      bytes[at] = data[i + 3];
    }
  } else {
    bytes.insert(bytes.end(), data.begin(), data.end());
  }
  const auto read = prt::decode_sequence(bytes, clip.character, 0, "fuzz");
  if (!read) return;
  RadianceSh light(2);
  light[0] = {1, 1, 1};
  std::vector<float> out(3 * read->surface.stride());
  read->surface.relight(1.5, light, {}, out);
  prt::Transfer ground;
  if (read->receiver) read->ground_deficit.decode(.5, {}, ground);
}

}  // namespace

// libFuzzer's entry point, by its own name and types.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::span<const std::uint8_t> rest(data + 1, size - 1);
  if (data[0] % 4 != 0) {
    read_clip(rest);
  } else if (size < 4096) {
    if (const auto maps = tools::decode_rgbe_video(rest, "fuzz"))
      for (const auto& map : *maps)
        for (const float v : map.pixels())
          if (std::isnan(v)) __builtin_trap();
  }
  return 0;
}
