#include "tools/chart/measures/accuracy.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/conventions.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/geometry/pinhole_view.h"
#include "prt/geometry/plane.h"
#include "runtime/scene/scene.h"

namespace penumbra::tools {

Result<Masks> make_masks(const runtime::PreparedScene& scene, const prt::PinholeView& view,
                         double seconds, const std::optional<calib::CameraModel>& lens) {
  // Sixteen samples a pixel call some full that are not: the sky behind them would count as the
  // object's error.
  constexpr int kFiner = 4;
  prt::PinholeView fine = view;
  fine.width *= kFiner, fine.height *= kFiner;
  fine.focal_px *= double(kFiner), fine.principal_px *= double(kFiner);
  std::optional<calib::CameraModel> fine_lens = lens;
  if (fine_lens) {
    fine_lens->width *= kFiner, fine_lens->height *= kFiner;
    fine_lens->focal_px *= double(kFiner), fine_lens->principal_px *= double(kFiner);
  }
  const Image<Rgb> white(64, 32, {1, 1, 1});
  const StillScene in{&scene, &white, fine, seconds, fine_lens};
  lighting::LightEstimate light;
  light.light[0] = light.upper_hemisphere_light[0] =
      Rgb{1, 1, 1} * static_cast<float>(std::sqrt(4 * kPi));
  light.valid = true;
  const auto over = [&](float backdrop) {
    const Image<Rgb> picture(fine.width, fine.height, {backdrop, backdrop, backdrop});
    return render_composite(in, light, Still{picture, 0, 0, {}, {}});
  };
  // A pixel that the object covers fully shows nothing of the backdrop.
  PENUMBRA_ASSIGN(dark, over(0));
  PENUMBRA_ASSIGN(bright, over(100));
  Masks masks;
  for (int y = 0; y < view.height; ++y)
    for (int x = 0; x < view.width; ++x) {
      bool object = true, open = true;
      for (int k = 0; k < kFiner * kFiner; ++k) {
        const int i = kFiner * x + k % kFiner, j = kFiner * y + k / kFiner;
        const float a = dark.radiance.at(i, j).g, b = bright.radiance.at(i, j).g;
        object &= a > 0 && std::abs(b - a) < 1e-3f;
        open &= a == 0;
      }
      const auto d = calib::direction_from_pixel(camera_of(view, lens), {x + .5, y + .5});
      masks.object.push_back(object);
      masks.floor.push_back(open && d && (view.world_from_camera.rotation * *d).y < 0);
    }
  return masks;
}

std::vector<bool> shaded_floor(const Image<Rgb>& full, const Image<Rgb>& empty,
                               const Masks& masks) {
  constexpr int kRadius = 4;
  constexpr double kShaded = .95;
  const int width = full.width(), height = full.height();
  const auto index = [width](int x, int y) { return static_cast<std::size_t>(y * width + x); };
  const auto is_shaded = [&](int x, int y) {
    double with = 0, without = 0;
    for (int j = std::max(0, y - kRadius); j <= std::min(height - 1, y + kRadius); ++j)
      for (int i = std::max(0, x - kRadius); i <= std::min(width - 1, x + kRadius); ++i) {
        if (!masks.floor[index(i, j)]) continue;
        with += luminance(full.at(i, j));
        without += luminance(empty.at(i, j));
      }
    return with < kShaded * without;
  };
  std::vector<bool> out(masks.floor.size());
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) out[index(x, y)] = masks.floor[index(x, y)] && is_shaded(x, y);
  return out;
}

namespace {

// Int grad s_a . grad s_b over the floor.
double edge_energy(const Image<Rgb>& a, const Image<Rgb>& b, const Image<Rgb>& empty,
                   const std::vector<bool>& floor) {
  const int width = a.width();
  const auto ratio = [&](const Image<Rgb>& picture, std::size_t i) {
    return double(luminance(picture.pixels()[i])) / luminance(empty.pixels()[i]);
  };
  double sum = 0;
  for (std::size_t i = 0; i < floor.size(); ++i) {
    const std::size_t right = i + 1, below = i + static_cast<std::size_t>(width);
    for (const std::size_t k : {right, below}) {
      if (k >= floor.size() || !floor[i] || !floor[k] ||
          (k == right && right % static_cast<std::size_t>(width) == 0))
        continue;
      sum += (ratio(a, k) - ratio(a, i)) * (ratio(b, k) - ratio(b, i));
    }
  }
  return sum;
}

double penumbra_error(const Still& ours, const Still& truth, const Still& empty,
                      const Masks& masks) {
  const double own = edge_energy(ours.radiance, ours.radiance, empty.radiance, masks.floor),
               real = edge_energy(truth.half_a, truth.half_b, empty.radiance, masks.floor);
  return own > 0 ? std::abs(real / own - 1) : std::numeric_limits<double>::quiet_NaN();
}

// The product of the errors against the reference's two halves. Channels that the compositor cut
// off at zero are an error where the reference is positive in them, taken together; that both
// halves decide it keeps their noise out of the mean.
double error_product(const Rgb& ours, const Rgb& half_a, const Rgb& half_b) {
  Rgb shown_a, shown_b, cut_a, cut_b;
  for (int c = 0; c < 3; ++c) {
    (ours[c] > 0 ? shown_a : cut_a)[c] = half_a[c] - ours[c];
    (ours[c] > 0 ? shown_b : cut_b)[c] = half_b[c] - ours[c];
  }
  double a = luminance(shown_a), b = luminance(shown_b);
  if (luminance(cut_a + cut_b) > 0) a += luminance(cut_a), b += luminance(cut_b);
  return a * b;
}

// The truth as the picture can show it: no negative light where ours was cut off at zero.
Rgb shown(Rgb truth, const Rgb& ours) {
  for (int c = 0; c < 3; ++c)
    if (ours[c] <= 0) truth[c] = std::max(0.f, truth[c]);
  return truth;
}

}  // namespace

Accuracy compare_pictures(const Still& ours, const Still& truth, const Still& empty,
                          const Masks& masks) {
  const std::vector<bool> shaded = shaded_floor(truth.radiance, empty.radiance, masks);
  double square = 0, mean = 0, bias = 0, objects = 0, shadow_square = 0, shadow_bias = 0,
         shadows = 0, noise = 0, product = 0;
  for (std::size_t i = 0; i < masks.object.size(); ++i) {
    const double a = luminance(ours.radiance.pixels()[i]);
    const double t = luminance(shown(truth.radiance.pixels()[i], ours.radiance.pixels()[i]));
    if (masks.object[i]) {
      square += (a - t) * (a - t);
      mean += t;
      bias += a - t;
      const double half_a = luminance(truth.half_a.pixels()[i]),
                   half_b = luminance(truth.half_b.pixels()[i]);
      noise += std::pow(half_a - half_b, 2) / 4;
      product += error_product(ours.radiance.pixels()[i], truth.half_a.pixels()[i],
                               truth.half_b.pixels()[i]);
      ++objects;
    } else if (shaded[i]) {
      const double open = luminance(empty.radiance.pixels()[i]);
      shadow_square += std::pow((a - t) / open, 2);
      shadow_bias += (a - t) / open;
      ++shadows;
    }
  }
  Accuracy out;
  out.object_rel_rmse = std::sqrt(square / objects) / (mean / objects);
  out.object_without_noise = std::sqrt(std::max(0., product / objects)) / (mean / objects);
  out.object_bias = bias / mean;
  out.shadow_bias = shadows > 0 ? shadow_bias / shadows : 0;
  out.shadow_rmse = shadows > 0 ? std::sqrt(shadow_square / shadows) : 0;
  out.penumbra_error = penumbra_error(ours, truth, empty, masks);
  out.reference_error = std::sqrt(noise / objects) / (mean / objects);
  return out;
}

void light_floor(const StillScene& in, const lighting::LightEstimate& light, const Masks& masks,
                 Still& empty) {
  const std::vector<prt::Plane>& planes = in.scene->planes;
  if (planes.empty()) return;
  const Rgb e = lighting::evaluate(lighting::irradiance(light_on(planes, light)), planes[0].normal);
  const Rgb exit = planes[0].albedo * e * static_cast<float>(1 / kPi);
  for (std::size_t i = 0; i < masks.floor.size(); ++i)
    if (masks.floor[i]) empty.radiance.pixels()[i] = exit;
}

}  // namespace penumbra::tools
