// One frame of a clip, baked: transfer in the materials' own frames.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "core/result.h"
#include "prt/bake/bake.h"
#include "prt/clip/internal/journal.h"
#include "prt/clip/internal/seams.h"
#include "prt/clip/key_frames.h"
#include "prt/clip/light_map.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"
#include "prt/transfer/transfer.h"

namespace penumbra::prt {

/// Of everything that a clip's transfer depends on in the asset.
std::uint64_t fingerprint(const Character& character, int clip);
/// Whether a light map could be laid out.
bool has_light_coordinates(const Character& character);

/// What a frame is baked with, the same in all frames.
class FrameBaker {
 public:
  /// errors: kInvalid (options, clip)
  static Result<FrameBaker> create(const Character& character, int clip,
                                   const SequenceOptions& options);

  /// Of the rate that was asked for: one every kMaxParts positions in time.
  int frames() const { return frames_; }
  /// Positions that a frame can be baked at, all alike apart.
  static constexpr int kMaxParts = KeyFrames::kMaxParts;
  int positions() const { return frames_ * kMaxParts; }
  const SurfaceLayout& layout() const { return layout_; }
  const std::optional<Receiver>& receiver() const { return receiver_; }
  JournalKey key() const;

  /// errors: kUnavailable (Embree)
  Result<FrameRecord> bake(int position, const std::function<void(double)>& progress) const;

  /// The streams of a frame's values, in their order.
  enum Stream { kSurface, kSurfaceReflected, kGround, kGroundReflected, kStreams };
  /// An empty transfer of the stream's shape: no points where there is no receiver.
  Transfer shape(Stream stream) const;
  std::size_t offset(Stream stream) const;  // in FrameRecord::values
  /// Gives points of the surface values in frames in which they lie within something, where records
  /// have none.
  void complete_hidden(std::span<Transfer> frames, const KeyFrames& keys) const;
  /// Whether the clip is more than one pose.
  bool moves() const;

 private:
  FrameBaker(const Character& character, int clip, const SequenceOptions& options);
  double seconds_at(int position) const;
  void find_receiver();
  int channels() const;
  void link_points();
  std::vector<glm::mat3> ray_frames(const Mesh& mesh, const std::vector<glm::mat3>& bones) const;
  void mark_hidden(const BakeReport& report, Transfer& transfer) const;
  void complete_in_time(std::size_t point, std::span<Transfer> frames, const KeyFrames& keys) const;
  void denoise(const BakeReport& report, const Mesh& mesh, Transfer& transfer) const;
  void equalise_seams(const BakeReport& report, Transfer& transfer, Transfer& reflected) const;

  const Character& character_;
  int clip_;
  const SequenceOptions& options_;
  SurfaceLayout layout_;
  Seams seams_;
  int frames_;
  int reflected_bands_;
  std::optional<Receiver> receiver_;
  std::vector<std::uint32_t> link_begin_, links_;  // of each point, those beside it
};

}  // namespace penumbra::prt
