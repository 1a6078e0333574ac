#include "tools/chart/benches/flicker.h"

#include <cmath>

#include "calib/camera/response.h"
#include "capture/hdr/merge.h"
#include "capture/studio/sensor.h"
#include "capture/studio/studio.h"
#include "capture/studio/world.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/scene/scene.h"
#include "tools/chart/measures/accuracy.h"
#include "tools/pictures/still.h"

namespace penumbra::tools {

Result<std::vector<Image<Rgb>>> measured_maps(const Image<Rgb>& environment, int count) {
  // Brings radiance to the scale of a camera.
  PENUMBRA_ASSIGN(world, capture::FloorWorld::make(environment));
  const Image<Rgb>& scene = world->environment();
  double before = 0, after = 0;
  for (std::size_t i = 0; i < scene.area(); ++i)
    before += luminance(environment.pixels()[i]), after += luminance(scene.pixels()[i]);
  capture::Sensor sensor;
  sensor.response = calib::Response::srgb();
  const std::vector<Exposure> schedule = capture::choose_schedule(scene, sensor);
  std::vector<Image<Rgb>> out;
  for (int t = 0; t < count; ++t) {
    capture::ExposureStack stack{{}, schedule, sensor.response, sensor.noise, sensor.black_level};
    for (std::size_t k = 0; k < schedule.size(); ++k) {
      FramePixels pixels;
      const auto seed = static_cast<std::uint64_t>(t) * schedule.size() + k;
      capture::expose(sensor, scene, schedule[k], 7919 * seed + 1, pixels);
      stack.frames.push_back(std::make_shared<const FramePixels>(std::move(pixels)));
    }
    PENUMBRA_ASSIGN(merged, capture::merge(stack));
    for (Rgb& c : merged.radiance.pixels()) c = c * static_cast<float>(before / after);
    out.push_back(std::move(merged.radiance));
  }
  return out;
}

Result<double> measure_flicker(const ChartScene& bench, const runtime::PreparedScene& scene,
                               const LightOf& light, const runtime::ShadowSampling& sampling,
                               const Still& empty, std::span<const Image<Rgb>> maps) {
  PENUMBRA_ASSIGN(pipeline, make_still_pipeline(scene, bench.view(), sampling));
  const Masks& masks = bench.masks();
  Image<Rgb> before;
  double square = 0, mean = 0, count = 0;
  for (std::size_t t = 0; t < maps.size(); ++t) {
    PENUMBRA_ASSIGN(estimate,
                    light(maps[t], TimestampNs{0} + Seconds(static_cast<double>(t) / 30)));
    PENUMBRA_ASSIGN(picture, composite_still(pipeline, bench.view(), estimate, empty));
    for (std::size_t i = 0; t > 0 && i < masks.floor.size(); ++i) {
      if (!masks.floor[i] && !masks.object[i]) continue;
      const double now = luminance(picture.radiance.pixels()[i]);
      square += std::pow(now - double(luminance(before.pixels()[i])), 2);
      mean += now;
      ++count;
    }
    before = std::move(picture.radiance);
  }
  return std::sqrt(square / count) / (mean / count);
}

}  // namespace penumbra::tools
