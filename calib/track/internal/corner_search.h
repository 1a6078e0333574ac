// Private to track: markers and corners of boards in a picture.
// threads: reentrant; OpenCV's detector is internally parallel
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/track/internal/board_layout.h"
#include "core/image.h"
#include "core/pose.h"

namespace penumbra::calib {

/// A board with its place.
struct LaidBoard {
  Board board;
  BoardLayout layout;
  Pose world_from_board;
  bool counts = true;  // false while it contradicts the others

  glm::dvec3 in_world(glm::dvec2 on_board_m) const {
    return world_from_board * glm::dvec3(on_board_m.x, -on_board_m.y, 0);
  }
  glm::dvec3 middle() const { return in_world(layout.outline.at_m + .5 * layout.outline.size_m); }
};

/// Brightness of a part of a picture; keeps its memory.
class GreyPart {
 public:
  struct GreyBounds {
    int left = 0, top = 0, right = 0, bottom = 0;  // the last two outside
    bool empty() const { return right <= left || bottom <= top; }
  };
  void set(const FramePixels& picture, GreyBounds bounds);
  const GreyBounds& bounds() const { return bounds_; }
  std::uint8_t* data() { return codes_.data(); }
  int width() const { return bounds_.right - bounds_.left; }
  int height() const { return bounds_.bottom - bounds_.top; }
  /// Between four pixels, at a continuous place in the picture; nothing outside.
  std::optional<double> at(glm::dvec2 pixel) const;

 private:
  GreyBounds bounds_;
  std::vector<std::uint8_t> codes_;
};

struct FoundMarking {
  std::size_t board = 0, marker = 0;     // in the boards; in the layout's markers
  std::array<glm::dvec2, 4> corners_px;  // clockwise from the upper left one
};
/// Of all boards, those that do not count, too. A marker that is seen twice is none.
/// enlarged: finds markers of half the size, in four times the time
std::vector<FoundMarking> find_markers(GreyPart& grey, std::span<const LaidBoard> boards,
                                       bool enlarged);

struct FoundCorner {
  std::size_t board = 0, point = 0;  // in the boards; in the layout's points
  glm::dvec2 pixel{0};
  // Of a tag's corner: by what it moves, in pixels, where both edges move inwards by one; of a
  // saddle point 0
  glm::dvec2 inward{0};
};
struct CornerSearch {
  std::vector<FoundCorner> found;
  int expected = 0;     // that the picture should show
  double moved_px = 0;  // of those found, from where the pose puts them: the median
};
/// To sub-pixels, near where a pose puts them. Whether their surroundings look right is checked.
CornerSearch find_corners(GreyPart& grey, const CameraModel& lens,
                          std::span<const LaidBoard> boards, const Pose& world_from_camera);

/// Blur rounds the corners of tags, and codes that are no light shift their edges: what is found
/// lies inside, as if all edges had moved by one length, which moves acute corners farther than
/// obtuse ones. It is read off at a pose that fits well, and taken back.
void take_back_rounding(const CameraModel& lens, std::span<const LaidBoard> boards,
                        const Pose& world_from_camera, std::vector<FoundCorner>& corners);

/// Where the boards lie in the picture, with a margin; empty where none does.
GreyPart::GreyBounds bounds_of(const CameraModel& lens, std::span<const LaidBoard> boards,
                               const Pose& world_from_camera);

/// Whether enough of the markers that the picture should show read right.
bool markers_agree(const GreyPart& grey, const CameraModel& lens, std::span<const LaidBoard> boards,
                   const Pose& world_from_camera);

}  // namespace penumbra::calib
