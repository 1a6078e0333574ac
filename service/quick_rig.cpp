#include "service/quick_rig.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <utility>

#include "capture/device/cameras.h"
#include "capture/recording/folder.h"
#include "core/io/log.h"

namespace penumbra::service {

namespace {

constexpr int kLargestWidth = 1280, kSmallestWidth = 640;
constexpr double kLeast_fps = 24;

// The largest picture that is not too large to be composited at the camera's rate.
const capture::CameraMode* best_mode(const capture::CameraListing& camera) {
  const capture::CameraMode* best = nullptr;
  for (const capture::CameraMode& m : camera.modes) {
    if (!m.readable || m.format == capture::kDepthFormat || m.width < kSmallestWidth ||
        m.width > kLargestWidth)
      continue;
    if (m.max_fps > 0 && m.max_fps < kLeast_fps) continue;
    if (!best || m.width * m.height > best->width * best->height) best = &m;
  }
  return best;
}

// Three quarters of a webcam's width, which is 67 degrees across.
calib::CameraModel guessed_lens(int width, int height) {
  constexpr double kFocal = .75;
  log_warning(
      "the lens is a guess, and objects may swim: `penumbra calibrate camera` measures it, "
      "--lens takes the result");
  return {calib::ProjectionKind::kPinhole,     width, height, glm::dvec2(kFocal * width),
          glm::dvec2(.5 * width, .5 * height), {}};
}

Result<capture::RigCamera> quick_camera(const QuickStart& quick) {
  const capture::CameraList list = capture::list_cameras();
  const auto fits = [&](const capture::CameraListing& c) {
    return (quick.source.empty() || c.device == quick.source) && best_mode(c) != nullptr;
  };
  const auto found = std::ranges::find_if(list.cameras, fits);
  if (found == list.cameras.end())
    return fail(ErrorCode::kNotFound, quick.source.empty() ? "camera" : quick.source,
                fmt::format("no camera here gives pictures {} to {} pixels wide, {:.0f} a second: "
                            "`penumbra inspect cameras` lists them",
                            kSmallestWidth, kLargestWidth, kLeast_fps));
  const capture::CameraMode& mode = *best_mode(*found);
  capture::RigCamera out;
  out.info.name = "webcam";
  out.info.role = capture::Role::kView;
  out.info.response = calib::Response::srgb();
  out.settings.device = found->device;
  out.settings.width = mode.width;
  out.settings.height = mode.height;
  out.settings.fps = mode.max_fps > 0 ? std::min(30., mode.max_fps) : 30;
  if (quick.lens.empty()) {
    out.info.projection = guessed_lens(mode.width, mode.height);
  } else {
    PENUMBRA_ASSIGN(camera, capture::read_camera_file(quick.lens));
    if (camera.projection.width != mode.width || camera.projection.height != mode.height)
      return fail(
          ErrorCode::kInvalid, quick.lens,
          fmt::format("is of {} x {} pixels, and the camera gives {} x {}", camera.projection.width,
                      camera.projection.height, mode.width, mode.height));
    out.info.projection = camera.projection;
    out.info.response = camera.response;
  }
  log_info("{} ({}): {} x {} pixels", found->device, found->name, mode.width, mode.height);
  return out;
}

runtime::Scene object_on_board(const QuickStart& quick) {
  runtime::Scene scene;
  runtime::SceneObject object;
  object.name = "object";
  object.asset = quick.asset;
  object.place_on_floor = true;
  object.fit_size_m = quick.size_m;
  scene.objects.push_back(std::move(object));
  runtime::RealGeometry table;
  table.plane = runtime::RealPlane{};
  scene.real.push_back(std::move(table));
  return scene;
}

}  // namespace

Result<RigConfig> quick_rig(const QuickStart& quick) {
  if (!(quick.size_m > 0 && quick.size_m <= 10))
    return fail(ErrorCode::kInvalid, "--size", "is not above 0 and at most 10 m");
  const auto board = calib::parse_board(quick.board);
  if (!board) return fail(ErrorCode::kInvalid, "--board", board.error().detail);
  RigConfig c;
  const bool films = quick.source.empty() || quick.source.starts_with("/dev/") ||
                     quick.source.starts_with("libcamera:");
  if (!films && !quick.lens.empty())
    return fail(ErrorCode::kInvalid, "--lens",
                "is of a camera that is filmed with: a recording says its own camera's lens");
  c.source = films ? "cameras" : quick.source;
  if (films) {
    PENUMBRA_ASSIGN(camera, quick_camera(quick));
    c.cameras.push_back(std::move(camera));
  }
  PoseConfig pose;
  pose.source = "board";
  pose.boards = {{*board, calib::world_from_flat_board(*board, calib::BoardOrigin::kMiddle)}};
  c.pose = std::move(pose);
  c.light_environment = quick.environment.empty() ? "builtin:room" : quick.environment;
  if (quick.environment.empty())
    log_info("the light is that of a built-in room: --environment takes an HDR map of yours");
  c.own_scene = object_on_board(quick);
  c.port = quick.port;
  c.recordings = "recordings";
  return c;
}

}  // namespace penumbra::service
