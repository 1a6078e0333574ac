#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <cmath>

#include "calib/camera/pose_file.h"
#include "calib/estimate/boards.h"
#include "calib/estimate/latency.h"
#include "calib/estimate/rig_calibration.h"
#include "capture/recording/folder.h"
#include "capture/recording/undamaged_frames.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "runtime/pipeline/report.h"
#include "tools/calibrate/calibration_report.h"
#include "tools/calibrate/commands.h"
#include "tools/calibrate/tracker_file.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"

namespace penumbra::tools {

namespace {

struct CalibrateLatencyOptions {
  std::string capture, tracker, board;
  std::string camera;               // empty: the first
  std::optional<std::string> lens;  // file of calibrate camera; else the capture's
  double max_offset_s = .5;
  std::optional<std::string> pose_file, report;
  bool json = false;
};

struct SeenBoards {
  std::string camera;
  std::size_t pictures = 0;
  std::vector<calib::TurnSample> turns;
};

Result<capture::CameraInfo> choose_camera(const CalibrateLatencyOptions& o,
                                          const std::vector<capture::CameraInfo>& all) {
  const auto found =
      o.camera.empty() ? all.begin() : std::ranges::find(all, o.camera, &capture::CameraInfo::name);
  if (found == all.end())
    return fail(ErrorCode::kNotFound, o.camera, "is not a camera of the capture");
  capture::CameraInfo camera = *found;
  if (o.lens) {
    PENUMBRA_ASSIGN(lens, capture::read_camera_file(*o.lens));
    if (lens.projection.width != camera.projection.width ||
        lens.projection.height != camera.projection.height)
      return fail(
          ErrorCode::kInvalid, *o.lens,
          fmt::format("is of pictures of {}x{} instead of {}x{}", lens.projection.width,
                      lens.projection.height, camera.projection.width, camera.projection.height));
    camera.projection = lens.projection;
  }
  return camera;
}

// The file with the new offset in place of the old one, all else as it stands there.
Result<std::string> with_offset(const std::string& path, const std::string& camera,
                                const calib::Latency& latency) {
  PENUMBRA_ASSIGN(text, read_text(path));
  PENUMBRA_ASSIGN(poses, calib::parse_pose_file(text, path));
  if (poses.poses_in != calib::PosesIn::kTrackedBody)
    return fail(ErrorCode::kInvalid, path,
                "has poses on no tracked body: calibrate rig --tracker makes such a file");
  if (std::ranges::find(poses.cameras, camera, &calib::PoseFile::NamedPose::name) ==
      poses.cameras.end())
    return fail(ErrorCode::kInvalid, path, fmt::format("has no camera \"{}\"", camera));
  const std::string offset = fmt::format(
      "tracker_offset_s = {:.6f}  # camera time + offset = tracker time\n"
      "tracker_offset_sigma_s = {:.2g}\n",
      latency.offset_s, latency.sigma_s);
  std::string out;
  std::size_t at = 0;
  bool written = false;
  while (at < text.size()) {
    const std::size_t end = std::min(text.find('\n', at), text.size() - 1) + 1;
    const std::string line = text.substr(at, end - at);
    at = end;
    const std::string_view key =
        std::string_view(line).substr(std::min(line.find_first_not_of(" \t"), line.size()));
    if (key.starts_with("tracker_offset_")) continue;
    out += line;
    if (!written && key.starts_with("[rig]")) out += offset, written = true;
  }
  PENUMBRA_ASSIGN(changed, calib::parse_pose_file(out, path));
  if (!changed.tracker_offset ||
      std::abs(changed.tracker_offset->count() - latency.offset_s) > 1e-6)
    return fail(ErrorCode::kInvalid, path, "has its table [rig] in a form that cannot be changed");
  return out;
}

// A chessboard looks the same upside down: nobody turns a rig by half a turn between two frames.
glm::dquat same_way_up(const glm::dquat& turn, const glm::dquat& before) {
  const glm::dquat flipped = glm::angleAxis(kPi, glm::dvec3(0, 0, 1)) * turn;
  return std::abs(glm::dot(flipped, before)) > std::abs(glm::dot(turn, before)) ? flipped : turn;
}

// How the camera is turned against the board, at each frame that shows it.
Result<SeenBoards> look(const CalibrateLatencyOptions& o, const calib::Board& board) {
  PENUMBRA_ASSIGN(source, capture::UndamagedFrames::open(o.capture));
  const auto& all = source->cameras();
  PENUMBRA_ASSIGN(camera, choose_camera(o, all));
  if (o.pose_file) PENUMBRA_TRY(with_offset(*o.pose_file, camera.name, {}));
  const auto index = std::ranges::find(all, camera.name, &capture::CameraInfo::name) - all.begin();
  SeenBoards seen{camera.name, 0, {}};
  const auto progress = progress_count("pictures looked at");
  while (true) {
    PENUMBRA_ASSIGN(frame, source->next());
    if (!frame) return seen;
    if (frame->camera != index) continue;
    progress(++seen.pictures);
    const auto view = calib::find_board(*frame->pixels, board,
                                        fmt::format("{} frame {}", camera.name, frame->sequence));
    if (!view) continue;
    const auto pose = calib::board_pose(camera.projection, *view);
    if (!pose) continue;
    glm::dquat turn = glm::conjugate(pose->rotation);
    if (board.kind == calib::Board::Kind::kChessboard && !seen.turns.empty())
      turn = same_way_up(turn, seen.turns.back().turn);
    seen.turns.push_back({(frame->time - TimestampNs{}).count(), turn});
  }
}

constexpr double kCertain = 4;  // standard deviations

bool clocks_drift(const calib::Latency& l) {
  constexpr double kMinDrift_s = .001;
  return l.drift_s && std::abs(*l.drift_s) > std::max(kMinDrift_s, kCertain * l.drift_sigma_s);
}

void print_latency(const SeenBoards& seen, const calib::Latency& l) {
  fmt::print("{}: {} pictures, board found in {}, {} turns compared, {:.2f} degrees left\n",
             seen.camera, seen.pictures, seen.turns.size(), l.steps.size(),
             l.residual_rad * 180 / kPi);
  fmt::print("tracker time = camera time + {:.2f} ms +- {:.2f}\n", 1000 * l.offset_s,
             1000 * l.sigma_s);
}

nlohmann::json to_json(const SeenBoards& seen, const calib::Latency& l) {
  return {{"camera", seen.camera},
          {"pictures", seen.pictures},
          {"boards", seen.turns.size()},
          {"turns", l.steps.size()},
          {"tracker_offset_s", l.offset_s},
          {"tracker_offset_sigma_s", l.sigma_s},
          {"drift_s", l.drift_s ? nlohmann::json(*l.drift_s) : nlohmann::json(nullptr)},
          {"drift_sigma_s", l.drift_sigma_s},
          {"residual_deg", l.residual_rad * 180 / kPi}};
}

}  // namespace

Result<void> calibrate_latency(const CalibrateLatencyOptions& o) {
  PENUMBRA_ASSIGN(board, calib::parse_board(o.board));
  if (!(o.max_offset_s > 0 && o.max_offset_s <= 10))
    return fail(ErrorCode::kInvalid, "--max-offset", "is not above 0 and at most 10 s");
  PENUMBRA_ASSIGN(tracker, read_tracker_file(o.tracker));
  if (o.pose_file) {
    PENUMBRA_TRY(check_writable(*o.pose_file));
  }
  if (o.report) PENUMBRA_TRY(make_folder(*o.report));
  PENUMBRA_ASSIGN(seen, look(o, board));
  std::vector<calib::TurnSample> turns;
  turns.reserve(tracker.size());
  for (const calib::TrackerPose& p : tracker)
    turns.push_back({p.time_s, p.world_from_body.rotation});
  PENUMBRA_ASSIGN(latency, calib::estimate_latency(seen.turns, turns, {o.max_offset_s}));
  if (clocks_drift(latency))
    log_warning(
        "{}: the offset grows by {:.1f} +- {:.1f} ms from the first half to the second: the "
        "clocks run apart",
        seen.camera, 1000 * *latency.drift_s, 1000 * latency.drift_sigma_s);
  if (o.pose_file) {
    PENUMBRA_ASSIGN(text, with_offset(*o.pose_file, seen.camera, latency));
    PENUMBRA_TRY(write_bytes(*o.pose_file, text));
  }
  if (o.report) PENUMBRA_TRY(write_latency_report(*o.report, latency));
  if (o.json)
    print_json(to_json(seen, latency));
  else
    print_latency(seen, latency);
  return {};
}

void add_calibrate_latency(CLI::App& parent, Action& action) {
  static CalibrateLatencyOptions latency;
  auto* c = parent.add_subcommand(
      "latency",
      "Find how late a camera's frames are against a tracker's poses, from turning both before a "
      "board that stands still");
  c->add_option("capture", latency.capture,
                "Recording or capture folder of a camera with a calibrated lens, turned to and fro "
                "before the board for some seconds")
      ->required();
  c->add_option("--board", latency.board, kBoardHelp)->required();
  c->add_option("--tracker", latency.tracker,
                "Tracked poses of what the camera is fixed to: CSV of time_s,tx,ty,tz,qx,qy,qz,qw, "
                "in seconds and metres")
      ->required();
  c->add_option("--camera", latency.camera, "Name of the camera; by default the first");
  c->add_option("--lens", latency.lens,
                "File of calibrate camera, instead of the capture's own lens");
  c->add_option("--max-offset", latency.max_offset_s,
                "Largest offset between the clocks that is looked for, in seconds, at most 10")
      ->capture_default_str();
  c->add_option("--pose-file", latency.pose_file,
                "Pose file of calibrate rig --tracker whose offset is brought up to date");
  c->add_option("--report", latency.report, "Folder for a plot and a table of the turns");
  add_json(c, latency.json);
  c->callback([&] { action = [] { return calibrate_latency(latency); }; });
}

}  // namespace penumbra::tools
