// What a frame costs while objects move, beside one bare occlusion ray of Embree from each vertex
// that moves. One object, light or size more at a time shows how the cost grows.
#include <sys/resource.h>

#include <cmath>

#include "bench/harness.h"
#include "calib/calib.h"
#include "capture/capture.h"
#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "lighting/lighting.h"
#include "prt/rays/rays.h"
#include "runtime/shading/composite_stage.h"

namespace penumbra::bench {
namespace {

// What is in the picture and what of it moves.
struct MovingCase {
  const char* asset;
  int objects, moving;
  int lights;             // a sun, then lamps of five degrees
  int width;              // pixels, 16 : 9
  bool coarse = false;    // a quarter of the vertices
  bool camera = true;     // moves, too
  const char* clip = "";  // that it plays
};
constexpr MovingCase kCases[] = {
    {"builtin:knot", 2, 1, 1, 1280},
    {"builtin:knot", 3, 3, 3, 1280},
    {"builtin:knot", 8, 1, 1, 1280, true, false},
    {"builtin:knot", 1, 1, 1, 1280, true, false},
    {"builtin:walker", 1, 1, 1, 1280, false, false, "Walk"},
    // Growth: in vertices,
    {"builtin:knot", 1, 1, 1, 640},
    {"builtin:knot", 2, 2, 1, 640},
    {"builtin:knot", 4, 4, 1, 640},
    // in lights,
    {"builtin:knot", 1, 1, 2, 640},
    {"builtin:knot", 1, 1, 4, 640},
    // in pixels.
    {"builtin:knot", 1, 1, 1, 320},
    {"builtin:knot", 1, 1, 1, 1280},
};

double process_seconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) { return double(t.tv_sec) + 1e-6 * double(t.tv_usec); };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

runtime::Scene scene_of(const MovingCase& c) {
  runtime::Scene scene;
  for (int k = 0; k < c.objects; ++k) {
    runtime::SceneObject o;
    o.name = "object " + std::to_string(k);
    o.asset = c.asset;
    o.animation = c.clip;
    o.place_on_floor = true;
    o.fit_size_m = c.objects > 4 ? .3 : .5;
    const double angle = 2 * kPi * k / c.objects, radius = c.objects > 1 ? .16 * c.objects : 0;
    o.position = {radius * std::cos(angle), 0, radius * std::sin(angle)};
    if (k < c.moving && o.animation.empty()) o.spin_rpm = 6;
    scene.objects.push_back(o);
  }
  runtime::RealGeometry floor;
  floor.plane = runtime::RealPlane{};
  floor.albedo = Rgb{.4f, .4f, .4f};
  scene.real.push_back(floor);
  return scene;
}

lighting::LightEstimate light_of(const MovingCase& c) {
  lighting::LightEstimate light =
      *lighting::estimate_map(capture::make_sky_environment(1024, 512, .7), {});
  light.lights.resize(1);
  light.lights[0].id = 1;
  while (static_cast<int>(light.lights.size()) < c.lights) {
    lighting::DistantLight lamp = light.lights[0];
    lamp.id = static_cast<int>(light.lights.size()) + 1;
    lamp.direction = glm::angleAxis(1.3 * lamp.id, glm::dvec3(0, 1, 0)) * lamp.direction;
    const double before = lamp.solid_angle_sr();
    lamp.radius = Radians{5 * kPi / 180};
    lamp.radiance = lamp.radiance * static_cast<float>(.5 * before / lamp.solid_angle_sr());
    light.lights.push_back(lamp);
  }
  return light;
}

// One ray towards the sun from each vertex of what moves.
class BarePass {
 public:
  explicit BarePass(const runtime::PreparedScene& scene, std::size_t moving,
                    const glm::dvec3& towards)
      : scene_(&scene), moving_(moving), towards_(towards), world_(*prt::RayWorld::create()) {
    for (std::size_t k = 0; k < scene.objects.size(); ++k) {
      (void)world_.add(scene.objects[k].baked.mesh);
      world_.set_pose(static_cast<int>(k), scene.objects[k].world_from_bake);
    }
  }
  void trace() const {
    constexpr std::size_t kPacket = prt::RayWorld::kPacket;
    for (std::size_t k = 0; k < moving_; ++k) {
      const prt::Mesh& mesh = scene_->objects[k].baked.mesh;
      const Pose& pose = scene_->objects[k].world_from_bake;
      const glm::mat3 turn = pose.rotation_matrix();
      const glm::vec3 shift(pose.translation);
      parallel_for(
          std::size_t{0}, (mesh.positions.size() + kPacket - 1) / kPacket, [&](std::size_t packet) {
            prt::RayWorld::Rays rays;
            const std::size_t first = packet * kPacket,
                              count = std::min(kPacket, mesh.positions.size() - first);
            for (std::size_t i = 0; i < count; ++i) {
              const glm::vec3 p =
                  turn * (mesh.positions[first + i] + 1e-3f * mesh.normals[first + i]) + shift;
              rays.ox[i] = p.x, rays.oy[i] = p.y, rays.oz[i] = p.z;
              rays.dx[i] = towards_.x, rays.dy[i] = towards_.y, rays.dz[i] = towards_.z;
            }
            benchmark::DoNotOptimize(world_.occluded(rays, static_cast<int>(count)));
          });
    }
  }

 private:
  const runtime::PreparedScene* scene_;
  std::size_t moving_;
  glm::vec3 towards_;
  prt::RayWorld world_;
};

void moving(benchmark::State& state) {
  const Threads threads(static_cast<int>(state.range(0)));
  const MovingCase& c = kCases[state.range(1)];
  const lighting::LightEstimate light = light_of(c);
  runtime::BakeSettings settings;
  if (c.coarse) settings.max_edge_fraction = .06f;
  const auto scene = runtime::prepare(
      scene_of(c), settings, [](const std::string&) { return std::function<void(double)>(); });
  if (!scene) return state.SkipWithError(scene.error().detail.c_str());
  std::vector<capture::CameraInfo> cameras{1};
  cameras[0].name = "view";
  cameras[0].role = capture::Role::kView;
  const int height = c.width * 9 / 16;
  cameras[0].projection = *calib::make_projection(calib::ProjectionKind::kPinhole, c.width, height);
  cameras[0].projection.focal_px = glm::dvec2(.82 * c.width);
  cameras[0].response = calib::Response::srgb();
  cameras[0].world_from_camera = capture::look_at({.25, .9, 1.9}, {.02, .2, 0});
  StageTimes times;
  auto stage = runtime::CompositeStage::create(cameras, *scene,
                                               compositor::Compositor::Surface::kOffscreen, times);
  if (!stage) return state.SkipWithError("no OpenGL ES 3.1");
  capture::Frame frame;
  frame.exposure = {Seconds(1), Gain(1)};
  frame.world_from_camera = cameras[0].world_from_camera;
  frame.pixels = std::make_shared<const FramePixels>(Image<Rgb8>(c.width, height, {120, 110, 100}));
  const BarePass bare(*scene, static_cast<std::size_t>(c.moving), light.lights[0].direction);
  double busy_s = 0, touched = 0;
  int frames = 0;
  compare(
      state,
      [&] {
        frame.time = frame.time + Seconds(1. / 60);
        if (c.camera) frame.world_from_camera.translation.x += 1e-3;
        const double before = process_seconds();
        touched = (*stage)->process(frame, light)->touched.fraction;
        busy_s += process_seconds() - before;
        ++frames;
      },
      [&] { bare.trace(); });
  std::size_t vertices = 0;
  for (int k = 0; k < c.moving; ++k)
    vertices += scene->objects[static_cast<std::size_t>(k)].baked.mesh.positions.size();
  state.counters["vertices"] = static_cast<double>(vertices);
  state.counters["lights"] = c.lights;
  state.counters["touched_pixels"] = touched * c.width * height;
  state.counters["processor_ms"] = 1e3 * busy_s / frames;
  for (const auto& [name, p] : times.summary()) state.counters[name + "_ms"] = p.p50_ms;
}

void every_case(benchmark::internal::Benchmark* b) {
  for (int c = 0; c < static_cast<int>(std::size(kCases)); ++c) b->Args({2, c});
}
BENCHMARK(moving)
    ->Name("runtime/moving")
    ->ArgNames({"threads", "case"})
    ->Apply(every_case)
    ->Iterations(7 * kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
