#include "runtime/shading/floor_recovery.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <utility>

#include "calib/camera/camera_model.h"
#include "calib/camera/lens_vignetting.h"
#include "calib/camera/response_table.h"
#include "calib/camera/vignetting.h"
#include "core/median.h"
#include "lighting/lights/distant_light.h"
#include "prt/geometry/plane.h"
#include "prt/geometry/rays.h"

namespace penumbra::runtime {

namespace {

constexpr int kStep_px = 6;  // between the pixels that are read
constexpr std::size_t kMinPixels = 200;
constexpr float kShadowed = .5f;  // of the median: darker pixels lie in a real shadow

// A pixel of the floor; a saturated channel has at least that radiance.
struct FloorPixel {
  Rgb radiance;
  std::array<bool, 3> saturated{};

  bool any_saturated() const { return saturated[0] || saturated[1] || saturated[2]; }
};

struct PixelReader {
  const ResponseTable* curve;
  float radiance_per_signal;

  // Nothing where a value is not finite.
  template <class Pixel>
  std::optional<FloorPixel> operator()(const Image<Pixel>& image, int x, int y) const {
    const Pixel& p = image.at(x, y);
    FloorPixel out;
    if constexpr (std::is_same_v<Pixel, Rgb>) {
      if (!is_finite(p)) return std::nullopt;
      out.radiance = p * radiance_per_signal;
    } else {
      const unsigned codes[] = {p.r, p.g, p.b};
      for (int c = 0; c < 3; ++c) {
        out.saturated[static_cast<std::size_t>(c)] = codes[c] >= curve->largest_code();
        out.radiance[c] = curve->decode(c, codes[c]) * radiance_per_signal;
      }
    }
    return out;
  }
};

std::optional<float> median_luminance(std::span<const FloorPixel> pixels) {
  std::vector<CensoredValue> values;
  for (const FloorPixel& p : pixels) values.push_back({luminance(p.radiance), p.any_saturated()});
  return censored_median(values);
}

// The mean, or the median where part is saturated: a mean of what is not would be too dark.
std::optional<float> middle_of_channel(std::span<const FloorPixel> pixels, int channel) {
  const auto saturated = [&](const FloorPixel& p) {
    return p.saturated[static_cast<std::size_t>(channel)];
  };
  if (std::ranges::any_of(pixels, saturated)) {
    std::vector<CensoredValue> values;
    for (const FloorPixel& p : pixels) values.push_back({p.radiance[channel], saturated(p)});
    return censored_median(values);
  }
  float sum = 0;
  for (const FloorPixel& p : pixels) sum += p.radiance[channel];
  return sum / static_cast<float>(pixels.size());
}

// Of what is not in a real shadow. Nothing where the floor is overexposed as a whole.
std::optional<Rgb> lit_radiance(std::vector<FloorPixel>& pixels) {
  const auto middle = median_luminance(pixels);
  if (!middle) return std::nullopt;
  std::erase_if(pixels,
                [&](const FloorPixel& p) { return luminance(p.radiance) < kShadowed * *middle; });
  Rgb out;
  for (int c = 0; c < 3; ++c) {
    const auto found = middle_of_channel(pixels, c);
    if (!found) return std::nullopt;
    out[c] = *found;
  }
  return out;
}

}  // namespace

Result<FloorRecovery> FloorRecovery::create(const PreparedScene& scene) {
  FloorRecovery out;
  out.scene_ = &scene;
  const auto stands_on = [](const prt::Plane& plane) {
    return [&plane](const PreparedObject& o) {
      return std::abs(glm::dot(o.world_from_bake.translation - plane.point, plane.normal)) < 1e-3;
    };
  };
  for (const prt::Plane& plane : scene.planes)
    if (!out.floor_ && luminance(plane.albedo) > 0 &&
        std::ranges::any_of(scene.objects, stands_on(plane)))
      out.floor_ = &plane;
  if (out.floor_ && !scene.real_mesh.triangles.empty()) {
    PENUMBRA_ASSIGN(real, prt::RayScene::build(scene.real_mesh));
    out.real_ = std::move(real);
  }
  return out;
}

bool FloorRecovery::is_near_an_object(const glm::dvec3& point) const {
  return std::ranges::any_of(scene_->objects, [&](const PreparedObject& o) {
    return glm::length(point - o.world_from_bake.translation) < kNear_m;
  });
}

// Past what stands there, as far as it is known. In the shadow of a wall most of the floor may lie.
bool FloorRecovery::is_seen_and_lit(const glm::dvec3& eye, const glm::dvec3& direction,
                                    double distance, std::span<const glm::dvec3> towards) const {
  if (!real_) return true;
  constexpr float kOff_m = 1e-3f, kFar_m = 1e4f;
  if (real_->occluded(glm::vec3(eye), glm::vec3(direction), 0, static_cast<float>(distance)))
    return false;
  const glm::vec3 point(eye + distance * direction);
  return std::ranges::none_of(towards, [&](const glm::dvec3& light) {
    return real_->occluded(point, glm::vec3(light), kOff_m, kFar_m);
  });
}

std::optional<lighting::ReflectancePatch> FloorRecovery::measure(
    const capture::Frame& frame, const capture::CameraInfo& camera, const ResponseTable* curve,
    std::span<const glm::dvec3> towards) const {
  const PixelReader read{curve, 1 / static_cast<float>(frame.exposure.product())};
  const calib::CameraModel& p = camera.projection;
  const Vignetting vignetting = calib::vignetting_of(p, camera.vignetting);
  const glm::dvec3 eye = frame.world_from_camera.translation;
  const double height = glm::dot(eye - floor_->point, floor_->normal);
  if (!(height > 0)) return std::nullopt;  // its underside
  std::vector<FloorPixel> seen;
  for (int y = kStep_px / 2; y < p.height; y += kStep_px)
    for (int x = kStep_px / 2; x < p.width; x += kStep_px) {
      const auto ray = calib::direction_from_pixel(p, {x + .5, y + .5});
      if (!ray) continue;
      const glm::dvec3 d = frame.world_from_camera.rotation * *ray;
      const double distance = -height / glm::dot(d, floor_->normal);
      if (!(distance > 0) || !is_near_an_object(eye + distance * d)) continue;
      if (!is_seen_and_lit(eye, d, distance, towards)) continue;
      auto pixel = std::visit([&](const auto& image) { return read(image, x, y); }, *frame.pixels);
      if (!pixel) continue;
      const auto left = static_cast<float>(vignetting.at({x + .5, y + .5}));
      pixel->radiance = pixel->radiance * (1 / left);
      seen.push_back(*pixel);
    }
  if (std::cmp_less(std::ranges::count_if(seen, std::not_fn(&FloorPixel::any_saturated)),
                    kMinPixels))
    return std::nullopt;
  const auto radiance = lit_radiance(seen);
  if (!radiance) return std::nullopt;
  return lighting::ReflectancePatch{floor_->normal, *radiance, floor_->albedo};
}

bool FloorRecovery::is_news(const std::vector<lighting::SaturationRecovery>& found) const {
  return !std::ranges::all_of(found, [&](const lighting::SaturationRecovery& c) {
    const auto before = std::ranges::find(said_, c.source, &lighting::SaturationRecovery::source);
    if (before == said_.end()) return false;
    const float was = luminance(before->power);
    return std::abs(luminance(c.power) - was) <= kMinChange * was;
  });
}

Result<std::vector<lighting::SaturationRecovery>> FloorRecovery::observe(
    const capture::Frame& frame, const capture::CameraInfo& camera, const ResponseTable* curve,
    const lighting::LightEstimate& light) {
  std::vector<int> clipped;
  std::vector<glm::dvec3> towards;
  for (const lighting::DistantLight& d : light.lights)
    if (d.clipped) clipped.push_back(d.id), towards.push_back(d.direction);
  if (!floor_ || clipped.empty() || (last_ && frame.time - *last_ < kAgain && clipped == tried_))
    return std::vector<lighting::SaturationRecovery>{};
  last_ = frame.time;
  tried_ = std::move(clipped);
  const auto patch = measure(frame, camera, curve, towards);
  if (!patch)
    return fail(ErrorCode::kUndetermined, camera.name,
                "shows too little of the floor, or overexposes it");
  auto found = lighting::recover_jointly(light, *patch);
  if (!found) return found;
  if (!is_news(*found)) return std::vector<lighting::SaturationRecovery>{};
  said_ = *found;
  return found;
}

}  // namespace penumbra::runtime
