// Where a camera is, picture by picture, from calibration boards whose places are known.
// Axes of a board as the rig's calibration has them: x right, y up on the paper, z out of the paper
// towards who looks at it, from the board's first corner. A BoardView's (x, y), y down, is there
// (x, -y, 0).
// threads: thread-bound
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/estimate/boards.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// Where a board has the world's origin.
enum class BoardOrigin {
  kFirstCorner,  // as `calibrate rig --board-plane floor` has it
  kMiddle,
};

/// Of a board that lies flat on the floor, face up: the world's y points up out of the paper, x to
/// the paper's right, z down the paper.
Pose world_from_flat_board(const Board& board, BoardOrigin origin = BoardOrigin::kFirstCorner);

struct PlacedBoard {
  Board board;  // ChArUco or AprilTags
  Pose world_from_board;
};

/// Places on the board where its paper is white, above and beside each marker; on the board as
/// BoardViews have it, metres, x right and y down.
std::vector<glm::dvec2> white_places(const Board& board);

/// A camera's pose with how sure it is.
struct TrackedPose {
  TimestampNs time;
  Pose world_from_camera;
  /// Row by row: a small turn about the world's axes in radians, then the position in metres.
  std::array<double, 36> covariance{};
  double rms_px = 0;      // of a coordinate, of the corners that count
  int corners = 0;        // that count
  bool searched = false;  // in the whole picture, as at first; else near the last place
};

class BoardTracker {
 public:
  /// errors: kInvalid (no board, a chessboard, markers that two boards share, a lens without
  ///         intrinsics or size), kNonFinite
  static Result<BoardTracker> create(std::vector<PlacedBoard> boards, const CameraModel& lens);
  BoardTracker(BoardTracker&&) noexcept;
  BoardTracker& operator=(BoardTracker&&) noexcept;
  ~BoardTracker();

  /// Looks near where the camera's motion leads first, then in the whole picture, every second time
  /// for small markers. Where boards have long been away it looks in every third picture.
  /// out:     nothing where fewer than six corners agree, or where two poses explain them alike and
  ///          the pictures before do not tell
  /// picture: of the lens's size
  /// time:    rises from call to call
  std::optional<TrackedPose> track(const FramePixels& picture, TimestampNs time);

  /// What the pictures contradict; empty while all is well. Of boards that contradict each other
  /// the first in order is believed.
  const std::string& trouble() const;
  struct TrackingCounts {
    std::uint64_t near = 0, searched = 0;  // poses found near the last place, in the whole picture
    std::uint64_t missed = 0;              // pictures without a pose
    std::uint64_t undecided = 0;           // of these, for two poses
  };
  const TrackingCounts& counts() const;

 private:
  struct Impl;
  explicit BoardTracker(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra::calib
#pragma GCC visibility pop
