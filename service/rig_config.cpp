#include "service/rig_config.h"

#include <algorithm>
#include <cctype>

#include "capture/camera_regions.h"
#include "capture/frames.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "core/io/toml_keys.h"
#include "service/http/loopback.h"

namespace penumbra::service {
namespace fs = std::filesystem;
namespace {

// One optional table of the file, with its known keys checked.
class Section {
 public:
  Section(const fs::path& path, const toml::table& root, const TomlKeys& root_keys,
          std::string_view name)
      : path_(path), root_keys_(root_keys), name_(name), node_(root.get(name)) {}

  template <class Read>
  Result<void> read(std::span<const std::string_view> known, Read read) const {
    if (!node_) return {};
    if (!node_->is_table())
      return root_keys_.invalid(name_, fmt::format("must be a table [{}]", name_));
    const TomlKeys keys(path_, *node_->as_table());
    PENUMBRA_TRY(keys.only(known));
    return read(keys);
  }

 private:
  const fs::path& path_;
  const TomlKeys& root_keys_;
  std::string_view name_;
  const toml::node* node_;
};

std::string resolve(const std::string& file, const fs::path& folder) {
  return fs::path(file).is_absolute() || file.starts_with("builtin:") ? file
                                                                      : (folder / file).string();
}

Result<void> read_path(const TomlKeys& keys, std::string_view key, const fs::path& folder,
                       std::optional<std::string>& out) {
  if (!keys.has(key)) return {};
  PENUMBRA_ASSIGN(text, keys.text(key));
  out = resolve(text, folder);
  return {};
}

Result<void> read_number(const TomlKeys& keys, std::string_view key, double low, double high,
                         double& out) {
  if (!keys.has(key)) return {};
  PENUMBRA_ASSIGN(value, keys.number(key));
  if (value <= low || value > high)
    return keys.invalid(key, fmt::format("is not above {} and at most {}", low, high));
  out = value;
  return {};
}

Result<void> read_integer(const TomlKeys& keys, std::string_view key, int low, int high, int& out) {
  if (!keys.has(key)) return {};
  PENUMBRA_ASSIGN(value, keys.integer(key, low, high));
  out = value;
  return {};
}

Result<void> read_capture(const TomlKeys& keys, const fs::path& folder, RigConfig& c) {
  PENUMBRA_ASSIGN(source, keys.text("source"));
  c.source = source == "studio" || source == "cameras" ? source : resolve(source, folder);
  // Elsewhere they would do nothing.
  if (c.source != "studio")
    for (const std::string_view key :
         {"environment", "asset", "real_mesh", "fps", "width", "height"})
      if (keys.has(key)) return keys.invalid(key, "belongs to source = \"studio\"");
  PENUMBRA_TRY(read_path(keys, "environment", folder, c.environment));
  PENUMBRA_TRY(read_path(keys, "asset", folder, c.asset));
  PENUMBRA_TRY(read_path(keys, "real_mesh", folder, c.real_mesh));
  PENUMBRA_TRY(read_number(keys, "fps", 0, 1000, c.fps));
  PENUMBRA_TRY(read_integer(keys, "width", 64, 8192, c.width));
  return read_integer(keys, "height", 64, 8192, c.height);
}

// A file of one line, of which strangers must not know.
Result<std::string> read_token(const TomlKeys& keys, const fs::path& file) {
  constexpr std::size_t kShortest = 16, kLongest = 256;
  PENUMBRA_ASSIGN(token, read_text(file, 4096));
  while (!token.empty() && std::isspace(static_cast<unsigned char>(token.back()))) token.pop_back();
  const auto plain = [](unsigned char c) { return std::isalnum(c) || c == '-' || c == '_'; };
  if (token.size() < kShortest || token.size() > kLongest || !std::ranges::all_of(token, plain))
    return keys.invalid("token_file",
                        "does not hold a token of 16 to 256 letters, digits, '-' and '_'");
  return token;
}

Result<void> read_origins(const TomlKeys& keys, const toml::table& table, RigConfig& c) {
  const toml::array* const list = table["origins"].as_array();
  if (!list) return keys.invalid("origins", "is not a list of texts");
  for (const toml::node& item : *list) {
    const auto origin = item.value<std::string>();
    if (!origin || !(origin->starts_with("http://") || origin->starts_with("https://")))
      return keys.invalid("origins", "holds what is no http:// or https:// origin");
    // As browsers send it, or none would ever match.
    if (origin->find('/', origin->find("//") + 2) != std::string::npos)
      return keys.invalid(
          "origins", *origin + " is more than an origin: leave out all after its host and port");
    c.origins.push_back(*origin);
  }
  return {};
}

// Nothing where the key is not there; empty stays empty.
Result<void> read_optional_path(const TomlKeys& keys, std::string_view key, const fs::path& folder,
                                std::optional<fs::path>& out) {
  if (!keys.has(key)) return {};
  PENUMBRA_ASSIGN(text, keys.text(key));
  out = text.empty() ? fs::path() : fs::path(resolve(text, folder));
  return {};
}

Result<void> read_http(const TomlKeys& keys, const toml::table& table, const fs::path& folder,
                       RigConfig& c) {
  PENUMBRA_TRY(read_optional_path(keys, "socket", folder, c.socket));
  if (keys.has("socket_group")) {
    const auto value = table["socket_group"].value_exact<bool>();
    if (!value) return keys.invalid("socket_group", "is neither true nor false");
    c.socket_for_group = *value;
  }
  if (keys.has("token_file")) {
    PENUMBRA_ASSIGN(name, keys.text("token_file"));
    PENUMBRA_ASSIGN(token, read_token(keys, resolve(name, folder)));
    c.token = token;
  }
  if (keys.has("origins")) PENUMBRA_TRY(read_origins(keys, table, c));
  if (keys.has("address")) {
    PENUMBRA_ASSIGN(address, keys.text("address"));
    // Strangers must not see through the user's cameras.
    if (!is_loopback(address) && c.token.empty())
      return keys.invalid(
          "address", "\"" + address + "\" is not a loopback address: others need a token_file");
    c.address = address;
    if (!keys.has("port")) return keys.invalid("address", "needs a port beside it");
  }
  if (!keys.has("port")) return {};
  int port = 0;
  PENUMBRA_TRY(read_integer(keys, "port", 0, 65535, port));
  c.port = port;
  return {};
}

// A map of the light instead of a camera that sees it.
Result<void> read_light_file(const TomlKeys& keys, const fs::path& folder, RigConfig& c) {
  constexpr double kLargest = 1e9;
  PENUMBRA_TRY(read_path(keys, "environment", folder, c.light_environment));
  for (const std::string_view key : {"environment_scale", "paper_albedo"})
    if (keys.has(key) && !c.light_environment)
      return keys.invalid(key, "belongs to an environment, which is not there");
  if (c.light_environment && c.source == "studio")
    return keys.invalid("environment", "belongs to [capture] for source = \"studio\"");
  if (keys.has("environment_scale")) {
    double scale = 0;
    PENUMBRA_TRY(read_number(keys, "environment_scale", 0, kLargest, scale));
    c.environment_scale = scale;
  }
  return read_number(keys, "paper_albedo", 0, 1, c.paper_albedo);
}

Result<void> read_headset(const TomlKeys& keys, HeadsetOptions& out) {
  constexpr double kFarthest_m = 10'000;
  if (keys.has("application")) {
    PENUMBRA_ASSIGN(name, keys.text("application"));
    out.application = name;
  }
  PENUMBRA_TRY(read_number(keys, "near_m", 0, kFarthest_m, out.near_m));
  PENUMBRA_TRY(read_number(keys, "far_m", 0, kFarthest_m, out.far_m));
  PENUMBRA_TRY(read_number(keys, "picture_distance_m", 0, kFarthest_m, out.picture_distance_m));
  if (keys.has("floor_height_m")) {
    double height = 0;
    PENUMBRA_TRY(read_number(keys, "floor_height_m", -100, 100, height));
    out.floor_height_m = height;
  }
  return {};
}

Result<void> read_pose(const fs::path& path, const TomlKeys& root, RigConfig& c) {
  PENUMBRA_ASSIGN(keys, root.table("pose"));
  if (c.source == "studio")
    return keys.invalid("source", "is for cameras and captures: the studio's cameras stand");
  PENUMBRA_ASSIGN(pose, read_pose_config(path, keys));
  c.pose = pose;
  return {};
}

}  // namespace

Result<RigConfig> read_rig_config(const fs::path& path, bool to_composite) {
  PENUMBRA_ASSIGN(root, parse_toml(path));
  const TomlKeys keys(path, root);
  constexpr std::string_view known[] = {"version", "capture", "camera", "scene",  "light",
                                        "http",    "output",  "pose",   "headset"};
  PENUMBRA_TRY(keys.only(known));
  PENUMBRA_TRY(keys.version(1));
  const fs::path folder = path.parent_path();
  RigConfig c;
  if (!keys.has("capture"))
    return keys.invalid(
        "capture", "is missing: its source is \"studio\", \"cameras\" or the path of a capture");
  constexpr std::string_view capture_keys[] = {"source", "environment", "asset", "real_mesh",
                                               "fps",    "width",       "height"};
  constexpr std::string_view scene_keys[] = {"file"};
  constexpr std::string_view light_keys[] = {"bands",         "max_lights",  "max_shadow_error",
                                             "stale_after_s", "environment", "environment_scale",
                                             "paper_albedo"};
  constexpr std::string_view http_keys[] = {"socket", "socket_group", "address",
                                            "port",   "token_file",   "origins"};
  constexpr std::string_view output_keys[] = {"recordings", "light_page", "pipewire",
                                              "v4l2",       "y4m",        "openxr"};
  constexpr std::string_view headset_keys[] = {"application", "picture_distance_m",
                                               "floor_height_m", "near_m", "far_m"};
  const auto capture = [&](const TomlKeys& k) { return read_capture(k, folder, c); };
  const auto scene = [&](const TomlKeys& k) { return read_path(k, "file", folder, c.scene); };
  const auto light = [&](const TomlKeys& k) -> Result<void> {
    PENUMBRA_TRY(read_integer(k, "bands", 1, kMaxBands, c.bands));
    PENUMBRA_TRY(read_integer(k, "max_lights", 0, 64, c.max_lights));
    PENUMBRA_TRY(read_number(k, "max_shadow_error", .001, 1, c.max_shadow_error));
    PENUMBRA_TRY(read_number(k, "stale_after_s", 0, 3600, c.stale_after_s));
    return read_light_file(k, folder, c);
  };
  const auto http = [&](const TomlKeys& k) {
    return read_http(k, *root["http"].as_table(), folder, c);
  };
  c.recordings = folder / "recordings";
  const auto output = [&](const TomlKeys& k) -> Result<void> {
    if (k.has("recordings")) {
      PENUMBRA_ASSIGN(name, k.text("recordings"));
      c.recordings = resolve(name, folder);
    }
    PENUMBRA_TRY(read_optional_path(k, "light_page", folder, c.light_page));
    for (const auto& [key, to] :
         {std::pair{"pipewire", &c.pipewire}, {"v4l2", &c.v4l2}, {"y4m", &c.y4m}}) {
      if (!k.has(key)) continue;
      PENUMBRA_ASSIGN(text, k.text(key));
      *to = text;
    }
    if (!c.y4m.empty() && c.y4m != "-") c.y4m = resolve(c.y4m, folder);
    if (k.has("openxr")) {
      PENUMBRA_ASSIGN(openxr, k.flag("openxr"));
      c.openxr = openxr;
    }
    return {};
  };
  PENUMBRA_TRY(Section(path, root, keys, "capture").read(capture_keys, capture));
  PENUMBRA_TRY(Section(path, root, keys, "scene").read(scene_keys, scene));
  PENUMBRA_TRY(Section(path, root, keys, "light").read(light_keys, light));
  PENUMBRA_TRY(Section(path, root, keys, "http").read(http_keys, http));
  PENUMBRA_TRY(Section(path, root, keys, "output").read(output_keys, output));
  PENUMBRA_TRY(Section(path, root, keys, "headset").read(headset_keys, [&](const TomlKeys& k) {
    return read_headset(k, c.headset);
  }));
  if (keys.has("pose")) PENUMBRA_TRY(read_pose(path, keys, c));
  if (!to_composite) c.scene.reset();
  if (to_composite && c.source != "studio" && !c.scene)
    return fail(ErrorCode::kInvalid, path.string(),
                "has no [scene] file = \"scene.toml\", which every source but the studio needs");
  if (c.source != "cameras" && keys.has("camera"))
    return keys.invalid("camera", "belongs to source = \"cameras\"");
  if (c.source != "cameras") return c;
  PENUMBRA_ASSIGN(cameras, capture::read_rig_cameras(path));
  const auto has_none = [&](const auto& predicate) {
    return to_composite &&
           std::ranges::none_of(cameras, [&](const auto& k) { return predicate(k.info); });
  };
  if (!c.light_environment && has_none(capture::shows_surroundings))
    return keys.invalid("camera",
                        "has neither a camera with role = \"environment\" nor a mirror ball, and "
                        "[light] no environment");
  if (has_none([](const auto& info) { return info.role == capture::Role::kView; }))
    return keys.invalid("camera", "has no camera with role = \"view\"");
  c.cameras = std::move(cameras);
  return c;
}

}  // namespace penumbra::service
