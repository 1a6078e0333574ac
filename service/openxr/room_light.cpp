#include "service/openxr/room_light.h"

#include <algorithm>
#include <cmath>

namespace penumbra::openxr {

RoomLight::RoomLight() {
  penumbra_client_open(nullptr, &client_);  // without memory it stays null, which each read bears
}

RoomLight::~RoomLight() {
  penumbra_client_close(client_);
}

bool RoomLight::read(penumbra_light& out) {
  constexpr std::int64_t kLongestWrite_ns = 1'000'000'000;
  const std::lock_guard lock(mutex_);
  const int code = penumbra_client_light(client_, &out);
  if (code == PENUMBRA_BUSY && last_.valid && penumbra_light_age_ns(&last_) < kLongestWrite_ns) {
    out = last_;
    return true;
  }
  if (code != PENUMBRA_OK || !out.valid) return false;
  last_ = out;
  return true;
}

bool RoomLight::read(penumbra_cube& out) {
  const std::lock_guard lock(mutex_);
  return penumbra_client_cube(client_, &out) == PENUMBRA_OK;
}

namespace {

constexpr float kConstant = .2820948f, kLinear = .4886025f;
constexpr float kCrossed = 1.0925484f, kPole = .3153916f, kSquares = .5462742f;

float luminance_of(const float* rgb) {
  return .2126f * rgb[0] + .7152f * rgb[1] + .0722f * rgb[2];
}

// The harmonics of a disc of even radiance: those of a point, weakened in each band by the mean of
// P_l(cos) over the disc, which is (1 + c)/2 and c(1 + c)/2 for its rim's cosine c.
void add_disc(const penumbra_distant_light& light, Harmonics& sh) {
  const float x = light.direction[0], y = light.direction[1], z = light.direction[2];
  const float c = std::cos(light.radius_rad);
  const float one = kLinear * (1 + c) / 2, two = c * (1 + c) / 2;
  const float basis[9] = {kConstant,
                          one * y,
                          one * z,
                          one * x,
                          two * kCrossed * x * y,
                          two * kCrossed * y * z,
                          two * kPole * (3 * z * z - 1),
                          two * kCrossed * x * z,
                          two * kSquares * (x * x - y * y)};
  for (std::size_t n = 0; n < 9; ++n)
    for (std::size_t i = 0; i < 3; ++i)
      sh[n][i] += basis[n] * light.radiance[i] * light.solid_angle_sr;
}

void copy_bands(const float (&from)[PENUMBRA_PAGE_COEFFICIENTS][3], std::uint32_t bands,
                Harmonics& to) {
  for (std::size_t n = 0; n < std::min(std::size_t{9}, std::size_t{bands} * bands); ++n)
    for (std::size_t i = 0; i < 3; ++i) to[n][i] = from[n][i];
}

Vector3 brightest_side(const Harmonics& sh) {
  const Vector3 v = {luminance_of(sh[3]), luminance_of(sh[1]), luminance_of(sh[2])};
  const float length = std::hypot(v[0], v[1], v[2]);
  if (!(length > 0)) return {0, 1, 0};
  return {v[0] / length, v[1] / length, v[2] / length};
}

}  // namespace

MainAndAmbient split_main_light(const penumbra_light& light) {
  MainAndAmbient out;
  copy_bands(light.coefficients, light.bands, out.total);
  copy_bands(light.residual, light.bands, out.ambient);
  const penumbra_distant_light* main = nullptr;
  float most = 0;
  for (std::uint32_t i = 0; i < light.light_count; ++i) {
    const float power = luminance_of(light.lights[i].radiance) * light.lights[i].solid_angle_sr;
    if (power > most) main = &light.lights[i], most = power;
  }
  for (std::uint32_t i = 0; i < light.light_count; ++i)
    if (&light.lights[i] != main) add_disc(light.lights[i], out.ambient);
  if (!main) {
    out.towards = brightest_side(out.total);
    return out;
  }
  for (std::size_t i = 0; i < 3; ++i) {
    out.irradiance[i] = main->radiance[i] * main->solid_angle_sr;
    out.towards[i] = main->direction[i];
  }
  return out;
}

}  // namespace penumbra::openxr
