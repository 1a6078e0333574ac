#include "prt/clip/sequence.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "prt/clip/internal/frame_bake.h"
#include "prt/clip/internal/journal.h"
#include "prt/clip/internal/sequence_codec.h"
#include "prt/clip/key_frames.h"
#include "prt/clip/light_map.h"
#include "prt/geometry/animation.h"
#include "prt/transfer/transfer.h"

namespace penumbra::prt {

double BakedSequence::frame_at(double time_s) const {
  return seconds > 0 ? keys.frame_at(time_s / seconds) : 0;
}

namespace {

// Positions in order into a journal, but for those that it holds; visit(record) of each new one.
template <class Visit>
Result<void> bake_positions(const FrameBaker& baker, std::span<const int> wanted, Journal& journal,
                            const std::function<void(double)>& progress, const Visit& visit) {
  const std::set<std::uint32_t> done(journal.frames().begin(), journal.frames().end());
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    const auto fraction = [&](double of_frame) {
      if (progress)
        progress((static_cast<double>(i) + of_frame) / static_cast<double>(wanted.size()));
    };
    fraction(0);
    if (done.contains(static_cast<std::uint32_t>(wanted[i]))) continue;
    PENUMBRA_ASSIGN(record, baker.bake(wanted[i], fraction));
    PENUMBRA_TRY(journal.add(record));
    visit(std::move(record));
  }
  if (progress) progress(1);
  return {};
}

Result<void> check(Shard shard) {
  if (shard.count >= 1 && shard.index >= 0 && shard.index < shard.count) return {};
  return fail(ErrorCode::kInvalid, "shard",
              fmt::format("{}/{} is not i/n with i in 1..n", shard.index + 1, shard.count));
}

// Of the wanted positions, those that a journal does not hold.
Result<std::size_t> count_missing(const FrameBaker& baker, std::span<const int> wanted,
                                  const std::filesystem::path& journal) {
  PENUMBRA_ASSIGN(held, frames_of_journal(journal, baker.key()));
  const std::set<std::uint32_t> found(held.begin(), held.end());
  return static_cast<std::size_t>(std::ranges::count_if(
      wanted, [&](int position) { return !found.contains(static_cast<std::uint32_t>(position)); }));
}

// Of the positions that the rate asks for.
std::vector<int> share_of(const FrameBaker& baker, Shard shard) {
  std::vector<int> out;
  for (int f = shard.index; f < baker.frames(); f += shard.count)
    out.push_back(f * FrameBaker::kMaxParts);
  return out;
}

}  // namespace

Result<void> bake_frames(const Character& character, int clip, const SequenceOptions& options,
                         Shard shard, const std::filesystem::path& journal_path) {
  PENUMBRA_TRY(check(shard));
  PENUMBRA_ASSIGN(baker, FrameBaker::create(character, clip, options));
  PENUMBRA_ASSIGN(journal, Journal::open(journal_path, baker.key()));
  const std::vector<int> wanted = share_of(baker, shard);
  PENUMBRA_TRY(bake_positions(baker, wanted, journal, options.progress, [](auto&&) {}));
  if (shard.count > 1) return {};
  const std::filesystem::path journals[] = {journal_path};
  PENUMBRA_TRY(bake_between(character, clip, options, journals, journal_path));
  return {};
}

Result<std::uint64_t> bake_key(const Character& character, int clip,
                               const SequenceOptions& options) {
  PENUMBRA_ASSIGN(baker, FrameBaker::create(character, clip, options));
  return baker.key().bake;
}

namespace {

using Records = std::map<std::uint32_t, FrameRecord>;  // by position

// Everything that journals hold: at least every frame of the rate that was asked for.
Result<Records> gather(const FrameBaker& baker, std::span<const std::filesystem::path> journals) {
  Records out;
  for (const std::filesystem::path& path : journals) {
    PENUMBRA_ASSIGN(records, read_journal(path, baker.key()));
    for (FrameRecord& r : records) out[r.frame] = std::move(r);
  }
  for (int f = 0; f < baker.frames(); ++f)
    if (!out.contains(static_cast<std::uint32_t>(f * FrameBaker::kMaxParts)))
      return fail(ErrorCode::kInvalid, journals.empty() ? "journals" : journals[0].string(),
                  fmt::format("frame {} of {} is in none of the {} journals: bake it first", f,
                              baker.frames(), journals.size()));
  return out;
}

KeyFrames keys_of(const FrameBaker& baker, const Records& records) {
  KeyFrames keys{static_cast<std::uint32_t>(baker.positions()), {}};
  for (const auto& [position, record] : records) keys.at.push_back(position);
  return keys;
}

std::vector<Transfer> frames_of(const FrameBaker& baker, const Records& records,
                                FrameBaker::Stream stream) {
  std::vector<Transfer> out;
  const auto first = static_cast<std::ptrdiff_t>(baker.offset(stream));
  for (const auto& [position, r] : records) {
    Transfer t = baker.shape(stream);
    std::copy_n(r.values.begin() + first, t.values.size(), t.values.begin());
    out.push_back(std::move(t));
  }
  if (stream == FrameBaker::kSurface || stream == FrameBaker::kSurfaceReflected)
    baker.complete_hidden(out, keys_of(baker, records));
  return out;
}

// Of the open receiver, whose light the shadow's ratio is of.
double open_rms(int bands) {
  double basis[kMaxCoefficients], sum = 0;
  lighting::evaluate_basis(bands, {0, 1, 0}, basis);
  for (int l = 0; l < bands; ++l)
    for (int m = -l; m <= l; ++m)
      sum += mean_band_energy()[static_cast<std::size_t>(l)] *
             std::pow(lighting::cosine_coefficient(l) / kPi * basis[sh_index(l, m)], 2);
  return std::sqrt(sum);
}

// Of t_0, relative to its mean.
double standard_error(const Records& records) {
  double variance = 0, mean = 0;
  std::uint64_t seen = 0;
  for (const auto& [position, r] : records) {
    seen += r.seen;
    variance += r.error_variance;
    mean += r.mean;
  }
  const auto points = static_cast<double>(seen);
  return mean > 0 ? std::sqrt(variance / points) / (mean / points) : 0;
}

// By interval, relative: of the surface or of the receiver, whichever is worse.
std::vector<double> errors_between(const FrameBaker& baker, const KeyFrames& keys,
                                   const Records& records) {
  const std::vector<Transfer> surface = frames_of(baker, records, FrameBaker::kSurface);
  std::vector<double> out = interpolation_errors(keys, surface);
  const double rms = SequenceCodec::rendered_rms(surface);
  for (double& error : out) error = error > 0 ? error / rms : 0;
  if (!baker.receiver()) return out;
  const std::vector<Transfer> ground = frames_of(baker, records, FrameBaker::kGround);
  const std::vector<double> on_ground = interpolation_errors(keys, ground);
  const double open = open_rms(ground[0].bands);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = std::max(out[i], on_ground[i] / open);
  return out;
}

void tell_interpolation(std::span<const double> errors, BakedSequence& out) {
  double sum = 0;
  for (std::size_t i = 0; i < errors.size(); ++i) {
    if (!std::isfinite(errors[i])) return;  // too few to tell
    sum += out.keys.width(i) * errors[i] * errors[i];
    out.report.worst_interpolation = std::max(out.report.worst_interpolation, errors[i]);
  }
  out.report.interpolation_error = std::sqrt(sum / out.keys.parts);
}

// Middles of the intervals that are too coarse.
std::vector<std::uint32_t> positions_between(const FrameBaker& baker, const Records& records,
                                             double bound) {
  const KeyFrames keys = keys_of(baker, records);
  const std::vector<double> errors = errors_between(baker, keys, records);
  const double allowed = allowed_interpolation_error(bound, standard_error(records));
  std::vector<std::uint32_t> out;
  for (std::size_t i = 0; i < errors.size(); ++i)
    if (errors[i] > allowed && keys.width(i) > 1) out.push_back(keys.at[i] + keys.width(i) / 2);
  return out;
}

// What a bake consists of: the frames of the rate, and those between that are asked for besides,
// round by round.
struct Chosen {
  Records records;
  std::vector<int> missing;  // positions of the first round that is not known as a whole
};

// Whatever else is known, as of a bake with another bound, makes no difference.
Chosen choose(const FrameBaker& baker, Records known, double bound) {
  Chosen out;
  const auto take = [&](std::uint32_t position) {
    const auto found = known.find(position);
    if (found == known.end()) return out.missing.push_back(static_cast<int>(position));
    out.records.insert(known.extract(found));
  };
  for (int p = 0; p < baker.positions(); p += FrameBaker::kMaxParts)
    take(static_cast<std::uint32_t>(p));
  if (bound == 0 || !baker.moves()) return out;
  while (
      out.missing.empty()) {  // ends: every round halves an interval, of kMaxParts parts at first
    const auto wanted = positions_between(baker, out.records, bound);
    if (wanted.empty()) break;
    std::ranges::for_each(wanted, take);
  }
  return out;
}

// Everything that a bake consists of.
Result<Records> gather_all(const FrameBaker& baker, double bound,
                           std::span<const std::filesystem::path> journals) {
  PENUMBRA_ASSIGN(known, gather(baker, journals));
  Chosen chosen = choose(baker, std::move(known), bound);
  if (chosen.missing.empty()) return std::move(chosen.records);
  return fail(ErrorCode::kInvalid, journals[0].string(),
              fmt::format("{} key frames between those of the frame rate are not baked yet",
                          chosen.missing.size()));
}

// The shard's part of the first round that is not known as a whole.
Result<std::vector<int>> share_of_round(const FrameBaker& baker, double bound, Shard shard,
                                        std::span<const std::filesystem::path> journals) {
  PENUMBRA_ASSIGN(known, gather(baker, journals));
  const Chosen chosen = choose(baker, std::move(known), bound);
  std::vector<int> out;
  for (auto i = static_cast<std::size_t>(shard.index); i < chosen.missing.size();
       i += static_cast<std::size_t>(shard.count))
    out.push_back(chosen.missing[i]);
  return out;
}

}  // namespace

Result<void> bake_round(const Character& character, int clip, const SequenceOptions& options,
                        Shard shard, std::span<const std::filesystem::path> journals,
                        const std::filesystem::path& journal_path) {
  PENUMBRA_TRY(check(shard));
  PENUMBRA_ASSIGN(baker, FrameBaker::create(character, clip, options));
  PENUMBRA_ASSIGN(wanted, share_of_round(baker, options.interpolation_error, shard, journals));
  PENUMBRA_ASSIGN(journal, Journal::open(journal_path, baker.key()));
  return bake_positions(baker, wanted, journal, options.progress, [](auto&&) {});
}

Result<std::size_t> missing_frames(const Character& character, int clip,
                                   const SequenceOptions& options, Shard shard,
                                   std::span<const std::filesystem::path> journals,
                                   const std::filesystem::path& journal) {
  PENUMBRA_TRY(check(shard));
  PENUMBRA_ASSIGN(baker, FrameBaker::create(character, clip, options));
  std::vector<int> wanted = share_of(baker, shard);
  if (!journals.empty()) {
    PENUMBRA_ASSIGN(round, share_of_round(baker, options.interpolation_error, shard, journals));
    wanted = std::move(round);
  }
  return count_missing(baker, wanted, journal);
}

Result<void> check_shards(const Character& character, int clip, const SequenceOptions& options,
                          std::span<const std::filesystem::path> journals) {
  PENUMBRA_ASSIGN(baker, FrameBaker::create(character, clip, options));
  std::optional<Error> first;
  std::string others;
  for (std::size_t i = 0; i < journals.size(); ++i) {
    const std::vector<int> wanted =
        share_of(baker, {static_cast<int>(i), static_cast<int>(journals.size())});
    const auto missing = count_missing(baker, wanted, journals[i]);
    if (missing && *missing == 0) continue;
    if (first) {
      others += fmt::format("{}{}", others.empty() ? "" : ", ", i + 1);
      continue;
    }
    first = !missing ? missing.error()
                     : Error{ErrorCode::kInvalid, journals[i].string(),
                             fmt::format("lacks {} of the {} frames of its shard: bake it again",
                                         *missing, wanted.size())};
  }
  if (!first) return {};
  if (!others.empty())
    first->detail += fmt::format(" (not right either, of {} shards: {})", journals.size(), others);
  return std::unexpected(std::move(*first));
}

Result<bool> bake_between(const Character& character, int clip, const SequenceOptions& options,
                          std::span<const std::filesystem::path> journals,
                          const std::filesystem::path& journal_path) {
  PENUMBRA_ASSIGN(baker, FrameBaker::create(character, clip, options));
  PENUMBRA_ASSIGN(known, gather(baker, journals));
  if (options.interpolation_error == 0 || !baker.moves()) return false;
  std::error_code ignored;
  const bool other = std::ranges::find(journals, journal_path) == journals.end();
  if (other && std::filesystem::exists(journal_path, ignored)) {
    PENUMBRA_ASSIGN(kept, read_journal(journal_path, baker.key()));
    for (FrameRecord& r : kept) known.try_emplace(r.frame, std::move(r));
  }
  Chosen chosen = choose(baker, std::move(known), options.interpolation_error);
  while (!chosen.missing.empty()) {
    PENUMBRA_ASSIGN(journal, Journal::open(journal_path, baker.key()));
    PENUMBRA_TRY(bake_positions(baker, chosen.missing, journal, options.progress,
                                [&](FrameRecord&& r) { chosen.records[r.frame] = std::move(r); }));
    chosen = choose(baker, std::move(chosen.records), options.interpolation_error);
  }
  return other && std::filesystem::exists(journal_path, ignored);
}

Result<BakedSequence> compress_frames(const Character& character, int clip,
                                      const SequenceOptions& options,
                                      std::span<const std::filesystem::path> journals) {
  PENUMBRA_ASSIGN(baker, FrameBaker::create(character, clip, options));
  PENUMBRA_ASSIGN(records, gather_all(baker, options.interpolation_error, journals));
  BakedSequence out;
  out.keys = keys_of(baker, records);
  out.clip = character.clips[static_cast<std::size_t>(clip)].name;
  out.seconds = character.clips[static_cast<std::size_t>(clip)].seconds;
  out.map_width = options.map_width;
  out.map_height = options.map_height;
  out.receiver = baker.receiver();
  for (const auto& [position, r] : records) {
    out.report.rays += r.rays;
    out.report.seconds += r.seconds;
  }
  out.report.standard_error = standard_error(records);
  if (out.seconds > 0) tell_interpolation(errors_between(baker, out.keys, records), out);
  const StreamLayout surface = layout_of_surface(baker.layout());
  const StreamLayout ground = layout_of_ground(out.receiver ? out.receiver->grid.size : 0);
  // The budget is one of the picture: a part of the light that is faint beside the whole may err by
  // more of itself.
  double allowed = 0;
  const auto encode = [&](FrameBaker::Stream stream, const StreamLayout& layout) {
    const std::vector<Transfer> frames = frames_of(baker, records, stream);
    if (stream == FrameBaker::kSurface) {
      const double rms = SequenceCodec::rendered_rms(frames);
      allowed = options.error * rms;
      auto outcome = SequenceCodec::encode(frames, layout, allowed);
      out.report.compression_error = rms > 0 ? outcome.error / rms : 0;
      return std::move(outcome.sequence);
    }
    if (stream == FrameBaker::kGround) allowed = options.error * open_rms(options.bands);
    return SequenceCodec::encode(frames, layout, allowed).sequence;
  };
  out.surface = encode(FrameBaker::kSurface, surface);
  out.surface_reflected = encode(FrameBaker::kSurfaceReflected, surface);
  out.ground_deficit = encode(FrameBaker::kGround, ground);
  out.ground_reflected = encode(FrameBaker::kGroundReflected, ground);
  return out;
}

Result<std::vector<Transfer>> baked_surface(const Character& character, int clip,
                                            const SequenceOptions& options,
                                            std::span<const std::filesystem::path> journals) {
  PENUMBRA_ASSIGN(baker, FrameBaker::create(character, clip, options));
  PENUMBRA_ASSIGN(records, gather_all(baker, options.interpolation_error, journals));
  return frames_of(baker, records, FrameBaker::kSurface);
}

CompressedSurface compress_surface(const SurfaceLayout& layout, std::span<const Transfer> frames,
                                   double relative_error) {
  const StreamLayout stream = layout_of_surface(layout);
  auto outcome =
      SequenceCodec::encode(frames, stream, relative_error * SequenceCodec::rendered_rms(frames));
  const std::size_t bytes = SequenceCodec::write(outcome.sequence, stream).size();
  return {std::move(outcome.sequence), bytes};
}

}  // namespace penumbra::prt
