#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/estimate/boards.h"
#include "calib/estimate/camera_calibration.h"
#include "capture/frames.h"
#include "codec/codec.h"
#include "core/io/files.h"
#include "core/io/log.h"
#include "core/io/toml_keys.h"
#include "core/threads/stop_signal.h"
#include "runtime/pipeline/report.h"
#include "service/rig_config.h"
#include "service/rig_source.h"
#include "tools/calibrate/calibration_report.h"
#include "tools/calibrate/commands.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/common/progress.h"
#include "tools/pictures/camera_film.h"

namespace penumbra::tools {

namespace {

struct CalibrateCameraOptions {
  std::vector<std::string> pictures;
  // Instead: a recording, capture folder or rig.toml, of it `camera`
  std::optional<std::string> capture;
  double seconds = 60;            // of a rig: how long it is looked at
  std::string camera = "camera";  // its name, there and in the output
  double every_s = .5;            // of a capture: at least so long between two pictures
  std::string board, projection = "pinhole", output;
  std::optional<std::string> report;
  bool json = false;
};

namespace fs = std::filesystem;

struct FoundBoards {
  std::vector<calib::BoardView> views;
  int width = 0, height = 0;
  std::size_t pictures = 0;
  std::vector<std::string> unreadable{};
};

// A frame of another size than the first is another camera's.
Result<void> look_at_picture(const FramePixels& pixels, const calib::Board& board,
                             const std::string& name, FoundBoards& found) {
  const int w = capture::width(pixels), h = capture::height(pixels);
  if (found.pictures++ == 0) {
    found.width = w;
    found.height = h;
  }
  if (w != found.width || h != found.height)
    return fail(ErrorCode::kInvalid, name,
                fmt::format("has {}x{} pixels, but the first picture has {}x{}", w, h, found.width,
                            found.height));
  if (auto view = calib::find_board(pixels, board, name)) found.views.push_back(std::move(*view));
  return {};
}

// Pictures of another size than most are another camera's.
Result<FoundBoards> look_at_pictures(const std::vector<std::string>& pictures,
                                     const calib::Board& board) {
  FoundBoards found;
  const auto progress = progress_bar("looking for the board");
  std::optional<Error> first;
  struct LookedAt {
    std::string picture;
    std::optional<calib::BoardView> view;
  };
  std::map<std::pair<int, int>, std::vector<LookedAt>> of_size;
  std::size_t looked = 0;
  for (const std::string& picture : pictures) {
    const auto pixels = codec::read_frame(picture);
    if (pixels) {
      const std::pair size{capture::width(*pixels), capture::height(*pixels)};
      of_size[size].push_back({picture, calib::find_board(*pixels, board, picture)});
    } else {
      if (!first) first = pixels.error();
      found.unreadable.push_back(picture);
      log_warning("{}: left out: {}", pixels.error().where, pixels.error().detail);
    }
    if (progress) progress(static_cast<double>(++looked) / static_cast<double>(pictures.size()));
  }
  if (of_size.empty()) return first ? std::unexpected(*first) : Result<FoundBoards>(found);
  const auto usual = std::ranges::max_element(
      of_size, {}, [](const auto& size_and_pictures) { return size_and_pictures.second.size(); });
  std::tie(found.width, found.height) = usual->first;
  found.pictures = usual->second.size();
  for (auto& [picture, view] : usual->second)
    if (view) found.views.push_back(std::move(*view));
  for (const auto& [size, others] : of_size)
    for (const auto& [picture, view] : others) {
      if (size == usual->first) continue;
      found.unreadable.push_back(picture);
      log_warning("{}: left out: has {}x{} pixels, most have {}x{}", picture, size.first,
                  size.second, found.width, found.height);
    }
  return found;
}

// Ninths of the picture without a corner, as one would tell somebody who holds the board.
std::string empty_parts(const FoundBoards& found) {
  constexpr const char* kRows[] = {"top", "middle", "bottom"};
  constexpr const char* kColumns[] = {"left", "centre", "right"};
  bool seen[3][3] = {};
  for (const calib::BoardView& view : found.views)
    for (const glm::dvec2& px : view.pixels) {
      const auto third = [](double at, int size) {
        return std::clamp(static_cast<int>(3 * at / size), 0, 2);
      };
      seen[third(px.y, found.height)][third(px.x, found.width)] = true;
    }
  std::string text;
  for (int y = 0; y < 3; ++y)
    for (int x = 0; x < 3; ++x)
      if (!seen[y][x])
        text += fmt::format("{}{} {}", text.empty() ? "" : ", ", kRows[y], kColumns[x]);
  return text.empty() ? "corners everywhere" : "no corners yet: " + text;
}

bool is_rig(const std::string& path) {
  return path.ends_with(".toml");
}

Result<CameraFilm> open_film(const std::string& path, const std::string& camera) {
  if (!is_rig(path)) return CameraFilm::open(path, camera);
  PENUMBRA_ASSIGN(config, service::read_rig_config(path, false));
  PENUMBRA_ASSIGN(rig, service::open_rig(config, progress_bar));
  return CameraFilm::of(std::move(rig.source), path, camera);
}

// Pictures of one camera of a capture or a live rig, so far apart in time that the board has moved.
Result<FoundBoards> look_at_capture(const CalibrateCameraOptions& o, const calib::Board& board) {
  PENUMBRA_ASSIGN(film, open_film(*o.capture, o.camera));
  const bool endless = is_rig(*o.capture);
  FoundBoards found;
  std::optional<TimestampNs> first, last;
  const auto progress = progress_line();
  const std::atomic<bool>* const stop = endless ? &catch_stop_signals() : nullptr;
  for (;;) {
    PENUMBRA_ASSIGN(frame, film.next());
    if (!frame || (stop && *stop)) break;
    if (!first) first = frame->time;
    if (endless && (frame->time - *first).count() > o.seconds) break;
    if (last && (frame->time - *last).count() < o.every_s) continue;
    last = frame->time;
    PENUMBRA_TRY(look_at_picture(*frame->pixels, board,
                                 fmt::format("{} frame {}", o.camera, frame->sequence), found));
    progress(fmt::format("{} pictures, board in {}; {}", found.pictures, found.views.size(),
                         empty_parts(found)));
  }
  progress("");
  return found;
}

std::string list(const glm::dvec2& v) {
  return fmt::format("[{}, {}]", v.x, v.y);
}

std::string list(const std::array<double, 5>& v, int count) {
  return fmt::format("[{}]", fmt::join(v.begin(), v.begin() + count, ", "));
}

// As [[camera]] of rig.toml and capture.toml takes it; [calibration] tells how sure it is.
std::string print_camera_file(const std::string& name, const calib::CameraCalibration& c,
                              std::string_view board) {
  const calib::CameraModel& p = c.projection;
  const int k = calib::distortion_count(p.kind);
  std::string text = fmt::format(
      "version = 1\n\n[[camera]]\nname = {}\nrole = \"{}\"\nwidth = {}\nheight = {}\n"
      "projection = \"{}\"\nfocal_px = {}\nprincipal_px = {}\n",
      toml_quoted(name), p.kind == calib::ProjectionKind::kPinhole ? "view" : "environment",
      p.width, p.height, calib::projection_name(p.kind), list(p.focal_px), list(p.principal_px));
  if (p.is_distorted()) text += fmt::format("distortion = {}\n", list(p.distortion, k));
  text += fmt::format(
      "\n[calibration]  # one standard deviation each\nboard = {}\nboards = {}\nrms_px = {}\n"
      "focal_sigma_px = {}\nprincipal_sigma_px = {}\n",
      toml_quoted(board), std::ranges::count(c.boards, true, &calib::BoardFit::used), c.rms_px,
      list(c.focal_sigma_px), list(c.principal_sigma_px));
  if (p.is_distorted()) text += fmt::format("distortion_sigma = {}\n", list(c.distortion_sigma, k));
  text += fmt::format("covariance = [{}]\n", fmt::join(c.covariance, ", "));
  return text;
}

nlohmann::json to_json(const calib::CameraCalibration& c, const FoundBoards& found) {
  const calib::CameraModel& p = c.projection;
  const auto pair = [](const glm::dvec2& v) { return nlohmann::json{v.x, v.y}; };
  const auto some = [&](const std::array<double, 5>& v) {
    return std::vector<double>(v.begin(), v.begin() + calib::distortion_count(p.kind));
  };
  nlohmann::json sigmas = some(c.distortion_sigma);
  for (std::size_t i = 0; i < sigmas.size(); ++i)
    if (c.distortion_fixed[i]) sigmas[i] = nullptr;
  nlohmann::json boards = nlohmann::json::array();
  for (const calib::BoardFit& b : c.boards)
    boards.push_back({{"name", b.name}, {"rms_px", b.rms_px}, {"used", b.used}});
  return {{"projection", calib::projection_name(p.kind)},
          {"width", p.width},
          {"height", p.height},
          {"focal_px", pair(p.focal_px)},
          {"focal_sigma_px", pair(c.focal_sigma_px)},
          {"principal_px", pair(p.principal_px)},
          {"principal_sigma_px", pair(c.principal_sigma_px)},
          {"distortion", some(p.distortion)},
          {"distortion_sigma", sigmas},
          {"unreadable", found.unreadable},
          {"rms_px", c.rms_px},
          {"coverage", c.coverage},
          {"reach", c.reach},
          {"pictures", found.pictures},
          {"boards", boards}};
}

void print_table(const calib::CameraCalibration& c, const FoundBoards& found) {
  const calib::CameraModel& p = c.projection;
  const auto used = std::ranges::count(c.boards, true, &calib::BoardFit::used);
  fmt::print("{} pictures, board found in {}, used {}: {:.3f} px RMS\n", found.pictures,
             c.boards.size(), used, c.rms_px);
  fmt::print("focal      {:10.3f} {:10.3f} px  +- {:.3f} {:.3f}\n", p.focal_px.x, p.focal_px.y,
             c.focal_sigma_px.x, c.focal_sigma_px.y);
  fmt::print("principal  {:10.3f} {:10.3f} px  +- {:.3f} {:.3f}\n", p.principal_px.x,
             p.principal_px.y, c.principal_sigma_px.x, c.principal_sigma_px.y);
  for (int i = 0; i < calib::distortion_count(p.kind); ++i) {
    const auto n = static_cast<std::size_t>(i);
    if (c.distortion_fixed[n])
      fmt::print("distortion   left at 0\n");
    else
      fmt::print("distortion {:10.6f}             +- {:.6f}\n", p.distortion[n],
                 c.distortion_sigma[n]);
  }
  fmt::print("corners in {:.0f} % of an 8 x 6 grid, out to {:.0f} % of the half diagonal\n",
             100 * c.coverage, 100 * c.reach);
  for (const calib::BoardFit& b : c.boards)
    if (!b.used)
      fmt::print("left out: {} ({})\n", b.name,
                 b.residuals_px.empty() ? "too far from the axis for a first guess of its pose"
                                        : fmt::format("{:.2f} px off", b.rms_px));
}

// A fit that exists is not yet a good one.
Result<void> check_errors(const CalibrateCameraOptions& o, const calib::CameraCalibration& c) {
  // Corners are found to a fraction of a pixel, whose size goes with the picture's.
  const double usual_px = std::max(1., c.projection.width / 1280.);
  constexpr double kUseless = 5;
  const std::string what = fmt::format(
      "the model is off by {:.1f} px RMS, and good pictures reach 0.1 to 0.5: is --projection "
      "right, and is the board flat and of the kind that --board says?",
      c.rms_px);
  if (c.rms_px > kUseless * usual_px) return fail(ErrorCode::kUndetermined, o.camera, what);
  if (c.rms_px > usual_px) log_warning("{}: {}", o.camera, what);
  if (std::ranges::any_of(c.distortion_fixed, std::identity()))
    log_info(
        "{}: the highest terms of the distortion stay at 0: the pictures do not determine them; "
        "bring the board to the borders",
        o.camera);
  return {};
}

}  // namespace

Result<void> calibrate_camera(const CalibrateCameraOptions& o) {
  PENUMBRA_ASSIGN(board, calib::parse_board(o.board));
  PENUMBRA_ASSIGN(kind, calib::projection_kind(o.projection));
  if (!calib::has_intrinsics(kind))
    return fail(ErrorCode::kInvalid, o.projection,
                "has nothing to calibrate; pinhole, equidistant, kb4 and double-sphere have");
  if (!(o.every_s >= 0 && o.every_s < 1e6))
    return fail(ErrorCode::kInvalid, "--min-interval", "is not a number of seconds within 0..1e6");
  if (o.pictures.empty() == !o.capture)
    return fail(ErrorCode::kInvalid, "calibrate camera", "needs either pictures or --capture");
  PENUMBRA_TRY(check_writable(o.output));
  if (o.report) PENUMBRA_TRY(make_folder(*o.report));
  PENUMBRA_ASSIGN(found,
                  o.capture ? look_at_capture(o, board) : look_at_pictures(o.pictures, board));
  if (found.pictures > 0 && found.views.empty())
    return fail(ErrorCode::kUndetermined, "camera calibration",
                fmt::format("the board was found in none of {} pictures: does --board say its kind "
                            "and counts (inner corners; 4x4_50 markers; tags 36h11)?",
                            found.pictures));
  if (found.pictures == 0)
    return fail(ErrorCode::kUndetermined, o.camera, "has no frame in the capture");
  PENUMBRA_ASSIGN(result, calib::calibrate_camera(found.views, kind, found.width, found.height));
  // Who is refused needs the report most.
  if (o.report) PENUMBRA_TRY(write_camera_report(*o.report, result, found.views));
  PENUMBRA_TRY(check_errors(o, result));
  PENUMBRA_TRY(write_bytes(o.output, print_camera_file(o.camera, result, o.board)));
  if (o.json)
    print_json(to_json(result, found));
  else
    print_table(result, found);
  return {};
}

void add_calibrate_camera(CLI::App& parent, Action& action) {
  static CalibrateCameraOptions camera;
  auto* c = parent.add_subcommand(
      "camera",
      "Find the intrinsics of a lens from ten to thirty pictures of a board, tilted to all sides "
      "and up to the borders");
  c->add_option("pictures", camera.pictures, "Pictures of the board: PNG, JPEG or TIFF");
  c->add_option(
      "--capture", camera.capture,
      "Recording or capture folder, instead of pictures, or a rig.toml whose camera is watched "
      "live");
  c->add_option("--seconds", camera.seconds,
                "How long a live camera is watched, in seconds, above 0; Ctrl-C ends it earlier")
      ->check(above_zero)
      ->capture_default_str();
  c->add_option("--camera", camera.camera, "Name of the camera, in the capture and in the output")
      ->capture_default_str();
  c->add_option("--min-interval", camera.every_s,
                "Shortest time between two frames of a capture that are used, in seconds")
      ->capture_default_str();
  c->add_option("--board", camera.board, kBoardHelp)->required();
  c->add_option("--projection", camera.projection,
                "Camera model: pinhole, equidistant, kb4 or double-sphere")
      ->capture_default_str();
  c->add_option("-o,--output", camera.output, "Camera file to write, .toml")->required();
  c->add_option("--report", camera.report, "Folder for plots and a table of the residuals");
  add_json(c, camera.json);
  c->callback([&] { action = [] { return calibrate_camera(camera); }; });
}

}  // namespace penumbra::tools
