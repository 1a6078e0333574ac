#include "service/rig_source.h"

#include "capture/device/rig.h"
#include "capture/recording/undamaged_frames.h"
#include "capture/studio/environments.h"
#include "capture/studio/studio.h"
#include "runtime/pipeline/light_file.h"
#include "runtime/studio/studio_setup.h"
#include "service/played_source.h"
#include "service/still_environment.h"

namespace penumbra::service {

namespace {

// A capture played again and again, its times running on.
class LoopingCapture : public capture::FrameSource {
 public:
  static Result<std::unique_ptr<LoopingCapture>> open(const std::string& path) {
    PENUMBRA_ASSIGN(first, capture::UndamagedFrames::open(path, capture::RecordedLight::kEither));
    auto out = std::unique_ptr<LoopingCapture>(new LoopingCapture);
    out->path_ = path;
    out->cameras_ = first->cameras();
    out->source_ = std::move(first);
    return out;
  }
  const std::vector<capture::CameraInfo>& cameras() const override { return cameras_; }
  double view_rate() const override { return source_->view_rate(); }
  Result<std::optional<capture::Frame>> next() override {
    auto frame = source_->next();
    if (!frame) return frame;
    if (!*frame) {
      PENUMBRA_ASSIGN(again,
                      capture::UndamagedFrames::open(path_, capture::RecordedLight::kEither));
      again->keep_quiet();
      source_ = std::move(again);
      frame = source_->next();
      if (!frame || !*frame) return frame;
      offset_ns_ = last_ns_ + 33'000'000 - (*frame)->time.value;
    }
    (*frame)->time.value += offset_ns_;
    last_ns_ = (*frame)->time.value;
    return frame;
  }

 private:
  LoopingCapture() = default;
  std::string path_;
  std::vector<capture::CameraInfo> cameras_;
  std::unique_ptr<capture::FrameSource> source_;
  std::int64_t offset_ns_ = 0, last_ns_ = 0;
};

// Finer than what an object's light can tell apart.
constexpr int kMapWidth = 1024;

Result<Image<Rgb>> read_map(const std::string& name) {
  if (name == "builtin:room") return capture::make_room_environment(kMapWidth / 2, kMapWidth / 4);
  PENUMBRA_ASSIGN(light, runtime::read_light(name));
  PENUMBRA_ASSIGN(map, runtime::whole_latlong(light));
  while (map.width() > kMapWidth && map.width() % 2 == 0 && map.height() % 2 == 0) {
    Image<Rgb> half(map.width() / 2, map.height() / 2);
    for (int y = 0; y < half.height(); ++y)
      for (int x = 0; x < half.width(); ++x)
        half.at(x, y) = (map.at(2 * x, 2 * y) + map.at(2 * x + 1, 2 * y) +
                         map.at(2 * x, 2 * y + 1) + map.at(2 * x + 1, 2 * y + 1)) *
                        .25f;
    map = std::move(half);
  }
  return map;
}

Result<std::unique_ptr<StillEnvironment>> with_light_of_file(
    std::unique_ptr<capture::FrameSource> frames, const RigConfig& c) {
  PENUMBRA_ASSIGN(map, read_map(*c.light_environment));
  StillEnvironmentOptions options{.map = std::move(map),
                                  .scale = c.environment_scale,
                                  .boards = {},
                                  .paper_albedo = c.paper_albedo};
  if (c.pose) options.boards = c.pose->boards;
  return StillEnvironment::create(std::move(frames), std::move(options));
}

}  // namespace

Result<RigSource> open_rig(const RigConfig& c, const ProgressOf& progress, PlayedTimes times,
                           std::unique_ptr<capture::PoseSource> head) {
  RigSource rig;
  if (c.source == "studio") {
    const runtime::StudioRequest request{.environment = c.environment,
                                         .asset = c.asset,
                                         .real_mesh = c.real_mesh,
                                         .width = c.width,
                                         .height = c.height,
                                         .fps = c.fps,
                                         .frames = 1 << 30,
                                         .clip = 16};
    PENUMBRA_ASSIGN(setup, runtime::set_up_studio(request, progress));
    rig.scene = std::move(setup.scene);
    rig.source = std::make_unique<capture::Studio>(setup.world, setup.options);
  } else if (c.source == "cameras") {
    PENUMBRA_ASSIGN(source, capture::Rig::open(c.cameras));
    rig.source = std::move(source);
  } else {
    PENUMBRA_ASSIGN(source, LoopingCapture::open(c.source));
    rig.source = std::move(source);
  }
  // A track's poses have the times of the frames as they were taken, all others those of now.
  const bool by_track = c.pose && c.pose->source == "track";
  const auto play_now = [&] {
    if (times == PlayedTimes::kOfNow && c.source != "cameras")
      rig.source = std::make_unique<PlayedSource>(std::move(rig.source));
  };
  if (!by_track) play_now();
  if (c.pose) {
    PENUMBRA_ASSIGN(posed, with_poses(std::move(rig.source), *c.pose, std::move(head)));
    rig.posed = posed.get();
    rig.source = std::move(posed);
  }
  if (by_track) play_now();
  if (c.light_environment) {
    PENUMBRA_ASSIGN(lit, with_light_of_file(std::move(rig.source), c));
    rig.source = std::move(lit);
  }
  if (c.own_scene) rig.scene = *c.own_scene;
  if (c.scene) {
    PENUMBRA_ASSIGN(scene, runtime::read_scene(*c.scene));
    rig.scene = std::move(scene);
  }
  return rig;
}

}  // namespace penumbra::service
