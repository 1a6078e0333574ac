#include "runtime/foreground/internal/soft_edges.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace penumbra::runtime {

namespace {

using EdgeSide = EdgeScratch::EdgeSide;
using EdgeBlock = EdgeScratch::EdgeBlock;

// Linear signal of one kind of pixel.
template <class Pixel>
class Signal {
 public:
  Signal(const Image<Pixel>& picture, const ResponseTable* curve)
      : picture_(picture), curve_(curve) {}
  Rgb at(int x, int y) const {
    const Pixel& p = picture_.at(x, y);
    if constexpr (std::is_same_v<Pixel, Rgb>)
      return p;
    else
      return {curve_->decode(0, p.r), curve_->decode(1, p.g), curve_->decode(2, p.b)};
  }

 private:
  const Image<Pixel>& picture_;
  const ResponseTable* curve_;
};

float sum_of(const Rgb& v) {
  return v.r + v.g + v.b;
}

void add(EdgeSide& side, const Rgb& c) {
  ++side.count;
  side.sum += c;
  side.squares += c * c;
}
void add(EdgeSide& side, const EdgeSide& o) {
  side.count += o.count;
  side.sum += o.sum;
  side.squares += o.squares;
}
Rgb mean_of(const EdgeSide& side) {
  return side.sum * (1 / side.count);
}
// Of a pixel, over all channels.
float variance_of(const EdgeSide& side) {
  const Rgb m = mean_of(side);
  return std::max(sum_of(side.squares) / side.count - sum_of(m * m), 0.f);
}

// What a thing and its background look like around a block.
struct TwoColours {
  float nearest_m = Silhouettes::kNothing;
  float trust = 0;  // in what colours say against what depth alone does, 0..1
  Rgb background, apart;
  float per_squared = 0;  // 1/|apart|^2

  explicit TwoColours(const EdgeBlock& around) : nearest_m(around.nearest_m) {
    constexpr float kMinSeen = 4;  // pixels of a side that tell its colour
    constexpr float kTrust = 4;    // times its variance a difference must be to count as much
    if (around.thing.count < kMinSeen || around.background.count < kMinSeen) return;
    background = mean_of(around.background);
    apart = mean_of(around.thing) - background;
    const float squared = sum_of(apart * apart);
    if (!(squared > 0) || !std::isfinite(squared)) return;
    per_squared = 1 / squared;
    trust =
        squared / (squared + kTrust * (variance_of(around.thing) + variance_of(around.background)));
  }

  // Cover and fringe of a pixel that depth alone says is covered so far.
  glm::vec4 mixture(const Rgb& signal, float by_depth) const {
    if (trust == 0) return {0, 0, 0, by_depth};
    constexpr float kNoise = .06f;  // what both sides' own patterns leave
    const float along = sum_of((signal - background) * apart) * per_squared;
    const float by_colour = std::clamp((along - kNoise) / (1 - 2 * kNoise), 0.f, 1.f);
    const float c = trust * by_colour + (1 - trust) * by_depth;
    if (!std::isfinite(c)) return {0, 0, 0, by_depth};
    const Rgb fringe = apart * (trust * c * (1 - c));
    return {fringe.r, fringe.g, fringe.b, c};
  }
};

// Which pixels may lie on an edge: where within the radius some are covered and some are not.
class EdgeBand {
 public:
  EdgeBand(const Silhouettes& in, const compositor::Rect& area, EdgeScratch& scratch)
      : area_(area),
        radius_(static_cast<int>(std::ceil(in.blur_px))),
        mask_(scratch.mask),
        sums_(scratch.sums),
        covered_(scratch.covered) {
    load_mask(in.distance_m);
    count_covered();
  }

  int radius() const { return radius_; }
  bool is_background(std::size_t i) const { return covered_[i] == 0; }
  bool is_thing(std::size_t i) const { return covered_[i] == window(); }
  bool is_edge(std::size_t i) const { return !is_background(i) && !is_thing(i); }
  // What depth alone says: an edge of a pixel where half of the neighbourhood is covered, which is
  // smooth though each pixel's depth is not.
  float by_depth(std::size_t i) const {
    const float off_half = static_cast<float>(covered_[i]) / static_cast<float>(window()) - .5f;
    return std::clamp(off_half * static_cast<float>(2 * radius_ + 1) + .5f, 0.f, 1.f);
  }

 private:
  int window() const { return (2 * radius_ + 1) * (2 * radius_ + 1); }
  int columns() const { return area_.width() + 2 * radius_; }

  // Of the area and the radius around it; beyond the picture's rim it goes on as there.
  void load_mask(const Image<float>& distance_m) {
    mask_.resize(static_cast<std::size_t>(columns()) *
                 static_cast<std::size_t>(area_.height() + 2 * radius_));
    const auto place = [](int v, int size) { return std::clamp(v, 0, size - 1); };
    std::uint8_t* to = mask_.data();
    for (int y = area_.y0 - radius_; y < area_.y1 + radius_; ++y) {
      const auto from = distance_m.row(place(y, distance_m.height()));
      const int x0 = area_.x0 - radius_, x1 = area_.x1 + radius_;
      int x = x0;
      const auto covers = [&](int at) {
        return from[static_cast<std::size_t>(at)] < Silhouettes::kNothing;
      };
      for (; x < std::min(0, x1); ++x) *to++ = covers(0);
      for (; x < std::min(x1, distance_m.width()); ++x) *to++ = covers(x);
      for (; x < x1; ++x) *to++ = covers(distance_m.width() - 1);
    }
  }

  // How many of the pixels within the radius are covered: sums down columns, then along rows.
  void count_covered() {
    const auto width = static_cast<std::size_t>(area_.width()),
               wide = static_cast<std::size_t>(columns());
    const std::size_t across = static_cast<std::size_t>(2 * radius_ + 1);
    covered_.resize(width * static_cast<std::size_t>(area_.height()));
    sums_.assign(wide, 0);
    const auto add = [&](std::size_t row, int sign) {
      const std::uint8_t* const from = &mask_[row * wide];
      for (std::size_t x = 0; x < wide; ++x)
        sums_[x] = static_cast<std::uint16_t>(sums_[x] + sign * from[x]);
    };
    for (std::size_t row = 0; row + 1 < across; ++row) add(row, 1);
    for (std::size_t y = 0; y < static_cast<std::size_t>(area_.height()); ++y) {
      add(y + across - 1, 1);
      std::uint16_t* const to = &covered_[y * width];
      int sum = 0;
      for (std::size_t x = 0; x + 1 < across; ++x) sum += sums_[x];
      for (std::size_t x = 0; x < width; ++x) {
        sum += sums_[x + across - 1];
        to[x] = static_cast<std::uint16_t>(sum);
        sum -= sums_[x];
      }
      add(y, -1);
    }
  }

  compositor::Rect area_;
  int radius_;
  std::vector<std::uint8_t>& mask_;
  std::vector<std::uint16_t>&sums_, &covered_;
};

// Blocks of pixels as large as an edge is uncertain.
struct Blocks {
  const compositor::Rect& area;
  int size;
  int columns = (area.width() + size - 1) / size, rows = (area.height() + size - 1) / size;

  std::size_t count() const {
    return static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows);
  }
  compositor::Rect rect(std::size_t block) const {
    const int x = area.x0 + static_cast<int>(block) % columns * size,
              y = area.y0 + static_cast<int>(block) / columns * size;
    return compositor::common({x, y, x + size, y + size}, area);
  }
  // Of itself and its neighbours.
  EdgeBlock around(const std::vector<EdgeBlock>& blocks, std::size_t block) const {
    const int i = static_cast<int>(block) % columns, j = static_cast<int>(block) / columns;
    EdgeBlock out;
    for (int v = std::max(j - 1, 0); v <= std::min(j + 1, rows - 1); ++v)
      for (int u = std::max(i - 1, 0); u <= std::min(i + 1, columns - 1); ++u) {
        const EdgeBlock& b = blocks[static_cast<std::size_t>(v * columns + u)];
        add(out.thing, b.thing);
        add(out.background, b.background);
        out.nearest_m = std::min(out.nearest_m, b.nearest_m);
        out.has_edge |= b.has_edge;
      }
    return out;
  }
};

// Calls body(index in the foreground, x, y).
template <class Body>
void for_pixels(const compositor::Foreground& f, const compositor::Rect& r, const Body& body) {
  for (int y = r.y0; y < r.y1; ++y) {
    std::size_t i = f.index(r.x0, y);
    for (int x = r.x0; x < r.x1; ++x, ++i) body(i, x, y);
  }
}

// Of a mask, 0..1; 0 without.
float mask_at(const Silhouettes& in, int x, int y) {
  return in.has_mask ? in.cover.at(x, y) : 0;
}

// What pixels say that are on no edge.
void load_row(const Silhouettes& in, const EdgeBand& band, int y, compositor::Foreground& out) {
  const std::size_t first = out.index(out.area.x0, y),
                    count = static_cast<std::size_t>(out.area.width()),
                    x0 = static_cast<std::size_t>(out.area.x0);
  const float* const distance = &in.distance_m.row(y)[x0];
  glm::vec4* const cover = &out.cover[first];
  float* const nearest = &out.distance_m[first];
  for (std::size_t i = 0; i < count; ++i) {
    cover[i] = {0, 0, 0, band.is_thing(first + i) ? 1.f : 0.f};
    nearest[i] = std::min(distance[i], compositor::Foreground::kNowhere_m);
  }
  if (!in.has_mask) return;
  const float* const mask = &in.cover.row(y)[x0];
  for (std::size_t i = 0; i < count; ++i) {
    if (!(mask[i] > 0)) continue;
    // It is in front of everything, also where it is thin.
    nearest[i] = 0;
    if (cover[i].a == 0) cover[i].a = mask[i];
  }
}

// Which blocks have an edge, and what is nearest in them.
void sum_up_row(const Silhouettes& in, const EdgeBand& band, int y, const Blocks& grid,
                std::vector<EdgeBlock>& blocks) {
  const compositor::Rect& area = grid.area;
  const int row = (y - area.y0) / grid.size;
  for (int column = 0; column < grid.columns; ++column) {
    EdgeBlock& block = blocks[static_cast<std::size_t>(row * grid.columns + column)];
    const int first = column * grid.size, last = std::min(first + grid.size, area.width());
    const float* const distance = &in.distance_m.row(y)[static_cast<std::size_t>(area.x0)];
    const std::size_t at =
        static_cast<std::size_t>(y - area.y0) * static_cast<std::size_t>(area.width());
    float nearest = block.nearest_m;
    bool has_edge = block.has_edge;
    for (int x = first; x < last; ++x) {
      nearest = std::min(nearest, distance[x]);
      has_edge |= band.is_edge(at + static_cast<std::size_t>(x));
    }
    block.nearest_m = nearest, block.has_edge = has_edge;
  }
}

void load_blocks(const Silhouettes& in, const EdgeBand& band, const Blocks& grid,
                 std::vector<EdgeBlock>& blocks, compositor::Foreground& out) {
  blocks.assign(grid.count(), {});
  for (int y = out.area.y0; y < out.area.y1; ++y) {
    load_row(in, band, y, out);
    sum_up_row(in, band, y, grid, blocks);
  }
  for (std::size_t b = 0; b < blocks.size(); ++b)
    blocks[b].near_edge = grid.around(blocks, b).has_edge;
}

template <class Pixel>
void find_cover_in(const Silhouettes& in, const Signal<Pixel>& signal, const Vignetting& vignetting,
                   EdgeScratch& scratch, compositor::Foreground& out) {
  const EdgeBand band(in, out.area, scratch);
  const Blocks grid{out.area, 2 * band.radius() + 2};
  std::vector<EdgeBlock>& blocks = scratch.blocks;
  load_blocks(in, band, grid, blocks, out);
  for (std::size_t b = 0; b < blocks.size(); ++b)
    if (blocks[b].near_edge)
      for_pixels(out, grid.rect(b), [&](std::size_t i, int x, int y) {
        const Rgb here = signal.at(x, y);
        if (!std::isfinite(sum_of(here))) return;
        if (band.is_thing(i)) add(blocks[b].thing, here);
        if (band.is_background(i)) add(blocks[b].background, here);
      });
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    if (!blocks[b].has_edge) continue;
    const TwoColours colours(grid.around(blocks, b));
    for_pixels(out, grid.rect(b), [&](std::size_t i, int x, int y) {
      if (band.is_thing(i) || band.is_background(i)) return;
      const float mask = mask_at(in, x, y);
      const float plain = in.has_depth ? std::max(mask, band.by_depth(i)) : mask;
      glm::vec4 c = colours.mixture(signal.at(x, y), plain);
      // The lens is put on all that is drawn, and the picture has it already.
      if (!vignetting.none()) {
        const auto left = static_cast<float>(vignetting.at({x + .5, y + .5}));
        c = {c.r / left, c.g / left, c.b / left, c.a};
      }
      out.cover[i] = c;
      if (out.distance_m[i] == compositor::Foreground::kNowhere_m)
        out.distance_m[i] = colours.nearest_m;
    });
  }
}

}  // namespace

void find_cover(const Silhouettes& silhouettes, const FramePixels& picture,
                const ResponseTable* curve, const Vignetting& vignetting, EdgeScratch& scratch,
                compositor::Foreground& out) {
  const int rim = 2 * static_cast<int>(std::ceil(silhouettes.blur_px)) + 2;
  const compositor::Rect& a = silhouettes.area;
  const Image<float>& d = silhouettes.distance_m;
  out.area = compositor::common({a.x0 - rim, a.y0 - rim, a.x1 + rim, a.y1 + rim},
                                {0, 0, d.width(), d.height()});
  const auto pixels =
      static_cast<std::size_t>(out.area.width()) * static_cast<std::size_t>(out.area.height());
  out.cover.resize(pixels);
  out.distance_m.resize(pixels);
  std::visit(
      [&]<class Pixel>(const Image<Pixel>& p) {
        find_cover_in(silhouettes, Signal<Pixel>(p, curve), vignetting, scratch, out);
      },
      picture);
}

}  // namespace penumbra::runtime
