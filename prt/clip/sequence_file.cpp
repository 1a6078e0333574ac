// The baked file of a clip.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <functional>

#include "core/io/files.h"
#include "core/io/hash.h"
#include "prt/clip/internal/frame_bake.h"
#include "prt/clip/internal/sequence_codec.h"
#include "prt/clip/key_frames.h"
#include "prt/clip/light_map.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/receiver.h"

namespace penumbra::prt {

namespace {

constexpr std::uint32_t kMaxTexels = 4096;  // of a light map's or a receiver's side
constexpr char kMagic[8] = {'P', 'N', 'B', 'S', 'H', 'L', 'M', '2'};

struct FileHead {
  char magic[8];
  std::uint64_t asset, layout;                              // fingerprints
  std::uint32_t map_width, map_height, ground_size, parts;  // the last of KeyFrames
  double seconds, standard_error, compression_error, interpolation_error, worst_interpolation;
  std::uint64_t rays;
  float ground_centre[2], ground_half_extent, ground_height, ground_albedo[3], unused2;
  std::uint64_t key_frames;  // their places follow the head, four bytes each
  std::uint64_t bytes[4];    // of the streams, which follow in order
};

std::uint64_t fingerprint(const SurfaceLayout& layout) {
  Fnv1a h;
  for (const SurfaceLayout::Texel& t : layout.texels) h.add(t.x).add(t.y).add(t.triangle);
  return h.add(layout.bone).value();
}

bool sizes_are_valid(const FileHead& head) {
  return head.map_width <= kMaxTexels && head.map_height <= kMaxTexels &&
         (head.map_width == 0) == (head.map_height == 0) && head.ground_size <= kMaxTexels;
}

SequenceReport report_of(const FileHead& head) {
  return {head.rays,
          0,
          head.standard_error,
          head.compression_error,
          head.interpolation_error,
          head.worst_interpolation,
          head.bytes[0] + head.bytes[1],
          head.bytes[2] + head.bytes[3]};
}

bool are_valid(const KeyFrames& k) {
  return !k.at.empty() && k.at.front() == 0 && k.at.back() < k.parts &&
         std::ranges::adjacent_find(k.at, std::greater_equal<>()) == k.at.end();
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
  head.worst_interpolation = s.report.worst_interpolation;
  head.parts = s.keys.parts;
  head.key_frames = s.keys.at.size();
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
                                                 SequenceCodec::write(s.surface_reflected, surface),
                                                 SequenceCodec::write(s.ground_deficit, ground),
                                                 SequenceCodec::write(s.ground_reflected, ground)};
  std::string bytes;
  for (std::size_t i = 0; i < 4; ++i) head.bytes[i] = streams[i].size();
  bytes.append(reinterpret_cast<const char*>(&head), sizeof head);
  bytes.append(reinterpret_cast<const char*>(s.keys.at.data()),
               sizeof(s.keys.at[0]) * s.keys.at.size());
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
  if (!sizes_are_valid(head))
    return fail(ErrorCode::kUnreadable, name, "is damaged at byte 24: its sizes are out of range");
  if (head.map_width > 0 && !has_light_coordinates(character))
    return fail(ErrorCode::kInvalid, name,
                "has a light map, but the asset has no texture coordinates");
  const SurfaceLayout layout =
      lay_out(character, static_cast<int>(head.map_width), static_cast<int>(head.map_height));
  const auto fraction = [](double v) { return v >= 0 && v < 1e6; };  // NaN is none
  if (head.seconds != character.clips[static_cast<std::size_t>(clip)].seconds ||
      !fraction(head.standard_error) || !fraction(head.compression_error) ||
      !fraction(head.interpolation_error) || !fraction(head.worst_interpolation) ||
      !fraction(head.ground_albedo[0]) || !fraction(head.ground_albedo[1]) ||
      !fraction(head.ground_albedo[2]))
    return fail(ErrorCode::kUnreadable, name, "is damaged: its figures are out of range");
  if (head.layout != fingerprint(layout))
    return fail(ErrorCode::kInvalid, name,
                "has a light map with another layout than this version makes: bake it again");
  BakedSequence out;
  out.clip = character.clips[static_cast<std::size_t>(clip)].name;
  out.seconds = head.seconds;
  out.map_width = static_cast<int>(head.map_width);
  out.map_height = static_cast<int>(head.map_height);
  out.report = report_of(head);
  if (head.ground_size > 0) {
    GroundGrid g{static_cast<int>(head.ground_size),
                 {head.ground_centre[0], head.ground_centre[1]},
                 head.ground_half_extent,
                 head.ground_height};
    if (head.ground_size < 2 || !(g.half_extent > 0) ||
        !std::isfinite(g.half_extent + g.height + g.centre.x + g.centre.y))
      return fail(ErrorCode::kUnreadable, name, "is damaged: its receiver is out of range");
    out.receiver =
        Receiver{g, {head.ground_albedo[0], head.ground_albedo[1], head.ground_albedo[2]}};
  }
  const StreamLayout surface = layout_of_surface(layout);
  const StreamLayout ground = layout_of_ground(static_cast<int>(head.ground_size));
  TransferSequence* const streams[4] = {&out.surface, &out.surface_reflected, &out.ground_deficit,
                                        &out.ground_reflected};
  std::size_t at = sizeof head;
  if (head.key_frames > (bytes.size() - at) / sizeof(std::uint32_t))
    return fail(ErrorCode::kUnreadable, name,
                fmt::format("is damaged at byte {}: the key frames are cut off", at));
  out.keys.parts = head.parts;
  out.keys.at.resize(static_cast<std::size_t>(head.key_frames));
  std::memcpy(out.keys.at.data(), bytes.data() + at, sizeof(std::uint32_t) * out.keys.at.size());
  if (!are_valid(out.keys))
    return fail(ErrorCode::kUnreadable, name,
                fmt::format("is damaged at byte {}: the key frames do not rise from 0", at));
  at += sizeof(std::uint32_t) * out.keys.at.size();
  for (std::size_t i = 0; i < 4; ++i) {
    if (head.bytes[i] > bytes.size() - at)
      return fail(ErrorCode::kUnreadable, name,
                  fmt::format("is damaged at byte {}: a stream of transfer is cut off", at));
    PENUMBRA_ASSIGN(read, SequenceCodec::read(bytes.subspan(at, head.bytes[i]),
                                              i < 2 ? surface : ground, name));
    *streams[i] = std::move(read);
    at += head.bytes[i];
  }
  if (out.surface.points() == 0 || out.surface_reflected.points() == 0 ||
      (out.receiver && (out.ground_deficit.points() == 0 || out.ground_reflected.points() == 0)))
    return fail(ErrorCode::kUnreadable, name, "is damaged: a stream of transfer is empty");
  for (const TransferSequence* s : streams)
    if (s->points() > 0 && (static_cast<std::size_t>(s->frames()) != out.keys.at.size() ||
                            s->channels() != out.surface.channels()))
      return fail(ErrorCode::kUnreadable, name,
                  "is damaged: its streams belong to different clips");
  return out;
}

Result<SequenceInfo> read_sequence_info(const std::filesystem::path& path) {
  FileHead head{};
  std::ifstream in(path, std::ios::binary);
  if (!in) return fail(ErrorCode::kNotFound, path.string(), "cannot be opened");
  if (!in.read(reinterpret_cast<char*>(&head), sizeof head) ||
      std::memcmp(head.magic, kMagic, sizeof kMagic) != 0)
    return fail(ErrorCode::kInvalid, path.string(), "is not a baked clip of this version");
  if (!sizes_are_valid(head))
    return fail(ErrorCode::kUnreadable, path.string(),
                "is damaged at byte 24: its sizes are out of range");
  return SequenceInfo{static_cast<int>(head.map_width),          static_cast<int>(head.map_height),
                      static_cast<int>(head.ground_size),        head.seconds,
                      static_cast<std::size_t>(head.key_frames), report_of(head)};
}

Result<BakedSequence> read_sequence(const std::filesystem::path& path, const Character& character,
                                    int clip) {
  PENUMBRA_ASSIGN(bytes, read_bytes(path));
  std::uint64_t sum = 0;
  if (bytes.size() < sizeof(FileHead) + sizeof sum ||
      std::memcmp(bytes.data(), kMagic, sizeof kMagic) != 0)
    return fail(ErrorCode::kInvalid, path.string(), "is not a baked clip of this version");
  const std::size_t body = bytes.size() - sizeof sum;
  std::memcpy(&sum, bytes.data() + body, sizeof sum);
  if (sum != Fnv1a().add(bytes.data(), body).value())
    return fail(ErrorCode::kUnreadable, path.string(),
                fmt::format("is damaged: the checksum at byte {} does not match", body));
  return decode_sequence(std::span(bytes).first(body), character, clip, path.string());
}

}  // namespace penumbra::prt
