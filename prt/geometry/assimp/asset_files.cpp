#include <fmt/format.h>

#include "core/io/files.h"
#include "prt/geometry/internal/asset_files.h"

namespace penumbra::prt {

namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxNameShown = 60;

bool lies_in(const fs::path& path, const fs::path& folder) {
  auto at = path.begin();
  for (const fs::path& part : folder)
    if (at == path.end() || *at++ != part) return false;
  return true;
}

}  // namespace

std::string shown(const std::string& name) {
  std::string out = name.substr(0, kMaxNameShown);
  for (char& c : out)
    if (static_cast<unsigned char>(c) < 32) c = ' ';
  return out.size() < name.size() ? out + "..." : out;
}

Result<std::vector<unsigned char>> read_beside(const fs::path& asset, const std::string& relative,
                                               const std::string& whose) {
  const std::string file = asset.string();
  const auto outside = [&] {
    return fail(
        ErrorCode::kInvalid, file,
        fmt::format("{} names \"{}\", which is not in the asset's folder", whose, shown(relative)));
  };
  if (fs::path(relative).is_absolute()) return outside();
  // Where links lead counts.
  std::error_code failed;
  const fs::path folder = fs::canonical(fs::absolute(asset).parent_path(), failed);
  if (failed) return fail(ErrorCode::kNotFound, file, "lies in no folder that can be read");
  const fs::path target = fs::weakly_canonical(folder / relative, failed);
  if (failed || !lies_in(target, folder)) return outside();
  if (!fs::is_regular_file(target, failed))
    return fail(ErrorCode::kNotFound, file,
                fmt::format("{} names \"{}\", which is not there", whose, shown(relative)));
  auto bytes = read_bytes(target);
  if (!bytes)
    return fail(bytes.error().code, file,
                fmt::format("{} names \"{}\", which cannot be read: {}", whose, shown(relative),
                            bytes.error().detail));
  return bytes;
}

}  // namespace penumbra::prt
