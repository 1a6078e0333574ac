#include "runtime/scene/scene.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <glm/gtx/quaternion.hpp>
#include <limits>

#include "core/conventions.h"
#include "core/io/log.h"
#include "prt/bake/baked_file.h"
#include "prt/geometry/ground_grid.h"
#include "prt/geometry/masked.h"
#include "prt/geometry/receiver.h"
#include "prt/rays/fine_form.h"
#include "runtime/scene/animated.h"
#include "runtime/scene/bake_cache.h"
#include "runtime/scene/depth_mesh.h"
#include "runtime/scene/internal/standing.h"

namespace penumbra::runtime {

namespace {

// A square column twisted by a third of a turn, rounded by its own normals: shows its rotation.
prt::Mesh make_twist(int quads, Rgb albedo) {
  prt::Mesh mesh = prt::make_box({-.13f, 0, -.13f}, {.13f, .62f, .13f}, quads, albedo);
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    glm::vec3 &p = mesh.positions[i], &n = mesh.normals[i];
    constexpr float kTurn = 2.1f / .62f;  // radians a metre
    const float a = kTurn * p.y, c = std::cos(a), s = std::sin(a);
    // Inverse transpose of the twist's Jacobian: the normal leans by the slope of the turned wall.
    const float slope = kTurn * (p.x * n.z - p.z * n.x);
    const glm::vec3 turned(c * n.x + s * n.z, n.y + slope, -s * n.x + c * n.z);
    p = {c * p.x + s * p.z, p.y, -s * p.x + c * p.z};
    n = glm::normalize(turned);
  }
  return mesh;
}

}  // namespace

Pose frame_on_plane(const prt::Plane& plane, const glm::dvec3& position) {
  const glm::dquat up = glm::rotation(glm::dvec3(0, 1, 0), plane.normal);
  const double height = glm::dot(position - plane.point, plane.normal);
  return {up, position - height * plane.normal};
}

const prt::Plane* plane_under(const std::vector<prt::Plane>& planes, const prt::Bounds& bounds) {
  constexpr double kBelow = 1e-3;  // metres: what lies flat on it stands on it
  const prt::Plane* best = nullptr;
  double nearest = HUGE_VAL;
  const glm::dvec3 centre(bounds.centre()), half(.5f * (bounds.high - bounds.low));
  for (const prt::Plane& plane : planes) {
    const double d = glm::dot(centre - plane.point, plane.normal),
                 rise = glm::dot(half, glm::abs(plane.normal));  // of its highest corner
    if (d + rise >= -kBelow && std::abs(d) < nearest) nearest = std::abs(d), best = &plane;
  }
  return best;
}

namespace {

// A file that is baked already stands on the plane that it was baked on; transfer has no length, so
// scaling and shifting its frame is all.
Result<PreparedObject> place_baked(const SceneObject& o, const prt::Plane* plane) {
  PENUMBRA_ASSIGN(read, prt::read_baked(o.asset));
  prt::BakedObject baked = prt::on_floor(read, plane ? plane->albedo : Rgb{});
  const prt::Bounds b = bounds_of(baked.mesh);
  const glm::vec3 size = b.high - b.low;
  const double scale =
      o.place_on_floor ? o.fit_size_m / std::max({size.x, size.y, size.z, 1e-9f}) : o.scale;
  glm::dvec3 shift(0);
  if (o.place_on_floor) shift = -glm::dvec3(b.centre().x, b.low.y, b.centre().z);
  if (baked.receiver) shift.y = -double(baked.receiver->grid.height);
  put_in_place(baked, scale, shift);
  if (!plane) baked.receiver.reset();  // nothing there to take the shadow
  const Pose frame = plane ? frame_on_plane(*plane, o.position) : Pose{{1, 0, 0, 0}, o.position};
  const glm::dvec3 up = glm::conjugate(frame.rotation) * (o.rotation * glm::dvec3(0, 1, 0));
  if (plane && up.y < .9999)
    return fail(ErrorCode::kInvalid, o.name,
                "is baked upright and cannot be tilted: use the mesh that it was baked from");
  return PreparedObject{o.name, std::move(baked), Pose{o.rotation, frame.translation}, o.spin_rpm,
                        nullptr};
}

// The plane under a mesh where it is placed; null: there is none.
const prt::Plane* plane_below(const SceneObject& o, const prt::Mesh& mesh,
                              const std::vector<prt::Plane>& planes) {
  prt::Mesh in_world = mesh;
  prt::transform(in_world, world_from_mesh(o, mesh, floor_normal(planes, o.position)));
  return plane_under(planes, bounds_of(in_world));
}

std::shared_ptr<const prt::SurfaceMaterials> turned(
    const std::shared_ptr<const prt::SurfaceMaterials>& surface, const glm::mat3& turn) {
  if (!surface || surface->tangents.empty()) return surface;
  auto out = std::make_shared<prt::SurfaceMaterials>(*surface);
  for (glm::vec4& t : out->tangents) t = glm::vec4(turn * glm::vec3(t), t.w);
  return out;
}

void tell_unit(const SceneObject& o, const prt::Mesh& mesh) {
  const float unit = prt::likely_unit_m(mesh);
  if (unit == 1 || o.place_on_floor || o.scale != 1) return;
  log_warning(
      "{}: has a radius of {:.0f} m, so its file is likely in {}: give scale = {} or "
      "fit_size_m",
      o.name, prt::radius_of(mesh), unit < .01f ? "millimetres" : "centimetres", unit);
}

std::shared_ptr<const prt::FineForm> placed(const std::shared_ptr<const prt::FineForm>& fine,
                                            const glm::dmat4& place, const glm::mat3& turn) {
  if (!fine) return fine;
  prt::FineForm out = *fine;
  prt::transform(out.mesh, place);
  out.surface = turned(out.surface, turn);
  return std::make_shared<const prt::FineForm>(std::move(out));
}

Result<PreparedObject> prepare_object(const SceneObject& o, const PreparedScene& scene,
                                      const BakeSettings& settings, AssetBakes& bakes,
                                      const std::function<void(double)>& progress) {
  if (!o.animation.empty()) return prepare_animated(o, scene.planes, settings, progress);
  if (!o.asset.starts_with("builtin:") && prt::is_baked_file(o.asset))
    return place_baked(o,
                       plane_under(scene.planes, {glm::vec3(o.position), glm::vec3(o.position)}));
  const auto asked = static_cast<std::size_t>(o.max_vertices);
  const std::size_t max_vertices = asked == 0 ? settings.max_vertices
                                   : o.coarse ? std::min(asked, settings.max_vertices)
                                              : asked;
  PENUMBRA_ASSIGN(asset, load_asset(o.asset, o.albedo, settings.max_edge_fraction, max_vertices));
  auto& [mesh, surface, fine] = asset;
  const prt::Mesh& seen = fine ? fine->mesh : mesh;
  tell_unit(o, seen);
  const prt::Plane* const plane = plane_below(o, seen, scene.planes);
  const Standing standing = standing_of(o, seen, plane);
  if (standing.tilt != glm::dquat(1, 0, 0, 0)) {
    const glm::dmat4 tilt(glm::mat3_cast(standing.tilt));
    const glm::mat3 turn = glm::mat3_cast(glm::quat(standing.tilt));
    prt::transform(mesh, tilt);
    surface = turned(surface, turn);
    fine = placed(fine, tilt, turn);
  }
  prt::BakeOptions options;
  options.bands = settings.bands;
  options.bounces = settings.bounces;
  options.rays = settings.rays;
  options.ground_rays = settings.ground_rays;
  options.visibility = settings.visibility;
  options.progress = progress;
  options.floor_apart = true;
  if (plane) options.receiver = prt::Receiver{prt::fit_ground_grid(mesh, standing.height), {}};
  PENUMBRA_ASSIGN(baked,
                  bakes.get(o.name, std::move(mesh), options, plane ? plane->albedo : Rgb{}));
  baked.surface = surface;
  baked.fine = fine;
  put_in_place(baked, standing.scale, standing.shift);
  return PreparedObject{o.name, std::move(baked), standing.world_from_bake, o.spin_rpm, nullptr};
}

}  // namespace

glm::dmat4 world_from_mesh(const Placement& p, const prt::Mesh& mesh, const glm::dvec3& up) {
  Pose pose{p.rotation, p.position};
  double scale = p.scale;
  glm::dvec3 shift(0);
  if (p.place_on_floor) {
    const prt::Bounds b = bounds_of(mesh);
    const glm::dvec3 size(b.high - b.low), centre(b.centre());
    scale = p.fit_size_m / std::max({size.x, size.y, size.z, 1e-9});
    // Upright its lowest point is known; turned, each vertex may be it.
    const glm::dvec3 own_up = glm::conjugate(p.rotation) * up;
    if (own_up.y > 1 - 1e-12) {
      shift = -glm::dvec3(centre.x, b.low.y, centre.z);
    } else {
      double lowest = HUGE_VAL;
      for (const glm::vec3& v : mesh.positions)
        lowest = std::min(lowest, glm::dot(glm::dvec3(v) - centre, own_up));
      shift = -centre - lowest * own_up;
    }
  }
  return pose.matrix() * glm::dmat4(glm::dmat3(scale)) *
         glm::dmat4(glm::dvec4(1, 0, 0, 0), glm::dvec4(0, 1, 0, 0), glm::dvec4(0, 0, 1, 0),
                    glm::dvec4(shift, 1));
}

glm::dvec3 floor_normal(const std::vector<prt::Plane>& planes, const glm::dvec3& position) {
  const prt::Plane* const plane = plane_under(planes, {glm::vec3(position), glm::vec3(position)});
  return plane ? plane->normal : glm::dvec3(0, 1, 0);
}

Pose PreparedObject::pose_at(double seconds) const {
  if (spin_rpm == 0) return world_from_bake;
  const double turn = 2 * kPi * spin_rpm / 60 * seconds;
  return world_from_bake * Pose{glm::angleAxis(turn, glm::dvec3(0, 1, 0)), {0, 0, 0}};
}

namespace {

void add_roughness(const prt::Material& m, lighting::SurfaceRoughness& out) {
  if (m.unlit) return;
  if (m.clearcoat > 0) out.add(m.clearcoat_roughness);
  if (!m.metallic_roughness_map) return out.add(m.roughness);
  const auto codes = m.metallic_roughness_map.picture->codes.pixels();
  const auto [low, high] = std::ranges::minmax(codes, {}, &prt::Rgba8::g);
  constexpr float kUnit = 1.f / 255;
  out.add_range(m.roughness * kUnit * static_cast<float>(low.g),
                m.roughness * kUnit * static_cast<float>(high.g));
}

}  // namespace

lighting::SurfaceRoughness mirrored_roughness(const PreparedScene& scene) {
  lighting::SurfaceRoughness out;
  for (const PreparedObject& o : scene.objects)
    if (o.baked.surface)
      for (const prt::Material& m : o.baked.surface->materials) add_roughness(m, out);
  return out;
}

namespace {

// Few vertices that are lit, of short edges.
struct CoarseMesh {
  prt::Mesh mesh;
  std::shared_ptr<const prt::SurfaceMaterials> surface;
  float error;
};
CoarseMesh coarse_of(const LoadedAsset& asset, float edge_fraction, std::size_t max_vertices) {
  prt::Simplified few = prt::simplify(asset.mesh, max_vertices / 3);
  const auto middles =
      prt::subdivide(few.mesh, edge_fraction * prt::radius_of(few.mesh), 2 * max_vertices);
  CoarseMesh out{std::move(few.mesh), nullptr, few.error};
  if (!asset.surface) return out;
  prt::SurfaceMaterials surface = prt::picked(*asset.surface, few.from);
  surface.extend(middles);
  out.surface = std::make_shared<const prt::SurfaceMaterials>(std::move(surface));
  return out;
}

Result<void> make_fine(const std::string& name, float edge_fraction, std::size_t max_vertices,
                       LoadedAsset& asset) {
  CoarseMesh coarse = coarse_of(asset, edge_fraction, max_vertices);
  log_info("{}: {} vertices are drawn, and lit from {}, which are off by {:.2g} % of its size",
           name, asset.mesh.positions.size(), coarse.mesh.positions.size(), 100 * coarse.error);
  PENUMBRA_ASSIGN(fine, prt::lit_by(std::move(asset.mesh), coarse.mesh));
  fine.surface = std::move(asset.surface);
  asset = {std::move(coarse.mesh), std::move(coarse.surface),
           std::make_shared<const prt::FineForm>(std::move(fine))};
  return {};
}

bool is_gltf_name(const std::string& asset) {
  const std::string suffix = std::filesystem::path(asset).extension().string();
  return suffix == ".glb" || suffix == ".gltf";
}

}  // namespace

Result<LoadedAsset> load_asset(const std::string& asset, Rgb albedo, float edge_fraction,
                               std::size_t max_vertices) {
  LoadedAsset out;
  prt::Mesh& mesh = out.mesh;
  const int subdivision =
      edge_fraction > .05f ? 1 : 2;  // of shapes that are made as finely as asked
  if (asset.empty()) return fail(ErrorCode::kInvalid, "asset", "is an empty name");
  if (asset == "builtin:knot") {
    mesh = prt::make_knot(.5f, 240 * subdivision, 40 * subdivision, albedo);
  } else if (asset == "builtin:twist") {
    mesh = make_twist(14 * subdivision, albedo);
  } else if (asset == "builtin:ball") {
    mesh = prt::make_sphere({0, .2f, 0}, .2f, 3 + subdivision, albedo);
    return out;  // cut edges leave the sphere
  } else if (asset == "builtin:box") {
    mesh = prt::make_box({-.17f, 0, -.13f}, {.17f, .4f, .13f}, 1, albedo);
  } else if (asset == "builtin:walker") {
    const prt::Character walker = prt::make_walker(albedo);
    prt::deform(walker, prt::rest_pose(walker), mesh);
  } else if (asset.starts_with("builtin:")) {
    return fail(
        ErrorCode::kNotFound, asset,
        fmt::format("is not a built-in asset, which are {}", fmt::join(kBuiltinAssets, ", ")));
  } else {
    PENUMBRA_ASSIGN(imported, prt::import_mesh(asset, albedo));
    if (imported.degenerate_triangles > 0)
      log_warning("{}: {} degenerate triangles are left out", asset, imported.degenerate_triangles);
    for (const std::string& line : imported.left_out) log_warning("{}: {}", asset, line);
    mesh = std::move(imported.mesh);
    out.surface = std::move(imported.surface);
    // A real room rightly faces inwards, and glTF says which way its triangles face.
    if (edge_fraction > 0 && !is_gltf_name(asset) && prt::turn_outwards(mesh))
      log_warning("{}: its triangles face inwards, and are turned round", asset);
  }
  std::shared_ptr<prt::SurfaceMaterials> materials;
  if (out.surface) {
    materials = std::make_shared<prt::SurfaceMaterials>(*out.surface);
    constexpr float kMaskEdge = .01f;  // of the radius: how finely light goes through holes
    prt::cut_masked_away(mesh, *materials, kMaskEdge * prt::radius_of(mesh));
    if (mesh.triangles.empty())
      return fail(ErrorCode::kInvalid, asset, "is masked away as a whole");
    out.surface = materials;
  }
  if (!(edge_fraction > 0)) return out;
  if (mesh.positions.size() > max_vertices) {
    PENUMBRA_TRY(make_fine(asset, edge_fraction, max_vertices, out));
    return out;
  }
  const auto middles = prt::subdivide(mesh, edge_fraction * prt::radius_of(mesh), 4 * max_vertices);
  if (materials) materials->extend(middles);
  return out;
}

namespace {

void find_luminous(PreparedObject& object) {
  constexpr int kPoints = 64;
  if (object.baked.surface)
    object.luminous = prt::luminous_parts(object.baked.mesh, *object.baked.surface, kPoints);
  if (object.luminous.empty())
    log_warning("{}: emission_lights: no material of it emits light, unlit ones apart",
                object.name);
}

// Each costs as much as a lamp with many rays. Of equal ones the first stay.
void keep_strongest_luminous(PreparedScene& scene) {
  constexpr std::size_t kMost = 16;
  std::vector<float> powers;
  for (const PreparedObject& o : scene.objects)
    for (const prt::LuminousPart& p : o.luminous) powers.push_back(luminance(p.emission_m2));
  if (powers.size() <= kMost) return;
  const auto weakest = powers.begin() + kMost - 1;
  std::ranges::nth_element(powers, weakest, std::greater<>());
  const float limit = *weakest;
  auto equal_left = static_cast<std::size_t>(std::count(powers.begin(), weakest + 1, limit));
  const auto is_too_weak = [&](const prt::LuminousPart& p) {
    const float power = luminance(p.emission_m2);
    if (power != limit) return power < limit;
    return equal_left == 0 || (--equal_left, false);
  };
  for (PreparedObject& o : scene.objects) {
    std::vector<prt::LuminousPart> kept;
    for (prt::LuminousPart& p : o.luminous)
      if (is_too_weak(p))
        log_warning(
            "{}: material {}: its emission lights nothing: {} others of the scene are "
            "as strong or stronger",
            o.name, p.material, kMost);
      else
        kept.push_back(std::move(p));
    o.luminous = std::move(kept);
  }
}

// Shadows on real meshes live at their vertices.
void prepare_receivers(PreparedScene& scene) {
  constexpr float kReceiverEdge = .08f;  // of the smallest object's radius
  constexpr std::size_t kMaxTriangles = 150'000;
  float smallest = std::numeric_limits<float>::max();
  for (const PreparedObject& o : scene.objects)
    smallest = std::min(smallest, prt::radius_of(o.baked.mesh));
  prt::subdivide(scene.real_mesh, kReceiverEdge * smallest, kMaxTriangles);
}

// What real things hide from and reflect onto each other and the floor: few rays, it is a fraction
// of what objects take.
Result<void> bake_real(PreparedScene& scene, const BakeSettings& settings,
                       const std::function<void(double)>& progress) {
  constexpr int kMaxRays = 1024, kMaxBounces = 2;
  prt::Mesh mesh = scene.real_mesh;
  const prt::Bounds bounds = prt::bounds_of(mesh);
  PreparedReal out;
  const prt::Plane* plane = plane_under(scene.planes, bounds);
  if (plane) out.world_from_bake = frame_on_plane(*plane, glm::dvec3(bounds.centre()));
  prt::transform(mesh, out.world_from_bake.inverse().matrix());
  prt::BakeOptions options;
  options.bands = settings.bands;
  options.bounces = std::min(settings.bounces, kMaxBounces);
  options.rays = std::min(settings.rays, kMaxRays);
  options.ground_rays = settings.ground_rays;
  options.progress = progress;
  if (plane) options.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0), plane->albedo};
  PENUMBRA_ASSIGN(baked, bake_or_recall("real geometry", std::move(mesh), options, settings.cache));
  out.baked = std::move(baked);
  scene.real = std::make_shared<const PreparedReal>(std::move(out));
  return {};
}

}  // namespace

Result<PreparedScene> prepare(
    const Scene& scene, const BakeSettings& settings,
    const std::function<std::function<void(double)>(const std::string&)>& progress) {
  PreparedScene out;
  out.lamps = scene.lamps;
  out.sun = scene.sun;
  for (const RealGeometry& real : scene.real) {
    if (real.plane) {
      // Without a known albedo the floor's reflection on the object is unknown and left out.
      out.planes.push_back(
          {real.plane->point, real.plane->normal, real.albedo.value_or(Rgb{}), {}});
      continue;
    }
    const Rgb albedo = real.albedo.value_or(Rgb{.5f, .5f, .5f});
    prt::Mesh mesh;
    if (real.depth.empty()) {
      PENUMBRA_ASSIGN(asset, load_asset(real.mesh, albedo, 0));
      mesh = std::move(asset.mesh);
    } else {
      PENUMBRA_ASSIGN(seen, read_depth_mesh(real.depth, real.camera, albedo));
      mesh = std::move(seen);
    }
    if (real.depth.empty()) prt::transform(mesh, world_from_mesh(real, mesh));
    append(out.real_mesh, mesh);
  }
  AssetBakes bakes(settings.cache);
  BakeSettings coarse = BakeSettings::coarse();
  coarse.bands = settings.bands;
  for (const SceneObject& object : scene.objects) {
    PENUMBRA_ASSIGN(prepared, prepare_object(object, out, object.coarse ? coarse : settings, bakes,
                                             progress("bake " + object.name)));
    prepared.visible = object.visible;
    if (object.emission_lights) find_luminous(prepared);
    prepared.instance = object.instance;
    out.objects.push_back(std::move(prepared));
  }
  keep_strongest_luminous(out);
  if (out.real_mesh.triangles.empty() || out.objects.empty()) return out;
  prepare_receivers(out);
  PENUMBRA_TRY(bake_real(out, settings, progress("bake real geometry")));
  return out;
}

prt::Mesh world_mesh(const PreparedScene& scene, bool with_objects, double seconds) {
  prt::Mesh all = scene.real_mesh;
  if (!with_objects) return all;
  for (const PreparedObject& o : scene.objects) {
    if (!o.visible) continue;
    prt::Mesh mesh = o.mesh_at(seconds);
    prt::transform(mesh, o.pose_at(seconds).matrix());
    append(all, mesh);
  }
  return all;
}

}  // namespace penumbra::runtime
