#include "codec/dct/rgbe_still.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <utility>
#include <vector>

#include "codec/internal/formats.h"
#include "codec/internal/goal_search.h"
#include "codec/internal/light_planes.h"
#include "codec/internal/rgbe_bases.h"
#include "core/io/hash.h"

namespace penumbra::codec {

namespace {

constexpr int kMaxCoarseness = 65535;
// Adaptive bits are cheap, but not free: what claims more pixels is not ours.
constexpr std::int64_t kPixelsPerByte = 1 << 10, kFreePixels = 1 << 20;
constexpr LightScale kRgbeScale{-140, 1};  // nothing that RGBE holds counts as black

constexpr std::array<char, 8> kStillMagic{'P', 'N', 'B', 'S', 'T', 'I', 'L', '2'};
struct StillHead {
  std::array<char, 8> magic = kStillMagic;
  std::uint64_t fingerprint = 0;  // of what follows it
  std::uint32_t width = 0, height = 0;
  std::uint16_t coarseness = 0;
  std::uint8_t base = 0, environment = 0;  // 1 + the attribute, or 0
  std::uint32_t reserved = 0;
};
static_assert(sizeof(StillHead) == 32 && std::endian::native == std::endian::little);
constexpr std::size_t kUnsigned = offsetof(StillHead, width);

std::uint64_t fingerprint_of(Bytes file) {
  return Fnv1a().add(file.data() + kUnsigned, file.size() - kUnsigned).value();
}

bool can_hold(std::size_t bytes, std::int64_t width, std::int64_t height) {
  return width * height <= kFreePixels + kPixelsPerByte * static_cast<std::int64_t>(bytes);
}

using StoredProjection = std::optional<EnvironmentAttribute>;

std::vector<unsigned char> still_file(const Image<Rgb>& kept, const RgbeCoding& coding,
                                      StoredProjection environment) {
  StillHead head;
  head.width = static_cast<std::uint32_t>(kept.width());
  head.height = static_cast<std::uint32_t>(kept.height());
  head.coarseness = static_cast<std::uint16_t>(coding.coarseness);
  head.base = static_cast<std::uint8_t>(coding.base);
  head.environment =
      static_cast<std::uint8_t>(environment ? 1 + static_cast<int>(*environment) : 0);
  std::vector<unsigned char> out(sizeof head);
  const std::vector<unsigned char> body = coding.base == RgbeBase::kContinuous
                                              ? write_continuous_base(kept, coding.coarseness)
                                              : write_split_bases(kept, coding);
  out.insert(out.end(), body.begin(), body.end());
  std::memcpy(out.data(), &head, sizeof head);
  head.fingerprint = fingerprint_of(out);
  std::memcpy(out.data(), &head, sizeof head);
  return out;
}

// What the file is to hold, and what it is measured against.
struct StillInput {
  const Image<Rgb>& truth;
  Image<Rgb> kept;
  StoredProjection environment;
};

Result<StillInput> still_input(const Image<Rgb>& radiance, StoredProjection environment) {
  if (radiance.empty()) return fail(ErrorCode::kInvalid, "picture", "has no pixels");
  PENUMBRA_TRY(check_size(radiance.width(), radiance.height(), "picture"));
  PENUMBRA_TRY(check_light(radiance));
  StillInput out{radiance, radiance, environment};
  for (Rgb& p : out.kept.pixels())
    if (std::min({p.r, p.g, p.b}) < 0) p = inside_rec709(p);
  return out;
}

Result<CodedStill> coded_as(const StillInput& input, const RgbeCoding& coding, bool measured) {
  CodedStill out{still_file(input.kept, coding, input.environment), {}};
  if (!measured) return out;
  PENUMBRA_ASSIGN(back, decode_rgbe_still(out.bytes, "picture"));
  out.error = error_of(input.truth, back.pixels, kRgbeScale);
  return out;
}

// As photographs have it.
double first_coarseness(const StillGoal& goal, RgbeBase base, std::size_t area) {
  const double bits = 8 * static_cast<double>(goal.max_bytes) / static_cast<double>(area);
  const double step = goal.max_bytes > 0 ? 3800 * std::pow(bits, -1.5) : 46000 * goal.deviation;
  return std::clamp(base == RgbeBase::kContinuous ? step : step / 16, 1., double{kMaxCoarseness});
}

}  // namespace

Result<CodedStill> encode_rgbe_still(const Image<Rgb>& radiance, const StillGoal& goal,
                                     RgbeBase base, StoredProjection environment) {
  PENUMBRA_TRY(check_goal(goal));
  if (base == RgbeBase::kLossless)
    return fail(ErrorCode::kInvalid, "base", "loses nothing, so that it has no goal");
  PENUMBRA_ASSIGN(input, still_input(radiance, environment));
  const bool by_size = goal.max_bytes > 0;
  RgbeCoding coding{base, 1};
  auto found = search_goal(goal, 1, kMaxCoarseness, first_coarseness(goal, base, radiance.area()),
                           [&](double coarseness) {
                             coding.coarseness = static_cast<int>(std::lround(coarseness));
                             return coded_as(input, coding, !by_size);
                           });
  if (!found || !by_size) return found;
  PENUMBRA_ASSIGN(back, decode_rgbe_still(found->bytes, "picture"));
  found->error = error_of(radiance, back.pixels, kRgbeScale);
  return found;
}

Result<CodedStill> encode_rgbe_still_as(const Image<Rgb>& radiance, const RgbeCoding& coding,
                                        StoredProjection environment) {
  const int least = coding.base == RgbeBase::kLossless ? 0 : 1,
            most = coding.base == RgbeBase::kLossless ? 0 : kMaxCoarseness;
  if (coding.coarseness < least || coding.coarseness > most)
    return fail(ErrorCode::kInvalid, "coarseness",
                "is not within " + std::to_string(least) + ".." + std::to_string(most));
  PENUMBRA_ASSIGN(input, still_input(radiance, environment));
  return coded_as(input, coding, true);
}

bool is_rgbe_still(Bytes bytes) {
  return bytes.size() >= kStillMagic.size() &&
         std::memcmp(bytes.data(), kStillMagic.data(), kStillMagic.size()) == 0;
}

Result<HdrImage> decode_rgbe_still(Bytes bytes, const std::string& name) {
  StillHead head;
  if (!is_rgbe_still(bytes)) return fail(ErrorCode::kUnreadable, name, "is not a .pnr file");
  if (bytes.size() < sizeof head)
    return fail(ErrorCode::kUnreadable, name, "is truncated within its first 32 bytes");
  std::memcpy(&head, bytes.data(), sizeof head);
  if (head.fingerprint != fingerprint_of(bytes))
    return fail(ErrorCode::kUnreadable, name, "is damaged: its fingerprint is of other bytes");
  PENUMBRA_TRY(check_size(head.width, head.height, name));
  const RgbeCoding coding{static_cast<RgbeBase>(head.base), head.coarseness};
  if (coding.base > RgbeBase::kContinuous || head.environment > 2 ||
      (coding.base == RgbeBase::kLossless) != (coding.coarseness == 0))
    return fail(ErrorCode::kUnreadable, name, "is damaged: its coding is not one of ours");
  const Bytes body = bytes.subspan(sizeof head);
  if (!can_hold(body.size(), head.width, head.height))
    return fail(ErrorCode::kInvalid, name, "claims more pixels than its bytes can hold");
  const int width = static_cast<int>(head.width), height = static_cast<int>(head.height);
  HdrImage out;
  out.pixels = coding.base == RgbeBase::kContinuous
                   ? read_continuous_base(body, width, height, coding.coarseness)
                   : read_split_bases(body, width, height, coding);
  if (head.environment > 0)
    out.environment = static_cast<EnvironmentAttribute>(head.environment - 1);
  return out;
}

}  // namespace penumbra::codec
