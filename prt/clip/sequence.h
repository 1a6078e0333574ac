// Transfer over an animation: baked frame by frame, compressed for rendered error, relit at any
// time. A surface point's transfer is kept in the frame of its strongest bone, where it hardly
// changes; so the light is what is turned.
// threads: free functions reentrant and internally parallel; a TransferSequence's queries reentrant
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "core/sh.h"
#include "prt/clip/key_frames.h"
#include "prt/clip/light_map.h"  // IWYU pragma: export
#include "prt/geometry/animation.h"
#include "prt/geometry/receiver.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

struct BakedObject;
struct Transfer;

/// What relighting a clip comes to at one moment, for whoever does the sums: point i of a part,
/// which is point order()[first_point + i], shines with the sum of colour times values()[offset +
/// i] over the part's terms.
struct RelightPlan {
  struct Term {
    std::uint32_t offset;
    float r, g, b;
  };
  struct RelightPart {
    std::uint32_t first_term, term_count, first_point, point_count;
    std::uint32_t wide_count;  // terms whose maps do not fit eight bits; they come first
  };
  std::vector<Term> terms;
  std::vector<RelightPart> parts;  // no point in two
};

/// A mean square over a part's points of what a term adds to the brightest colour.
struct TermEnergy {
  float energy;
  bool wide;  // its map does not fit eight bits
};

/// Transfer at points over the frames of a clip, compressed: t(f) = m + sum_k v_k(f) U_k
/// for every group of points that share a bone, and apart for green, red - green and blue - green.
/// m and U_k are multiples of one step, each band's as fine as the light's mean energy in it asks.
/// A long clip has several spans of frames with an m and U_k each; from one to the next the sums
/// are mixed.
/// source: temporal PCA in the material frame after Sloan, Luna & Snyder 2005; uniform steps and
///         the cut of components by reverse water-filling (Cover & Thomas 2006, 10.3.3)
class TransferSequence {
 public:
  int bands() const { return bands_; }
  int channels() const { return channels_; }
  int frames() const { return frames_; }
  std::size_t points() const { return points_; }
  std::size_t stride() const { return (points_ + 63) / 64 * 64; }
  /// Most components of any group at a time, the mean not counted.
  int max_components() const;

  /// out[channel * stride + point] = sum_n l_n t_n(point): exit radiance for a unit albedo, as
  /// prt::relight.
  /// in: frame 0..frames(), between frames on a straight line, beyond the last to the first; light
  ///     in the bake frame; turns as bone_turns at that time
  /// out: 3 * stride() floats. No allocation after the first call of a thread. Parallel inside: not
  /// from within a parallel loop.
  void relight(double frame, const RadianceSh& light, std::span<const glm::mat3> turns,
               std::span<float> out) const;
  /// The sums of relight(), not done; terms that together are below kUnseen of the whole are left
  /// out. No allocation once `out` has its size.
  void plan(double frame, const RadianceSh& light, std::span<const glm::mat3> turns,
            RelightPlan& out) const;
  /// Maps over a part's points, each padded to kLanes.
  std::span<const std::int16_t> values() const { return values_; }
  std::span<const std::uint32_t> order() const { return order_; }
  /// All coefficients at a time, in the bake frame. No allocation once `out` has its size.
  void decode(double frame, std::span<const glm::mat3> turns, Transfer& out) const;

  /// RMS over a part's points, relative to the root of its terms' summed squares: a fifth of what
  /// compression may cost, and half of the work.
  static constexpr float kUnseen = .001f;
  /// Points that kernels take at once: what a map is padded to.
  static constexpr std::size_t kLanes = 32;

 private:
  friend class SequenceCodec;
  // Over the points of a group.
  struct Map {
    std::uint32_t offset;   // into values_; kNone: zero everywhere
    float mean_square = 0;  // of its values
    bool wide = false;      // does not fit narrow_
    bool none() const { return offset == kNone; }
  };
  static constexpr std::uint32_t kNone = 0xffffffffu;
  struct Component {
    int first_frame = 0, frames = 0;  // of its span; 0 outside
    std::vector<float> weight;        // by frame of the span; the mean has none: 1
    std::vector<Map> maps;            // by coefficient
    float at(int frame) const {
      const int inside = frame - first_frame;
      if (inside < 0 || inside >= frames) return 0;
      return weight.empty() ? 1 : weight[static_cast<std::size_t>(inside)];
    }
  };
  struct BoneGroup {
    int bone;
    int plane;                 // 0: green or grey, 1: red - green, 2: blue - green
    std::size_t first, count;  // in order_
    std::vector<Component> components;
  };
  float weight_at(const Component& c, double frame) const;
  void add_terms(const BoneGroup& group, double frame, const RadianceSh& seen, bool wide,
                 std::vector<RelightPlan::Term>& terms, std::vector<TermEnergy>& energies) const;
  /// Fills in what follows from values_.
  void finish_maps();

  int bands_ = 0, channels_ = 1, frames_ = 0;
  std::size_t points_ = 0;
  std::vector<float> step_;           // by band: what one unit of a value is
  std::vector<std::uint32_t> order_;  // points by bone
  std::vector<BoneGroup> groups_;
  std::vector<std::int16_t> values_;  // padded to kernels' width a map
  // The same once more where a map fits: relighting waits for memory
  std::vector<std::int8_t> narrow_;
};

/// Mean square of a coefficient of light in band l, beside that of band 0, over the eight measured
/// environments of docs/results.md, suns and lamps counted in. What transfer in a band is worth.
std::span<const float> mean_band_energy();

struct SequenceOptions {
  double frames_per_second = 30;
  int bands = 5;
  int bounces = 4;
  int rays = 256, ground_rays = 256;  // a point and frame; multiples of 64
  int map_width = 0, map_height = 0;  // of a light map, texels; 0: vertices alone
  std::optional<int> ground_size;     // texels of the receiver's side; none: no receiver
  Rgb ground_albedo;
  bool denoise = true;
  /// Rendered error that compression may add: RMS over points and frames of the exit radiance under
  /// light of mean_band_energy, relative.
  double error = .005;
  /// The same measure that a straight line between two key frames may be off by: where it is more
  /// than allowed_interpolation_error of it, further frames are baked between them, up to
  /// KeyFrames::kMaxParts - 1. 0: none are.
  double interpolation_error = .02;
  std::function<void(double done)> progress;  // 0..1
};

struct SequenceReport {
  std::uint64_t rays = 0;
  double seconds = 0;              // of baking, over all runs and shards
  double standard_error = 0;       // of t_0, relative to its mean, as BakeReport
  double compression_error = 0;    // as SequenceOptions::error
  double interpolation_error = 0;  // RMS over the clip's time, the same measure; 0: too few frames
  double worst_interpolation = 0;  // of all intervals between key frames
  std::size_t surface_bytes = 0, ground_bytes = 0;
};

/// A character's clip, baked.
struct BakedSequence {
  std::string clip;
  double seconds = 0;  // of the clip
  KeyFrames keys;
  int map_width = 0, map_height = 0;
  TransferSequence surface, surface_reflected;  // at the layout's points
  std::optional<Receiver> receiver;             // its grid holds for all frames
  TransferSequence ground_deficit, ground_reflected;
  SequenceReport report;
  double frame_at(double time_s) const;
};

/// Frames index, index + count, ... of a clip.
struct Shard {
  int index = 0, count = 1;
};
/// Bakes a clip's frames into `journal`: a bake that was cut off goes on where it stopped, and
/// shards are baked apart. The whole of them (one shard) with what bake_between adds.
/// errors: kInvalid (options, clip, a journal of another bake), kUnwritable, kUnavailable
Result<void> bake_frames(const Character& character, int clip, const SequenceOptions& options,
                         Shard shard, const std::filesystem::path& journal);
/// Bakes the frames that options.interpolation_error asks for besides those of `journals`, which
/// hold the others, into `journal`, round by round: progress begins anew with each. What is baked
/// does not depend on how frames were shared out, nor on kills. True when compress_frames needs
/// `journal` besides `journals`.
/// errors: as bake_frames, as compress_frames
Result<bool> bake_between(const Character& character, int clip, const SequenceOptions& options,
                          std::span<const std::filesystem::path> journals,
                          const std::filesystem::path& journal);
/// Rounds of bake_between that are worth sharing out: as many as it takes to halve an interval down
/// to a part. An interval that becomes too coarse only when those beside it are finer comes later;
/// such stragglers bake_between bakes.
inline constexpr int kRounds = std::bit_width(KeyFrames::kMaxParts) - 1;
/// The shard's part of the first round that `journals`, which hold every frame of the rounds
/// before, do not hold; into `journal`, which need not be among them. So shards of one round are
/// baked apart, too.
/// errors: as bake_between
Result<void> bake_round(const Character& character, int clip, const SequenceOptions& options,
                        Shard shard, std::span<const std::filesystem::path> journals,
                        const std::filesystem::path& journal);
/// How many frames `journal` lacks of those that bake_frames bakes for the shard, or, where
/// `journals` are given, of those that bake_round does.
/// errors: as bake_frames, as compress_frames
Result<std::size_t> missing_frames(const Character& character, int clip,
                                   const SequenceOptions& options, Shard shard,
                                   std::span<const std::filesystem::path> journals,
                                   const std::filesystem::path& journal);
/// Whether each shard's journal holds its frames: journals[i] is that of shard i of so many.
/// errors: kNotFound, kUnreadable, kInvalid (of another bake; frames missing), each naming the
///         first faulty journal, with the numbers of the others
Result<void> check_shards(const Character& character, int clip, const SequenceOptions& options,
                          std::span<const std::filesystem::path> journals);
/// A fingerprint of everything that a bake of the clip depends on.
/// errors: as bake_frames
Result<std::uint64_t> bake_key(const Character& character, int clip,
                               const SequenceOptions& options);
/// What baking a clip comes to, but for frames between those of the rate that was asked for.
struct ClipWork {
  int frames = 0;
  std::size_t points = 0;
  std::uint64_t rays = 0;
  std::uint64_t journal_bytes = 0;
  double seconds = 0;       // about, on this machine as busy as it is
  double core_seconds = 0;  // about, of one core like these
};
/// By baking one frame with few rays, and with some more.
/// errors: as bake_frames
Result<ClipWork> estimate_work(const Character& character, int clip,
                               const SequenceOptions& options);
/// Joins journals that together hold every frame of the rate that was asked for, and those of
/// bake_between. Others that they hold besides, as of another options.interpolation_error, are left
/// out. The result does not depend on how frames were shared out.
/// errors: kNotFound, kUnreadable, kInvalid (frames missing: which; a journal of another bake)
Result<BakedSequence> compress_frames(const Character& character, int clip,
                                      const SequenceOptions& options,
                                      std::span<const std::filesystem::path> journals);

/// The surface's frames as baked, in the materials' frames, and what their compression alone comes
/// to: for charts.
/// errors: as compress_frames
Result<std::vector<Transfer>> baked_surface(const Character& character, int clip,
                                            const SequenceOptions& options,
                                            std::span<const std::filesystem::path> journals);
struct CompressedSurface {
  TransferSequence sequence;
  std::size_t bytes = 0;
};
CompressedSurface compress_surface(const SurfaceLayout& layout, std::span<const Transfer> frames,
                                   double relative_error);

/// The baked file of a clip. It belongs to its asset, which is needed to read it.
/// errors: kUnwritable / kNotFound, kUnreadable (damaged: offset), kInvalid (not ours, another
/// version, baked from another mesh or clip)
Result<void> write_sequence(const std::filesystem::path& path, const Character& character, int clip,
                            const BakedSequence& sequence);
Result<BakedSequence> read_sequence(const std::filesystem::path& path, const Character& character,
                                    int clip);
/// What a baked clip's file tells without its asset, which has to be prepared for the light map
/// before it can be read.
struct SequenceInfo {
  int map_width = 0, map_height = 0;  // of the light map, texels; 0 without one
  int ground_size = 0;                // texels of the receiver's side; 0 without one
  double seconds = 0;
  std::size_t key_frames = 0;
  SequenceReport report;  // without its seconds
};
/// errors: as read_sequence; damage beyond the file's head is not found
Result<SequenceInfo> read_sequence_info(const std::filesystem::path& path);
/// The same from memory, without the checksum over all of it; `name` stands in errors. For fuzzing.
Result<BakedSequence> decode_sequence(std::span<const unsigned char> bytes,
                                      const Character& character, int clip,
                                      const std::string& name);

}  // namespace penumbra::prt
#pragma GCC visibility pop
