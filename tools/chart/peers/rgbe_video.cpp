#include "tools/chart/peers/rgbe_video.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>

#include "codec/dct/dct_coding.h"

namespace penumbra::tools {

namespace {

constexpr int kMacro = 16, kReach = 7, kMaxSide = 4096;
constexpr std::uint32_t kMaxMaps = 1u << 16;

struct Planes {
  Image<std::uint8_t> base, exponent, negative;
};

// v = base/256 2^(exponent - 128), as RGBE of a grey pixel; 0 has exponent 0.
Planes split(const Image<float>& map) {
  Planes out{{map.width(), map.height()}, {map.width(), map.height()}, {map.width(), map.height()}};
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      int e = 0;
      const float m = std::frexp(std::abs(map.at(x, y)), &e);
      if (m == 0 || e < -127) continue;
      out.base.at(x, y) = static_cast<std::uint8_t>(256 * m);
      out.exponent.at(x, y) = static_cast<std::uint8_t>(e + 128);
      out.negative.at(x, y) = map.at(x, y) < 0;
    }
  return out;
}

float joined(std::uint8_t base, std::uint8_t exponent, std::uint8_t negative) {
  if (exponent == 0) return 0;
  // The middle of what the base stands for, as Radiance's readers take it.
  const float v = std::ldexp((static_cast<float>(base) + .5f) / 256, int{exponent} - 128);
  return negative ? -v : v;
}

struct VideoModels {
  codec::BlockModels block;
  codec::NumberModel motion[2];
  codec::NumberModel exponent[3];
  std::array<codec::BitModel, 8> negative;
};

template <class Stream>
class Coder {
 public:
  Coder(Stream& stream, int width, int height, int quality)
      : stream_(stream),
        width_(width),
        height_(height),
        quality_(quality),
        before_{{width, height}, {width, height}, {width, height}} {}

  /// In: what is to be coded (writing), any (reading); afterwards what a reader gets.
  void map(Planes& p, bool key) {
    exponents(p.exponent, key);
    signs(p);
    bases(p, key);
    before_ = p;
  }

 private:
  std::uint8_t at(const Image<std::uint8_t>& image, int x, int y) const {
    return image.at(std::clamp(x, 0, width_ - 1), std::clamp(y, 0, height_ - 1));
  }

  void exponents(Image<std::uint8_t>& e, bool key) {
    for (int y = 0; y < height_; ++y)
      for (int x = 0; x < width_; ++x) {
        int guess = 0, restless = 0;
        const int left = x > 0 ? e.at(x - 1, y) : 0, upper_moments = y > 0 ? e.at(x, y - 1) : 0;
        if (!key) {
          guess = before_.exponent.at(x, y);
          restless = (left != (x > 0 ? before_.exponent.at(x - 1, y) : 0)) +
                     (upper_moments != (y > 0 ? before_.exponent.at(x, y - 1) : 0));
        } else {
          const int corner = x > 0 && y > 0 ? e.at(x - 1, y - 1) : 0;
          guess = std::clamp(left + upper_moments - corner, std::min(left, upper_moments),
                             std::max(left, upper_moments));
          restless = (left != corner) + (upper_moments != corner);
        }
        const int v = guess + stream_.number(models_->exponent[restless], e.at(x, y) - guess);
        e.at(x, y) = static_cast<std::uint8_t>(std::clamp(v, 0, 255));
      }
  }

  void signs(Planes& p) {
    for (int y = 0; y < height_; ++y)
      for (int x = 0; x < width_; ++x) {
        if (p.exponent.at(x, y) == 0) {
          p.negative.at(x, y) = 0;
          continue;
        }
        const int context = (x > 0 ? p.negative.at(x - 1, y) : 0) +
                            2 * (y > 0 ? p.negative.at(x, y - 1) : 0) +
                            4 * before_.negative.at(x, y);
        p.negative.at(x, y) = stream_.bit(models_->negative[static_cast<std::size_t>(context)],
                                          p.negative.at(x, y) != 0);
      }
  }

  struct Motion {
    int x = 0, y = 0;
  };

  // The best of all places near by the sum of differences; staying is worth a little.
  Motion best_motion(const Image<std::uint8_t>& base, int x0, int y0) const {
    Motion best;
    long smallest = -1;
    for (int dy = -kReach; dy <= kReach; ++dy)
      for (int dx = -kReach; dx <= kReach; ++dx) {
        long sum = dx == 0 && dy == 0 ? -64 : 0;
        for (int y = 0; y < kMacro; ++y)
          for (int x = 0; x < kMacro; ++x)
            sum += std::abs(int{at(base, x0 + x, y0 + y)} -
                            int{at(before_.base, x0 + x + dx, y0 + y + dy)});
        if (smallest < 0 || sum < smallest) smallest = std::max(sum, 0l), best = {dx, dy};
      }
    return best;
  }

  void bases(Planes& p, bool key) {
    Image<std::uint8_t> out(width_, height_);
    for (int my = 0; my < height_; my += kMacro)
      for (int mx = 0; mx < width_; mx += kMacro) {
        Motion motion;
        if (!key) {
          if constexpr (Stream::kWrites) motion = best_motion(p.base, mx, my);
          motion.x = std::clamp(stream_.number(models_->motion[0], motion.x), -kReach, kReach);
          motion.y = std::clamp(stream_.number(models_->motion[1], motion.y), -kReach, kReach);
        }
        for (int y = my; y < std::min(my + kMacro, height_); y += codec::kBlock)
          for (int x = mx; x < std::min(mx + kMacro, width_); x += codec::kBlock)
            block(p, x, y, key, motion, out);
      }
    p.base = std::move(out);
  }

  void block(const Planes& p, int x0, int y0, bool key, Motion motion, Image<std::uint8_t>& out) {
    int low = 255, high = 0;
    for (int i = 0; i < 64; ++i) {
      const int e = at(p.exponent, x0 + i % codec::kBlock, y0 + i / codec::kBlock);
      low = std::min(low, e);
      high = std::max(high, e);
    }
    const float finer = codec::finer_where_exponents_differ(low, high);
    codec::DctBlock guess{}, in{};
    for (int i = 0; i < 64; ++i) {
      const int x = x0 + i % codec::kBlock, y = y0 + i / codec::kBlock;
      guess[static_cast<std::size_t>(i)] = key ? 128 : at(before_.base, x + motion.x, y + motion.y);
      in[static_cast<std::size_t>(i)] =
          static_cast<float>(at(p.base, x, y)) - guess[static_cast<std::size_t>(i)];
    }
    codec::DctBlock coded = Stream::kWrites ? codec::transformed(in, false) : codec::DctBlock{};
    codec::code_block(stream_, models_->block, coded, [&](int i) {
      return codec::quantiser(codec::kLuminanceSteps, codec::table_scale(quality_), i) / finer;
    });
    const codec::DctBlock back = codec::transformed(coded, true);
    for (int i = 0; i < 64; ++i) {
      const int x = x0 + i % codec::kBlock, y = y0 + i / codec::kBlock;
      if (x >= width_ || y >= height_) continue;
      out.at(x, y) = static_cast<std::uint8_t>(
          std::clamp(back[static_cast<std::size_t>(i)] + guess[static_cast<std::size_t>(i)] + .5f,
                     0.f, 255.f));
    }
  }

  Stream& stream_;
  int width_, height_, quality_;
  Planes before_;
  std::unique_ptr<VideoModels> models_ = std::make_unique<VideoModels>();
};

struct VideoHead {
  char magic[8];
  std::uint32_t maps;
  std::uint16_t width, height, quality, key_interval;
};
constexpr char kMagic[8] = {'P', 'N', 'B', 'R', 'G', 'B', 'E', '1'};

}  // namespace

Result<std::vector<unsigned char>> encode_rgbe_video(std::span<const Image<float>> maps,
                                                     int quality, int key_interval) {
  if (maps.empty() || maps.size() > kMaxMaps || maps[0].empty() || maps[0].width() > kMaxSide ||
      maps[0].height() > kMaxSide)
    return fail(ErrorCode::kInvalid, "maps", "are none, or larger than 4096 pixels");
  if (quality < 1 || quality > 100 || key_interval < 1 || key_interval > 65535)
    return fail(ErrorCode::kInvalid, "quality", "is not within 1..100");
  VideoHead head{{},
                 static_cast<std::uint32_t>(maps.size()),
                 static_cast<std::uint16_t>(maps[0].width()),
                 static_cast<std::uint16_t>(maps[0].height()),
                 static_cast<std::uint16_t>(quality),
                 static_cast<std::uint16_t>(key_interval)};
  std::memcpy(head.magic, kMagic, sizeof kMagic);
  codec::BitWriter writer;
  Coder<codec::BitWriter> coder(writer, maps[0].width(), maps[0].height(), quality);
  for (std::size_t i = 0; i < maps.size(); ++i) {
    if (maps[i].width() != maps[0].width() || maps[i].height() != maps[0].height())
      return fail(ErrorCode::kInvalid, "maps", "differ in size");
    for (const float v : maps[i].pixels())
      if (!(std::abs(v) < 0x1p126f))
        return fail(ErrorCode::kInvalid, "maps", "have a value that RGBE cannot hold");
    Planes planes = split(maps[i]);
    coder.map(planes, i % static_cast<std::size_t>(key_interval) == 0);
  }
  std::vector<unsigned char> out(sizeof head);
  std::memcpy(out.data(), &head, sizeof head);
  const std::vector<unsigned char> body = writer.finish();
  out.insert(out.end(), body.begin(), body.end());
  return out;
}

Result<std::vector<Image<float>>> decode_rgbe_video(std::span<const unsigned char> bytes,
                                                    const std::string& name) {
  VideoHead head{};
  if (bytes.size() < sizeof head || std::memcmp(bytes.data(), kMagic, sizeof kMagic) != 0)
    return fail(ErrorCode::kUnreadable, name, "is not a sequence of RGBE maps");
  std::memcpy(&head, bytes.data(), sizeof head);
  // A block takes a bit at least.
  const std::uint64_t area = std::uint64_t{head.width} * head.height;
  if (head.maps < 1 || head.maps > kMaxMaps || head.width < 1 || head.width > kMaxSide ||
      head.height < 1 || head.height > kMaxSide || head.quality < 1 || head.quality > 100 ||
      head.key_interval < 1 || area * head.maps > std::uint64_t{1} << 28)
    return fail(ErrorCode::kUnreadable, name, "is damaged: its sizes are out of range");
  codec::BitReader reader(bytes.subspan(sizeof head));
  Coder<codec::BitReader> coder(reader, head.width, head.height, head.quality);
  std::vector<Image<float>> out;
  for (std::uint32_t i = 0; i < head.maps; ++i) {
    Planes planes{{head.width, head.height}, {head.width, head.height}, {head.width, head.height}};
    coder.map(planes, i % head.key_interval == 0);
    Image<float> map(head.width, head.height);
    for (int y = 0; y < map.height(); ++y)
      for (int x = 0; x < map.width(); ++x)
        map.at(x, y) =
            joined(planes.base.at(x, y), planes.exponent.at(x, y), planes.negative.at(x, y));
    out.push_back(std::move(map));
  }
  return out;
}

}  // namespace penumbra::tools
