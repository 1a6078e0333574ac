#include "tools/chart/peers/baselines.h"

#include <algorithm>
#include <cmath>

#include "core/conventions.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/projection.h"
#include "prt/bake/bake.h"
#include "prt/transfer/transfer.h"

namespace penumbra::tools {

namespace {

using lighting::DistantLight;
using lighting::LightEstimate;

// A point light in all but name: its shadow is hard.
const Radians kPoint(.002);

DistantLight point_light(int id, const glm::dvec3& direction, const double (&energy)[3]) {
  DistantLight source;
  source.id = id;
  source.direction = direction;
  source.radius = kPoint;
  for (int c = 0; c < 3; ++c)
    source.radiance[c] = static_cast<float>(std::max(0., energy[c]) / source.solid_angle_sr());
  return source;
}

LightEstimate black(int bands) {
  LightEstimate light;
  light.light = light.upper_hemisphere_light = RadianceSh(bands);
  light.valid = true;
  light.coverage = 1;
  return light;
}

void set_mean(LightEstimate& light) {
  light.mean_radiance = light.light[0] * static_cast<float>(1 / std::sqrt(4 * kPi));
  for (const DistantLight& d : light.lights)
    light.mean_radiance += d.radiance * static_cast<float>(d.solid_angle_sr() / (4 * kPi));
}

// Median cut on the map itself: regions of pixels [x0, x1) x [y0, y1).
struct Region {
  int x0, y0, x1, y1;
};

class MedianCut {
 public:
  explicit MedianCut(const Image<Rgb>& map) : map_(map) {}

  void cut(const Region& r, int count, std::vector<DistantLight>& out) {
    if (count <= 1 || (r.x1 - r.x0 <= 1 && r.y1 - r.y0 <= 1)) {
      add(r, out);
      return;
    }
    // The longer side in angle: rows near the poles are short.
    const double middle = kPi * (r.y0 + r.y1) / 2. / map_.height();
    const double wide = 2. * (r.x1 - r.x0) / map_.width() * std::sin(middle),
                 high = static_cast<double>(r.y1 - r.y0) / map_.height();
    const bool along_x = r.y1 - r.y0 <= 1 || (wide > high && r.x1 - r.x0 > 1);
    const double half = .5 * energy(r);
    int at = along_x ? r.x0 : r.y0;
    const int last = (along_x ? r.x1 : r.y1) - 1;
    for (double sum = 0; at < last - 1; ++at) {
      const Region line = along_x ? Region{at, r.y0, at + 1, r.y1} : Region{r.x0, at, r.x1, at + 1};
      sum += energy(line);
      if (sum >= half) break;
    }
    cut(along_x ? Region{r.x0, r.y0, at + 1, r.y1} : Region{r.x0, r.y0, r.x1, at + 1}, count / 2,
        out);
    cut(along_x ? Region{at + 1, r.y0, r.x1, r.y1} : Region{r.x0, at + 1, r.x1, r.y1}, count / 2,
        out);
  }

 private:
  double energy(const Region& r) const {
    double sum = 0;
    for (int y = r.y0; y < r.y1; ++y) {
      double row = 0;
      for (int x = r.x0; x < r.x1; ++x) row += luminance(map_.at(x, y));
      sum += row * latlong_solid_angle(y, map_.width(), map_.height());
    }
    return sum;
  }

  void add(const Region& r, std::vector<DistantLight>& out) const {
    double rgb[3] = {};
    glm::dvec3 centre(0);
    for (int y = r.y0; y < r.y1; ++y) {
      const double w = latlong_solid_angle(y, map_.width(), map_.height());
      for (int x = r.x0; x < r.x1; ++x) {
        const Rgb& c = map_.at(x, y);
        for (int k = 0; k < 3; ++k) rgb[k] += w * c[k];
        centre += w * luminance(c) * latlong_direction(x + .5, y + .5, map_.width(), map_.height());
      }
    }
    if (glm::length(centre) > 0)
      out.push_back(point_light(static_cast<int>(out.size()) + 1, glm::normalize(centre), rgb));
  }

  const Image<Rgb>& map_;
};

// A_l Y_n(normal)/pi at every point, times a factor of its own.
template <class Normal, class Factor>
prt::Transfer open_transfer(int bands, std::size_t points, Normal normal, Factor factor) {
  prt::Transfer out(bands, 1, points);
  double basis[kMaxCoefficients];
  for (std::size_t p = 0; p < points; ++p) {
    lighting::evaluate_basis(bands, glm::normalize(glm::dvec3(normal(p))), basis);
    for (int l = 0; l < bands; ++l)
      for (int m = -l; m <= l; ++m) {
        const int n = sh_index(l, m);
        out.set(0, n, p,
                static_cast<float>(lighting::cosine_coefficient(l) / kPi * basis[n] * factor(p)));
      }
  }
  return out;
}

void clear(prt::Transfer& t) {
  std::ranges::fill(t.values, std::uint16_t{0});
}

}  // namespace

LightEstimate sampled_lights(const Image<Rgb>& map, int count) {
  LightEstimate light = black(1);
  MedianCut(map).cut({0, 0, map.width(), map.height()}, count, light.lights);
  set_mean(light);
  return light;
}

LightEstimate phone_light(const Image<Rgb>& map) {
  LightEstimate light = black(1);
  const auto projection = lighting::project_latlong(map, 2);
  if (!projection) return light;
  const RadianceSh& l = projection->light;
  const glm::dvec3 sum(luminance(l[3]), luminance(l[1]), luminance(l[2]));
  const glm::dvec3 direction = glm::length(sum) > 0 ? glm::normalize(sum) : glm::dvec3(0, 1, 0);
  // A light of energy F in that direction has the linear band F sqrt(3/4pi) d: it explains all of
  // that band.
  double energy[3], basis[4];
  lighting::evaluate_basis(2, direction, basis);
  for (int c = 0; c < 3; ++c) {
    double along = 0;
    for (int n = 1; n < 4; ++n) along += l[n][c] * basis[n];
    const double whole = l[0][c] * std::sqrt(4 * kPi);
    energy[c] = std::clamp(along * 4 * kPi / 3, 0., whole);
    light.light[0][c] = static_cast<float>((whole - energy[c]) / std::sqrt(4 * kPi));
  }
  light.upper_hemisphere_light = light.light;
  light.lights.push_back(point_light(1, direction, energy));
  set_mean(light);
  return light;
}

LightEstimate dissertation_light(const Image<Rgb>& map) {
  LightEstimate light = black(3);
  if (const auto projection = lighting::project_latlong(map, 3))
    light.light = light.upper_hemisphere_light = projection->light;
  set_mean(light);
  return light;
}

runtime::PreparedScene without_floor_shadow(const runtime::PreparedScene& scene) {
  runtime::PreparedScene out = scene;
  for (runtime::PreparedObject& o : out.objects) {
    clear(o.baked.ground_deficit);
    clear(o.baked.ground_reflected);
  }
  return out;
}

runtime::PreparedScene without_shadows(const runtime::PreparedScene& scene) {
  runtime::PreparedScene out = without_floor_shadow(scene);
  for (runtime::PreparedObject& o : out.objects) {
    const auto& normals = o.baked.mesh.normals;
    o.baked.transfer = open_transfer(
        o.baked.transfer.bands, normals.size(), [&](std::size_t p) { return normals[p]; },
        [](std::size_t) { return 1.; });
    clear(o.baked.reflected);
  }
  return out;
}

runtime::PreparedScene with_ambient_occlusion(const runtime::PreparedScene& scene) {
  runtime::PreparedScene out = without_shadows(scene);
  const double open = lighting::cosine_coefficient(0) / kPi / std::sqrt(4 * kPi);
  for (std::size_t i = 0; i < out.objects.size(); ++i) {
    const prt::BakedObject& truth = scene.objects[i].baked;
    prt::BakedObject& o = out.objects[i].baked;
    const auto& normals = truth.mesh.normals;
    o.transfer = open_transfer(
        truth.transfer.bands, normals.size(), [&](std::size_t p) { return normals[p]; },
        [&](std::size_t p) { return truth.transfer.value(0, 0, p) / open; });
    if (!truth.receiver) continue;
    o.ground_deficit = open_transfer(
        truth.ground_deficit.bands, truth.ground_deficit.points,
        [](std::size_t) { return glm::vec3(0, 1, 0); },
        [&](std::size_t p) { return truth.ground_deficit.value(0, 0, p) / open; });
  }
  return out;
}

}  // namespace penumbra::tools
