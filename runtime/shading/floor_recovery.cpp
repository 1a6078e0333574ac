#include "runtime/shading/floor_recovery.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <map>
#include <utility>

#include "calib/camera/camera_model.h"
#include "calib/camera/lens_vignetting.h"
#include "calib/camera/response_table.h"
#include "calib/camera/vignetting.h"
#include "core/conventions.h"
#include "core/io/log.h"
#include "core/median.h"
#include "core/threads/parallel.h"
#include "lighting/lights/distant_light.h"
#include "prt/geometry/plane.h"
#include "prt/rays/ray_pattern.h"
#include "prt/rays/rays.h"
#include "runtime/surroundings/floor_irradiance.h"

namespace penumbra::runtime {

namespace {

// Between the pixels that are read, in a picture of that width.
constexpr int kStep_px = 6, kUsualWidth_px = 640;
constexpr std::size_t kMinPixels = 200;
constexpr float kShadowed = .5f;  // of the median: darker pixels lie in a real shadow
constexpr float kOff_m = 1e-3f, kFar_m = 1e4f;

// A pixel of the floor; a saturated channel has at least that radiance.
struct FloorPixel {
  Rgb radiance;
  std::array<bool, 3> saturated{};
  glm::dvec3 point{0};

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

// Which clipped lights known things keep from a point, bit by light.
using HiddenLights = std::uint32_t;
constexpr std::size_t kMaxClipped = 32;

// Of a point of the floor that the eye looks at. Nothing where a known thing hides it, or a part of
// a clipped light from it.
std::optional<HiddenLights> hidden_at(const prt::RayScene& real, const glm::dvec3& eye,
                                      const glm::dvec3& direction, double distance,
                                      std::span<const lighting::DistantLight* const> clipped) {
  if (real.occluded(glm::vec3(eye), glm::vec3(direction), 0, static_cast<float>(distance)))
    return std::nullopt;
  const glm::vec3 point(eye + distance * direction);
  const auto keeps = [&](const glm::dvec3& d) {
    return real.occluded(point, glm::vec3(glm::normalize(d)), kOff_m, kFar_m);
  };
  HiddenLights out = 0;
  for (std::size_t k = 0; k < clipped.size(); ++k) {
    // Its middle and its rim, about: half shadows are in neither light.
    const glm::dvec3& axis = clipped[k]->direction;
    const glm::dmat3 frame(prt::frame_around(glm::vec3(axis)));
    const double reach = std::tan(std::min(clipped[k]->radius.value(), 1.));
    const int kept = keeps(axis) + keeps(axis + reach * frame[0]) + keeps(axis - reach * frame[0]) +
                     keeps(axis + reach * frame[1]) + keeps(axis - reach * frame[1]);
    if (kept != 0 && kept != 5) return std::nullopt;
    if (kept == 5) out |= HiddenLights{1} << k;
  }
  return out;
}

// Evenly, of many.
std::vector<glm::dvec3> some_of(std::span<const FloorPixel> pixels) {
  constexpr std::size_t kMax = 32;
  const std::size_t apart = (pixels.size() + kMax - 1) / kMax;
  std::vector<glm::dvec3> out;
  for (std::size_t i = 0; i < pixels.size(); i += apart) out.push_back(pixels[i].point);
  return out;
}

}  // namespace

struct FloorRecovery::SeenFloor {
  std::vector<FloorPixel> lit;                               // as far as is known
  std::map<HiddenLights, std::vector<FloorPixel>> shadowed;  // by known things
};

// What things do to the light of a region.
void FloorRecovery::take_in(const FloorIrradianceParts& light, std::uint32_t hidden,
                            std::span<const lighting::DistantLight* const> clipped,
                            lighting::ShadowRegion& region) const {
  region.others = light.others, region.beside = light.beside;
  for (std::size_t k = 0; k < clipped.size(); ++k) {
    const auto cosine = static_cast<float>(glm::dot(clipped[k]->direction, floor_->normal));
    const float direct = hidden >> k & 1 ? 0 : 1;
    const Rgb more = light.reflected[k] * (1 / std::max(cosine, .05f));
    region.parts.push_back({clipped[k]->id, Rgb{direct, direct, direct} + more});
  }
}

Result<FloorRecovery> FloorRecovery::create(const PreparedScene& scene) {
  FloorRecovery out;
  out.scene_ = &scene;
  const auto stands_on = [](const prt::Plane& plane) {
    return [&plane](const PreparedObject& o) {
      return std::abs(glm::dot(o.world_from_bake.translation - plane.point, plane.normal)) < 1e-3;
    };
  };
  // One of known albedo, or else any on which a known thing may cast a shadow.
  for (const bool known : {true, false})
    for (const prt::Plane& plane : scene.planes)
      if (!out.floor_ &&
          (known ? luminance(plane.albedo) > 0 : !scene.real_mesh.triangles.empty()) &&
          std::ranges::any_of(scene.objects, stands_on(plane)))
        out.floor_ = &plane;
  if (out.floor_) out.planes_.emplace(scene);
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

FloorRecovery::SeenFloor FloorRecovery::measure(
    const capture::Frame& frame, const capture::CameraInfo& camera, const ResponseTable* curve,
    std::span<const lighting::DistantLight* const> clipped) const {
  const PixelReader read{curve, 1 / static_cast<float>(frame.exposure.product())};
  const calib::CameraModel& p = camera.projection;
  const Vignetting vignetting = calib::vignetting_of(p, camera.vignetting);
  const glm::dvec3 eye = frame.world_from_camera.translation;
  const double height = glm::dot(eye - floor_->point, floor_->normal);
  SeenFloor out;
  if (!(height > 0)) return out;  // its underside
  // Larger pictures show no more of the floor.
  const int step = kStep_px * std::max(1, p.width / kUsualWidth_px);
  struct RowPixel {
    HiddenLights hidden;
    FloorPixel pixel;
  };
  std::vector<std::vector<RowPixel>> rows(static_cast<std::size_t>((p.height + step - 1) / step));
  const auto look = [&](int x, int y, std::vector<RowPixel>& row) {
    const auto ray = calib::direction_from_pixel(p, {x + .5, y + .5});
    if (!ray) return;
    const glm::dvec3 d = frame.world_from_camera.rotation * *ray;
    const double distance = -height / glm::dot(d, floor_->normal);
    const glm::dvec3 point = eye + distance * d;
    if (!(distance > 0) || !is_near_an_object(point)) return;
    const auto hidden =
        real_ ? hidden_at(*real_, eye, d, distance, clipped) : std::optional<HiddenLights>(0);
    if (!hidden) return;
    auto pixel = std::visit([&](const auto& image) { return read(image, x, y); }, *frame.pixels);
    if (!pixel) return;
    pixel->radiance = pixel->radiance * (1 / static_cast<float>(vignetting.at({x + .5, y + .5})));
    pixel->point = point;
    row.push_back({*hidden, *pixel});
  };
  parallel_for(std::size_t{0}, rows.size(), [&](std::size_t r) {
    const int y = step / 2 + static_cast<int>(r) * step;
    for (int x = step / 2; x < p.width && y < p.height; x += step) look(x, y, rows[r]);
  });
  for (const std::vector<RowPixel>& row : rows)
    for (const RowPixel& seen : row)
      (seen.hidden == 0 ? out.lit : out.shadowed[seen.hidden]).push_back(seen.pixel);
  return out;
}

std::vector<lighting::ShadowRegion> FloorRecovery::regions_of(
    SeenFloor& floor, const Rgb& lit, const lighting::LightEstimate& light,
    std::span<const lighting::DistantLight* const> clipped) const {
  std::vector<lighting::ShadowRegion> out{{lit}};
  if (!real_) return out;
  constexpr std::size_t kFewest = 40;  // pixels of a region
  std::vector<FloorIrradiance::FloorRadiance> seen{{0, lit}};
  std::vector<std::pair<HiddenLights, const std::vector<FloorPixel>*>> from{{0, &floor.lit}};
  for (auto& [hidden, pixels] : floor.shadowed) {
    if (pixels.size() < kFewest) continue;
    const auto radiance = lit_radiance(pixels);
    if (!radiance || !(luminance(*radiance) > 0)) continue;
    out.push_back({*radiance});
    from.emplace_back(hidden, &pixels);
    seen.push_back({hidden, *radiance});
  }
  const FloorIrradiance around(*real_, scene_->real_mesh, *floor_, light, clipped, seen);
  for (std::size_t i = 0; i < out.size(); ++i)
    take_in(around.at(some_of(*from[i].second)), from[i].first, clipped, out[i]);
  // Where things hide much of all other light too, harmonics do not tell well enough what is left.
  constexpr float kMostlyOpen = .6f;
  const auto first_shadow = out.begin() + 1;
  out.erase(std::remove_if(
                first_shadow, out.end(),
                [](const lighting::ShadowRegion& r) { return luminance(r.others) < kMostlyOpen; }),
            out.end());
  return out;
}

Result<std::vector<lighting::SaturationRecovery>> FloorRecovery::recover(
    SeenFloor floor, const lighting::LightEstimate& light,
    std::span<const lighting::DistantLight* const> clipped, const std::string& camera) {
  const auto usable = static_cast<std::size_t>(
      std::ranges::count_if(floor.lit, std::not_fn(&FloorPixel::any_saturated)));
  const auto lit = usable >= kMinPixels ? lit_radiance(floor.lit) : std::nullopt;
  overexposed_ = !lit && floor.lit.size() >= kMinPixels;
  if (!lit)
    return fail(ErrorCode::kUndetermined, camera,
                "shows too little of the floor, or overexposes it");
  std::vector<lighting::ShadowRegion> regions = regions_of(floor, *lit, light, clipped);
  planes_->update(light);
  const Rgb& by_planes = planes_->change(static_cast<std::size_t>(floor_ - scene_->planes.data()));
  for (lighting::ShadowRegion& region : regions) region.beside += by_planes;
  lighting::ShadowedSurface surface{floor_->normal, regions};
  if (regions.size() > 1) {
    auto found = lighting::recover_from_shadows(light, surface);
    if (found && contradicts_albedo(luminance(found->albedo), camera))
      return std::move(found->powers);
  }
  if (!(luminance(floor_->albedo) > 0))
    return fail(ErrorCode::kUndetermined, camera,
                "shows a floor of unknown albedo, and no shadow of a known thing");
  surface.albedo = floor_->albedo;
  auto found = lighting::recover_from_shadows(light, surface);
  // Shadows that do not tell all lights apart: what is lit tells of them together.
  if (!found && regions.size() > 1) {
    surface.regions = std::span(regions).first(1);
    found = lighting::recover_from_shadows(light, surface);
  }
  PENUMBRA_TRY(found);
  return std::move(found->powers);
}

// By more than it takes to believe the albedo again: the sun must not jump between two powers.
bool FloorRecovery::contradicts_albedo(float measured, const std::string& camera) {
  const float given = luminance(floor_->albedo);
  const float factor = by_shadow_ ? kAgreeingFactor : kAlbedoFactor;
  by_shadow_ = given > factor * measured || measured > factor * given;
  if (by_shadow_ && !std::exchange(warned_, true))
    log_warning(
        "{}: the floor's albedo is {:.2f} by a shadow on it{}; saturated light is recovered by "
        "that shadow",
        camera, measured,
        given > 0
            ? fmt::format(", not {:.2f} as given, or this camera and that of the surroundings "
                          "count light differently",
                          given)
            : "");
  return by_shadow_;
}

bool FloorRecovery::differs_from_said(const std::vector<lighting::SaturationRecovery>& found,
                                      const lighting::LightEstimate& light) const {
  return !std::ranges::all_of(found, [&](const lighting::SaturationRecovery& c) {
    if (c.source == lighting::kUnseenSun) {
      // By what it has now: behind clouds that is next to nothing, and noise is no news.
      const auto sun = std::ranges::find(light.lights, c.source, &lighting::DistantLight::id);
      if (sun == light.lights.end() || sun->is_lower_bound()) return false;
      const float had = luminance(sun->radiance) * static_cast<float>(sun->solid_angle_sr()),
                  others = static_cast<float>(kPi) * luminance(light.mean_radiance);
      return std::abs(luminance(c.power) - had) <= kMinChange * std::max(had, others);
    }
    const auto before = std::ranges::find(said_, c.source, &lighting::SaturationRecovery::source);
    if (before == said_.end() || (before->is_guess && !c.is_guess)) return false;
    // What the light has made of it since: shorter exposures leave less of a disc, and of power.
    const auto now = std::ranges::find(light.lights, c.source, &lighting::DistantLight::id);
    const bool refused = now != light.lights.end() && now->is_lower_bound();
    const float was = now == light.lights.end() || c.is_guess || refused
                          ? luminance(before->power)
                          : luminance(now->radiance) * static_cast<float>(now->solid_angle_sr());
    return std::abs(luminance(c.power) - was) <= kMinChange * was;
  });
}

Result<std::vector<lighting::SaturationRecovery>> FloorRecovery::observe(
    const capture::Frame& frame, const capture::CameraInfo& camera, const ResponseTable* curve,
    const lighting::LightEstimate& light) {
  std::vector<int> clipped;
  std::vector<const lighting::DistantLight*> lights;
  for (const lighting::DistantLight& d : light.lights)
    if (d.clipped && lights.size() < kMaxClipped) clipped.push_back(d.id), lights.push_back(&d);
  const bool rests = !frame.for_light && last_ && frame.time - *last_ < kInterval;
  looked_ = floor_ && !clipped.empty() && !(rests && clipped == tried_);
  if (!looked_) return std::vector<lighting::SaturationRecovery>{};
  last_ = frame.time;
  tried_ = std::move(clipped);
  auto found = recover(measure(frame, camera, curve, lights), light, lights, camera.name);
  if (!found) return found;
  if (!differs_from_said(*found, light)) return std::vector<lighting::SaturationRecovery>{};
  said_ = *found;
  return found;
}

}  // namespace penumbra::runtime
