#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <glm/gtc/quaternion.hpp>

#include "calib/camera/calibration_files.h"
#include "calib/camera/response.h"
#include "calib/estimate/boards.h"
#include "calib/estimate/rig_calibration.h"
#include "capture/frames.h"
#include "capture/recording/folder.h"
#include "capture/recording/folder_format.h"
#include "capture/recording/undamaged_frames.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "core/io/toml_keys.h"
#include "runtime/pipeline/report.h"
#include "tools/calibrate/calibration_report.h"
#include "tools/calibrate/commands.h"
#include "tools/calibrate/lens_parts.h"
#include "tools/calibrate/tracker_file.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"

namespace penumbra::tools {

namespace {

struct CalibrateRigOptions {
  std::string capture;  // cameras that are fixed to each other, and a board
  std::string board, output;
  std::vector<std::string> cameras;    // the first is the rig's frame; empty: all
  std::vector<std::string> lenses;     // files of calibrate camera, by the cameras' names
  std::optional<std::string> tracker;  // poses of the body that the cameras are fixed to, .csv
  double tracker_sigma_mm = 1, tracker_sigma_deg = .05;
  std::string board_plane;  // "floor" or "wall": the board is the world
  double every_s = .5, max_time_apart_s = .005;
  std::optional<std::string> report, lens_file;
  bool json = false;
};

struct RigPictures {
  std::vector<capture::CameraInfo> all;  // of the capture
  std::vector<RigPart> parts;
  std::vector<calib::RigCameraInput> cameras;  // of the parts
  std::vector<calib::RigObservation> boards;
  std::size_t pictures = 0;
};

// A camera of several lenses takes part with each of them.
Result<void> choose_cameras(const CalibrateRigOptions& o, RigPictures& seen) {
  const std::vector<capture::CameraInfo>& all = seen.all;
  std::vector<bool> chosen(all.size());
  std::vector<std::string> names = o.cameras;
  if (names.empty())
    for (const capture::CameraInfo& c : all) names.push_back(c.name);
  for (const std::string& name : names) {
    const auto camera = std::ranges::find(all, name, &capture::CameraInfo::name);
    if (camera == all.end())
      return fail(ErrorCode::kNotFound, name, "is not a camera of the capture");
    const auto index = static_cast<std::size_t>(camera - all.begin());
    if (chosen[index]) return fail(ErrorCode::kInvalid, name, "is named twice");
    chosen[index] = true;
    for (RigPart& part : parts_of(*camera, index)) {
      seen.cameras.push_back(part.input);
      seen.parts.push_back(std::move(part));
    }
  }
  return {};
}

// Lenses of files in place of the capture's, with how sure they are.
Result<void> set_lenses(const CalibrateRigOptions& o, RigPictures& seen) {
  for (const std::string& file : o.lenses) {
    PENUMBRA_ASSIGN(info, capture::read_camera_file(file));
    const auto camera = std::ranges::find(seen.cameras, info.name, &calib::RigCameraInput::name);
    if (camera == seen.cameras.end())
      return fail(ErrorCode::kNotFound, file,
                  fmt::format("is of the camera \"{}\", which takes no part", info.name));
    if (info.projection.width != camera->projection.width ||
        info.projection.height != camera->projection.height)
      return fail(
          ErrorCode::kInvalid, file,
          fmt::format("is of pictures of {}x{} instead of {}x{}", info.projection.width,
                      info.projection.height, camera->projection.width, camera->projection.height));
    if (!camera->lens_covariance.empty())
      return fail(ErrorCode::kInvalid, file,
                  fmt::format("is a second lens of the camera \"{}\"", info.name));
    if (info.projection != camera->projection)
      log_warning("{}: is another lens than that of the capture: the poses belong to this one",
                  file);
    PENUMBRA_ASSIGN(text, read_text(file));
    PENUMBRA_ASSIGN(covariance, calib::parse_lens_covariance(text, file));
    *camera = {info.name, info.projection, std::move(covariance)};
  }
  return {};
}

bool some_lens_is_exact(const RigPictures& seen) {
  return std::ranges::any_of(
      seen.cameras, [](const calib::RigCameraInput& c) { return c.lens_covariance.empty(); });
}

// Frames of one moment, and then none until `every_s` has passed.
Result<RigPictures> look(const CalibrateRigOptions& o, const calib::Board& board) {
  PENUMBRA_ASSIGN(source, capture::UndamagedFrames::open(o.capture));
  RigPictures seen;
  seen.all = source->cameras();
  PENUMBRA_TRY(choose_cameras(o, seen));
  PENUMBRA_TRY(set_lenses(o, seen));
  if (o.lens_file &&
      std::ranges::none_of(seen.parts, [](const RigPart& part) { return part.lens.has_value(); }))
    return fail(ErrorCode::kInvalid, "--lens-file", "is of cameras with [[camera.lens]]");
  if (seen.cameras.size() == 1 && !o.tracker && o.board_plane.empty())
    return fail(ErrorCode::kInvalid, seen.cameras[0].name,
                "is one camera alone, whose pose needs --tracker or --board-plane");
  const auto progress = progress_count("pictures looked at");
  std::optional<double> moment;
  constexpr double kJitter = .0005;  // seconds
  while (true) {
    PENUMBRA_ASSIGN(frame, source->next());
    if (!frame) return seen;
    const auto of_frame = [&](const RigPart& part) {
      return part.camera == static_cast<std::size_t>(frame->camera);
    };
    if (std::ranges::none_of(seen.parts, of_frame)) continue;
    const double time = (frame->time - TimestampNs{}).count();
    if (!moment || time - *moment >= o.every_s - kJitter) moment = time;
    if (time - *moment > o.max_time_apart_s) continue;
    progress(++seen.pictures);
    for (std::size_t i = 0; i < seen.parts.size(); ++i) {
      const RigPart& part = seen.parts[i];
      if (!of_frame(part)) continue;
      const std::string name = fmt::format("{} frame {}", seen.cameras[i].name, frame->sequence);
      if (auto view = calib::find_board(picture_of(part, seen.all[part.camera], *frame->pixels),
                                        board, name))
        seen.boards.push_back({i, time, std::move(*view)});
    }
  }
}

// The world of a board that lies on the floor, face up, or hangs on a wall: +y up.
Result<Pose> world_from_board(const std::string& lies) {
  if (lies == "floor") return Pose{glm::angleAxis(-kPi / 2, glm::dvec3(1, 0, 0)), {0, 0, 0}};
  if (lies == "wall") return Pose{};
  return fail(ErrorCode::kInvalid, "--board-plane", "\"" + lies + "\" is neither floor nor wall");
}

// The mean of a board that stood still.
Result<Pose> still_board(const calib::RigCalibration& c) {
  constexpr double kMoved_m = .01, kTurned = .5 * kPi / 180;
  const Pose& first = c.rig_from_board.front().rig_from_board;
  glm::dvec3 place(0);
  glm::dquat turn(0, 0, 0, 0);
  for (const auto& [time_s, board] : c.rig_from_board) {
    const glm::dquat q =
        glm::dot(board.rotation, first.rotation) < 0 ? -board.rotation : board.rotation;
    const double angle = 2 * std::acos(std::min(1., glm::dot(q, first.rotation)));
    if (glm::length(board.translation - first.translation) > kMoved_m || angle > kTurned)
      return fail(ErrorCode::kUndetermined, "--board-plane",
                  fmt::format("the board or the cameras moved: at {:.2f} s the board is {:.0f} mm "
                              "and {:.1f} degrees from its first pose",
                              time_s, 1000 * glm::length(board.translation - first.translation),
                              angle * 180 / kPi));
    place += board.translation / static_cast<double>(c.rig_from_board.size());
    turn = turn + q;
  }
  return Pose{glm::normalize(turn), place};
}

std::string_view frame_name(const CalibrateRigOptions& o) {
  return o.tracker ? "tracked body" : o.board_plane.empty() ? "first camera" : "board";
}

std::string print_pose_file(const CalibrateRigOptions& o, const RigPictures& seen,
                            const calib::RigCalibration& c,
                            const std::vector<JoinedCamera>& joined) {
  std::string text =
      fmt::format("version = 1\n\n[rig]\nframe = \"{}\"\nboard = {}\nrms_px = {:.4g}\n",
                  frame_name(o), toml_quoted(o.board), c.rms_px);
  if (c.tracker_offset_s)
    text += fmt::format(
        "tracker_offset_s = {:.6f}  # camera time + offset = tracker time\n"
        "tracker_offset_sigma_s = {:.2g}\n",
        *c.tracker_offset_s, c.tracker_offset_sigma_s);
  for (const JoinedCamera& one : joined) {
    const glm::dmat4 m = one.pose.matrix();
    const auto& camera = c.cameras[one.first_part];
    const auto list = [](const glm::dvec3& v, double unit) {
      return fmt::format("[{:.3g}, {:.3g}, {:.3g}]", unit * v.x, unit * v.y, unit * v.z);
    };
    text += fmt::format(
        "\n[[camera]]\nname = {}\nworld_from_camera = [{}]\nposition_sigma_mm = {}  # one standard "
        "deviation, against {}\nrotation_sigma_deg = {}\n",
        toml_quoted(seen.all[one.camera].name), fmt::join(&m[0][0], &m[0][0] + 16, ", "),
        list(camera.position_sigma_m, 1000),
        o.tracker ? "the tracked body" : "the first camera, in its axes",
        list(camera.rotation_sigma_rad, 180 / kPi));
  }
  return text;
}

void print_table(const CalibrateRigOptions& o, const RigPictures& seen,
                 const calib::RigCalibration& c, const std::vector<Pose>& poses) {
  fmt::print(
      "{} pictures, board found in {}, left out {}: {:.3f} px RMS; poses in the frame of the "
      "{}\n",
      seen.pictures, seen.boards.size(), c.left_out.size(), c.rms_px, frame_name(o));
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const glm::dvec3 at = 1000. * poses[i].translation,
                     degrees = glm::eulerAngles(poses[i].rotation) * (180 / kPi);
    const auto& camera = c.cameras[i];
    fmt::print(
        "{:<14} {:9.2f} {:9.2f} {:9.2f} mm +- {:.2f}   {:8.3f} {:8.3f} {:8.3f} deg +- {:.3f}   "
        "{} boards, {:.3f} px\n",
        seen.cameras[i].name, at.x, at.y, at.z, 1000 * glm::length(camera.position_sigma_m),
        degrees.x, degrees.y, degrees.z, 180 / kPi * glm::length(camera.rotation_sigma_rad),
        camera.boards, camera.rms_px);
  }
  if (c.tracker_offset_s)
    fmt::print("tracker time = camera time + {:.2f} ms +- {:.2f}\n", 1000 * *c.tracker_offset_s,
               1000 * c.tracker_offset_sigma_s);
  if (c.board_scale)
    fmt::print("board by the tracker's metres: {:.4f} +- {:.4f} times its told size\n",
               *c.board_scale, c.board_scale_sigma);
  for (const std::string& name : c.left_out) fmt::print("left out: {}\n", name);
  if (some_lens_is_exact(seen))
    fmt::print("lenses are taken as exact where --lenses gives no file of calibrate camera\n");
}

// Cameras of several lenses, with how these look now.
Result<void> write_lens_file(const std::string& file, const RigPictures& seen,
                             const std::vector<JoinedCamera>& joined) {
  std::string text = "version = 1\n";
  for (const JoinedCamera& one : joined) {
    if (one.lenses.empty()) continue;
    capture::CameraInfo info = seen.all[one.camera];
    info.lenses = one.lenses;
    std::string response = info.response.describe();
    if (response.starts_with("table")) {  // has no name: goes into a file of its own
      response = info.name + ".response.toml";
      PENUMBRA_TRY(calib::write_response(std::filesystem::path(file).parent_path() / response,
                                         info.response));
    }
    text += capture::print_camera(info, response);
  }
  return write_bytes(file, text);
}

void print_lenses(const RigPictures& seen, const std::vector<JoinedCamera>& joined) {
  for (const JoinedCamera& one : joined)
    for (std::size_t k = 1; k < one.lenses.size(); ++k)
      fmt::print(
          "{}: lens {} looks {:.2f} degrees away from where it was said to, and stands "
          "{:.1f} mm from the first\n",
          seen.all[one.camera].name, k + 1, one.turned_rad[k] * 180 / kPi, 1000 * one.apart_m[k]);
}

nlohmann::json lenses_json(const RigPictures& seen, const std::vector<JoinedCamera>& joined) {
  nlohmann::json out = nlohmann::json::array();
  for (const JoinedCamera& one : joined)
    for (std::size_t k = 0; k < one.lenses.size(); ++k) {
      const glm::dmat4 m = glm::mat4_cast(one.lenses[k].camera_from_lens);
      out.push_back({{"camera", seen.all[one.camera].name},
                     {"lens", k + 1},
                     {"camera_from_lens", std::vector<double>(&m[0][0], &m[0][0] + 16)},
                     {"turned_deg", one.turned_rad[k] * 180 / kPi},
                     {"apart_m", one.apart_m[k]}});
    }
  return out;
}

nlohmann::json to_json(const RigPictures& seen, const calib::RigCalibration& c,
                       const std::vector<Pose>& poses) {
  const auto list = [](const glm::dvec3& v) { return nlohmann::json{v.x, v.y, v.z}; };
  nlohmann::json cameras = nlohmann::json::array();
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const glm::dquat& q = poses[i].rotation;
    cameras.push_back({{"name", seen.cameras[i].name},
                       {"position_m", list(poses[i].translation)},
                       {"rotation_xyzw", {q.x, q.y, q.z, q.w}},
                       {"position_sigma_m", list(c.cameras[i].position_sigma_m)},
                       {"rotation_sigma_rad", list(c.cameras[i].rotation_sigma_rad)},
                       {"lens_exact", seen.cameras[i].lens_covariance.empty()},
                       {"boards", c.cameras[i].boards},
                       {"rms_px", c.cameras[i].rms_px}});
  }
  nlohmann::json out = {{"cameras", cameras},
                        {"rms_px", c.rms_px},
                        {"pictures", seen.pictures},
                        {"boards", seen.boards.size()},
                        {"left_out", c.left_out}};
  if (c.tracker_offset_s) {
    out["tracker_offset_s"] = *c.tracker_offset_s;
    out["tracker_offset_sigma_s"] = c.tracker_offset_sigma_s;
  }
  if (c.board_scale) {
    out["board_scale"] = *c.board_scale;
    out["board_scale_sigma"] = c.board_scale_sigma;
  }
  return out;
}

Result<calib::RigOptions> solver_options(const CalibrateRigOptions& o) {
  calib::RigOptions out;
  out.max_time_apart_s = o.max_time_apart_s;
  out.tracker_sigma_m = o.tracker_sigma_mm / 1000;
  out.tracker_sigma_rad = o.tracker_sigma_deg * kPi / 180;
  if (!(o.every_s >= 0 && o.every_s < 1e6))
    return fail(ErrorCode::kInvalid, "--min-interval", "is not a number of seconds within 0..1e6");
  if (!(o.max_time_apart_s >= 0 && o.max_time_apart_s <= 1))
    return fail(ErrorCode::kInvalid, "--sync-tolerance", "is not within 0..1 s");
  const auto sensible = [](double v) { return v > 0 && v < 10; };  // metres, radian
  if (!sensible(out.tracker_sigma_m) || !sensible(out.tracker_sigma_rad))
    return fail(ErrorCode::kInvalid, "--tracker-sigma-mm, --tracker-sigma-deg",
                "are not above 0 and below 10000 mm and 573 degrees");
  if (o.tracker && o.max_time_apart_s > calib::RigOptions().max_time_apart_s)
    return fail(ErrorCode::kInvalid, "--sync-tolerance",
                "is above 0.005 s, in which a tracked rig moves too far");
  if (!o.tracker) return out;
  if (!o.board_plane.empty())
    return fail(ErrorCode::kInvalid, "--board-plane",
                "excludes --tracker, which defines the world");
  PENUMBRA_ASSIGN(tracker, read_tracker_file(*o.tracker));
  out.tracker = std::move(tracker);
  return out;
}

}  // namespace

Result<void> calibrate_rig(const CalibrateRigOptions& o) {
  PENUMBRA_ASSIGN(board, calib::parse_board(o.board));
  PENUMBRA_ASSIGN(options, solver_options(o));
  std::optional<Pose> board_in_world;
  if (!o.board_plane.empty()) {
    PENUMBRA_ASSIGN(pose, world_from_board(o.board_plane));
    board_in_world = pose;
  }
  PENUMBRA_TRY(check_writable(o.output));
  if (o.lens_file) PENUMBRA_TRY(check_writable(*o.lens_file));
  if (o.report) PENUMBRA_TRY(make_folder(*o.report));
  PENUMBRA_ASSIGN(seen, look(o, board));
  const bool has_lenses =
      std::ranges::any_of(seen.parts, [](const RigPart& part) { return part.lens.has_value(); });
  if (seen.boards.empty())
    return fail(
        ErrorCode::kUndetermined, "rig calibration",
        fmt::format("the board was found in none of {} pictures: does --board say its kind and "
                    "counts?",
                    seen.pictures));
  PENUMBRA_ASSIGN(result, calib::calibrate_rig(seen.cameras, seen.boards, options));
  if (result.board_scale &&
      std::abs(*result.board_scale - 1) > std::max(.01, 4 * result.board_scale_sigma))
    log_warning(
        "{}: by the tracker's metres the board is {:.3f} times its told size, or a focal length is "
        "off as much",
        o.capture, *result.board_scale);
  Pose file_from_rig;
  if (board_in_world) {
    PENUMBRA_ASSIGN(board_pose, still_board(result));
    file_from_rig = *board_in_world * board_pose.inverse();
  }
  std::vector<Pose> poses;
  for (const calib::RigCameraPose& c : result.cameras)
    poses.push_back(file_from_rig * c.rig_from_camera);
  const std::vector<JoinedCamera> joined = join(seen.parts, poses, seen.all);
  PENUMBRA_TRY(write_bytes(o.output, print_pose_file(o, seen, result, joined)));
  if (o.lens_file) PENUMBRA_TRY(write_lens_file(*o.lens_file, seen, joined));
  if (o.report) PENUMBRA_TRY(write_rig_report(*o.report, seen.cameras, poses, result));
  if (o.json) {
    nlohmann::json out = to_json(seen, result, poses);
    if (has_lenses) out["lenses"] = lenses_json(seen, joined);
    print_json(out);
  } else {
    print_table(o, seen, result, poses);
    print_lenses(seen, joined);
  }
  return {};
}

void add_calibrate_rig(CLI::App& parent, Action& action) {
  static CalibrateRigOptions rig;
  auto* c = parent.add_subcommand(
      "rig",
      "Find the poses of cameras that are fixed to each other, from a board that they see at once");
  c->add_option("capture", rig.capture,
                "Recording or capture folder whose cameras have calibrated lenses")
      ->required();
  c->add_option("--board", rig.board, kBoardHelp)->required();
  c->add_option("--cameras", rig.cameras,
                "Names of the cameras, separated by commas; the first one is the frame of the "
                "rig; by default all")
      ->delimiter(',');
  c->add_option("--lenses", rig.lenses,
                "Files of calibrate camera, separated by commas: lenses by the cameras' names, "
                "whose uncertainty counts in what is stated; without, the capture's, as exact")
      ->delimiter(',');
  c->add_option(
      "--tracker", rig.tracker,
      "Tracked poses of the body that carries the cameras past a board that stands still: CSV of "
      "time_s,tx,ty,tz,qx,qy,qz,qw, in seconds and metres");
  c->add_option("--tracker-sigma-mm", rig.tracker_sigma_mm,
                "Standard deviation of a tracked position in mm, above 0")
      ->capture_default_str();
  c->add_option("--tracker-sigma-deg", rig.tracker_sigma_deg,
                "Standard deviation of a tracked rotation in degrees, above 0")
      ->capture_default_str();
  c->add_option(
      "--board-plane", rig.board_plane,
      "Where the board lies, floor or wall: cameras and board stand still, and the board's "
      "first corner is the origin of the world");
  c->add_option("--min-interval", rig.every_s,
                "Shortest time between two moments that are used, in seconds")
      ->capture_default_str();
  c->add_option(
       "--sync-tolerance", rig.max_time_apart_s,
       "Longest time between the frames of one moment, in seconds, at most 1; with --tracker "
       "at most 0.005")
      ->capture_default_str();
  c->add_option("-o,--output", rig.output, "Pose file to write, .toml")->required();
  c->add_option("--lens-file", rig.lens_file,
                "Also a camera file to write, .toml: cameras of several lenses, with how these "
                "look by the board that they see at once");
  c->add_option("--report", rig.report, "Folder for a plot and a table of the boards' errors");
  add_json(c, rig.json);
  c->callback([&] { action = [] { return calibrate_rig(rig); }; });
}

}  // namespace penumbra::tools
