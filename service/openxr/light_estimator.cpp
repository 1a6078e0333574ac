#include "service/openxr/light_estimator.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace penumbra::openxr {

/// The light in the application's space and its engine's signs.
struct RoomLightEstimator::Turned {
  Harmonics total{}, ambient{};
  Vector3 mean{};  // radiance of the ambient part
  Vector3 irradiance{}, direction{};

  Turned(const MainAndAmbient& world, const SpaceRotation& from_world, const LayerSettings& s) {
    constexpr float kMeanOfFirst = .2820948f;
    irradiance = world.irradiance;
    for (std::size_t c = 0; c < 3; ++c) mean[c] = kMeanOfFirst * world.ambient[0][c];
    rotate_harmonics(from_world, world.total, total);
    rotate_harmonics(from_world, world.ambient, ambient);
    penumbra_sh_convert(s.convention, total, 3, total);
    penumbra_sh_convert(s.convention, ambient, 3, ambient);
    direction = rotated(from_world, world.towards);
    if (!s.towards_light)
      for (float& v : direction) v = -v;
    penumbra_direction_convert(s.convention, direction.data(), direction.data());
  }
};

namespace {

constexpr auto kValid = XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID;
constexpr auto kInvalid = XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID;

XrVector3f vector_of(const Vector3& v) {
  return {v[0], v[1], v[2]};
}

// The tint of a light for pictures in gamma space: green is 1.
XrVector3f colour_correction(const Vector3& mean) {
  if (!(mean[1] > 0)) return {1, 1, 1};
  const auto encoded = [&](std::size_t c) {
    return std::pow(std::max(0.f, mean[c] / mean[1]), 1 / 2.2f);
  };
  return {encoded(0), 1, encoded(2)};
}

XrBaseOutStructure* chain_of(XrLightEstimateANDROID& estimate) {
  return static_cast<XrBaseOutStructure*>(estimate.next);
}

template <class Struct>
Struct& as(XrBaseOutStructure& one) {
  return reinterpret_cast<Struct&>(one);
}

}  // namespace

void RoomLightEstimator::invalidate(XrLightEstimateANDROID& estimate) {
  estimate.state = kInvalid;
  for (XrBaseOutStructure* one = chain_of(estimate); one; one = one->next)
    switch (static_cast<std::int64_t>(one->type)) {
      case XR_TYPE_DIRECTIONAL_LIGHT_ANDROID:
        as<XrDirectionalLightANDROID>(*one).state = kInvalid;
        break;
      case XR_TYPE_AMBIENT_LIGHT_ANDROID:
        as<XrAmbientLightANDROID>(*one).state = kInvalid;
        break;
      case XR_TYPE_SPHERICAL_HARMONICS_ANDROID:
        as<XrSphericalHarmonicsANDROID>(*one).state = kInvalid;
        break;
      case XR_TYPE_CUBEMAP_LIGHTING_DATA_ANDROID:
        as<XrCubemapLightingDataANDROID>(*one).state = kInvalid;
        break;
      default:
        break;
    }
}

// Without the runtime's clock it is the application's time less the light's age. That varies with
// how far ahead the application asks, so it is taken once a light, and never goes back.
XrTime RoomLightEstimator::updated_time(const penumbra_light& light, const EstimateTime& at) {
  if (at.published) return *at.published;
  const std::lock_guard lock(mutex_);
  if (light.number != number_ || updated_ == 0) {
    updated_ = std::max<XrTime>(updated_ + 1, at.now - penumbra_light_age_ns(&light));
    number_ = light.number;
  }
  return updated_;
}

void RoomLightEstimator::fill(const penumbra_light& light, const EstimateTime& at,
                              XrLightEstimateANDROID& estimate) {
  const Turned turned(split_main_light(light), inverse(at.world_from_application), settings_);
  const XrTime updated = updated_time(light, at);
  estimate.state = kValid;
  estimate.lastUpdatedTime = updated;
  for (XrBaseOutStructure* one = chain_of(estimate); one; one = one->next)
    fill_struct(light, turned, at, updated, *one);
}

void RoomLightEstimator::fill_struct(const penumbra_light& light, const Turned& turned,
                                     const EstimateTime& at, XrTime updated,
                                     XrBaseOutStructure& one) {
  switch (static_cast<std::int64_t>(one.type)) {
    case XR_TYPE_DIRECTIONAL_LIGHT_ANDROID: {
      auto& out = as<XrDirectionalLightANDROID>(one);
      out.state = kValid;
      out.intensity = vector_of(turned.irradiance);
      out.direction = vector_of(turned.direction);
      break;
    }
    case XR_TYPE_AMBIENT_LIGHT_ANDROID: {
      auto& out = as<XrAmbientLightANDROID>(one);
      out.state = kValid;
      out.intensity = vector_of(turned.mean);
      out.colorCorrection = colour_correction(turned.mean);
      break;
    }
    case XR_TYPE_SPHERICAL_HARMONICS_ANDROID: {
      auto& out = as<XrSphericalHarmonicsANDROID>(one);
      const bool total = out.kind == XR_SPHERICAL_HARMONICS_KIND_TOTAL_ANDROID;
      const bool known = total || out.kind == XR_SPHERICAL_HARMONICS_KIND_AMBIENT_ANDROID;
      out.state = known ? kValid : kInvalid;
      std::memcpy(out.coefficients, total ? turned.total : turned.ambient, sizeof out.coefficients);
      break;
    }
    case XR_TYPE_CUBEMAP_LIGHTING_DATA_ANDROID: {
      auto& out = as<XrCubemapLightingDataANDROID>(one);
      out.state = fill_cube(light, at, updated, out) ? kValid : kInvalid;
      break;
    }
    default:
      break;
  }
}

bool RoomLightEstimator::fill_cube(const penumbra_light& light, const EstimateTime& at,
                                   XrTime updated, XrCubemapLightingDataANDROID& out) {
  if (!cube_request_) return false;
  const CubeRequest& asked = *cube_request_;
  const std::array<std::uint8_t*, 6> to = {out.imageBufferRight, out.imageBufferLeft,
                                           out.imageBufferTop,   out.imageBufferBottom,
                                           out.imageBufferFront, out.imageBufferBack};
  if (std::ranges::find(to, nullptr) != to.end() ||
      out.imageBufferSize < std::size_t{asked.size} * asked.size * texel_bytes(asked.format))
    return false;
  const SpaceRotation axes = asked.reproject ? at.world_from_application : SpaceRotation{};
  const std::lock_guard lock(mutex_);
  if (!cube_) cube_ = std::make_unique<penumbra_cube>();
  if (!room_.read(*cube_) && cube_number_ == 0) return false;
  if (cube_->number != cube_number_ || axes != cube_rotation_) {
    make_faces(*cube_, axes, asked.size, asked.format, images_);
    cube_number_ = cube_->number;
    cube_rotation_ = axes;
  }
  for (std::size_t f = 0; f < 6; ++f) std::memcpy(to[f], images_[f].data(), images_[f].size());
  // On the frames' own clock the cube is so much older than the light.
  out.centerExposureTime = updated - (light.capture_time_ns - cube_->capture_time_ns);
  out.rotation = asked.reproject ? XrQuaternionf{0, 0, 0, 1} : at.application_from_world;
  return true;
}

}  // namespace penumbra::openxr
