#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <charconv>

#include "calib/camera/mirror_ball.h"
#include "capture/device/rig.h"
#include "capture/frames.h"
#include "capture/recording/undamaged_frames.h"
#include "runtime/pipeline/report.h"
#include "tools/calibrate/commands.h"
#include "tools/common/command.h"
#include "tools/common/print.h"

namespace penumbra::tools {

namespace {

struct CalibrateBallOptions {
  std::string cameras;                // capture folder, recording or rig.toml
  std::vector<std::string> outlines;  // NAME:x,y,radius in pixels
  double radius_m = 0, sigma_px = 1;
  bool json = false;
};

Result<std::vector<capture::CameraInfo>> cameras_of(const std::string& path) {
  if (!path.ends_with(".toml")) {
    PENUMBRA_ASSIGN(source, capture::UndamagedFrames::open(path));
    return source->cameras();
  }
  PENUMBRA_ASSIGN(rig, capture::read_rig_cameras(path));
  std::vector<capture::CameraInfo> out;
  for (capture::RigCamera& c : rig) out.push_back(std::move(c.info));
  return out;
}

Result<calib::BallOutline> parse_outline(const std::string& text,
                                         const std::vector<capture::CameraInfo>& cameras) {
  const auto invalid = [&](const char* why) {
    return fail(ErrorCode::kInvalid, "--outline", text + " " + why);
  };
  const std::size_t colon = text.rfind(':');
  if (colon == std::string::npos) return invalid("is not NAME:x,y,radius");
  const auto camera = std::ranges::find(cameras, text.substr(0, colon), &capture::CameraInfo::name);
  if (camera == cameras.end())
    return fail(ErrorCode::kNotFound, "--outline",
                text + " names no camera of the capture or the rig");
  double numbers[3];
  const char *at = text.data() + colon + 1, *const end = text.data() + text.size();
  for (int i = 0; i < 3; ++i) {
    const auto [next, error] = std::from_chars(at, end, numbers[i]);
    if (error != std::errc() || (i < 2 ? next == end || *next != ',' : next != end))
      return invalid("is not NAME:x,y,radius");
    at = next + 1;
  }
  return calib::BallOutline{camera->name,
                            camera->projection,
                            camera->world_from_camera,
                            {numbers[0], numbers[1]},
                            numbers[2]};
}

}  // namespace

Result<void> calibrate_ball(const CalibrateBallOptions& o) {
  PENUMBRA_ASSIGN(cameras, cameras_of(o.cameras));
  std::vector<calib::BallOutline> outlines;
  for (const std::string& text : o.outlines) {
    PENUMBRA_ASSIGN(outline, parse_outline(text, cameras));
    outlines.push_back(outline);
  }
  PENUMBRA_ASSIGN(place, calib::locate_ball(outlines, o.radius_m, o.sigma_px));
  const auto& [c, s] = place;
  if (o.json)
    print_json(
        {{"centre_m", {c.x, c.y, c.z}}, {"sigma_m", {s.x, s.y, s.z}}, {"radius_m", o.radius_m}});
  else
    fmt::print(
        "[camera.ball]\ncentre_m = [{:.4f}, {:.4f}, {:.4f}]  # +- {:.1f} {:.1f} {:.1f} mm\n"
        "radius_m = {}\n",
        c.x, c.y, c.z, 1000 * s.x, 1000 * s.y, 1000 * s.z, o.radius_m);
  return {};
}

void add_calibrate_ball(CLI::App& parent, Action& action) {
  static CalibrateBallOptions ball;
  auto* c =
      parent.add_subcommand("ball",
                            "Find where a mirror ball of known radius stands, from its outlines "
                            "in pictures of cameras with known poses");
  c->add_option("cameras", ball.cameras, "Capture folder, recording or rig.toml with the cameras")
      ->required();
  c->add_option(
       "--outline", ball.outlines,
       "Circle over the ball in the picture of camera NAME, as NAME:x,y,radius in pixels; once for "
       "each camera")
      ->required();
  c->add_option("--radius", ball.radius_m, "Radius of the ball in metres, above 0")
      ->required()
      ->check(above_zero);
  c->add_option("--sigma-px", ball.sigma_px, "Standard deviation of the circles in pixels, above 0")
      ->check(above_zero)
      ->capture_default_str();
  add_json(c, ball.json);
  c->callback([&] { action = [] { return calibrate_ball(ball); }; });
}

}  // namespace penumbra::tools
