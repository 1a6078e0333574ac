// The texts of captures, recordings and calibrations: cameras.toml, a line of a frame list, a
// response file, a colour file, a vignetting file, a board.
#include <toml++/toml.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "calib/calib.h"
#include "capture/capture.h"
#include "capture/recording/folder_format.h"
#include "core/io/toml_keys.h"

// libFuzzer's entry point, by its own name and types. The first byte chooses the reader.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace penumbra;
  if (size == 0) return 0;
  const std::string_view text(reinterpret_cast<const char*>(data + 1), size - 1);
  switch (data[0] % 6) {
    case 0:
      if (const auto row = capture::parse_row(text, size % 2, "fuzz")) {
        if (!(row->exposure.product() > 0)) __builtin_trap();
        if (!capture::stays_inside(row->file)) __builtin_trap();
      }
      break;
    case 1:
      if (const auto root = parse_toml_text(text, "fuzz"))
        if (const auto cameras = capture::read_cameras(
                *root, "fuzz", [](const std::string&) { return calib::Response::srgb(); }))
          for (const auto& camera : *cameras)
            if (camera.projection.width < 1 || !(camera.black_level < 1)) __builtin_trap();
      break;
    case 2:
      if (const auto response = calib::parse_response_file(text, "fuzz"))
        if (!(response->decode(1, 0) <= 1)) __builtin_trap();
      break;
    case 3:
      if (const auto colour = calib::parse_colour_file(text, "fuzz"))
        if (!(std::abs((*colour)[0][0]) <= 1e6)) __builtin_trap();
      break;
    case 4:
      if (const auto terms = calib::parse_vignetting_file(text, "fuzz"))
        for (const double t : *terms)
          if (!std::isfinite(t)) __builtin_trap();
      break;
    default:
      if (const auto board = calib::parse_board(text))
        if (!(board->square_m > 0) || board->columns < 2) __builtin_trap();
  }
  return 0;
}
