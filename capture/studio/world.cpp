#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "capture/studio/world.h"
#include "core/conventions.h"

namespace penumbra::capture {

namespace {

// Bilinear, wrapping in azimuth.
Rgb lookup(const Image<Rgb>& map, const glm::dvec3& direction) {
  const int w = map.width(), h = map.height();
  const glm::dvec2 p = latlong_pixel(direction, w, h);
  const double px = p.x - .5 + w, py = std::clamp(p.y - .5, 0., h - 1.);
  const int x0 = static_cast<int>(px) % w, x1 = (x0 + 1) % w;
  const int y0 = static_cast<int>(py), y1 = std::min(y0 + 1, h - 1);
  const auto fx = static_cast<float>(px - std::floor(px)), fy = static_cast<float>(py - y0);
  return (map.at(x0, y0) * (1 - fx) + map.at(x1, y0) * fx) * (1 - fy) +
         (map.at(x0, y1) * (1 - fx) + map.at(x1, y1) * fx) * fy;
}

float lattice(int x, int y) {
  auto h =
      static_cast<std::uint32_t>(x) * 0x9e3779b1u ^ static_cast<std::uint32_t>(y) * 0x85ebca6bu;
  h = (h ^ (h >> 15)) * 0x2c1b3c6du;
  h = (h ^ (h >> 12)) * 0x297a2d39u;
  return static_cast<float>((h ^ (h >> 15)) >> 8) * 0x1p-24f;
}

float value_noise(double x, double y) {
  const double fx = std::floor(x), fy = std::floor(y);
  const auto smooth = [](double t) { return static_cast<float>(t * t * (3 - 2 * t)); };
  const float u = smooth(x - fx), v = smooth(y - fy);
  const int ix = static_cast<int>(fx), iy = static_cast<int>(fy);
  const float a = lattice(ix, iy), b = lattice(ix + 1, iy), c = lattice(ix, iy + 1),
              d = lattice(ix + 1, iy + 1);
  return (a + (b - a) * u) + ((c + (d - c) * u) - (a + (b - a) * u)) * v;
}

// Stone slabs with joints: mean near 1. Fades out with distance, where a camera could not resolve
// it.
float floor_detail(double x, double z) {
  constexpr double kSlab = .6, kJoint = .006;
  const double fade = 1 / (1 + std::pow(std::hypot(x, z) / 2.4, 8));
  const double gx = x / kSlab - std::floor(x / kSlab), gz = z / kSlab - std::floor(z / kSlab);
  const double edge = std::min({gx, 1 - gx, gz, 1 - gz}) * kSlab;
  const double joint = edge < kJoint ? .8 : 1;
  const int slab_x = static_cast<int>(std::floor(x / kSlab)),
            slab_z = static_cast<int>(std::floor(z / kSlab));
  const double tone = 1 + .08 * (lattice(slab_x * 7 + 3, slab_z * 13 + 5) - .5);
  const double grain = 1 + .16 * (value_noise(x * 90, z * 90) - .5) +
                       .10 * (value_noise(x * 23, z * 23) - .5) +
                       .07 * (value_noise(x * 310, z * 310) - .5);
  return static_cast<float>(1 + fade * (joint * tone * grain - 1));
}

// Largest albedo a floor may show: beyond, it would reflect more than it gets.
constexpr float kWhitest = .92f, kBlackest = .02f;
constexpr float kStone = .3f;

}  // namespace

Result<std::shared_ptr<FloorWorld>> FloorWorld::make(Image<Rgb> map, Ground ground) {
  if (map.empty()) return fail(ErrorCode::kInvalid, "environment", "has no pixels");
  double mean = 0, irradiance[3] = {};
  for (int y = 0; y < map.height(); ++y) {
    const double w = latlong_solid_angle(y, map.width(), map.height());
    // Exact over the row: Int cos th sin th dth per pixel.
    const double c0 = std::cos(kPi * y / map.height()), c1 = std::cos(kPi * (y + 1) / map.height());
    const double up = kPi / map.width() *
                      (std::max(0., c0) * std::max(0., c0) - std::max(0., c1) * std::max(0., c1));
    for (int x = 0; x < map.width(); ++x) {
      const Rgb& c = map.at(x, y);
      if (!is_finite(c))
        return fail(ErrorCode::kNonFinite, "environment",
                    fmt::format("pixel {},{} is not finite", x, y));
      mean += w * luminance(c) / (4 * kPi);
      for (int k = 0; k < 3; ++k) irradiance[k] += up * c[k];
    }
  }
  if (!(mean > 0)) return fail(ErrorCode::kUndetermined, "environment", "is black everywhere");
  const auto scale = static_cast<float>(kMeanLuminance / mean);
  auto world = std::shared_ptr<FloorWorld>(new FloorWorld);
  for (Rgb& c : map.pixels()) c = c * scale;
  world->map_ = std::move(map);
  for (int k = 0; k < 3; ++k) world->irradiance_[k] = static_cast<float>(irradiance[k]) * scale;

  // A floor far too dark or too bright for its own light (a tripod, a painted ground) is brought in
  // range.
  const auto mean_near = [&] {
    Rgb sum;
    for (int i = 0; i < 400; ++i) {
      const double r = 1.5 * std::sqrt((i + .5) / 400),
                   a = i * 2.39996322972865332;  // golden angle
      sum += world->floor_albedo({r * std::cos(a), 0, r * std::sin(a)});
    }
    return sum * (1.f / 400);
  };
  const float found = luminance(mean_near());
  world->albedo_scale_ = std::clamp(found, .15f, .6f) / found;
  world->mean_albedo_ = mean_near();
  world->grey_ =
      ground == Ground::kGreyUnderSky && world->mean_albedo_.b > kSkyBlue * world->mean_albedo_.r;
  if (world->grey_) world->mean_albedo_ = mean_near();
  return world;
}

Rgb FloorWorld::floor_albedo(const glm::dvec3& p) const {
  const Rgb ground = lookup(map_, glm::normalize(glm::dvec3(p.x, -kCaptureHeight, p.z)));
  // The correction fades out towards the horizon, where the floor meets the environment's own
  // picture.
  const double far = std::clamp((std::hypot(p.x, p.z) - 2) / 8, 0., 1.);
  const auto outside = static_cast<float>(far * far * (3 - 2 * far));
  const float scale = albedo_scale_ + (1 - albedo_scale_) * outside;
  const float detail = scale * floor_detail(p.x, p.z);
  // Far out the plane stands for walls and lamps of the picture, which may be brighter than any
  // floor.
  const float whitest = far < 1 ? kWhitest / static_cast<float>(1 - far) : 1e6f;
  Rgb albedo;
  for (int c = 0; c < 3; ++c) {
    const float e = std::max(irradiance_[c], 1e-6f);
    const float of_map = static_cast<float>(kPi) * ground[c] / e * detail;
    const float found = grey_ ? kStone * detail / scale * (1 - outside) + of_map * outside : of_map;
    albedo[c] = std::clamp(found, kBlackest, whitest);
  }
  return albedo;
}

Rgb FloorWorld::far_radiance(const glm::dvec3& direction) const {
  return lookup(map_, direction);
}

Rgb FloorWorld::radiance(const glm::dvec3& origin, const glm::dvec3& direction) const {
  if (direction.y >= 0 || origin.y <= 0) return far_radiance(direction);
  const glm::dvec3 p = origin + direction * (-origin.y / direction.y);
  return floor_albedo(p) * irradiance_ * static_cast<float>(1 / kPi);
}

}  // namespace penumbra::capture
