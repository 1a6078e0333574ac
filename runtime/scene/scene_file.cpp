#include <fmt/format.h>
#include <fmt/ranges.h>
#include <algorithm>

#include "core/io/spelling.h"
#include "core/io/toml_keys.h"
#include "runtime/scene/scene.h"
#include "shadows/visibility/lamp.h"

namespace penumbra::runtime {
namespace fs = std::filesystem;
namespace {

constexpr std::string_view kObjectKeys[] = {
    "name",     "asset",        "albedo",      "position",     "rotation",       "scale",
    "spin_rpm", "visible",      "animation",   "transfer",     "light_map",      "fit_size_m",
    "blend",    "blend_weight", "transfer_ms", "max_vertices", "emission_lights"};
constexpr std::string_view kPlacementKeys[] = {"position", "rotation", "scale", "fit_size_m"};
constexpr std::string_view kRealKeys[] = {"plane",    "mesh",     "depth", "camera",    "albedo",
                                          "position", "rotation", "scale", "fit_size_m"};

// Beyond these floats have no room for a shadow.
constexpr double kFarthest = 1e4, kMinScale = 1e-4, kLargestScale = 1e4, kFastest_rpm = 1e4;

Result<glm::dvec3> read_point(const TomlKeys& keys, std::string_view key) {
  PENUMBRA_ASSIGN(p, keys.numbers(key, 3));
  for (const double c : p)
    if (!(std::abs(c) <= kFarthest))
      return keys.invalid(key, fmt::format("is not within {} m of the origin", kFarthest));
  return glm::dvec3(p[0], p[1], p[2]);
}

Result<double> read_size(const TomlKeys& keys, std::string_view key) {
  PENUMBRA_ASSIGN(s, keys.number(key));
  if (s <= 0) return keys.invalid(key, "is not positive");
  if (!(s >= kMinScale && s <= kLargestScale))
    return keys.invalid(key, fmt::format("is not within {}..{}", kMinScale, kLargestScale));
  return s;
}

Result<Rgb> read_albedo(const TomlKeys& keys) {
  PENUMBRA_ASSIGN(v, keys.numbers("albedo", 3));
  for (double c : v)
    if (c < 0 || c > 1) return keys.invalid("albedo", "is not within 0..1");
  return Rgb{static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
}

// Relative paths are meant from the scene's folder.
std::string resolve(const std::string& file, const fs::path& folder) {
  if (file.starts_with("builtin:") || fs::path(file).is_absolute()) return file;
  return (folder / file).string();
}

Result<void> read_placement(const TomlKeys& keys, Placement& o) {
  if (keys.has("position")) {
    PENUMBRA_ASSIGN(p, read_point(keys, "position"));
    o.position = p;
  }
  if (keys.has("rotation")) {
    PENUMBRA_ASSIGN(q, keys.numbers("rotation", 4));
    const glm::dquat r(q[3], q[0], q[1], q[2]);
    if (std::abs(glm::length(r) - 1) > 1e-3)
      return keys.invalid("rotation", "is not a unit quaternion x, y, z, w");
    o.rotation = glm::normalize(r);
  }
  if (keys.has("scale")) {
    PENUMBRA_ASSIGN(s, read_size(keys, "scale"));
    o.scale = s;
  }
  if (keys.has("fit_size_m")) {
    if (keys.has("scale"))
      return keys.invalid("fit_size_m", "excludes scale: give only one of them");
    PENUMBRA_ASSIGN(s, read_size(keys, "fit_size_m"));
    o.place_on_floor = true;
    o.fit_size_m = s;
  }
  return {};
}

Result<void> read_blend(const TomlKeys& keys, SceneObject& o) {
  if (keys.has("blend")) {
    PENUMBRA_ASSIGN(blend, keys.text("blend"));
    if (blend.empty()) return keys.invalid("blend", "is empty: name a clip of the asset");
    if (!o.transfer.empty())
      return keys.invalid("transfer", "must be \"live\" or left out, since a blend is traced live");
    if (keys.has("light_map"))
      return keys.invalid("light_map", "excludes blend, whose transfer is kept at vertices");
    o.blend = blend;
    o.live = true;
  }
  if (keys.has("blend_weight")) {
    if (o.blend.empty()) return keys.invalid("blend_weight", "needs blend");
    PENUMBRA_ASSIGN(fraction, keys.number("blend_weight"));
    if (!(fraction >= 0 && fraction <= 1))
      return keys.invalid("blend_weight", "is not within 0..1");
    o.blend_weight = fraction;
  }
  if (keys.has("transfer_ms")) {
    if (!o.live) return keys.invalid("transfer_ms", "needs transfer = \"live\" or blend");
    PENUMBRA_ASSIGN(ms, keys.number("transfer_ms"));
    if (!(ms > 0 && ms <= 1000))
      return keys.invalid("transfer_ms", "is not above 0 and at most 1000");
    o.transfer_ms = ms;
  }
  return {};
}

Result<SceneObject> read_object(const TomlKeys& keys, const fs::path& folder) {
  PENUMBRA_TRY(keys.only(kObjectKeys));
  SceneObject o;
  PENUMBRA_ASSIGN(asset, keys.text("asset"));
  if (asset.starts_with("builtin:") &&
      std::ranges::find(kBuiltinAssets, asset) == kBuiltinAssets.end()) {
    const auto near = nearest_word(asset, kBuiltinAssets);
    return keys.invalid("asset",
                        near ? fmt::format("{} is not built in: did you mean {}?", asset, *near)
                             : fmt::format("{} is not built in", asset));
  }
  o.asset = resolve(asset, folder);
  if (keys.has("name")) {
    PENUMBRA_ASSIGN(name, keys.text("name"));
    if (name.empty()) return keys.invalid("name", "is empty");
    o.name = name;
  }
  if (keys.has("albedo")) {
    PENUMBRA_ASSIGN(albedo, read_albedo(keys));
    o.albedo = albedo;
  }
  PENUMBRA_TRY(read_placement(keys, o));
  if (keys.has("max_vertices")) {
    constexpr int kFewest = 1'000, kMost = 10'000'000;
    PENUMBRA_ASSIGN(count, keys.integer("max_vertices", kFewest, kMost));
    o.max_vertices = count;
  }
  if (keys.has("spin_rpm")) {
    PENUMBRA_ASSIGN(spin, keys.number("spin_rpm"));
    if (!(std::abs(spin) <= kFastest_rpm))
      return keys.invalid("spin_rpm", fmt::format("is not within -{0}..{0}", kFastest_rpm));
    o.spin_rpm = spin;
  }
  if (keys.has("visible")) {
    PENUMBRA_ASSIGN(visible, keys.flag("visible"));
    o.visible = visible;
  }
  if (keys.has("emission_lights")) {
    PENUMBRA_ASSIGN(lights, keys.flag("emission_lights"));
    o.emission_lights = lights;
  }
  if (keys.has("animation")) {
    PENUMBRA_ASSIGN(animation, keys.text("animation"));
    if (animation.empty()) return keys.invalid("animation", "is empty: name a clip of the asset");
    o.animation = animation;
  }
  for (const std::string_view key :
       {"transfer", "light_map", "blend", "blend_weight", "transfer_ms"})
    if (keys.has(key) && o.animation.empty()) return keys.invalid(key, "needs animation");
  if (keys.has("transfer")) {
    PENUMBRA_ASSIGN(transfer, keys.text("transfer"));
    o.live = transfer == "live";
    if (keys.has("light_map"))
      return keys.invalid("light_map",
                          o.live ? "excludes transfer = \"live\", which is kept at vertices"
                                 : "is part of the transfer file: leave it out");
    if (!o.live) o.transfer = resolve(transfer, folder);
  }
  PENUMBRA_TRY(read_blend(keys, o));
  if (keys.has("light_map")) {
    PENUMBRA_ASSIGN(size, keys.numbers("light_map", 2));
    for (std::size_t i = 0; i < 2; ++i) {
      if (!(size[i] >= 8 && size[i] <= 4096 && size[i] == std::floor(size[i])))
        return keys.invalid("light_map", "is not two whole numbers within 8..4096");
      o.light_map[i] = static_cast<int>(size[i]);
    }
  }
  return o;
}

Result<RealGeometry> read_real(const fs::path& path, const toml::table& table,
                               const fs::path& folder) {
  const TomlKeys keys(path, table);
  PENUMBRA_TRY(keys.only(kRealKeys));
  RealGeometry real;
  if (keys.has("plane") + keys.has("mesh") + keys.has("depth") != 1)
    return keys.invalid("plane", "exactly one of plane, mesh and depth is needed");
  if (keys.has("depth") != keys.has("camera"))
    return keys.invalid("depth", "needs camera, and camera needs depth");
  for (const std::string_view key : kPlacementKeys)
    if (keys.has(key) && !keys.has("mesh"))
      return keys.invalid(key, "needs mesh: planes and depth pictures are not moved");
  if (keys.has("albedo")) {
    PENUMBRA_ASSIGN(albedo, read_albedo(keys));
    real.albedo = albedo;
  }
  if (keys.has("mesh")) {
    PENUMBRA_ASSIGN(mesh, keys.text("mesh"));
    real.mesh = resolve(mesh, folder);
    PENUMBRA_TRY(read_placement(keys, real));
    return real;
  }
  if (keys.has("depth")) {
    PENUMBRA_ASSIGN(depth, keys.text("depth"));
    PENUMBRA_ASSIGN(camera, keys.text("camera"));
    real.depth = resolve(depth, folder);
    real.camera = resolve(camera, folder);
    return real;
  }
  const toml::table* plane = table["plane"].as_table();
  if (!plane)
    return keys.invalid("plane", "is not a table { point = [x, y, z], normal = [x, y, z] }");
  const TomlKeys plane_keys(path, *plane);
  constexpr std::string_view known[] = {"point", "normal"};
  PENUMBRA_TRY(plane_keys.only(known));
  PENUMBRA_ASSIGN(p, read_point(plane_keys, "point"));
  PENUMBRA_ASSIGN(n, plane_keys.numbers("normal", 3));
  const glm::dvec3 normal(n[0], n[1], n[2]);
  if (!(glm::length(normal) >= 1e-6 && glm::length(normal) < 1e100))
    return plane_keys.invalid("normal", "is a vector without length");
  real.plane = RealPlane{p, glm::normalize(normal)};
  return real;
}

Result<shadows::Lamp> read_lamp(const TomlKeys& keys) {
  constexpr std::string_view known[] = {"position", "radius_m", "irradiance_at_1m"};
  PENUMBRA_TRY(keys.only(known));
  shadows::Lamp lamp;
  PENUMBRA_ASSIGN(p, read_point(keys, "position"));
  lamp.position = p;
  if (keys.has("radius_m")) {
    PENUMBRA_ASSIGN(radius, keys.number("radius_m"));
    if (radius < 0 || radius > 10) return keys.invalid("radius_m", "is not within 0..10 m");
    lamp.radius_m = radius;
  }
  PENUMBRA_ASSIGN(e, keys.numbers("irradiance_at_1m", 3));
  for (const double c : e)
    if (c < 0 || c > 1e9)
      return keys.invalid("irradiance_at_1m", "has a number that is not within 0..1e9");
  lamp.irradiance_at_1m = {static_cast<float>(e[0]), static_cast<float>(e[1]),
                           static_cast<float>(e[2])};
  return lamp;
}

Result<lighting::SunSite> read_sun(const TomlKeys& keys) {
  using namespace std::chrono;
  constexpr std::string_view known[] = {"latitude_deg", "longitude_deg", "north_deg", "time"};
  PENUMBRA_TRY(keys.only(known));
  lighting::SunSite sun;
  PENUMBRA_ASSIGN(latitude, keys.number("latitude_deg"));
  PENUMBRA_ASSIGN(longitude, keys.number("longitude_deg"));
  if (std::abs(latitude) > 90) return keys.invalid("latitude_deg", "is not within -90..90");
  if (std::abs(longitude) > 180) return keys.invalid("longitude_deg", "is not within -180..180");
  sun.latitude_deg = latitude, sun.longitude_deg = longitude;
  if (keys.has("north_deg")) {
    PENUMBRA_ASSIGN(north, keys.number("north_deg"));
    if (std::abs(north) > 360) return keys.invalid("north_deg", "is not within -360..360");
    sun.north_deg = north;
  }
  if (keys.has("time")) {
    PENUMBRA_ASSIGN(time, keys.time("time"));
    if (time < sys_days{1999y / 1 / 1} || time >= sys_days{2051y / 1 / 1})
      return keys.invalid("time", "is not within the years 1999 to 2050");
    sun.time = time;
  }
  return sun;
}

std::string print_sun(const lighting::SunSite& sun) {
  std::string text = fmt::format("\n[sun]\nlatitude_deg = {}\nlongitude_deg = {}\nnorth_deg = {}\n",
                                 sun.latitude_deg, sun.longitude_deg, sun.north_deg);
  if (!sun.time) return text;
  using namespace std::chrono;
  const auto day = floor<days>(*sun.time);
  const year_month_day date(day);
  const hh_mm_ss clock(*sun.time - day);
  return text + fmt::format("time = {:04}-{:02}-{:02}T{:02}:{:02}:{:02}Z\n", int(date.year()),
                            unsigned(date.month()), unsigned(date.day()), clock.hours().count(),
                            clock.minutes().count(), clock.seconds().count());
}

bool has_object(const Scene& scene, const std::string& name) {
  return std::ranges::find(scene.objects, name, &SceneObject::name) != scene.objects.end();
}

// Objects without a name are called by their files, and counted.
void name_the_rest(Scene& scene) {
  for (SceneObject& o : scene.objects) {
    if (!o.name.empty()) continue;
    const std::string stem = fs::path(o.asset).stem().string();
    std::string name = stem;
    for (int n = 2; has_object(scene, name); ++n) name = fmt::format("{} {}", stem, n);
    o.name = name;
  }
}

}  // namespace

Result<Scene> read_scene(const fs::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml(path));
  const TomlKeys keys(path, root);
  constexpr std::string_view known[] = {"version", "object", "real", "lamp", "sun"};
  PENUMBRA_TRY(keys.only(known));
  PENUMBRA_TRY(keys.version(1));
  const fs::path folder = path.parent_path();
  Scene scene;
  PENUMBRA_ASSIGN(objects, keys.tables("object"));
  for (const toml::table* table : objects) {
    const TomlKeys object_keys(path, *table);
    PENUMBRA_ASSIGN(object, read_object(object_keys, folder));
    if (!object.name.empty() && has_object(scene, object.name))
      return object_keys.invalid("name", fmt::format("{} is another object's", object.name));
    scene.objects.push_back(object);
  }
  name_the_rest(scene);
  PENUMBRA_ASSIGN(reals, keys.tables("real"));
  for (const toml::table* table : reals) {
    PENUMBRA_ASSIGN(real, read_real(path, *table, folder));
    scene.real.push_back(real);
  }
  PENUMBRA_ASSIGN(lamps, keys.tables("lamp"));
  for (const toml::table* table : lamps) {
    PENUMBRA_ASSIGN(lamp, read_lamp(TomlKeys(path, *table)));
    scene.lamps.push_back(lamp);
  }
  if (keys.has("sun")) {
    PENUMBRA_ASSIGN(table, keys.table("sun"));
    PENUMBRA_ASSIGN(sun, read_sun(table));
    scene.sun = sun;
  }
  return scene;
}

Result<void> write_scene(const fs::path& path, const Scene& scene) {
  const auto absolute = [](const std::string& file) {
    return file.starts_with("builtin:") ? file : fs::absolute(file).lexically_normal().string();
  };
  std::string text = "version = 1\n";
  const auto list = [](const auto&... v) {
    return fmt::format("[{}]", fmt::join(std::array{double(v)...}, ", "));
  };
  const auto placed = [&](const Placement& p) {
    const glm::dquat& r = p.rotation;
    return fmt::format("position = {}\nrotation = {}\n{}\n",
                       list(p.position.x, p.position.y, p.position.z), list(r.x, r.y, r.z, r.w),
                       p.place_on_floor ? fmt::format("fit_size_m = {}", p.fit_size_m)
                                        : fmt::format("scale = {}", p.scale));
  };
  for (const SceneObject& o : scene.objects) {
    text += fmt::format("\n[[object]]\nname = {}\nasset = {}\nalbedo = {}\n", toml_quoted(o.name),
                        toml_quoted(absolute(o.asset)), list(o.albedo.r, o.albedo.g, o.albedo.b));
    text += placed(o);
    if (!o.animation.empty()) text += fmt::format("animation = {}\n", toml_quoted(o.animation));
    if (!o.transfer.empty())
      text += fmt::format("transfer = {}\n", toml_quoted(absolute(o.transfer)));
    if (o.live) text += fmt::format("transfer = \"live\"\ntransfer_ms = {}\n", o.transfer_ms);
    if (!o.blend.empty())
      text += fmt::format("blend = {}\nblend_weight = {}\n", toml_quoted(o.blend), o.blend_weight);
    if (o.light_map[0] > 0)
      text += fmt::format("light_map = [{}, {}]\n", o.light_map[0], o.light_map[1]);
    if (o.spin_rpm != 0) text += fmt::format("spin_rpm = {}\n", o.spin_rpm);
    if (o.max_vertices != 0) text += fmt::format("max_vertices = {}\n", o.max_vertices);
    if (!o.visible) text += "visible = false\n";
    if (o.emission_lights) text += "emission_lights = true\n";
  }
  for (const RealGeometry& r : scene.real) {
    text += "\n[[real]]\n";
    if (r.plane) {
      const auto &p = r.plane->point, &n = r.plane->normal;
      text += fmt::format("plane = {{ point = {}, normal = {} }}\n", list(p.x, p.y, p.z),
                          list(n.x, n.y, n.z));
    } else if (!r.depth.empty()) {
      text += fmt::format("depth = {}\ncamera = {}\n", toml_quoted(absolute(r.depth)),
                          toml_quoted(absolute(r.camera)));
    } else {
      text += fmt::format("mesh = {}\n", toml_quoted(absolute(r.mesh))) + placed(r);
    }
    if (r.albedo) text += fmt::format("albedo = {}\n", list(r.albedo->r, r.albedo->g, r.albedo->b));
  }
  for (const shadows::Lamp& l : scene.lamps) {
    const Rgb& e = l.irradiance_at_1m;
    text += fmt::format("\n[[lamp]]\nposition = {}\nradius_m = {}\nirradiance_at_1m = {}\n",
                        list(l.position.x, l.position.y, l.position.z), l.radius_m,
                        list(e.r, e.g, e.b));
  }
  if (scene.sun) text += print_sun(*scene.sun);
  return write_bytes(path, text);
}

}  // namespace penumbra::runtime
