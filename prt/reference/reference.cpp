#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <mutex>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/pinhole_view.h"
#include "prt/geometry/plane.h"
#include "prt/rays/ray_pattern.h"
#include "prt/rays/rays.h"
#include "prt/reference/environment_light.h"
#include "prt/reference/reference.h"

namespace penumbra::prt {

namespace {

// The first six numbers of a path come from the R6 sequence (Roberts 2018: powers of the root of
// x^7 = x + 1) with a random start per pixel; the others are plain random numbers.
class PathNumbers {
 public:
  PathNumbers(std::uint64_t stream, int sample) : state_(mix(stream)) {
    static constexpr double kRoot = 1.1127756842787055;  // of x^7 = x + 1
    double step = 1;
    for (double& value : quasi_) {
      step /= kRoot;
      const double x = step * sample + random();
      value = x - std::floor(x);
    }
    state_ = mix(state_ + static_cast<std::uint64_t>(sample));
  }
  float next() {
    return std::min(0x1.fffffep-1f, static_cast<float>(used_ < 6 ? quasi_[used_++] : random()));
  }

 private:
  static std::uint64_t mix(std::uint64_t z) {  // SplitMix64, Steele et al. 2014
    z += 0x9e3779b97f4a7c15ull;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
  }
  double random() {
    state_ += 0x9e3779b97f4a7c15ull;
    return static_cast<double>(mix(state_) >> 11) * 0x1p-53;
  }
  std::uint64_t state_;
  double quasi_[6]{};
  int used_ = 0;
};

struct SurfacePoint {
  glm::vec3 position, normal;
  Rgb albedo;
};

enum class Meeting { kNothing, kSurface, kBack };

class Tracer {
 public:
  static Result<Tracer> make(const ReferenceWorld& world, int longest_path) {
    Tracer tracer(world, longest_path);
    if (!world.mesh.triangles.empty()) {
      PENUMBRA_ASSIGN(scene, RayScene::build(world.mesh));
      tracer.scene_ = std::make_shared<RayScene>(std::move(scene));
      tracer.near_ = 1e-4f * radius_around(world.mesh, bounds_of(world.mesh).centre());
    }
    return tracer;
  }

  Meeting trace(const glm::vec3& o, const glm::vec3& d, float near, SurfacePoint& out) const;
  bool occluded(const glm::vec3& o, const glm::vec3& d, float far = 1e30f) const;
  // One sample of E/pi at a point: the cosine-weighted mean of what arrives.
  Rgb gather(const SurfacePoint& start, PathNumbers& numbers) const;
  Rgb seen_from_camera(const glm::vec3& o, const glm::vec3& d, PathNumbers& numbers) const;

 private:
  Tracer(const ReferenceWorld& world, int longest_path)
      : world_(world), longest_path_(longest_path) {}
  const Plane* nearest_plane(const glm::vec3& o, const glm::vec3& d, float near,
                             float& distance) const;
  Rgb direct(const SurfacePoint& at, PathNumbers& numbers) const;
  Rgb from_lamp(const SphereLight& lamp, const SurfacePoint& at, PathNumbers& numbers) const;

  const ReferenceWorld& world_;
  int longest_path_;
  std::shared_ptr<const RayScene> scene_;
  float near_ = 1e-4f;
};

const Plane* Tracer::nearest_plane(const glm::vec3& o, const glm::vec3& d, float near,
                                   float& distance) const {
  const Plane* nearest = nullptr;
  for (const Plane& plane : world_.planes) {
    const double slope = glm::dot(plane.normal, glm::dvec3(d));
    if (slope == 0) continue;
    const double t = glm::dot(plane.normal, plane.point - glm::dvec3(o)) / slope;
    if (t > near && t < distance) distance = static_cast<float>(t), nearest = &plane;
  }
  return nearest;
}

Meeting Tracer::trace(const glm::vec3& o, const glm::vec3& d, float near, SurfacePoint& out) const {
  const auto hit = scene_ ? scene_->intersect(o, d, near) : std::nullopt;
  float distance = hit ? hit->distance : 1e30f;
  if (const Plane* plane = nearest_plane(o, d, near, distance)) {
    if (glm::dot(plane->normal, glm::dvec3(d)) > 0) return Meeting::kBack;
    out = {o + distance * d, glm::vec3(plane->normal), plane->albedo};
    if (plane->texture) out.albedo = out.albedo * plane->texture(glm::dvec3(out.position));
    return Meeting::kSurface;
  }
  if (!hit) return Meeting::kNothing;
  if (!hit->front) return Meeting::kBack;
  const Mesh& mesh = world_.mesh;
  const auto& t = mesh.triangles[hit->triangle];
  const float w0 = 1 - hit->u - hit->v;
  out.position = o + hit->distance * d;
  out.normal = glm::normalize(w0 * mesh.normals[t[0]] + hit->u * mesh.normals[t[1]] +
                              hit->v * mesh.normals[t[2]]);
  out.albedo = w0 * mesh.albedo[t[0]] + hit->u * mesh.albedo[t[1]] + hit->v * mesh.albedo[t[2]];
  return Meeting::kSurface;
}

bool Tracer::occluded(const glm::vec3& o, const glm::vec3& d, float far) const {
  float distance = far;
  if (nearest_plane(o, d, near_, distance)) return true;
  return scene_ && scene_->occluded(o, d, near_, far);
}

// Its cone evenly: Shirley, Wang & Zimmerman 1996.
Rgb Tracer::from_lamp(const SphereLight& lamp, const SurfacePoint& at, PathNumbers& numbers) const {
  const float u1 = numbers.next(), phi = 2 * static_cast<float>(kPi) * numbers.next();
  const glm::vec3 to = glm::vec3(lamp.position) - at.position;
  const float distance = glm::length(to), radius = static_cast<float>(lamp.radius_m);
  if (distance <= radius) return {};  // within it
  const float sine2 = radius * radius / (distance * distance), cut = 1 - std::sqrt(1 - sine2),
              z = 1 - u1 * cut, r = std::sqrt(1 - z * z);
  const glm::vec3 d =
      frame_around(to / distance) * glm::vec3(r * std::cos(phi), r * std::sin(phi), z);
  const float cosine = glm::dot(at.normal, d);
  if (cosine <= 0 || occluded(at.position + near_ * at.normal, d, distance - radius)) return {};
  const float solid_angle = 2 * static_cast<float>(kPi) * cut;
  const Rgb radiance = lamp.irradiance_at_1m * (1 / (static_cast<float>(kPi) * radius * radius));
  return radiance * (cosine * solid_angle / static_cast<float>(kPi));
}

// Power of two strategies is balanced by density: w = p_light/(p_light + p_cosine).
Rgb Tracer::direct(const SurfacePoint& at, PathNumbers& numbers) const {
  const float u1 = numbers.next(), u2 = numbers.next();
  const EnvironmentLight::LightSample s = world_.light->sample(u1, u2);
  const float cosine = glm::dot(at.normal, s.direction);
  if (cosine <= 0 || s.density <= 0) return {};
  if (occluded(at.position + near_ * at.normal, s.direction)) return {};
  const float p_cosine = cosine / static_cast<float>(kPi);
  return s.radiance * (p_cosine / (s.density + p_cosine));
}

Rgb Tracer::gather(const SurfacePoint& start, PathNumbers& numbers) const {
  const bool sampled = world_.light->has_sampler();
  SurfacePoint at = start;
  Rgb sum{}, throughput{1, 1, 1};
  for (int depth = 0; depth < longest_path_; ++depth) {
    if (sampled) sum += throughput * direct(at, numbers);
    for (const SphereLight& lamp : world_.lamps) sum += throughput * from_lamp(lamp, at, numbers);
    const float phi = 2 * static_cast<float>(kPi) * numbers.next(), u = numbers.next();
    const float r = std::sqrt(u), z = std::sqrt(1 - u);
    const glm::vec3 d =
        frame_around(at.normal) * glm::vec3(r * std::cos(phi), r * std::sin(phi), z);
    SurfacePoint next;
    const Meeting met = trace(at.position + near_ * at.normal, d, near_, next);
    if (met == Meeting::kBack) break;
    if (met == Meeting::kNothing) {
      const float p_cosine = z / static_cast<float>(kPi);
      const float weight = sampled ? p_cosine / (p_cosine + world_.light->density(d)) : 1;
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
  }
  return sum;
}

Rgb Tracer::seen_from_camera(const glm::vec3& o, const glm::vec3& d, PathNumbers& numbers) const {
  SurfacePoint point;
  switch (trace(o, d, 1e-4f, point)) {
    case Meeting::kNothing:
      return world_.background ? world_.background(d) : world_.light->radiance(d);
    case Meeting::kBack:
      return {};
    case Meeting::kSurface:
      break;
  }
  return point.albedo * gather(point, numbers);
}

glm::dvec3 pinhole_ray(const PinholeView& view, glm::dvec2 pixel) {
  return glm::normalize(glm::dvec3((pixel.x - view.principal_px.x) / view.focal_px.x,
                                   -(pixel.y - view.principal_px.y) / view.focal_px.y, -1));
}

void render_half(const Tracer& tracer, const PinholeView& view, const ReferenceOptions& options,
                 std::uint64_t seed, int first, int count, Image<Rgb>& sum) {
  const glm::vec3 origin(view.world_from_camera.translation);
  parallel_for(0, view.height, 4, [&](const auto& rows) {
    for (int y = rows.begin(); y < rows.end(); ++y)
      for (int x = 0; x < view.width; ++x)
        for (int s = first; s < first + count; ++s) {
          const auto pixel =
              static_cast<std::uint64_t>(y) * static_cast<std::uint64_t>(view.width) +
              static_cast<std::uint64_t>(x);
          PathNumbers numbers(seed * 0x100000001b3ull + pixel, s);
          const double px = x + double(numbers.next()), py = y + double(numbers.next());
          const glm::dvec3 in_camera =
              options.ray ? options.ray({px, py}) : pinhole_ray(view, {px, py});
          if (in_camera == glm::dvec3(0)) continue;
          const glm::vec3 d(view.world_from_camera.rotation * in_camera);
          sum.at(x, y) += tracer.seen_from_camera(origin, d, numbers);
        }
  });
}

// Standard error of the mean of both halves, relative to the mean, from their difference.
double half_difference(const Image<Rgb>& a, const Image<Rgb>& b, int samples) {
  double square = 0, mean = 0;
  for (std::size_t i = 0; i < a.area(); ++i) {
    const double ya = luminance(a.pixels()[i]), yb = luminance(b.pixels()[i]);
    square += (ya - yb) * (ya - yb) / 4;
    mean += (ya + yb) / 2;
  }
  const auto n = static_cast<double>(a.area());
  return mean > 0 ? std::sqrt(square / n) / (mean / n) : (samples > 0 ? 0 : 1);
}

}  // namespace

Result<Reference> render_reference(const ReferenceWorld& world, const PinholeView& view,
                                   const ReferenceOptions& options) {
  if (view.width < 1 || view.height < 1 || !(view.focal_px.x > 0) || !(view.focal_px.y > 0) ||
      !std::isfinite(view.focal_px.x + view.focal_px.y + view.principal_px.x + view.principal_px.y))
    return fail(ErrorCode::kInvalid, "camera",
                "has a size or focal length that is not positive and finite");
  if (options.max_samples < 2)
    return fail(ErrorCode::kInvalid, "samples", "are fewer than two, one for each half");
  if (world.light == nullptr) return fail(ErrorCode::kInvalid, "world", "has no light");
  PENUMBRA_ASSIGN(tracer, Tracer::make(world, options.longest_path));
  Reference out;
  out.half_a = out.half_b = Image<Rgb>(view.width, view.height);
  int done = 0;
  double error = 1;
  for (int pass = 4; done < options.max_samples / 2; pass = std::min(pass * 2, 64)) {
    const int count = std::min(pass, options.max_samples / 2 - done);
    render_half(tracer, view, options, 2 * options.seed, done, count, out.half_a);
    render_half(tracer, view, options, 2 * options.seed + 1, done, count, out.half_b);
    done += count;
    error = half_difference(out.half_a, out.half_b, done);
    if (options.progress)
      options.progress(std::min(1., std::max(double(done) / (options.max_samples / 2),
                                             std::pow(options.error / std::max(error, 1e-12), 2))));
    if (error < options.error) break;
  }
  const float scale = 1 / static_cast<float>(done);
  out.radiance = Image<Rgb>(view.width, view.height);
  for (std::size_t i = 0; i < out.radiance.area(); ++i) {
    Rgb &a = out.half_a.pixels()[i], &b = out.half_b.pixels()[i];
    a = a * scale;
    b = b * scale;
    out.radiance.pixels()[i] = (a + b) * .5f;
  }
  out.error = error;
  out.samples = 2 * done;
  return out;
}

Result<std::vector<Rgb>> reference_irradiance(const ReferenceWorld& world,
                                              std::span<const IrradiancePoint> points, int samples,
                                              std::uint64_t seed) {
  if (world.light == nullptr) return fail(ErrorCode::kInvalid, "world", "has no light");
  PENUMBRA_ASSIGN(tracer, Tracer::make(world, ReferenceOptions{}.longest_path));
  std::vector<Rgb> out(points.size());
  parallel_for(std::size_t{0}, points.size(), [&](std::size_t i) {
    double sum[3] = {};
    const SurfacePoint at{glm::vec3(points[i].position), glm::vec3(points[i].normal), {1, 1, 1}};
    for (int s = 0; s < samples; ++s) {
      PathNumbers numbers(seed * 0x100000001b3ull + i, s);
      const Rgb v = tracer.gather(at, numbers);
      for (int c = 0; c < 3; ++c) sum[c] += v[c];
    }
    for (int c = 0; c < 3; ++c) out[i][c] = static_cast<float>(kPi * sum[c] / samples);
  });
  return out;
}

}  // namespace penumbra::prt
