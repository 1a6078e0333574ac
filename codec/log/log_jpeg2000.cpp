#include "codec/log/log_jpeg2000.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string_view>

#include "codec/internal/formats.h"
#include "codec/internal/goal_search.h"
#include "codec/internal/light_planes.h"
#include "codec/internal/wavelets.h"
#include "core/io/hash.h"

namespace penumbra::codec {

namespace {

constexpr double kStepsPerStop = 2048;
constexpr std::array<unsigned char, 12> kSignature{0,   0,   0,  12,   'j',  'P',
                                                   ' ', ' ', 13, '\n', 0x87, '\n'};
// Of the box that says what the planes stand for: lowest stop and steps per stop as floats, 1 + the
// environment or 0, and a fingerprint of these and of the codestream. OpenJPEG 2.5 is built with
// assertions on what it reads, which damage would run into.
constexpr std::array<unsigned char, 16> kScaleId{0xa3, 0x46, 0x79, 0x4f, 0xc2, 0xdf, 0x45, 0x9f,
                                                 0xa7, 0x4d, 0x73, 0x57, 0x3b, 0x81, 0xe6, 0x5b};
constexpr std::size_t kBoxHead = 8, kScaleBytes = 12, kFingerprintBytes = 8;

std::uint64_t fingerprint_of(Bytes scale, Bytes codestream) {
  return Fnv1a().add(scale.data(), scale.size()).add(codestream.data(), codestream.size()).value();
}

class BoxWriter {
 public:
  void number(std::uint32_t v) {
    for (int shift = 24; shift >= 0; shift -= 8)
      out_.push_back(static_cast<unsigned char>(v >> shift));
  }
  void bytes(std::span<const unsigned char> v) { out_.insert(out_.end(), v.begin(), v.end()); }
  void box(std::string_view type, std::span<const unsigned char> content) {
    number(static_cast<std::uint32_t>(kBoxHead + content.size()));
    out_.insert(out_.end(), type.begin(), type.end());
    bytes(content);
  }
  std::vector<unsigned char> take() { return std::move(out_); }

 private:
  std::vector<unsigned char> out_;
};

using StoredProjection = std::optional<EnvironmentAttribute>;

std::vector<unsigned char> scale_content(const LightScale& scale, StoredProjection environment,
                                         Bytes codestream, std::size_t padding) {
  BoxWriter w;
  w.bytes(kScaleId);
  w.number(std::bit_cast<std::uint32_t>(scale.lowest_stop));
  w.number(std::bit_cast<std::uint32_t>(scale.steps_per_stop));
  w.number(environment ? 1 + static_cast<std::uint32_t>(*environment) : 0);
  std::vector<unsigned char> out = w.take();
  const std::uint64_t fingerprint = fingerprint_of(out, codestream);
  for (int shift = 56; shift >= 0; shift -= 8)
    out.push_back(static_cast<unsigned char>(fingerprint >> shift));
  out.resize(out.size() + padding);
  return out;
}

std::vector<unsigned char> header_content(int width, int height) {
  constexpr std::uint32_t kSycc = 18;
  BoxWriter size;
  size.number(static_cast<std::uint32_t>(height));
  size.number(static_cast<std::uint32_t>(width));
  // Planes, their bits less one, compression 7, a known colour space, no rights.
  size.bytes(std::array<unsigned char, 6>{0, kPlanes, kPlaneBits - 1, 7, 0, 0});
  BoxWriter colour;
  colour.bytes(std::array<unsigned char, 3>{1, 0, 0});
  colour.number(kSycc);
  BoxWriter out;
  out.box("ihdr", size.take());
  out.box("colr", colour.take());
  return out.take();
}

// What stays the same from try to try.
struct StillTask {
  const Image<Rgb>& radiance;
  WaveletCoder coder;
  StoredProjection environment;
};

std::vector<unsigned char> file_of(const StillTask& task, const LightPlanes& planes,
                                   Bytes codestream) {
  const std::string_view brand = task.coder == WaveletCoder::kFast ? "jph " : "jp2 ";
  BoxWriter type;
  type.bytes({reinterpret_cast<const unsigned char*>(brand.data()), brand.size()});
  type.number(0);
  type.bytes({reinterpret_cast<const unsigned char*>(brand.data()), brand.size()});
  const std::size_t least = min_codestream_bytes(planes.width, planes.height);
  BoxWriter out;
  out.bytes(kSignature);
  out.box("ftyp", type.take());
  out.box("jp2h", header_content(planes.width, planes.height));
  out.box("uuid", scale_content(planes.scale, task.environment, codestream,
                                least > codestream.size() ? least - codestream.size() : 0));
  out.box("jp2c", codestream);
  return out.take();
}

struct Boxes {
  Bytes codestream;
  Bytes scale;
};

std::uint32_t number_at(Bytes bytes, std::size_t at) {
  std::uint32_t out = 0;
  for (std::size_t i = 0; i < 4; ++i) out = out << 8 | bytes[at + i];
  return out;
}

bool is_scale(Bytes content) {
  return content.size() >= kScaleId.size() + kScaleBytes + kFingerprintBytes &&
         std::ranges::equal(content.first(kScaleId.size()), kScaleId);
}

struct ReadScale {
  LightScale light;
  StoredProjection environment;
};

Result<ReadScale> read_scale(Bytes content, Bytes codestream, const std::string& name) {
  const Bytes head = content.first(kScaleId.size() + kScaleBytes);
  const std::uint64_t fingerprint =
      std::uint64_t{number_at(content, head.size())} << 32 | number_at(content, head.size() + 4);
  if (fingerprint != fingerprint_of(head, codestream))
    return fail(ErrorCode::kUnreadable, name, "is damaged: its fingerprint is of other bytes");
  const float lowest = std::bit_cast<float>(number_at(head, kScaleId.size())),
              steps = std::bit_cast<float>(number_at(head, kScaleId.size() + 4));
  const std::uint32_t environment = number_at(head, kScaleId.size() + 8);
  // What floats can hold, and planes of 16 bits.
  if (!(std::abs(lowest) < 160) || !(steps >= .01f && steps <= 65536) || environment > 2)
    return fail(ErrorCode::kUnreadable, name, "is damaged: its scale of light is out of range");
  ReadScale out{{lowest, steps}, {}};
  if (environment > 0) out.environment = static_cast<EnvironmentAttribute>(environment - 1);
  return out;
}

Result<Boxes> read_boxes(Bytes bytes, const std::string& name) {
  Boxes out;
  std::size_t at = 0;
  while (at + kBoxHead <= bytes.size() && out.codestream.empty()) {
    std::uint64_t length = number_at(bytes, at);
    std::size_t head = kBoxHead;
    const std::string_view type(reinterpret_cast<const char*>(bytes.data()) + at + 4, 4);
    if (length == 1 && at + 16 <= bytes.size()) {
      length = std::uint64_t{number_at(bytes, at + 8)} << 32 | number_at(bytes, at + 12);
      head = 16;
    }
    if (length == 0) length = bytes.size() - at;  // the last one may go to the end
    if (length < head || length > bytes.size() - at)
      return fail(ErrorCode::kUnreadable, name, "is truncated: a box ends beyond its bytes");
    const Bytes content = bytes.subspan(at + head, static_cast<std::size_t>(length) - head);
    if (type == "jp2c") out.codestream = content;
    if (type == "uuid" && is_scale(content)) out.scale = content;
    at += static_cast<std::size_t>(length);
  }
  if (out.codestream.empty())
    return fail(ErrorCode::kUnreadable, name, "is truncated: it has no codestream");
  return out;
}

Result<CodedStill> encode_planes(const StillTask& task, const LightPlanes& planes,
                                 double coarseness) {
  PENUMBRA_ASSIGN(codestream, task.coder == WaveletCoder::kFast
                                  ? encode_fast_wavelets(planes, coarseness)
                                  : encode_small_wavelets(planes, coarseness));
  return CodedStill{file_of(task, planes, codestream), {}};
}

// By the picture that a reader gets.
Result<CodedStill> measured(Result<CodedStill> coded, const StillTask& task,
                            const LightScale& scale) {
  if (!coded) return coded;
  PENUMBRA_ASSIGN(back, decode_log_jpeg2000(coded->bytes, "picture"));
  coded->error = error_of(task.radiance, back.pixels, scale);
  return coded;
}

// A size is found without reading each try back.
Result<CodedStill> search_coarseness(const StillTask& task, const LightPlanes& planes,
                                     const StillGoal& goal) {
  const auto encode = [&](double coarseness) {
    auto coded = encode_planes(task, planes, coarseness);
    return goal.max_bytes > 0 ? coded : measured(std::move(coded), task, planes.scale);
  };
  if (task.coder == WaveletCoder::kFast) {
    // As photographs have it: the step of the quantiser over its error and over bits a pixel.
    const double bits = 8 * static_cast<double>(goal.max_bytes) /
                        static_cast<double>(task.radiance.area()),
                 first = goal.max_bytes > 0 ? .0175 * std::pow(bits, -1.4) : .28 * goal.deviation;
    return search_goal(goal, 2e-5, .5, std::clamp(first, 2e-5, .5), encode);
  }
  const double raw = 2. * kPlanes * static_cast<double>(task.radiance.area()),
               most = std::max(2., raw / 64);
  const double first = goal.max_bytes > 0 ? raw / static_cast<double>(goal.max_bytes) : 12;
  return search_goal(goal, 1.01, most, std::clamp(first * 1.01, 1.01, most), encode);
}

WaveletCoder coder_for(const Image<Rgb>& radiance, WaveletCoder wished) {
  const bool is_small = std::min(radiance.width(), radiance.height()) < kMinFastSide;
  return is_small ? WaveletCoder::kSmall : wished;
}

Result<void> check_picture(const Image<Rgb>& radiance, const StillGoal& goal) {
  if (radiance.empty()) return fail(ErrorCode::kInvalid, "picture", "has no pixels");
  PENUMBRA_TRY(check_size(radiance.width(), radiance.height(), "picture"));
  return check_goal(goal);
}

}  // namespace

Result<CodedStill> encode_log_jpeg2000(const Image<Rgb>& radiance, const StillGoal& goal,
                                       WaveletCoder coder, StoredProjection environment) {
  PENUMBRA_TRY(check_picture(radiance, goal));
  const StillTask task{radiance, coder_for(radiance, coder), environment};
  // Rounding alone is to be a quarter of the error.
  const double steps =
      std::max(kStepsPerStop, std::log10(2.) * 4 / (std::sqrt(12.) * goal.deviation));
  PENUMBRA_ASSIGN(planes, planes_from_rgb(radiance, steps));
  auto found = search_coarseness(task, planes, goal);
  return goal.max_bytes > 0 ? measured(std::move(found), task, planes.scale) : found;
}

Result<CodedStill> encode_log_jpeg2000_exactly(const Image<Rgb>& radiance, const StillGoal& goal,
                                               WaveletCoder coder, StoredProjection environment) {
  PENUMBRA_TRY(check_picture(radiance, goal));
  if (goal.max_bytes > 0)
    return fail(ErrorCode::kInvalid, "goal", "has a size, but what is exact takes what it takes");
  // Half a step off at most, less what floats round.
  double steps = std::log10(2.) / (2 * goal.deviation) * 1.01;
  const StillTask task{radiance, coder_for(radiance, coder), environment};
  constexpr int kTries = 4;  // finer, for the light of a channel that is few pixels' colour
  for (int i = 0; i < kTries; ++i) {
    PENUMBRA_ASSIGN(planes, planes_from_rgb(radiance, steps));
    PENUMBRA_ASSIGN(coded, measured(encode_planes(task, planes, 0), task, planes.scale));
    if (coded.error.luminance_max > goal.deviation) break;
    if (coded.error.light <= goal.deviation) return coded;
    steps *= 1.2 * coded.error.light / goal.deviation;
  }
  return fail(ErrorCode::kUndetermined, "goal",
              "cannot be met: the picture's range leaves too few of 16 bits");
}

bool is_jpeg2000(Bytes bytes) {
  return bytes.size() >= kSignature.size() &&
         std::ranges::equal(bytes.first(kSignature.size()), kSignature);
}

Result<HdrImage> decode_log_jpeg2000(Bytes bytes, const std::string& name) {
  if (!is_jpeg2000(bytes)) return fail(ErrorCode::kUnreadable, name, "is not a JP2 or JPH file");
  PENUMBRA_ASSIGN(boxes, read_boxes(bytes, name));
  if (boxes.scale.empty())
    return fail(ErrorCode::kUnreadable, name,
                "is a JPEG 2000 picture that does not say how bright its numbers are");
  PENUMBRA_ASSIGN(scale, read_scale(boxes.scale, boxes.codestream, name));
  PENUMBRA_ASSIGN(planes, decode_wavelets(boxes.codestream, name));
  planes.scale = scale.light;
  HdrImage out;
  out.pixels = rgb_from_planes(planes);
  out.environment = scale.environment;
  out.non_finite = count_non_finite(out.pixels.pixels());
  return out;
}

}  // namespace penumbra::codec
