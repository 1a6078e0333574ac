// Private to capture: the merge of 8-bit frames by tables, kept up to date frame by frame.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/camera/noise.h"
#include "calib/camera/response_table.h"
#include "capture/frames.h"
#include "capture/hdr/contradiction.h"
#include "capture/hdr/merge.h"
#include "capture/hdr/pixel_weights.h"
#include "capture/ring/hdr_ring.h"
#include "capture/ring/internal/table_kernel.h"

namespace penumbra::capture {

/// The estimate of merge() for 8-bit frames of a fixed set of exposures, from tables. The longest
/// unclipped exposure and the next one decide, which costs at most 3 % of RMSE at two stops between
/// exposures. An update does no more than the new frame needs. Blocks of pixels that shorter
/// exposures than the new one have decided alone stay as they are. Samples are tested against newer
/// ones only where something changed since the oldest frame was taken.
/// threads: internally parallel; no allocation after the first update
class TableMerger {
 public:
  /// Exposures longest first. Nothing when they lie so close that two of them hold less than 90 %
  /// of the information.
  static std::optional<TableMerger> make(std::span<const Exposure> exposures,
                                         const CameraInfo& camera);

  struct MergeSlot {
    const Image<Rgb8>* pixels;
    Exposure exposure;     // within a few per cent of what make() got
    std::uint64_t placed;  // grows with time; the newest is the one that is new
  };
  /// Slots as the exposures in make(). `replaced`: what stood in the newest one's place before;
  /// without it everything is merged anew.
  void update(std::span<const MergeSlot> slots, const MergeSlot* replaced, MergedImage& out);

 private:
  struct MergeBlock {
    BlockCounts counts;
    std::uint64_t changed = 0;  // when it last showed something else than before
    bool mixed = false;         // of frames from before and after that
    // Where samples contradicted: radiance times solid angle, in stored units
    std::array<double, 3> vanished{};
    bool vanished_clipped = false;  // some of that was a lower bound
    // Holds pixels brighter than the newest exposure can tell, which others contradict
    bool undecided = false;
  };
  static constexpr std::size_t kMaxExposures = HdrRing::kMaxSlots;
  /// What an update knows of all blocks.
  struct MergeJob {
    std::array<const std::uint8_t*, kMaxExposures> codes{};
    std::array<std::uint8_t, kMaxExposures> by_age{};  // newest first
    const std::uint8_t* replaced = nullptr;
    CodeTolerance tolerance{};
    std::uint64_t now = 0, oldest = 0;  // placed
    std::size_t newest() const { return by_age[0]; }
  };
  struct BlockJob {
    const MergeJob& all;
    std::array<const std::uint8_t*, kMaxExposures> codes;
    const std::uint8_t* replaced;
    HalfRgba* out;
    std::size_t first;  // pixel
    std::size_t count;  // of real pixels; the rest repeats them
  };
  using Flags = std::array<std::uint8_t, kMergeBlock>;
  struct LeftOut {
    std::array<Flags, kMaxExposures> of{};
    Flags any{};
  };

  explicit TableMerger(const CameraInfo& camera);
  void fill_tables();
  void follow(std::span<const MergeSlot> slots);
  void scale_step(std::size_t step);
  void compare_exposures(std::size_t one);
  CodeSamples samples(std::size_t channel) const;
  const AllowedCodes& allowed(std::size_t channel, std::size_t known, std::size_t asked) const;
  AllowedCodes& allowed(std::size_t channel, std::size_t known, std::size_t asked);
  CodeTolerance tolerance(const Exposure& now, const Exposure& before) const;
  MergeJob describe(std::span<const MergeSlot> slots, const MergeSlot* replaced) const;
  void update_rest(const MergeJob& job, MergedImage& out);
  void update_block(const BlockJob& job, MergeBlock& block) const;
  bool leave_out_contradicted(const BlockJob& job, LeftOut& left) const;
  void bound_undecided(const BlockJob& job, const LeftOut& left, std::size_t pixel) const;
  void merge_mixed(const BlockJob& job, MergeBlock& block) const;
  BlockCounts merge_real(const BlockJob& job) const;
  void keep_energy(MergedImage& out);
  TableView view() const;

  ResponseTable curve_;
  calib::CameraModel projection_;
  calib::NoiseModel noise_;
  double max_sigmas_ = kMaxSigmas;
  std::vector<Exposure> nominal_, current_;  // longest first; current: what the tables hold
  // [channel set][step][code of next][code]: half radiance / scale, at the nominal exposures and at
  // the current ones
  std::vector<std::uint16_t> nominal_tables_, tables_;
  std::vector<AllowedCodes> allowed_;  // [channel set][known][asked], at the current exposures
  std::size_t channel_sets_ = 1;
  float scale_ = 1;
  std::array<std::uint8_t, 3> clip_code_{};
  std::array<std::uint8_t, kBlockSamples> clip_{}, black_{};
  std::array<std::int32_t, kBlockSamples> offsets_{};  // of a sample's channel in allowed_

  std::optional<PixelWeights> weights_;
  std::vector<MergeBlock> blocks_;
};

}  // namespace penumbra::capture
