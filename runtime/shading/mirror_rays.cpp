#include "runtime/shading/mirror_rays.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

#include "compositor/projection.h"
#include "compositor/surroundings.h"
#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "lighting/reflections/ggx.h"
#include "prt/geometry/fine_form.h"
#include "prt/geometry/local_material.h"

namespace penumbra::runtime {

namespace {

using prt::RayWorld;
constexpr std::size_t kLanes = RayWorld::kPacket;
// From a surface, of an object's radius: smooth normals see the neighbouring facets otherwise.
constexpr float kOffset = .002f;
constexpr int kMaxTexelSamples = 16, kMaxStillSamples = 64;

const prt::Mesh& form_of(const prt::BakedObject& baked) {
  return baked.fine ? baked.fine->mesh : baked.mesh;
}
const prt::SurfaceMaterials* surface_of(const prt::BakedObject& baked) {
  return baked.fine ? baked.fine->surface.get() : baked.surface.get();
}

int samples_for(const prt::Material& m) {
  if (!compositor::mirrors_objects(m)) return 0;
  return m.roughness <= .1f ? 1 : m.roughness <= .35f ? 4 : kMaxTexelSamples;
}

bool is_blended(const prt::Material& m) {
  return m.alpha == prt::Material::Alpha::kBlend || m.transmission > 0;
}

// Of `count` points that fill the unit square evenly: Fibonacci's lattice, in each pass moved by
// another one of Roberts' additive recurrence: within its strip, and around.
glm::vec2 square_point(int i, int count, int pass) {
  constexpr float kGolden = .618034f;
  const auto shift = [&](float step) { return static_cast<float>(pass) * step; };
  const auto fraction = [](float v) { return v - std::floor(v); };
  return {(static_cast<float>(i) + fraction(.5f + shift(.7548777f))) / static_cast<float>(count),
          fraction(static_cast<float>(i) * kGolden + shift(.5698403f))};
}

// Half way vector of a sample of the lobe, z along the normal: Walter et al. 2007, eq. 35.
glm::vec3 half_vector(float alpha, const glm::vec2& u) {
  constexpr float kFarthest = .999f;  // of the lobe's tail
  const float tangent =
                  alpha * std::sqrt(std::min(u.x, kFarthest) / (1 - std::min(u.x, kFarthest))),
              phi = 2 * static_cast<float>(kPi) * u.y;
  return glm::normalize(glm::vec3(tangent * std::cos(phi), tangent * std::sin(phi), 1));
}

glm::mat3 frame_of(const glm::vec3& n) {
  const glm::vec3 side = std::abs(n.y) < .9f ? glm::vec3(0, 1, 0) : glm::vec3(1, 0, 0),
                  x = glm::normalize(glm::cross(side, n));
  return {x, glm::cross(n, x), n};
}

struct LobeRay {
  glm::vec3 towards{0, 1, 0};
  float weight = 0;  // of all in the lobe; 0: it goes into the surface
};
// Of a sample by D n.h: Walter et al. 2007, eq. 41, without Fresnel's term. Weights are 1 in the
// mean where nothing is hidden from anything.
// half: way vector, z along the normal
LobeRay lobe_ray(const prt::LocalMaterial& m, const glm::vec3& view, float alpha,
                 const glm::vec3& half) {
  const glm::vec3 h = frame_of(m.normal) * half;
  const float v_dot_h = glm::dot(view, h), n_dot_v = glm::dot(m.normal, view);
  const glm::vec3 l = 2 * v_dot_h * h - view;
  const float n_dot_l = glm::dot(m.normal, l);
  // So that not-finite normals fail, too.
  if (!(n_dot_v > 0 && v_dot_h > 0 && n_dot_l > 0 && glm::dot(m.plain, l) > 0)) return {};
  const float weight = 4 * lighting::ggx_visibility(alpha, n_dot_l, n_dot_v) * n_dot_l * v_dot_h /
                       glm::dot(m.normal, h);
  return weight > 0 ? LobeRay{glm::normalize(l), weight} : LobeRay{};
}

struct EvenLight {
  Rgb fraction;    // that a surface mirrors
  float lobe = 1;  // the same in one bounce, were all facets perfect mirrors
};
// in: n_dot_v above 0
EvenLight mirrored_of_even(const prt::LocalMaterial& m, float n_dot_v) {
  const Image<glm::vec2>& table = lighting::reflected_of_even_table();
  const float last = static_cast<float>(table.width() - 1);
  const auto at = [&](float v) {
    return static_cast<int>(std::lround(last * std::clamp(v, 0.f, 1.f)));
  };
  const glm::vec2 even = table.at(at(n_dot_v), at(m.roughness));
  EvenLight out{{}, std::max(even.x + even.y, 1e-3f)};
  for (int c = 0; c < 3; ++c)
    out.fraction[c] = (m.reflectance[c] * even.x + m.grazing_reflectance * even.y) *
                      lighting::more_than_once(out.lobe, m.reflectance[c]);
  return out;
}

float alpha_of(float roughness) {
  return std::max(roughness * roughness, .0025f);
}

}  // namespace

// Up to sixteen rays on their way, each from one texel.
struct MirrorRays::Lanes {
  struct MetSurface {
    glm::vec3 at, view;  // view: towards where the ray came from
    prt::LocalMaterial material;
    std::size_t object = 0;
    bool mirrors = false;  // objects
    MetPlace place;        // without weight
  };
  std::array<bool, kLanes> active{};
  std::array<MetSurface, kLanes> surface{};
  std::array<MirrorChain, kLanes> chain{};
  std::array<Rgb, kLanes> weight{};          // of what comes along the ray
  std::array<std::size_t, kLanes> sample{};  // in MirrorRow::samples
  RayWorld::Rays rays;
  RayWorld::Hits hits;

  Lanes() {
    for (std::size_t i = 0; i < kLanes; ++i) send(i, {0, 0, 0}, {0, 0, 1});
  }
  bool any() const { return std::ranges::any_of(active, std::identity()); }
  void clear_hits() {
    std::fill_n(hits.mesh, kLanes, -1);
    for (std::size_t i = 0; i < kLanes; ++i) hits.distance[i] = active[i] ? 1e30f : -1.f;
  }
  void send(std::size_t i, const glm::vec3& from, const glm::vec3& to) {
    rays.ox[i] = from.x, rays.oy[i] = from.y, rays.oz[i] = from.z;
    rays.dx[i] = to.x, rays.dy[i] = to.y, rays.dz[i] = to.z;
  }
  glm::vec3 origin(std::size_t i) const { return {rays.ox[i], rays.oy[i], rays.oz[i]}; }
  glm::vec3 direction(std::size_t i) const { return {rays.dx[i], rays.dy[i], rays.dz[i]}; }
  void meet(std::size_t i, const PreparedScene& scene, std::span<const Pose> poses);
  void end(std::size_t i, MirrorRow& out) {
    out.chains.push_back(chain[i]);
    active[i] = false;
  }
};

void MirrorRays::Lanes::meet(std::size_t i, const PreparedScene& scene,
                             std::span<const Pose> poses) {
  MetSurface& s = surface[i];
  s.object = static_cast<std::size_t>(hits.mesh[i]);
  const prt::BakedObject& baked = scene.objects[s.object].baked;
  const prt::Mesh& mesh = form_of(baked);
  const auto& corners = mesh.triangles[hits.triangle[i]];
  const glm::mat3 turn(poses[s.object].rotation_matrix());
  const float u = hits.u[i], v = hits.v[i];
  s.at = origin(i) + hits.distance[i] * direction(i);
  s.view = -direction(i);
  if (const prt::SurfaceMaterials* materials = surface_of(baked)) {
    const glm::vec3 a = mesh.positions[corners[0]];
    const glm::vec3 across =
        turn * glm::cross(mesh.positions[corners[1]] - a, mesh.positions[corners[2]] - a);
    s.material = local_material(mesh, *materials, {corners, u, v, glm::dot(across, s.view) > 0});
    s.mirrors = compositor::mirrors_objects(materials->materials[materials->material[corners[0]]]);
  } else {
    const auto mix = [&](const auto& values) {
      return values[corners[0]] * (1 - u - v) + values[corners[1]] * u + values[corners[2]] * v;
    };
    s.material = {};
    s.material.diffuse = mix(mesh.albedo);
    s.material.plain = s.material.normal = glm::normalize(mix(mesh.normals));
    s.mirrors = false;
  }
  s.material.plain = turn * s.material.plain;
  s.material.normal = turn * s.material.normal;
  s.place = {{}, static_cast<std::uint16_t>(s.object), corners, u, v};
  if (!baked.fine) return;
  const std::size_t nearest = u + v < .5f ? 0 : u > v ? 1 : 2;
  const prt::FineForm::LitAt& lit = baked.fine->lit_at[corners[nearest]];
  s.place.corners = lit.corners, s.place.u = lit.u, s.place.v = lit.v;
}

int mirror_samples_of(const prt::BakedObject& baked) {
  int out = 0;
  if (const prt::SurfaceMaterials* const surface = surface_of(baked))
    for (const prt::Material& m : surface->materials) out = std::max(out, samples_for(m));
  return out;
}

Result<MirrorRays> MirrorRays::create(const PreparedScene& scene) {
  PENUMBRA_ASSIGN(world, RayWorld::create());
  MirrorRays out(scene, std::move(world));
  for (const PreparedObject& o : scene.objects) {
    PENUMBRA_TRY(out.world_.add(form_of(o.baked)));
    out.radii_.push_back(prt::radius_of(form_of(o.baked)));
    out.bounds_.push_back(prt::bounds_of(form_of(o.baked)));
    const prt::SurfaceMaterials* const surface = surface_of(o.baked);
    out.opaque_.push_back(!surface || !std::ranges::all_of(surface->material, [&](std::uint16_t m) {
      return is_blended(surface->materials[m]);
    }));
  }
  return out;
}

void MirrorRays::update_vertices(std::size_t object) {
  const prt::Mesh& form = form_of(scene_->objects[object].baked);
  world_.update_vertices(static_cast<int>(object), form);
  bounds_[object] = prt::bounds_of(form);
}

void MirrorRays::set_poses(std::span<const Pose> poses) {
  for (std::size_t i = 0; i < poses.size(); ++i) world_.set_pose(static_cast<int>(i), poses[i]);
}

void MirrorRays::intersect_all(const ViewOfObjects& seen, Lanes& lanes) const {
  lanes.clear_hits();
  for (std::size_t i = 0; i < scene_->objects.size(); ++i)
    if (seen.visible[i] && opaque_[i])
      world_.intersect(static_cast<int>(i), lanes.rays, lanes.hits);
}

// What the texels x to x + 15 see of the object at the place of a sample.
void MirrorRays::meet_first(const MirroredByObject& o, const ViewOfObjects& seen, int x, int y,
                            int sample, Lanes& lanes) const {
  const Pose& eye = seen.view.camera.world_from_camera;
  const glm::mat3 turn(eye.rotation_matrix());
  // Roberts' additive recurrence: other numbers than the lobe's, so that no side of a texel has its
  // narrow angles.
  const glm::dvec2 within(std::fmod(.5 + .7548777 * sample, 1.),
                          std::fmod(.5 + .5698403 * sample, 1.));
  for (std::size_t i = 0; i < kLanes; ++i) {
    const glm::dvec2 pixel =
        glm::dvec2(o.x0, o.y0) + double(o.step) * (glm::dvec2(x + static_cast<int>(i), y) + within);
    const auto direction = calib::direction_from_pixel(seen.camera, pixel);
    lanes.active[i] = direction.has_value();
    lanes.send(i, glm::vec3(eye.translation),
               turn * glm::vec3(direction.value_or(glm::dvec3(0, 0, -1))));
  }
  lanes.clear_hits();
  world_.intersect(static_cast<int>(o.object), lanes.rays, lanes.hits);
  for (std::size_t i = 0; i < kLanes; ++i) {
    lanes.active[i] = lanes.active[i] && lanes.hits.mesh[i] >= 0;
    if (!lanes.active[i]) continue;
    lanes.meet(i, *scene_, seen.poses);
    lanes.active[i] = lanes.surface[i].mirrors;
  }
}

// From what was met first, along a sample of each lobe, until something else is met.
void MirrorRays::send_first(const MirroredByObject& o, const ViewOfObjects& seen, std::size_t x,
                            int sample, const Lanes& first, Lanes& lanes, MirrorRow& out) const {
  for (std::size_t i = 0; i < kLanes; ++i) {
    lanes.active[i] = false;
    if (!first.active[i]) continue;
    const Lanes::MetSurface& s = first.surface[i];
    const float alpha = alpha_of(s.material.roughness);
    const glm::vec3 half =
        o.samples == 1 ? glm::vec3(0, 0, 1)
                       : half_vector(alpha, square_point(sample, o.samples, o.pass.value_or(0)));
    const auto [towards, weight] = lobe_ray(s.material, s.view, alpha, half);
    if (weight <= 0) continue;
    const auto column = static_cast<std::uint32_t>(x + i);
    const float part = alpha / std::sqrt(static_cast<float>(o.samples));
    lanes.active[i] = true;
    lanes.weight[i] = {weight, weight, weight};
    lanes.chain[i] = {};
    lanes.chain[i].column = column, lanes.chain[i].end_alpha = part;
    lanes.send(i, s.at + kOffset * radii_[s.object] * s.material.plain, towards);
    out.weights[column] += weight;
    lanes.sample[i] = out.samples.size();
    out.samples.push_back({column, false, weight, part, lanes.origin(i), towards});
  }
  intersect_all(seen, lanes);
  for (std::size_t i = 0; i < kLanes; ++i)
    if (lanes.active[i] && lanes.hits.mesh[i] < 0) {
      out.open[x + i] += lanes.weight[i].r;
      out.samples[lanes.sample[i]].open = true;
      lanes.active[i] = false;
    }
}

// What one ray has met adds its own light, and sends the ray on unless it is the last.
void MirrorRays::bounce(const LaterSamples& later, std::size_t i, bool last, Lanes& lanes,
                        MirrorRow& out) const {
  const Lanes::MetSurface& s = lanes.surface[i];
  const prt::LocalMaterial& m = s.material;
  MirrorChain& chain = lanes.chain[i];
  const float n_dot_v = glm::dot(m.normal, s.view);
  const bool is_seen = n_dot_v > 0;  // not finite: no
  last |= !s.mirrors || !is_seen;
  const auto [fraction, lobe] = mirrored_of_even(m, is_seen ? n_dot_v : 1e-3f);
  chain.emitted += lanes.weight[i] * m.emission;
  MetPlace place = s.place;
  place.weight = lanes.weight[i] * m.diffuse * (Rgb{1, 1, 1} - fraction);
  // What it mirrors beyond is about as bright as it is itself.
  if (last) place.weight += lanes.weight[i] * fraction * (m.diffuse + m.reflectance);
  chain.place[static_cast<std::size_t>(chain.places++)] = place;
  if (last) return lanes.end(i, out);
  LobeRay on{glm::normalize(glm::reflect(-s.view, m.normal)), lobe};
  float alpha = alpha_of(m.roughness);
  if (later.place) {
    on = lobe_ray(m, s.view, alpha, half_vector(alpha, *later.place));
    alpha /= std::sqrt(static_cast<float>(later.count));
  }
  if (on.weight <= 0) return lanes.end(i, out);  // into the surface
  lanes.weight[i] = lanes.weight[i] * fraction * (on.weight / lobe);
  chain.end_alpha = std::hypot(chain.end_alpha, alpha);
  lanes.send(i, s.at + kOffset * radii_[s.object] * m.plain, on.towards);
}

// Rays that have met something, on until they leave or have met enough.
void MirrorRays::follow(const LaterSamples& later, const ViewOfObjects& seen, Lanes& lanes,
                        MirrorRow& out) const {
  for (int hit = 1; lanes.any(); ++hit) {
    for (std::size_t i = 0; i < kLanes; ++i) {
      if (!lanes.active[i]) continue;
      if (lanes.hits.mesh[i] >= 0) {
        lanes.meet(i, *scene_, seen.poses);
        bounce(later, i, hit == MirrorChain::kMaxHits, lanes, out);
        continue;
      }
      MirrorChain& chain = lanes.chain[i];
      chain.end_weight = lanes.weight[i];
      chain.end_at = lanes.origin(i), chain.end_towards = lanes.direction(i);
      lanes.end(i, out);
    }
    if (lanes.any()) intersect_all(seen, lanes);
  }
}

void MirrorRays::trace_row(const MirroredByObject& o, const ViewOfObjects& seen, int y,
                           MirrorRow& out) const {
  Lanes first, lanes;
  for (std::size_t x = 0; x < out.weights.size(); x += kLanes)
    for (int k = 0; k < o.samples; ++k) {
      meet_first(o, seen, static_cast<int>(x), y, k, first);
      for (std::size_t i = out.weights.size() - x; i < kLanes; ++i) first.active[i] = false;
      if (!first.any()) continue;
      send_first(o, seen, x, k, first, lanes, out);
      LaterSamples later{{}, o.samples};
      // In another order than the first ones: 11 divides no number of samples but its multiples.
      const int stride = o.samples % 11 == 0 ? 7 : 11;
      if (o.pass && o.samples > 1)
        later.place = square_point((stride * k + 5) % o.samples, o.samples, *o.pass);
      follow(later, seen, lanes, out);
    }
  std::erase_if(out.samples, [&](const MirrorSample& s) {
    return out.open[s.column] == 0 || out.open[s.column] >= .999f * out.weights[s.column];
  });
  std::ranges::stable_sort(out.samples, {}, &MirrorSample::column);
}

// Texels stand on multiples of their size, so that they do not wander with the object.
int MirrorRays::choose_texels(MirroredByObject& o, const ViewOfObjects& seen, double rays) const {
  const prt::Bounds& bounds = bounds_[o.object];
  std::array<glm::dvec3, 8> corners;
  for (std::size_t i = 0; i < 8; ++i)
    corners[i] = seen.poses[o.object] * glm::dvec3((i & 1 ? bounds.high : bounds.low).x,
                                                   (i & 2 ? bounds.high : bounds.low).y,
                                                   (i & 4 ? bounds.high : bounds.low).z);
  const compositor::Rect rect =
      compositor::ViewProjection(seen.view.camera, seen.view.lens.get()).reach(corners);
  if (rect.empty()) return 0;
  const double pixels = double(rect.width()) * rect.height(),
               side = std::sqrt(pixels * o.least_samples / rays);
  // A size stays until it is a third off.
  if (!(side <= o.step && o.step <= std::max(1., 1.33 * side)))
    o.step = std::max(1, static_cast<int>(std::ceil(side)));
  o.samples = std::clamp(static_cast<int>(rays * o.step * o.step / pixels), o.least_samples,
                         o.pass ? kMaxStillSamples : kMaxTexelSamples);
  o.x0 = rect.x0 - rect.x0 % o.step, o.y0 = rect.y0 - rect.y0 % o.step;
  o.columns = (rect.x1 - o.x0 + o.step - 1) / o.step;
  return (rect.y1 - o.y0 + o.step - 1) / o.step;
}

void MirrorRays::trace(MirroredByObject& o, const ViewOfObjects& seen, double rays) const {
  o.rows.clear();
  if (!seen.visible[o.object]) return;
  const int height = choose_texels(o, seen, rays);
  o.rows.resize(static_cast<std::size_t>(height));
  parallel_for(0, height, [&](int y) {
    MirrorRow& row = o.rows[static_cast<std::size_t>(y)];
    row.weights.assign(static_cast<std::size_t>(o.columns), 0);
    row.open.assign(static_cast<std::size_t>(o.columns), 0);
    trace_row(o, seen, y, row);
  });
}

}  // namespace penumbra::runtime
