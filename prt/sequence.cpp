#include "prt/sequence.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <set>

#include "core/files.h"
#include "core/hash.h"
#include "lighting/lighting.h"
#include "prt/frame_bake.h"
#include "prt/prt.h"
#include "prt/sequence_codec.h"

namespace penumbra::prt {

double BakedSequence::frame_at(double time_s) const {
  return seconds > 0 ? time_s / seconds * surface.frames() : 0;
}

Result<void> bake_frames(const Character& character, int clip, const SequenceOptions& options,
                         Shard shard, const std::filesystem::path& journal_path) {
  if (shard.count < 1 || shard.index < 0 || shard.index >= shard.count)
    return fail(ErrorCode::kInvalid, "shard",
                fmt::format("{}/{} is not one of a whole", shard.index + 1, shard.count));
  auto baker = FrameBaker::create(character, clip, options);
  if (!baker) return std::unexpected(baker.error());
  auto journal = Journal::open(journal_path, baker->key());
  if (!journal) return std::unexpected(journal.error());
  const std::set<std::uint32_t> done(journal->frames().begin(), journal->frames().end());
  std::vector<int> wanted;
  for (int f = shard.index; f < baker->frames(); f += shard.count) wanted.push_back(f);
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    const auto progress = [&](double share) {
      if (options.progress)
        options.progress((static_cast<double>(i) + share) / static_cast<double>(wanted.size()));
    };
    progress(0);
    if (done.contains(static_cast<std::uint32_t>(wanted[i]))) continue;
    const auto record = baker->bake(wanted[i], progress);
    if (!record) return std::unexpected(record.error());
    PENUMBRA_TRY(journal->add(*record));
  }
  if (options.progress) options.progress(1);
  return {};
}

Result<std::uint64_t> bake_key(const Character& character, int clip,
                               const SequenceOptions& options) {
  auto baker = FrameBaker::create(character, clip, options);
  if (!baker) return std::unexpected(baker.error());
  return baker->key().bake;
}

namespace {

// Every frame once, in order.
Result<std::vector<FrameRecord>> gather(const JournalKey& key,
                                        std::span<const std::filesystem::path> journals) {
  std::vector<std::optional<FrameRecord>> found(key.frames);
  for (const std::filesystem::path& path : journals) {
    auto records = read_journal(path, key);
    if (!records) return std::unexpected(records.error());
    for (FrameRecord& r : *records) found[r.frame] = std::move(r);
  }
  std::vector<FrameRecord> out;
  for (std::size_t f = 0; f < found.size(); ++f) {
    if (!found[f])
      return fail(ErrorCode::kInvalid, journals.empty() ? "journals" : journals[0].string(),
                  fmt::format("frame {} of {} is not baked yet", f, found.size()));
    out.push_back(std::move(*found[f]));
  }
  return out;
}

std::vector<Transfer> frames_of(const FrameBaker& baker, std::span<const FrameRecord> records,
                                FrameBaker::Stream stream) {
  std::vector<Transfer> out;
  const auto first = static_cast<std::ptrdiff_t>(baker.offset(stream));
  for (const FrameRecord& r : records) {
    Transfer t = baker.shape(stream);
    std::copy_n(r.values.begin() + first, t.values.size(), t.values.begin());
    out.push_back(std::move(t));
  }
  if (stream == FrameBaker::kSurface || stream == FrameBaker::kSurfaceIndirect)
    baker.complete_hidden(out);
  return out;
}

// RMS of what a straight line between frames leaves out: at most an eighth of the second difference (the middle between
// two frames is what it was measured at).
double interpolation_error(std::span<const Transfer> frames) {
  const std::size_t count = frames.size();
  if (count < 3) return 0;
  const auto energy = mean_band_energy();
  double sum = 0, all = 0;
  constexpr std::size_t kStep = 7;  // of the points: a sample is plenty
  for (std::size_t f = 0; f < count; ++f) {
    const Transfer &a = frames[f], &b = frames[(f + 1) % count], &c = frames[(f + 2) % count];
    for (int channel = 0; channel < a.channels; ++channel)
      for (int l = 0; l < a.bands; ++l)
        for (int m = -l; m <= l; ++m)
          for (std::size_t p = 0; p < a.points; p += kStep) {
            const int n = sh_index(l, m);
            const double middle = b.value(channel, n, p);
            const double bend = (a.value(channel, n, p) - 2 * middle + c.value(channel, n, p)) / 8;
            sum += double(energy[static_cast<std::size_t>(l)]) * bend * bend;
            all += double(energy[static_cast<std::size_t>(l)]) * middle * middle;
          }
  }
  return all > 0 ? std::sqrt(sum / all) : 0;
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

}  // namespace

Result<BakedSequence> compress_frames(const Character& character, int clip,
                                      const SequenceOptions& options,
                                      std::span<const std::filesystem::path> journals) {
  auto baker = FrameBaker::create(character, clip, options);
  if (!baker) return std::unexpected(baker.error());
  auto records = gather(baker->key(), journals);
  if (!records) return std::unexpected(records.error());
  BakedSequence out;
  out.clip = character.clips[static_cast<std::size_t>(clip)].name;
  out.seconds = character.clips[static_cast<std::size_t>(clip)].seconds;
  out.map_width = options.map_width;
  out.map_height = options.map_height;
  out.receiver = baker->receiver();
  double variance = 0, mean = 0;
  std::uint64_t seen = 0;
  for (const FrameRecord& r : *records) {
    seen += r.seen;
    out.report.rays += r.rays;
    out.report.seconds += r.seconds;
    variance += r.error_variance;
    mean += r.mean;
  }
  if (mean > 0)
    out.report.standard_error =
        std::sqrt(variance / static_cast<double>(seen)) / (mean / static_cast<double>(seen));
  const StreamLayout surface = layout_of_surface(baker->layout());
  const StreamLayout ground = layout_of_ground(out.receiver ? out.receiver->grid.size : 0);
  // The budget is one of the picture: a part of the light that is faint beside the whole may err by more of itself.
  double allowed = 0;
  const auto encode = [&](FrameBaker::Stream stream, const StreamLayout& layout) {
    const std::vector<Transfer> frames = frames_of(*baker, *records, stream);
    if (stream == FrameBaker::kSurface) {
      const double rms = SequenceCodec::rendered_rms(frames);
      allowed = options.error * rms;
      out.report.interpolation_error = interpolation_error(frames);
      auto outcome = SequenceCodec::encode(frames, layout, allowed);
      out.report.compression_error = rms > 0 ? outcome.error / rms : 0;
      return std::move(outcome.sequence);
    }
    if (stream == FrameBaker::kGround) allowed = options.error * open_rms(options.bands);
    return SequenceCodec::encode(frames, layout, allowed).sequence;
  };
  out.surface = encode(FrameBaker::kSurface, surface);
  out.surface_indirect = encode(FrameBaker::kSurfaceIndirect, surface);
  out.ground_deficit = encode(FrameBaker::kGround, ground);
  out.ground_indirect = encode(FrameBaker::kGroundIndirect, ground);
  return out;
}

Result<std::vector<Transfer>> baked_surface(const Character& character, int clip,
                                            const SequenceOptions& options,
                                            std::span<const std::filesystem::path> journals) {
  auto baker = FrameBaker::create(character, clip, options);
  if (!baker) return std::unexpected(baker.error());
  auto records = gather(baker->key(), journals);
  if (!records) return std::unexpected(records.error());
  return frames_of(*baker, *records, FrameBaker::kSurface);
}

CompressedSurface compress_surface(const SurfaceLayout& layout, std::span<const Transfer> frames,
                                   double relative_error) {
  const StreamLayout stream = layout_of_surface(layout);
  auto outcome =
      SequenceCodec::encode(frames, stream, relative_error * SequenceCodec::rendered_rms(frames));
  const std::size_t bytes = SequenceCodec::write(outcome.sequence, stream).size();
  return {std::move(outcome.sequence), bytes};
}

// ---------------------------------------------------------------------------------- file

namespace {

constexpr std::uint32_t kMostTexels = 4096;  // of a light map's side
constexpr char kMagic[8] = {'P', 'N', 'B', 'S', 'H', 'L', 'M', '1'};

struct FileHead {
  char magic[8];
  std::uint64_t asset, layout;  // fingerprints
  std::uint32_t map_width, map_height, ground_size, unused;
  double seconds, standard_error, compression_error, interpolation_error;
  std::uint64_t rays;
  float ground_centre[2], ground_half_extent, ground_height, ground_albedo[3], unused2;
  std::uint64_t bytes[4];  // of the streams, which follow in order
};

std::uint64_t fingerprint(const SurfaceLayout& layout) {
  Fnv1a h;
  for (const SurfaceLayout::Texel& t : layout.texels) h.add(t.x).add(t.y).add(t.triangle);
  return h.add(layout.bone).value();
}

}  // namespace

Result<void> write_sequence(const std::filesystem::path& path, const Character& character, int clip,
                            const BakedSequence& s) {
  const SurfaceLayout layout = lay_out(character, s.map_width, s.map_height);
  const StreamLayout surface = layout_of_surface(layout);
  const int ground_size = s.receiver ? s.receiver->grid.size : 0;
  const StreamLayout ground = layout_of_ground(ground_size);
  FileHead head{};
  std::memcpy(head.magic, kMagic, sizeof kMagic);
  head.asset = prt::fingerprint(character, clip);
  head.layout = fingerprint(layout);
  head.map_width = static_cast<std::uint32_t>(s.map_width);
  head.map_height = static_cast<std::uint32_t>(s.map_height);
  head.ground_size = static_cast<std::uint32_t>(ground_size);
  head.seconds = s.seconds;
  head.standard_error = s.report.standard_error;
  head.compression_error = s.report.compression_error;
  head.interpolation_error = s.report.interpolation_error;
  head.rays = s.report.rays;
  if (s.receiver) {
    const GroundGrid& g = s.receiver->grid;
    head.ground_centre[0] = g.centre.x;
    head.ground_centre[1] = g.centre.y;
    head.ground_half_extent = g.half_extent;
    head.ground_height = g.height;
    for (int c = 0; c < 3; ++c) head.ground_albedo[c] = s.receiver->albedo[c];
  }
  const std::vector<unsigned char> streams[4] = {SequenceCodec::write(s.surface, surface),
                                                 SequenceCodec::write(s.surface_indirect, surface),
                                                 SequenceCodec::write(s.ground_deficit, ground),
                                                 SequenceCodec::write(s.ground_indirect, ground)};
  std::string bytes;
  for (std::size_t i = 0; i < 4; ++i) head.bytes[i] = streams[i].size();
  bytes.append(reinterpret_cast<const char*>(&head), sizeof head);
  for (const auto& stream : streams)
    bytes.append(reinterpret_cast<const char*>(stream.data()), stream.size());
  const std::uint64_t sum = Fnv1a().add(bytes.data(), bytes.size()).value();
  bytes.append(reinterpret_cast<const char*>(&sum), sizeof sum);
  return write_bytes(path, bytes);
}

Result<BakedSequence> decode_sequence(std::span<const unsigned char> bytes,
                                      const Character& character, int clip,
                                      const std::string& name) {
  FileHead head{};
  if (bytes.size() < sizeof head || std::memcmp(bytes.data(), kMagic, sizeof kMagic) != 0)
    return fail(ErrorCode::kInvalid, name, "is not a baked clip of this version");
  std::memcpy(&head, bytes.data(), sizeof head);
  if (head.asset != prt::fingerprint(character, clip))
    return fail(ErrorCode::kInvalid, name, "was baked from another mesh, albedo or clip");
  if (head.map_width > kMostTexels || head.map_height > kMostTexels ||
      (head.map_width == 0) != (head.map_height == 0) || head.ground_size > 4096)
    return fail(ErrorCode::kUnreadable, name, "damaged at byte 24: sizes out of range");
  if (head.map_width > 0 && !has_light_coordinates(character))
    return fail(ErrorCode::kInvalid, name, "has a light map, and the asset no texture coordinates");
  const SurfaceLayout layout =
      lay_out(character, static_cast<int>(head.map_width), static_cast<int>(head.map_height));
  const auto share = [](double v) { return v >= 0 && v < 1e6; };  // NaN is none
  if (head.seconds != character.clips[static_cast<std::size_t>(clip)].seconds ||
      !share(head.standard_error) || !share(head.compression_error) ||
      !share(head.interpolation_error) || !share(head.ground_albedo[0]) ||
      !share(head.ground_albedo[1]) || !share(head.ground_albedo[2]))
    return fail(ErrorCode::kUnreadable, name, "damaged: its figures are out of range");
  if (head.layout != fingerprint(layout))
    return fail(ErrorCode::kInvalid, name, "lays its texels out otherwise than this program does");
  BakedSequence out;
  out.clip = character.clips[static_cast<std::size_t>(clip)].name;
  out.seconds = head.seconds;
  out.map_width = static_cast<int>(head.map_width);
  out.map_height = static_cast<int>(head.map_height);
  out.report = {head.rays,
                0,
                head.standard_error,
                head.compression_error,
                head.interpolation_error,
                head.bytes[0] + head.bytes[1],
                head.bytes[2] + head.bytes[3]};
  if (head.ground_size > 0) {
    GroundGrid g{static_cast<int>(head.ground_size),
                 {head.ground_centre[0], head.ground_centre[1]},
                 head.ground_half_extent,
                 head.ground_height};
    if (head.ground_size < 2 || !(g.half_extent > 0) ||
        !std::isfinite(g.half_extent + g.height + g.centre.x + g.centre.y))
      return fail(ErrorCode::kUnreadable, name, "damaged: the receiver's grid is none");
    out.receiver =
        Receiver{g, {head.ground_albedo[0], head.ground_albedo[1], head.ground_albedo[2]}};
  }
  const StreamLayout surface = layout_of_surface(layout);
  const StreamLayout ground = layout_of_ground(static_cast<int>(head.ground_size));
  TransferSequence* const streams[4] = {&out.surface, &out.surface_indirect, &out.ground_deficit,
                                        &out.ground_indirect};
  std::size_t at = sizeof head;
  for (std::size_t i = 0; i < 4; ++i) {
    if (head.bytes[i] > bytes.size() - at)
      return fail(ErrorCode::kUnreadable, name,
                  fmt::format("damaged at byte {}: a stream of transfer is cut off", at));
    auto read =
        SequenceCodec::read(bytes.subspan(at, head.bytes[i]), i < 2 ? surface : ground, name);
    if (!read) return std::unexpected(read.error());
    *streams[i] = std::move(*read);
    at += head.bytes[i];
  }
  if (out.surface.points() == 0 || out.surface_indirect.points() == 0 ||
      (out.receiver && (out.ground_deficit.points() == 0 || out.ground_indirect.points() == 0)))
    return fail(ErrorCode::kUnreadable, name, "damaged: a stream of transfer is empty");
  for (const TransferSequence* s : streams)
    if (s->points() > 0 &&
        (s->frames() != out.surface.frames() || s->channels() != out.surface.channels()))
      return fail(ErrorCode::kUnreadable, name, "damaged: streams of different clips");
  return out;
}

Result<LightMapSize> light_map_size(const std::filesystem::path& path) {
  auto bytes = read_bytes(path);
  if (!bytes) return std::unexpected(bytes.error());
  FileHead head{};
  if (bytes->size() < sizeof head || std::memcmp(bytes->data(), kMagic, sizeof kMagic) != 0)
    return fail(ErrorCode::kInvalid, path.string(), "is not a baked clip of this version");
  std::memcpy(&head, bytes->data(), sizeof head);
  if (head.map_width > kMostTexels || head.map_height > kMostTexels ||
      (head.map_width == 0) != (head.map_height == 0))
    return fail(ErrorCode::kUnreadable, path.string(), "damaged: the light map's size is none");
  return LightMapSize{static_cast<int>(head.map_width), static_cast<int>(head.map_height)};
}

Result<BakedSequence> read_sequence(const std::filesystem::path& path, const Character& character,
                                    int clip) {
  auto bytes = read_bytes(path);
  if (!bytes) return std::unexpected(bytes.error());
  std::uint64_t sum = 0;
  if (bytes->size() < sizeof(FileHead) + sizeof sum ||
      std::memcmp(bytes->data(), kMagic, sizeof kMagic) != 0)
    return fail(ErrorCode::kInvalid, path.string(), "is not a baked clip of this version");
  const std::size_t body = bytes->size() - sizeof sum;
  std::memcpy(&sum, bytes->data() + body, sizeof sum);
  if (sum != Fnv1a().add(bytes->data(), body).value())
    return fail(ErrorCode::kUnreadable, path.string(),
                fmt::format("damaged: the checksum at byte {} does not fit", body));
  return decode_sequence(std::span(*bytes).first(body), character, clip, path.string());
}

}  // namespace penumbra::prt
