// What a frame costs as a whole: a light update of one object with default settings, and
// compositing it.
#include <cmath>

#include "bench/harness.h"
#include "calib/calib.h"
#include "capture/capture.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "runtime/shading/composite_stage.h"

namespace penumbra::bench {
namespace {

using runtime::CompositeStage;

struct UpdateSetup {
  runtime::PreparedScene scene;
  std::vector<capture::CameraInfo> cameras{1};
  lighting::LightEstimate light;

  UpdateSetup() {
    runtime::SceneObject object;
    object.name = "knot", object.asset = "builtin:knot", object.place_on_floor = true;
    runtime::RealGeometry floor;
    floor.plane = runtime::RealPlane{};
    floor.albedo = Rgb{.4f, .4f, .4f};
    scene = *runtime::prepare({{object}, {floor}}, {},
                              [](const std::string&) { return std::function<void(double)>(); });
    capture::CameraInfo& c = cameras[0];
    c.name = "view";
    c.role = capture::Role::kView;
    c.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 1280, 720);
    c.projection.focal_px = {1050, 1050};
    c.response = calib::Response::srgb();
    c.world_from_camera = capture::look_at({.25, .8, 1.75}, {.02, .25, 0});
    light = *lighting::estimate_map(capture::make_sky_environment(1024, 512, .7), {});
    for (lighting::DistantLight& d : light.lights) d.id = 1;
  }
  std::unique_ptr<CompositeStage> stage(StageTimes& times, bool with_effects = false) const {
    std::vector<capture::CameraInfo> seen_by = cameras;
    seen_by[0].noise_known = with_effects;
    if (with_effects) seen_by[0].psf_sigma_px = .7;
    auto made =
        CompositeStage::create(seen_by, scene, compositor::Compositor::Surface::kOffscreen, times);
    return made ? std::move(*made) : nullptr;
  }
};
const UpdateSetup& update_setup() {
  static const UpdateSetup one;
  return one;
}

lighting::LightEstimate turned(const lighting::LightEstimate& light, double radians) {
  const glm::dmat3 turn = glm::mat3_cast(glm::angleAxis(radians, glm::dvec3(0, 1, 0)));
  lighting::LightEstimate out = light;
  const lighting::ShRotation rotation(turn, light.light.bands());
  out.light = rotation * light.light;
  out.upper_hemisphere_light = rotation * light.upper_hemisphere_light;
  for (lighting::DistantLight& d : out.lights) d.direction = turn * d.direction;
  return out;
}

void report(benchmark::State& state, const StageTimes& times) {
  for (const auto& [name, p] : times.summary()) state.counters[name + "_ms"] = p.p50_ms;
}

// What brings the light that moves, or that changes where it stands.
enum Source { kStands, kSun, kSpot, kSmallLamp, kBroadLamp, kThreeLamps };

double radius_of(Source source) {
  constexpr double kDegrees[] = {0, 0, 1.9, 5, 10, 10};  // in its order
  return kDegrees[source] * kPi / 180;
}

// The sky's sun as it is, or as a lamp; for each update as far as it moves.
lighting::LightEstimate light_of(Source source) {
  lighting::LightEstimate out = update_setup().light;
  if (source == kStands || source == kSun) return out;
  lighting::DistantLight& lamp = out.lights[0];
  const double before = lamp.solid_angle_sr();
  lamp.radius = Radians{radius_of(source)};
  lamp.radiance = lamp.radiance * static_cast<float>(before / lamp.solid_angle_sr());
  out.lights.resize(1);
  if (source != kThreeLamps) return out;
  for (const int id : {2, 3}) {
    out.lights.push_back(out.lights[0]);
    out.lights.back().id = id;
    out.lights.back().direction =
        glm::angleAxis(id * 1., glm::dvec3(0, 1, 0)) * out.lights[0].direction;
  }
  return out;
}

// Peer: the same light once more, which costs the comparison alone.
void light_update(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  const auto source = static_cast<Source>(state.range(1));
  const double step = source == kSun ? .01 : .05;  // radians
  StageTimes times;
  const auto stage = update_setup().stage(times);
  if (!stage) return state.SkipWithError("no OpenGL ES 3.1");
  const lighting::LightEstimate start = light_of(source);
  lighting::LightEstimate light = start;
  double angle = 0;
  compare(
      state,
      [&] {
        angle += step;
        if (source != kStands) light = turned(start, angle);
        if (source == kStands)
          light.light[0] += Rgb{.1f, .1f, .1f}, light.upper_hemisphere_light = light.light;
        stage->shade(light, 0);
      },
      [&] { stage->shade(light, 0); });
  report(state, times);
}
BENCHMARK(light_update)
    ->Name("runtime/light_update_of_the_knot_vs_unchanged_light")
    ->ArgNames({"threads", "source"})
    ->Args({1, kStands})
    ->Args({1, kSun})
    ->Args({1, kSpot})
    ->Args({1, kSmallLamp})
    ->Args({1, kBroadLamp})
    ->Args({1, kThreeLamps})
    ->Args({2, kSun})
    ->Iterations(3 * kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

// A camera that moves with every frame over a standing light, without and with its blur and noise;
// peer: a copy of the frame.
void composite_frame(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  StageTimes times;
  const auto stage = update_setup().stage(times, state.range(1) != 0);
  if (!stage) return state.SkipWithError("no OpenGL ES 3.1");
  capture::Frame frame;
  frame.exposure = {Seconds(1), Gain(1)};
  frame.world_from_camera = update_setup().cameras[0].world_from_camera;
  const Image<Rgb8> picture(1280, 720, {120, 110, 100});
  frame.pixels = std::make_shared<const FramePixels>(picture);
  double touched = 0;
  compare(
      state,
      [&] {
        frame.world_from_camera.translation.x += 1e-4;
        touched = stage->process(frame, update_setup().light)->touched.fraction;
      },
      [&] {
        Image<Rgb8> copy = picture;
        benchmark::DoNotOptimize(copy.pixels().data());
      });
  state.counters["touched"] = touched;
  report(state, times);
}
BENCHMARK(composite_frame)
    ->Name("runtime/composite_1280x720_moving_camera_vs_frame_copy")
    ->ArgNames({"threads", "effects"})
    ->Args({1, 0})
    ->Args({2, 0})
    ->Args({2, 1})
    ->Iterations(3 * kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
