#include "prt/rays/ray_pattern.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <random>

namespace penumbra::prt {

namespace {

constexpr double kTwoPi = 2 * std::numbers::pi;

std::uint32_t spread_bits(std::uint32_t v) {
  v = (v | (v << 8)) & 0x00ff00ffu;
  v = (v | (v << 4)) & 0x0f0f0f0fu;
  v = (v | (v << 2)) & 0x33333333u;
  return (v | (v << 1)) & 0x55555555u;
}

std::uint32_t morton(double u, double v) {
  return spread_bits(static_cast<std::uint32_t>(u * 1024)) |
         spread_bits(static_cast<std::uint32_t>(v * 1024)) << 1;
}

std::uint32_t reversed_bits(std::uint32_t v) {
  v = (v << 16) | (v >> 16);
  v = ((v & 0x00ff00ffu) << 8) | ((v & 0xff00ff00u) >> 8);
  v = ((v & 0x0f0f0f0fu) << 4) | ((v & 0xf0f0f0f0u) >> 4);
  v = ((v & 0x33333333u) << 2) | ((v & 0xccccccccu) >> 2);
  return ((v & 0x55555555u) << 1) | ((v & 0xaaaaaaaau) >> 1);
}

// Owen scrambling by a hash that carries only upwards (Laine & Karras 2011), on reversed bits.
std::uint32_t owen_scrambled(std::uint32_t v, std::uint32_t seed) {
  v = reversed_bits(v);
  v += seed;
  v ^= v * 0x6c50b47cu;
  v ^= v * 0xb82f1e52u;
  v ^= v * 0xc7afe638u;
  v ^= v * 0x8d22f6e6u;
  return reversed_bits(v);
}

// Second dimension of Sobol's sequence; the first is the reversed index.
std::uint32_t sobol_second(std::uint32_t i) {
  std::uint32_t value = 0;
  for (std::uint32_t direction = 1u << 31; i; i >>= 1, direction ^= direction >> 1)
    if (i & 1) value ^= direction;
  return value;
}

// Square to disk with equal areas, by Shirley & Chiu 1997.
std::pair<double, double> concentric_disk(double u, double v) {
  const double a = 2 * u - 1, b = 2 * v - 1;
  if (a == 0 && b == 0) return {0, 0};
  const bool first = std::abs(a) > std::abs(b);
  const double r = first ? a : b;
  const double phi = first ? std::numbers::pi / 4 * (b / a)
                           : std::numbers::pi / 2 - std::numbers::pi / 4 * (a / b);
  return {r * std::cos(phi), r * std::sin(phi)};
}

struct StratumSample {
  double u, v;
  std::uint8_t group;
};

// Owen-scrambled Sobol points: a (0, m, 2)-net as a whole, and each quarter is one of its own, so
// the quarters' spread bounds the error of the whole from above. In Morton order, so that sixteen
// neighbours make a coherent packet.
std::vector<StratumSample> make_samples(int rays, std::mt19937& rng) {
  std::vector<StratumSample> samples;
  const auto seed_u = static_cast<std::uint32_t>(rng()), seed_v = static_cast<std::uint32_t>(rng());
  for (int i = 0; i < rays; ++i) {
    const auto index = static_cast<std::uint32_t>(i);
    samples.push_back({owen_scrambled(reversed_bits(index), seed_u) * 0x1p-32,
                       owen_scrambled(sobol_second(index), seed_v) * 0x1p-32,
                       static_cast<std::uint8_t>(i / (rays / 4))});
  }
  std::ranges::sort(samples, {}, [](const StratumSample& s) { return morton(s.u, s.v); });
  return samples;
}

}  // namespace

RayPatterns::RayPatterns(int rays) : rays_(rays), variants_(kVariants) {
  std::mt19937 rng(20050101);
  for (Variant& variant : variants_)
    for (const StratumSample& s : make_samples(rays, rng)) {
      const auto [x, y] = concentric_disk(s.u, s.v);
      variant.disk_x.push_back(static_cast<float>(x));
      variant.disk_y.push_back(static_cast<float>(y));
      variant.disk_z.push_back(static_cast<float>(std::sqrt(std::max(0., 1 - x * x - y * y))));
      variant.height.push_back(static_cast<float>(s.v));
      variant.cos_phi.push_back(static_cast<float>(std::cos(kTwoPi * s.u)));
      variant.sin_phi.push_back(static_cast<float>(std::sin(kTwoPi * s.u)));
      variant.group.push_back(s.group);
    }
}

RayPatterns::Turn RayPatterns::turn_of(std::size_t point) {
  // Integer hash by Wellons ("lowbias32"): neighbours must not share a pattern.
  auto h = static_cast<std::uint32_t>(point);
  h = (h ^ (h >> 16)) * 0x7feb352du;
  h = (h ^ (h >> 15)) * 0x846ca68bu;
  h ^= h >> 16;
  const double angle = kTwoPi * (h >> 8) * 0x1p-24;
  return {static_cast<int>(h % kVariants), static_cast<float>(std::cos(angle)),
          static_cast<float>(std::sin(angle))};
}

const std::uint8_t* RayPatterns::groups(Turn turn, int block) const {
  return variants_[static_cast<std::size_t>(turn.variant)].group.data() + block * RayScene::kPacket;
}

namespace {

void rotate_lane(RayScene::RayPacket& p, int lane, RayPatterns::Turn turn, const glm::mat3& f,
                 float lx, float ly, float lz) {
  const float x = turn.cosine * lx - turn.sine * ly, y = turn.sine * lx + turn.cosine * ly;
  p.x[lane] = f[0].x * x + f[1].x * y + f[2].x * lz;
  p.y[lane] = f[0].y * x + f[1].y * y + f[2].y * lz;
  p.z[lane] = f[0].z * x + f[1].z * y + f[2].z * lz;
}

}  // namespace

void RayPatterns::cosine_block(Turn turn, int block, const glm::mat3& frame,
                               RayScene::RayPacket& packet) const {
  const Variant& v = variants_[static_cast<std::size_t>(turn.variant)];
  const auto first = static_cast<std::size_t>(block * RayScene::kPacket);
  for (int i = 0; i < RayScene::kPacket; ++i) {
    const std::size_t k = first + static_cast<std::size_t>(i);
    rotate_lane(packet, i, turn, frame, v.disk_x[k], v.disk_y[k], v.disk_z[k]);
  }
}

void RayPatterns::cone_block(Turn turn, int block, const glm::mat3& frame, float cos_half,
                             RayScene::RayPacket& packet) const {
  const Variant& v = variants_[static_cast<std::size_t>(turn.variant)];
  const auto first = static_cast<std::size_t>(block * RayScene::kPacket);
  for (int i = 0; i < RayScene::kPacket; ++i) {
    const std::size_t k = first + static_cast<std::size_t>(i);
    const float z = 1 - v.height[k] * (1 - cos_half), r = std::sqrt(std::max(0.f, 1 - z * z));
    rotate_lane(packet, i, turn, frame, r * v.cos_phi[k], r * v.sin_phi[k], z);
  }
}

glm::mat3 frame_around(const glm::vec3& n) {
  const float sign = std::copysign(1.f, n.z);
  const float a = -1 / (sign + n.z), b = n.x * n.y * a;
  return {{1 + sign * n.x * n.x * a, sign * b, -sign * n.x}, {b, sign + n.y * n.y * a, -n.y}, n};
}

}  // namespace penumbra::prt
