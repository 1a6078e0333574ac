#include "prt/reference/reference.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "prt/geometry/pinhole_view.h"
#include "prt/reference/internal/path_numbers.h"
#include "prt/reference/internal/tracer.h"

namespace penumbra::prt {

namespace {

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
  for (int pass = 4; done < options.max_samples / 2;) {
    const int count = std::min(pass, options.max_samples / 2 - done);
    render_half(tracer, view, options, 2 * options.seed, done, count, out.half_a);
    render_half(tracer, view, options, 2 * options.seed + 1, done, count, out.half_b);
    done += count;
    error = half_difference(out.half_a, out.half_b, done);
    const double of_needed = std::pow(options.error / std::max(error, 1e-12), 2);
    if (options.progress)
      options.progress(std::min(1., std::max(double(done) / (options.max_samples / 2), of_needed)));
    if (error < options.error) break;
    // No more than seem to be missing.
    const double missing = std::min(1e6, done / of_needed - done);
    pass = std::clamp(static_cast<int>(std::ceil(missing)), 2, std::min(2 * pass, 64));
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
    const PathPoint at{glm::vec3(points[i].position), glm::vec3(points[i].normal), {1, 1, 1}};
    for (int s = 0; s < samples; ++s) {
      PathNumbers numbers(seed * 0x100000001b3ull + i, s);
      const Rgb v = tracer.gather(at, at.normal, numbers);
      for (int c = 0; c < 3; ++c) sum[c] += v[c];
    }
    for (int c = 0; c < 3; ++c) out[i][c] = static_cast<float>(kPi * sum[c] / samples);
  });
  return out;
}

}  // namespace penumbra::prt
