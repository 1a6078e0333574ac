#include "calib/track/board_tracker.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <utility>

#include "calib/track/internal/corner_search.h"
#include "calib/track/internal/pose_solver.h"
#include "calib/track/internal/small_turns.h"
#include "core/conventions.h"
#include "core/io/log.h"

namespace penumbra::calib {

namespace {

constexpr int kFewestCorners = 6;
constexpr Seconds kRemembered{.25};  // a pose after which one looks near it
constexpr Seconds kLooksAgain{1};    // whether boards still contradict each other
constexpr Seconds kDecides{.5};      // a pose that decides between two that look alike

double angle_between(const Pose& a, const Pose& b) {
  return glm::length(turn_of(a.rotation * glm::conjugate(b.rotation)));
}

// Marker corners or sub-pixel corners of one board.
struct BoardSightings {
  std::vector<Sighting> all;
  std::vector<glm::dvec3> seen;
  std::vector<glm::dvec2> on_board;
};

Result<void> check_boards(const std::vector<PlacedBoard>& boards) {
  const auto invalid = [](std::size_t i, const char* why) {
    return fail(ErrorCode::kInvalid, fmt::format("board {}", i + 1), why);
  };
  if (boards.empty()) return fail(ErrorCode::kInvalid, "board tracking", "there is no board");
  for (std::size_t i = 0; i < boards.size(); ++i) {
    const Board& b = boards[i].board;
    if (b.kind == Board::Kind::kChessboard)
      return invalid(i, "is a chessboard, which looks the same from its other end: take ChArUco");
    const Pose& p = boards[i].world_from_board;
    for (const double v : {p.rotation.w, p.rotation.x, p.rotation.y, p.rotation.z, p.translation.x,
                           p.translation.y, p.translation.z})
      if (!std::isfinite(v))
        return fail(ErrorCode::kNonFinite, fmt::format("board {}", i + 1),
                    "has a place that is not finite");
    for (std::size_t j = 0; j < i; ++j) {
      const Board& other = boards[j].board;
      if (other.kind == b.kind && other.first_id < b.first_id + marker_count(b) &&
          b.first_id < other.first_id + marker_count(other))
        return invalid(i, "has markers that an earlier board has, too: give it another first id");
    }
  }
  return {};
}

}  // namespace

Pose world_from_flat_board(const Board& board, BoardOrigin origin) {
  const Pose lies{glm::angleAxis(-kPi / 2, glm::dvec3(1, 0, 0)), {0, 0, 0}};
  if (origin == BoardOrigin::kFirstCorner) return lies;
  const BoardLayout::Rectangle outline = layout_of(board).outline;
  const glm::dvec2 middle = outline.at_m + .5 * outline.size_m;
  return {lies.rotation, -(lies * glm::dvec3(middle.x, -middle.y, 0))};
}

struct BoardTracker::Impl {
  std::vector<LaidBoard> boards;
  CameraModel lens;
  GreyPart grey;
  std::optional<TrackedPose> last, before;
  std::optional<TimestampNs> compared;  // when boards last contradicted each other
  std::string trouble;
  TrackingCounts counts;
  int misses = 0;
  bool undecided = false;

  std::optional<TrackedPose> track(const FramePixels& picture, TimestampNs time);

 private:
  struct Found {
    SolvedPose pose;
    int corners;
  };
  Pose predicted(TimestampNs time) const;
  std::optional<Found> near(const FramePixels& picture, TimestampNs time);
  std::optional<Found> search(const FramePixels& picture, TimestampNs time);
  std::optional<Found> refine(const Pose& start, TimestampNs time);
  std::optional<SolvedPose> decide(std::span<const Sighting> points, const SolvedPose& first,
                                   std::size_t board, TimestampNs time);
  std::vector<BoardSightings> marker_corners(const std::vector<FoundMarking>& markers) const;
  std::vector<BoardSightings> sub_pixels(const std::vector<FoundCorner>& corners) const;
  std::optional<SolvedPose> fit(std::vector<FoundCorner>& corners, const Pose& start,
                                std::vector<Sighting>& points, std::size_t& main) const;
  std::optional<SolvedPose> alone(std::size_t board, const BoardSightings& seen) const;
  void compare(const std::vector<std::optional<SolvedPose>>& poses);
};

// By the turn and the way between the last two.
Pose BoardTracker::Impl::predicted(TimestampNs time) const {
  const Pose& now = last->world_from_camera;
  if (!before) return now;
  const double dt = (last->time - before->time).count(), ahead = (time - last->time).count();
  if (!(dt > 0) || dt > kRemembered.count()) return now;
  const Pose& then = before->world_from_camera;
  const double k = ahead / dt;
  return {glm::normalize(rotation_by(k * turn_of(now.rotation * glm::conjugate(then.rotation))) *
                         now.rotation),
          now.translation + k * (now.translation - then.translation)};
}

std::vector<BoardSightings> BoardTracker::Impl::marker_corners(
    const std::vector<FoundMarking>& markers) const {
  std::vector<BoardSightings> out(boards.size());
  constexpr glm::dvec2 kCorners[] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  for (const FoundMarking& m : markers) {
    const BoardLayout& layout = boards[m.board].layout;
    for (std::size_t c = 0; c < 4; ++c) {
      const glm::dvec2 at = layout.markers[m.marker].at_m + layout.marker_m * kCorners[c];
      const auto s = sighting_of(lens, m.corners_px[c], boards[m.board].in_world(at));
      if (!s) continue;
      out[m.board].all.push_back(*s);
      out[m.board].seen.push_back(s->seen);
      out[m.board].on_board.push_back(at);
    }
  }
  return out;
}

std::vector<BoardSightings> BoardTracker::Impl::sub_pixels(
    const std::vector<FoundCorner>& corners) const {
  std::vector<BoardSightings> out(boards.size());
  for (const FoundCorner& c : corners) {
    const LaidBoard& board = boards[c.board];
    const glm::dvec2 at = board.layout.points[c.point].at_m;
    if (const auto s = sighting_of(lens, c.pixel, board.in_world(at)))
      out[c.board].all.push_back(*s);
  }
  return out;
}

// A board's own opinion of where the camera is, the better of both leans.
std::optional<SolvedPose> BoardTracker::Impl::alone(std::size_t board,
                                                    const BoardSightings& seen) const {
  const auto camera_from_board = flat_board_pose(seen.seen, seen.on_board);
  if (!camera_from_board) return std::nullopt;
  const LaidBoard& laid = boards[board];
  const Pose start = laid.world_from_board * camera_from_board->inverse();
  auto first = solve_pose(seen.all, start);
  if (!first) return std::nullopt;
  auto other = solve_pose(seen.all, leaned_the_other_way(first->world_from_camera, laid.middle(),
                                                         laid.world_from_board.rotation_matrix()));
  if (other && misfit(*other, first->sigma_px) < misfit(*first, first->sigma_px)) return other;
  return first;
}

// A flat board far away looks nearly alike from two places.
std::optional<SolvedPose> BoardTracker::Impl::decide(std::span<const Sighting> points,
                                                     const SolvedPose& first, std::size_t board,
                                                     TimestampNs time) {
  constexpr double kSame = .01;    // radians
  constexpr double kDecided = 25;  // of misfit: five standard deviations
  constexpr double kNearer = .5;
  const LaidBoard& laid = boards[board];
  auto other = solve_pose(points, leaned_the_other_way(first.world_from_camera, laid.middle(),
                                                       laid.world_from_board.rotation_matrix()));
  if (!other) return first;
  const double turn = angle_between(first.world_from_camera, other->world_from_camera);
  const double sigma = std::min(first.sigma_px, other->sigma_px);
  const double worse = misfit(*other, sigma) - misfit(first, sigma);
  if (turn < kSame) return worse >= 0 ? first : *other;
  if (worse > kDecided) return first;
  if (worse < -kDecided) return other;
  if (last && time - last->time <= kDecides) {
    const Pose expected = predicted(time);
    const double from_first = angle_between(expected, first.world_from_camera),
                 from_other = angle_between(expected, other->world_from_camera);
    if (from_first < kNearer * from_other) return first;
    if (from_other < kNearer * from_first) return other;
  }
  undecided = true;
  return std::nullopt;
}

// With tags twice more, as their corners are rounded by what the pose tells.
// points: that were fitted
// main:   the board that most of them lie on
std::optional<SolvedPose> BoardTracker::Impl::fit(std::vector<FoundCorner>& corners,
                                                  const Pose& start, std::vector<Sighting>& points,
                                                  std::size_t& main) const {
  const bool tags =
      std::ranges::any_of(corners, [](const auto& c) { return c.inward != glm::dvec2(0); });
  std::optional<SolvedPose> solved;
  for (int round = 0; round < (tags ? 3 : 1); ++round) {
    if (round > 0) take_back_rounding(lens, boards, solved->world_from_camera, corners);
    points.clear();
    const auto seen = sub_pixels(corners);
    for (std::size_t b = 0; b < seen.size(); ++b) {
      if (seen[b].all.size() > seen[main].all.size()) main = b;
      points.insert(points.end(), seen[b].all.begin(), seen[b].all.end());
    }
    solved = solve_pose(points, solved ? solved->world_from_camera : start);
    if (!solved) return std::nullopt;
  }
  return solved;
}

// Corners to sub-pixels around a pose, again where that misses many or moves them far: windows that
// are off by some pixels find neighbours' edges, which agree on a pose that lags behind.
std::optional<BoardTracker::Impl::Found> BoardTracker::Impl::refine(const Pose& start,
                                                                    TimestampNs time) {
  constexpr double kMost = .7, kAgree = .5, kSettled_px = 1;
  constexpr int kPasses = 4;
  Pose pose = start;
  std::optional<SolvedPose> solved;
  std::vector<Sighting> points;
  std::size_t main = 0;
  for (int pass = 0; pass < kPasses; ++pass) {
    CornerSearch corners = find_corners(grey, lens, boards, pose);
    if (std::ssize(corners.found) < kFewestCorners) return std::nullopt;
    solved = fit(corners.found, pose, points, main);
    if (!solved) return std::nullopt;
    pose = solved->world_from_camera;
    if (corners.moved_px < kSettled_px &&
        (static_cast<double>(solved->used) > kMost * corners.expected || pass > 0))
      break;
  }
  if (solved->used < kFewestCorners || solved->used < kAgree * static_cast<double>(points.size()))
    return std::nullopt;
  const auto decided = decide(points, *solved, main, time);
  if (!decided || !markers_agree(grey, lens, boards, decided->world_from_camera))
    return std::nullopt;
  return Found{*decided, decided->used};
}

std::optional<BoardTracker::Impl::Found> BoardTracker::Impl::near(const FramePixels& picture,
                                                                  TimestampNs time) {
  if (!last || time - last->time > kRemembered) return std::nullopt;
  if (!trouble.empty() && time - *compared > kLooksAgain) return std::nullopt;
  const Pose pose = predicted(time);
  const auto bounds = bounds_of(lens, boards, pose);
  if (bounds.empty()) return std::nullopt;
  grey.set(picture, bounds);
  return refine(pose, time);
}

std::optional<BoardTracker::Impl::Found> BoardTracker::Impl::search(const FramePixels& picture,
                                                                    TimestampNs time) {
  grey.set(picture, {0, 0, lens.width, lens.height});
  const auto seen = marker_corners(find_markers(grey, boards, misses % 2 == 1));  // in turns
  std::vector<std::optional<SolvedPose>> poses(boards.size());
  std::size_t main = 0;
  for (std::size_t b = 0; b < boards.size(); ++b) {
    if (!seen[b].all.empty()) poses[b] = alone(b, seen[b]);
    if (seen[b].all.size() > seen[main].all.size()) main = b;
  }
  if (std::ranges::count_if(poses, [](const auto& p) { return p.has_value(); }) > 1) compare(poses);
  if (!trouble.empty()) compared = time;
  for (std::size_t b = 0; !boards[main].counts && b < boards.size(); ++b)
    if (boards[b].counts && poses[b]) main = b;
  if (!poses[main]) return std::nullopt;
  return refine(poses[main]->world_from_camera, time);
}

// Each board's corners around its own pose; then whether one camera sees them all.
void BoardTracker::Impl::compare(const std::vector<std::optional<SolvedPose>>& poses) {
  constexpr double kTimes = 4, kLeast_px = .4, kFarthest_px = 50;
  for (LaidBoard& b : boards) b.counts = false;
  std::vector<Sighting> points;
  std::vector<std::size_t> those;
  std::vector<glm::dvec3> middles;  // in the camera
  double own_px = 0;
  std::optional<Pose> start;
  for (std::size_t b = 0; b < boards.size(); ++b) {
    if (!poses[b]) continue;
    boards[b].counts = true;
    const auto seen =
        sub_pixels(find_corners(grey, lens, boards, poses[b]->world_from_camera).found);
    boards[b].counts = false;
    const auto own = solve_pose(seen[b].all, poses[b]->world_from_camera);
    if (!own || own->used < kFewestCorners) continue;
    own_px = std::max(own_px, own->rms_px);
    if (!start) start = own->world_from_camera;
    those.push_back(b);
    middles.push_back(own->world_from_camera.inverse() * boards[b].middle());
    points.insert(points.end(), seen[b].all.begin(), seen[b].all.end());
  }
  for (LaidBoard& b : boards) b.counts = true;
  const auto all = those.size() > 1 ? solve_pose(points, *start) : std::nullopt;
  if (!all) return;
  double squares = 0;
  for (const double off : all->off_px) squares += std::pow(std::min(off, kFarthest_px), 2);
  const double rms = std::sqrt(squares / (2. * static_cast<double>(all->off_px.size())));
  if (rms <= std::max(kLeast_px, kTimes * own_px)) {
    trouble.clear();
    return;
  }
  const bool new_trouble = trouble.empty();
  trouble = fmt::format(
      "boards {} and {} contradict each other by {:.1f} px: their middles are {:.3f} m apart as "
      "seen and {:.3f} m as told; is a size or a place wrong, or was one moved? Board {} is "
      "believed",
      those[0] + 1, those[1] + 1, rms, glm::length(middles[0] - middles[1]),
      glm::length(boards[those[0]].middle() - boards[those[1]].middle()), those[0] + 1);
  if (new_trouble) log_warning("board tracking: {}", trouble);
  for (std::size_t i = 1; i < those.size(); ++i) boards[those[i]].counts = false;
}

std::optional<TrackedPose> BoardTracker::Impl::track(const FramePixels& picture, TimestampNs time) {
  constexpr int kLong = 15, kSometimes = 3;  // pictures
  const int width = std::visit([](const auto&image) { return image.width(); }, picture),
            height = std::visit([](const auto&image) { return image.height(); }, picture);
  if (width != lens.width || height != lens.height) return std::nullopt;
  undecided = false;
  auto found = near(picture, time);
  const bool searched = !found;
  if (!found && (misses < kLong || misses % kSometimes == 0)) found = search(picture, time);
  if (!found) {
    ++misses;
    ++counts.missed;
    counts.undecided += undecided;
    return std::nullopt;
  }
  misses = 0;
  ++(searched ? counts.searched : counts.near);
  TrackedPose out{time,
                  found->pose.world_from_camera,
                  found->pose.covariance.m,
                  found->pose.rms_px,
                  found->corners,
                  searched};
  before = last && time - last->time <= kRemembered ? last : std::nullopt;
  last = out;
  return out;
}

BoardTracker::BoardTracker(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
BoardTracker::BoardTracker(BoardTracker&&) noexcept = default;
BoardTracker& BoardTracker::operator=(BoardTracker&&) noexcept = default;
BoardTracker::~BoardTracker() = default;

Result<BoardTracker> BoardTracker::create(std::vector<PlacedBoard> boards,
                                          const CameraModel& lens) {
  PENUMBRA_TRY(check_boards(boards));
  if (!has_intrinsics(lens.kind) || lens.width < 1 || lens.height < 1)
    return fail(
        ErrorCode::kInvalid, "board tracking",
        fmt::format("needs a lens with intrinsics, and {} has none", projection_name(lens.kind)));
  auto impl = std::make_unique<Impl>();
  impl->lens = lens;
  for (PlacedBoard& b : boards) {
    b.world_from_board.rotation = glm::normalize(b.world_from_board.rotation);
    impl->boards.push_back({b.board, layout_of(b.board), b.world_from_board, true});
  }
  return BoardTracker(std::move(impl));
}

std::optional<TrackedPose> BoardTracker::track(const FramePixels& picture, TimestampNs time) {
  return impl_->track(picture, time);
}
const std::string& BoardTracker::trouble() const {
  return impl_->trouble;
}
const BoardTracker::TrackingCounts& BoardTracker::counts() const {
  return impl_->counts;
}

}  // namespace penumbra::calib
