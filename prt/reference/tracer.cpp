#include "prt/reference/internal/tracer.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "core/conventions.h"
#include "prt/geometry/mesh.h"
#include "prt/rays/ray_pattern.h"

namespace penumbra::prt {

namespace {

constexpr int kMaxPassed = 64;  // surfaces that one ray goes through

}  // namespace

Result<Tracer> Tracer::make(const ReferenceWorld& world, int longest_path) {
  if (!(world.emission_unit >= 0 && std::isfinite(world.emission_unit)))
    return fail(ErrorCode::kInvalid, "emission unit", "is negative or not finite");
  Tracer tracer(world, longest_path);
  if (world.mesh.triangles.empty()) return tracer;
  if (world.surface) {
    PENUMBRA_TRY(check_surface(world.mesh, *world.surface));
    tracer.see_through_ = std::ranges::any_of(world.surface->materials, is_see_through);
  }
  PENUMBRA_ASSIGN(scene, RayScene::build(world.mesh));
  tracer.scene_ = std::make_shared<RayScene>(std::move(scene));
  tracer.near_ = 1e-4f * radius_around(world.mesh, bounds_of(world.mesh).centre());
  return tracer;
}

const Plane* Tracer::nearest_plane(const glm::vec3& o, const glm::vec3& d, float near,
                                   float& distance) const {
  const Plane* nearest = nullptr;
  for (const Plane& plane : world_.planes) {
    const double slope = glm::dot(plane.normal, glm::dvec3(d));
    if (slope == 0) continue;
    const double above = glm::dot(plane.normal, glm::dvec3(o) - plane.point);
    double t = -above / slope;
    // What starts on a plane, as where a wall meets the floor, and goes into it is stopped there.
    const bool starts_on_it = slope < 0 && near <= near_ && std::abs(above) <= double{near_};
    if (starts_on_it) t = near;
    if ((starts_on_it || t > near) && t < distance)
      distance = static_cast<float>(t), nearest = &plane;
  }
  return nearest;
}

const Material* Tracer::material_of(const Hit& hit) const {
  if (!world_.surface) return nullptr;
  return &world_.surface
              ->materials[world_.surface->material[world_.mesh.triangles[hit.triangle][0]]];
}

TrianglePlace Tracer::place_of(const Hit& hit) const {
  return {world_.mesh.triangles[hit.triangle], hit.u, hit.v, hit.front};
}

// What a ray does not pass of the surface that it meets.
float Tracer::cover(const Hit& hit, const glm::vec3& d) const {
  const Material* const m = material_of(hit);
  if (!m || !is_see_through(*m)) return 1;
  if (!hit.front && !has_backs(*m)) return 0;
  return MaterialLobes(local_material(world_.mesh, *world_.surface, place_of(hit)), -d).cover();
}

Tracer::Meeting Tracer::meet_triangle(const Hit& hit, const glm::vec3& o, const glm::vec3& d,
                                      PathPoint& out) const {
  const Material* const material = material_of(hit);
  if (!hit.front && !(material && material->double_sided)) return Meeting::kBack;
  const Mesh& mesh = world_.mesh;
  out.position = o + hit.distance * d;
  if (material) {
    out.material = local_material(mesh, *world_.surface, place_of(hit));
    out.normal = out.material->plain;
    out.albedo = {1, 1, 1};
    return Meeting::kSurface;
  }
  const auto& t = mesh.triangles[hit.triangle];
  const float w0 = 1 - hit.u - hit.v;
  out.normal = glm::normalize(w0 * mesh.normals[t[0]] + hit.u * mesh.normals[t[1]] +
                              hit.v * mesh.normals[t[2]]);
  out.albedo = w0 * mesh.albedo[t[0]] + hit.u * mesh.albedo[t[1]] + hit.v * mesh.albedo[t[2]];
  return Meeting::kSurface;
}

Tracer::Meeting Tracer::trace(const glm::vec3& o, const glm::vec3& d, float near,
                              PathNumbers& numbers, PathPoint& out) const {
  for (int passed = 0; passed < kMaxPassed; ++passed) {
    const auto hit = scene_ ? scene_->intersect(o, d, near) : std::nullopt;
    float distance = hit ? hit->distance : 1e30f;
    if (const Plane* plane = nearest_plane(o, d, near, distance)) {
      if (glm::dot(plane->normal, glm::dvec3(d)) > 0) return Meeting::kBack;
      out = {o + distance * d, glm::vec3(plane->normal), plane->albedo};
      if (plane->texture) out.albedo = out.albedo * plane->texture(glm::dvec3(out.position));
      return Meeting::kSurface;
    }
    if (!hit) return Meeting::kNothing;
    const float covered = see_through_ ? cover(*hit, d) : 1;
    if (covered < 1 && numbers.next() >= covered) {
      near = hit->distance + near_;
      continue;
    }
    out.material.reset();
    const Meeting met = meet_triangle(*hit, o, d, out);
    // What it sends counts by its opacity, and it was met by what it covers.
    if (met == Meeting::kSurface && covered < 1)
      out.albedo = out.albedo * (out.material->opacity / covered);
    return met;
  }
  return Meeting::kBack;
}

float Tracer::open_fraction(const glm::vec3& o, const glm::vec3& d, float far) const {
  float distance = far;
  if (nearest_plane(o, d, near_, distance)) return 0;
  if (!scene_) return 1;
  if (!see_through_) return scene_->occluded(o, d, near_, far) ? 0 : 1;
  float open = 1, near = near_;
  for (int passed = 0; passed < kMaxPassed && open > 0; ++passed) {
    const auto hit = scene_->intersect(o, d, near, far);
    if (!hit) return open;
    open *= 1 - cover(*hit, d);
    near = hit->distance + near_;
  }
  return 0;
}

// Its cone evenly: Shirley, Wang & Zimmerman 1996.
Rgb Tracer::from_lamp(const SphereLight& lamp, const PathPoint& at, const MaterialLobes* lobes,
                      PathNumbers& numbers) const {
  const float u1 = numbers.next(), phi = 2 * static_cast<float>(kPi) * numbers.next();
  const glm::vec3 to = glm::vec3(lamp.position) - at.position;
  const float distance = glm::length(to), radius = static_cast<float>(lamp.radius_m);
  if (distance <= radius) return {};  // within it
  const float sine2 = radius * radius / (distance * distance), cut = 1 - std::sqrt(1 - sine2),
              z = 1 - u1 * cut, r = std::sqrt(1 - z * z);
  const glm::vec3 d =
      frame_around(to / distance) * glm::vec3(r * std::cos(phi), r * std::sin(phi), z);
  const float cosine = glm::dot(at.normal, d);
  if (cosine <= 0) return {};
  const float open = open_fraction(at.position + near_ * at.normal, d, distance - radius);
  if (open <= 0) return {};
  const float solid_angle = 2 * static_cast<float>(kPi) * cut;
  const Rgb radiance = lamp.irradiance_at_1m * (1 / (static_cast<float>(kPi) * radius * radius));
  if (lobes) return radiance * lobes->evaluate(d) * (solid_angle * open);
  return radiance * (cosine * solid_angle / static_cast<float>(kPi)) * open;
}

// Power of two strategies is balanced by density: w = p_light/(p_light + p_surface).
Rgb Tracer::direct(const PathPoint& at, const MaterialLobes* lobes, PathNumbers& numbers) const {
  const float u1 = numbers.next(), u2 = numbers.next();
  const EnvironmentLight::LightSample s = world_.light->sample(u1, u2);
  const float cosine = glm::dot(at.normal, s.direction);
  if (cosine <= 0 || s.density <= 0) return {};
  const float open = open_fraction(at.position + near_ * at.normal, s.direction);
  if (open <= 0) return {};
  if (lobes)
    return s.radiance * lobes->evaluate(s.direction) *
           (open / (s.density + lobes->density(s.direction)));
  const float p_cosine = cosine / static_cast<float>(kPi);
  return s.radiance * (p_cosine / (s.density + p_cosine)) * open;
}

Tracer::PathStep Tracer::step(const PathPoint& at, const MaterialLobes* lobes,
                              PathNumbers& numbers) const {
  const float u1 = numbers.next(), u = numbers.next();
  if (lobes) {
    const MaterialLobes::Bounce s = lobes->sample(u1, u);
    return {s.towards_light, s.weight, s.density};
  }
  const float phi = 2 * static_cast<float>(kPi) * u1;
  const float r = std::sqrt(u), z = std::sqrt(1 - u);
  return {frame_around(at.normal) * glm::vec3(r * std::cos(phi), r * std::sin(phi), z),
          {1, 1, 1},
          z / static_cast<float>(kPi)};
}

Rgb Tracer::gather(const PathPoint& start, const glm::vec3& towards_viewer,
                   PathNumbers& numbers) const {
  const bool sampled = world_.light->has_sampler();
  PathPoint at = start;
  glm::vec3 viewer = towards_viewer;
  Rgb sum{}, throughput{1, 1, 1};
  for (int depth = 0; depth < longest_path_; ++depth) {
    std::optional<MaterialLobes> made;
    if (at.material) {
      made.emplace(*at.material, viewer);
      sum += throughput * (made->emission() * world_.emission_unit);
      if (at.material->unlit) break;
    }
    const MaterialLobes* const lobes = made ? &*made : nullptr;
    if (sampled) sum += throughput * direct(at, lobes, numbers);
    for (const SphereLight& lamp : world_.lamps)
      sum += throughput * from_lamp(lamp, at, lobes, numbers);
    const PathStep next_step = step(at, lobes, numbers);
    const glm::vec3 d = next_step.direction;
    // A Lambertian point's step along the surface has no density and yet counts, for nothing.
    if (lobes && (next_step.density <= 0 || glm::dot(d, at.normal) <= 0)) break;
    throughput = throughput * next_step.weight;
    PathPoint next;
    const Meeting met = trace(at.position + near_ * at.normal, d, near_, numbers, next);
    if (met == Meeting::kBack) break;
    if (met == Meeting::kNothing) {
      const float weight =
          sampled ? next_step.density / (next_step.density + world_.light->density(d)) : 1;
      sum += throughput * (world_.light->radiance(d) * weight);
      break;
    }
    throughput = throughput * next.albedo;
    if (depth >= 3) {
      const float survive = std::min(.95f, luminance(throughput));
      if (numbers.next() >= survive) break;
      throughput = throughput * (1 / survive);
    }
    at = next;
    viewer = -d;
  }
  return sum;
}

Rgb Tracer::seen_from_camera(const glm::vec3& o, const glm::vec3& d, PathNumbers& numbers) const {
  PathPoint point;
  switch (trace(o, d, 1e-4f, numbers, point)) {
    case Meeting::kNothing:
      return world_.background ? world_.background(d) : world_.light->radiance(d);
    case Meeting::kBack:
      return {};
    case Meeting::kSurface:
      break;
  }
  return point.albedo * gather(point, -d, numbers);
}

}  // namespace penumbra::prt
