// The HDR merge at camera rate.
// threads: thread-bound
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "capture/frames.h"
#include "capture/hdr/merge.h"
#include "core/image.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

class FrameWatch;   // private: frame_watch.h
class TableMerger;  // private: table_merger.h

/// The merge at camera rate: every new frame replaces the one of its exposure and publishes a new
/// image. What moved or changed since an older exposure was taken leaves no ghost: older samples
/// that contradict newer ones by the noise model are left out. Of a lamp that moves, light vanishes
/// from one place while another becomes brighter than the newest exposure can tell. In frames of 8
/// bits that light stays whole until a shorter exposure has seen it. When the camera turns
/// (Frame::world_from_camera) older exposures are turned with it; what they did not see is taken
/// from the newest. Bands that light on the mains leaves under a rolling shutter are taken out of a
/// frame first, once eight frames of its exposure have shown them. A white balance that moves is
/// warned of once.
/// source: sample rejection at 3.5 sigma, Granados et al. 2010
class HdrRing {
 public:
  static constexpr int kMaxSlots = 16;
  /// in: slots 1..kMaxSlots
  HdrRing(CameraInfo camera, int slots = kMaxSlots);
  ~HdrRing();
  HdrRing(HdrRing&&) noexcept;
  HdrRing& operator=(HdrRing&&) noexcept;
  /// errors: kInvalid (size changed, bad exposure, more exposures in turn than slots, as soon as
  ///         they are seen to come again), kUndetermined as merge(), and where a frame shows
  ///         another exposure of the bracket than its label says
  Result<const MergedImage*> add(const Frame& given);
  /// Different exposures that stand in the ring.
  std::size_t exposures() const { return slots_.size(); }
  /// Whether the shortest exposure's own frame holds a clipped pixel. Where it holds none, what is
  /// clipped in the merged image only waits for it.
  bool shortest_clips() const;
  /// False while a shorter exposure may still come: until one came back after others or twice in a
  /// row, or the ring is full.
  bool bracket_complete() const { return came_back_ || slots_.size() >= max_slots_; }

 private:
  struct RingSlot {
    Frame frame;
    Exposure nominal;          // as its exposure came first; flicker moves the frames' own
    double gain_log = 0;       // of late, in the mean
    std::uint64_t placed = 0;  // frames that the ring had taken before
    // As the camera would have seen it from where it looks now; null: as it is.
    std::shared_ptr<const FramePixels> turned{};
    Image<std::uint8_t> valid{};  // of `turned`
    const std::shared_ptr<const FramePixels>& pixels() const {
      return turned ? turned : frame.pixels;
    }
  };
  bool turn_to(const Frame& newest);
  void fill_unseen(RingSlot& slot, const Frame& newest) const;
  RingSlot* slot_of(const Exposure& exposure);
  Result<void> make_room(const Frame& frame);
  Result<void> merge_now(const std::optional<Frame>& replaced);
  Result<void> merge_all();
  CameraInfo camera_;
  std::size_t max_slots_;
  bool came_back_ = false;   // an exposure
  int repeats_ = 0;          // in a row: of a frame that a driver gave twice, or one exposure alone
  bool was_turned_ = false;  // some slot, at the last merge
  std::uint64_t taken_ = 0;
  std::vector<RingSlot> slots_;  // longest exposure first
  struct LeftExposure {
    Exposure exposure;
    std::uint64_t left;  // frames that the ring had taken before
  };
  std::vector<LeftExposure> left_;  // of late, for want of room
  std::size_t came_again_ = 0;      // frames in a row whose exposure had left
  bool said_ = false;               // that exposures leave
  std::unique_ptr<FrameWatch> watch_;
  std::vector<Exposure> table_exposures_;
  std::unique_ptr<TableMerger> table_;
  MergedImage merged_;
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
