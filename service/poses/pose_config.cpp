#include "service/poses/pose_config.h"

#include <algorithm>
#include <array>
#include <utility>

#include "calib/camera/pose_file.h"
#include "capture/poses/board_pose_source.h"
#include "capture/poses/pose_stream.h"
#include "capture/poses/pose_track.h"
#include "core/io/files.h"
#include "core/io/toml_keys.h"

namespace penumbra::service {

namespace fs = std::filesystem;

namespace {

// Sources and the keys that belong to each alone.
struct SourceKeys {
  std::string_view source;
  std::vector<std::string_view> keys;
};
const std::array<SourceKeys, 4>& source_keys() {
  static const std::array<SourceKeys, 4> all{
      {{"board", {"boards"}},
       {"track", {"file", "clock_offset_s"}},
       {"stream", {"socket", "port", "clock", "clock_offset_s"}},
       {"openxr", {"device"}}}};
  return all;
}

Result<void> check_keys(const TomlKeys& keys, const std::string& source) {
  const auto own = std::ranges::find(source_keys(), source, &SourceKeys::source);
  if (own == source_keys().end())
    return keys.invalid("source", "is \"" + source +
                                      "\" and not \"board\", \"track\", \"stream\" or "
                                      "\"openxr\"");
  for (const SourceKeys& other : source_keys())
    for (const std::string_view key : other.keys)
      if (keys.has(key) && std::ranges::find(own->keys, key) == own->keys.end())
        return keys.invalid(key, "belongs to source = \"" + std::string(other.source) + "\"");
  return {};
}

// The world on a wall: x along it, y up, z out of it, as the board itself.
Result<Pose> plane_of_board(const TomlKeys& keys, const calib::Board& board) {
  std::string plane = "floor", origin = "first corner";
  if (keys.has("plane")) {
    PENUMBRA_ASSIGN(text, keys.text("plane"));
    plane = text;
  }
  if (keys.has("origin")) {
    PENUMBRA_ASSIGN(text, keys.text("origin"));
    origin = text;
  }
  if (origin != "first corner" && origin != "middle")
    return keys.invalid("origin", "is neither \"first corner\" nor \"middle\"");
  const Pose flat = calib::world_from_flat_board(
      board, origin == "middle" ? calib::BoardOrigin::kMiddle : calib::BoardOrigin::kFirstCorner);
  if (plane == "floor") return flat;
  if (plane != "wall") return keys.invalid("plane", "is neither \"floor\" nor \"wall\"");
  // What leads from the floor's board to the paper's own axes leads the origin there, too.
  const Pose upright{glm::conjugate(flat.rotation), {0, 0, 0}};
  return upright * flat;
}

Result<calib::PlacedBoard> read_board(const TomlKeys& keys) {
  constexpr std::string_view board_keys[] = {"board", "plane", "origin", "world_from_board"};
  PENUMBRA_TRY(keys.only(board_keys));
  PENUMBRA_ASSIGN(text, keys.text("board"));
  const auto board = calib::parse_board(text);
  if (!board) return keys.invalid("board", board.error().detail);
  if (!keys.has("world_from_board")) {
    PENUMBRA_ASSIGN(pose, plane_of_board(keys, *board));
    return calib::PlacedBoard{*board, pose};
  }
  for (const std::string_view key : {"plane", "origin"})
    if (keys.has(key)) return keys.invalid(key, "stands beside world_from_board, which tells it");
  PENUMBRA_ASSIGN(numbers, keys.numbers("world_from_board", 16));
  const auto pose = calib::pose_from_matrix(numbers);
  if (!pose) return keys.invalid("world_from_board", pose.error().detail);
  return calib::PlacedBoard{*board, *pose};
}

Result<void> read_boards(const TomlKeys& keys, const fs::path& path, PoseConfig& c) {
  PENUMBRA_ASSIGN(tables, keys.tables("boards"));
  if (tables.empty()) return keys.invalid("boards", "is missing: which boards does a camera see?");
  for (const toml::table* table : tables) {
    PENUMBRA_ASSIGN(board, read_board(TomlKeys(path, *table)));
    c.boards.push_back(board);
  }
  return {};
}

Result<void> read_stream(const TomlKeys& keys, const fs::path& folder, PoseConfig& c) {
  if (keys.has("socket") == keys.has("port"))
    return keys.invalid("source", "needs either a socket or a port for \"stream\"");
  if (keys.has("socket")) {
    PENUMBRA_ASSIGN(name, keys.text("socket"));
    c.socket = folder / name;
  } else {
    PENUMBRA_ASSIGN(port, keys.integer("port", 0, 65535));
    c.port = port;
  }
  if (!keys.has("clock")) return {};
  PENUMBRA_ASSIGN(clock, keys.text("clock"));
  if (clock != "sender" && clock != "arrival")
    return keys.invalid("clock", "is neither \"sender\" nor \"arrival\"");
  c.by_arrival = clock == "arrival";
  return {};
}

}  // namespace

Result<PoseConfig> read_pose_config(const fs::path& path, const TomlKeys& keys) {
  constexpr std::string_view pose_keys[] = {"source", "cameras",       "calibration", "boards",
                                            "file",   "socket",        "port",        "clock",
                                            "device", "clock_offset_s"};
  const fs::path folder = path.parent_path();
  PENUMBRA_TRY(keys.only(pose_keys));
  PoseConfig c;
  PENUMBRA_ASSIGN(source, keys.text("source"));
  PENUMBRA_TRY(check_keys(keys, source));
  c.source = source;
  if (keys.has("cameras")) {
    PENUMBRA_ASSIGN(names, keys.texts("cameras"));
    c.cameras = names;
  }
  if (keys.has("calibration")) {
    PENUMBRA_ASSIGN(name, keys.text("calibration"));
    c.calibration = folder / name;
  }
  if (keys.has("clock_offset_s")) {
    PENUMBRA_ASSIGN(offset, keys.number("clock_offset_s"));
    c.clock_offset_s = offset;
  }
  if (keys.has("device")) {
    PENUMBRA_ASSIGN(device, keys.text("device"));
    if (device != "head" && device != "left" && device != "right")
      return keys.invalid("device", "is none of \"head\", \"left\" and \"right\"");
    c.device = device;
  }
  if (source == "board") PENUMBRA_TRY(read_boards(keys, path, c));
  if (source == "stream") PENUMBRA_TRY(read_stream(keys, folder, c));
  if (source == "track") {
    PENUMBRA_ASSIGN(name, keys.text("file"));
    c.file = folder / name;
  }
  return c;
}

namespace {

Result<int> index_of(const std::vector<capture::CameraInfo>& cameras, const std::string& name) {
  const auto found = std::ranges::find(cameras, name, &capture::CameraInfo::name);
  if (found == cameras.end())
    return fail(ErrorCode::kInvalid, "pose", "cameras: there is no camera named " + name);
  return static_cast<int>(found - cameras.begin());
}

// Which cameras move, and where they are on the body.
Result<capture::PosedSourceOptions> movers_of(const std::vector<capture::CameraInfo>& cameras,
                                              const PoseConfig& c) {
  capture::PosedSourceOptions out;
  if (c.calibration) {
    PENUMBRA_ASSIGN(text, read_text(*c.calibration, 1 << 20));
    PENUMBRA_ASSIGN(file, calib::parse_pose_file(text, *c.calibration));
    PENUMBRA_ASSIGN(moving, capture::moving_cameras(cameras, file, *c.calibration));
    out.cameras = moving;
    // A board is seen at the frame's own time.
    if (c.source != "board") out.tracker_offset = file.tracker_offset.value_or(Seconds(0));
    if (c.cameras.empty()) return out;
    std::vector<int> named;
    for (const std::string& name : c.cameras) {
      PENUMBRA_ASSIGN(index, index_of(cameras, name));
      named.push_back(index);
    }
    std::erase_if(out.cameras, [&](const capture::MovingCamera& m) {
      return std::ranges::find(named, m.camera) == named.end();
    });
    return out;
  }
  for (const std::string& name : c.cameras) {
    PENUMBRA_ASSIGN(index, index_of(cameras, name));
    out.cameras.push_back({index, {}});
  }
  for (std::size_t i = 0; c.cameras.empty() && i < cameras.size(); ++i)
    if (cameras[i].role == capture::Role::kView) out.cameras.push_back({static_cast<int>(i), {}});
  if (out.cameras.size() > 1)
    return fail(ErrorCode::kInvalid, "pose",
                "moves several cameras: a calibration has to tell where each is on the body");
  return out;
}

Result<std::unique_ptr<capture::PoseSource>> boards_before(
    const std::vector<capture::CameraInfo>& cameras, const capture::PosedSourceOptions& movers,
    const PoseConfig& c, Seconds period) {
  const auto is_body = [](const capture::MovingCamera& m) { return m.body_from_camera == Pose(); };
  const auto body = std::ranges::find_if(movers.cameras, is_body);
  if (body == movers.cameras.end())
    return fail(ErrorCode::kInvalid, "pose",
                "has no camera that is the body: with boards the calibration's poses are those of "
                "its first camera, which sees them");
  const auto index = static_cast<std::size_t>(body->camera);
  PENUMBRA_ASSIGN(source, capture::BoardPoseSource::create(
                              c.boards, cameras[index].projection,
                              {.camera = body->camera, .max_extrapolation = period}));
  return std::unique_ptr<capture::PoseSource>(std::move(source));
}

}  // namespace

Result<std::unique_ptr<capture::PosedSource>> with_poses(
    std::unique_ptr<capture::FrameSource> frames, const PoseConfig& c,
    std::unique_ptr<capture::PoseSource> openxr) {
  const double rate = frames->view_rate();
  const Seconds period(rate > 0 ? 1 / rate : 1. / 30), offset(c.clock_offset_s);
  PENUMBRA_ASSIGN(movers, movers_of(frames->cameras(), c));
  std::unique_ptr<capture::PoseSource> poses = std::move(openxr);
  if (c.source == "board") {
    PENUMBRA_ASSIGN(boards, boards_before(frames->cameras(), movers, c, period));
    poses = std::move(boards);
  } else if (c.source == "track") {
    PENUMBRA_ASSIGN(track, capture::PoseTrack::open(c.file, offset, period));
    poses = std::move(track);
  } else if (c.source == "stream") {
    PENUMBRA_ASSIGN(stream, capture::PoseStream::open({.socket = c.socket,
                                                       .port = c.port,
                                                       .clock_offset = offset,
                                                       .by_arrival = c.by_arrival,
                                                       .max_extrapolation = period}));
    poses = std::move(stream);
  }
  if (!poses) return fail(ErrorCode::kUnavailable, "pose", "has no headset to ask for its poses");
  return capture::PosedSource::create(std::move(frames), std::move(poses), movers);
}

}  // namespace penumbra::service
