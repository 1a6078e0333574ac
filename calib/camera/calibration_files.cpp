#include "calib/camera/calibration_files.h"

#include <algorithm>
#include <cmath>
#include <glm/matrix.hpp>

#include "core/io/toml_keys.h"

namespace penumbra::calib {

Result<void> check_colour_matrix(const glm::dmat3& m) {
  constexpr double kLargest = 1e6, kSmallest = 1e-6, kFlat = 1e-6;
  const auto refuse = [](const char* why) {
    return fail(ErrorCode::kInvalid, "colour matrix", why);
  };
  for (int r = 0; r < 3; ++r) {
    double white = 0;
    for (int c = 0; c < 3; ++c) {
      if (!(std::abs(m[c][r]) <= kLargest)) return refuse("has an element beyond a million");
      white += m[c][r];
    }
    if (!(white >= kSmallest)) return refuse("makes a channel of white zero or negative");
  }
  const double size = std::max({std::abs(m[0][0]), std::abs(m[1][1]), std::abs(m[2][2])});
  if (!(glm::determinant(m) > kFlat * size * size * size))
    return refuse("is singular or has a negative determinant");
  return {};
}

Result<glm::dmat3> parse_colour_file(std::string_view text, const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml_text(text, path));
  const TomlKeys keys(path, root);
  constexpr std::string_view known[] = {"version", "colour"};
  PENUMBRA_TRY(keys.only(known));
  PENUMBRA_TRY(keys.version(1));
  const toml::table* const table = root["colour"].as_table();
  if (!table) return keys.invalid("colour", "must be a table [colour]");
  const TomlKeys colour(path, *table);
  constexpr std::string_view inside[] = {"matrix", "sigma", "rms"};
  PENUMBRA_TRY(colour.only(inside));
  PENUMBRA_ASSIGN(m, colour.numbers("matrix", 9));
  glm::dmat3 out;
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) out[c][r] = m[static_cast<std::size_t>(3 * r + c)];
  const auto carries = check_colour_matrix(out);
  if (!carries) return colour.invalid("matrix", carries.error().detail);
  return out;
}

Result<NoiseFile> parse_noise_file(std::string_view text, const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml_text(text, path));
  const TomlKeys keys(path, root);
  constexpr std::string_view known[] = {"version", "noise"};
  PENUMBRA_TRY(keys.only(known));
  PENUMBRA_TRY(keys.version(1));
  const toml::table* const table = root["noise"].as_table();
  if (!table) return keys.invalid("noise", "must be a table [noise]");
  const TomlKeys noise(path, *table);
  constexpr std::string_view inside[] = {"full_well_electrons", "full_well_sigma", "read_noise",
                                         "read_sigma", "black_level"};
  PENUMBRA_TRY(noise.only(inside));
  NoiseFile out;
  PENUMBRA_ASSIGN(electrons, noise.number("full_well_electrons"));
  PENUMBRA_ASSIGN(read, noise.number("read_noise"));
  PENUMBRA_ASSIGN(black, noise.number("black_level"));
  if (!(electrons > 0)) return noise.invalid("full_well_electrons", "is not positive");
  if (!(read >= 0 && read < 1)) return noise.invalid("read_noise", "is not within 0..1");
  if (!(black >= 0 && black < 1)) return noise.invalid("black_level", "is not within 0..1");
  out.model = {electrons, read};
  out.black_level = black;
  return out;
}

Result<std::array<double, 3>> parse_vignetting_file(std::string_view text,
                                                    const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml_text(text, path));
  const TomlKeys keys(path, root);
  constexpr std::string_view known[] = {"version", "vignetting"};
  PENUMBRA_TRY(keys.only(known));
  PENUMBRA_TRY(keys.version(1));
  PENUMBRA_ASSIGN(table, keys.table("vignetting"));
  constexpr std::string_view inside[] = {"terms", "corner", "corner_sigma"};
  PENUMBRA_TRY(table.only(inside));
  PENUMBRA_ASSIGN(terms, table.numbers("terms", 3));
  return std::array<double, 3>{terms[0], terms[1], terms[2]};
}

Result<std::vector<double>> parse_lens_covariance(std::string_view text,
                                                  const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml_text(text, path));
  const TomlKeys keys(path, root);
  PENUMBRA_ASSIGN(table, keys.table("calibration"));
  if (!table.has("covariance"))
    return table.invalid("covariance", "is missing: calibrate the lens again");
  PENUMBRA_ASSIGN(values, table.numbers("covariance"));
  return values;
}

}  // namespace penumbra::calib
