// Rows of what the compositor puts into a frame, for the passes over its pixels.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "calib/camera/response_table.h"
#include "calib/camera/vignetting.h"
#include "compositor/foreground.h"
#include "compositor/layers/layers.h"
#include "compositor/pixels/code_row.h"
#include "compositor/pixels/half_rows.h"
#include "compositor/pixels/receivers.h"

namespace penumbra::compositor {

/// Access to one kind of pixel: linear signal in, linear signal out.
template <class Code>
struct CodedPixels {
  const ResponseTable& curve;
  Rgb clipped;  // signal of the largest code

  explicit CodedPixels(const View& view) : curve(*view.curve), clipped(view.clipped_signal) {}
  float decode(int c, Code code) const { return decode_clipped(curve, c, code, clipped[c]); }
  Code encode(int c, float v) const {
    if constexpr (sizeof(Code) == 1)
      return curve.encode8(c, v);
    else
      return static_cast<Code>(curve.encode(c, v));
  }
};
struct Linear {
  static float decode(int, float v) { return v; }
  static float encode(int, float v) { return v; }
};

/// Rows of one worker: shadow ratios and the layers as floats.
struct RowBuffers {
  std::vector<float> r, g, b, object, hidden, weights, left;
  void resize(std::size_t width) {
    for (auto* v : {&r, &g, &b}) v->resize(width);
    for (auto* v : {&object, &hidden, &weights, &left}) v->resize(4 * width);
  }
};

inline bool has_row(const Layer& layer, int y) {
  return y >= layer.rect.y0 && y < layer.rect.y1;
}

inline void load_halves(std::span<const std::uint16_t> row, std::vector<float>& out) {
  floats_from_halves(row, std::span(out).first(row.size()));
}
inline void load_row(const Layer& layer, int y, std::vector<float>& out) {
  load_halves(layer.row(y), out);
}

/// What one frame is composited from.
struct Layered {
  const Layer &objects, &hidden;
  const Receivers& receivers;
  Rect area;  // all that is touched at most
  const Vignetting& vignetting;
  const Foreground* foreground = nullptr;

  /// The same for row y alone, `area` being what is touched there at most.
  Layered row(int y) const {
    Rect part = receivers.reach_in_row(y);
    for (const Layer* layer : {&objects, &hidden})
      if (has_row(*layer, y)) part = united(part, {layer->rect.x0, y, layer->rect.x1, y + 1});
    return within(part);
  }
  Layered within(const Rect& part) const {
    return {objects, hidden, receivers, part, vignetting, foreground};
  }
};

/// The objects' row as the lens lets it through.
inline void load_objects(const Layered& in, int y, std::vector<float>& out) {
  load_row(in.objects, y, out);
  if (in.vignetting.none()) return;
  for (int x = in.objects.rect.x0; x < in.objects.rect.x1; ++x) {
    const auto left = static_cast<float>(in.vignetting.at({x + .5, y + .5}));
    float* const pixel = &out[static_cast<std::size_t>(x - in.objects.rect.x0) * 4];
    for (int c = 0; c < 3; ++c) pixel[c] *= left;
  }
}

/// Shadows on planes do not fall on what stands in front of them.
inline void spare_foreground(const Layered& in, int y, RowBuffers& rows) {
  if (!in.foreground) return;
  const Rect& f = in.foreground->area;
  if (y < f.y0 || y >= f.y1) return;
  for (int x = std::max(f.x0, in.area.x0); x < std::min(f.x1, in.area.x1); ++x) {
    const float left = 1 - in.foreground->cover[in.foreground->index(x, y)].a;
    const auto i = static_cast<std::size_t>(x - in.area.x0);
    for (auto* v : {&rows.r, &rows.g, &rows.b}) (*v)[i] = 1 + left * ((*v)[i] - 1);
  }
}

/// Of an open plane's light: what real things shade altogether is still seen.
inline constexpr float kMinPlaneWeight = .01f;

/// What a pixel shows of real meshes and of the plane behind them keeps the mean of their ratios,
/// by the light that leaves each.
inline void weigh_surfaces(const Layered& in, int y, RowBuffers& rows) {
  const int x0 = std::max(in.hidden.rect.x0, in.area.x0),
            x1 = std::min(in.hidden.rect.x1, in.area.x1);
  if (x0 >= x1) return;
  const auto load = [&](std::span<const std::uint16_t> row, std::vector<float>& out) {
    load_halves(row.subspan(static_cast<std::size_t>(x0 - in.hidden.rect.x0) * 4,
                            static_cast<std::size_t>(x1 - x0) * 4),
                out);
  };
  load(in.hidden.row(y), rows.hidden);
  const auto in_hidden = [&](int x) { return static_cast<std::size_t>(x - x0) * 4; };
  bool any = false;
  int first = x1, last = x0;  // of those that show a plane beside a mesh
  for (int x = x0; x < x1; ++x) {
    const float covered = rows.hidden[in_hidden(x) + 3];
    any |= covered > 0;
    if (covered > 0 && covered < 1) first = std::min(first, x), last = x + 1;
  }
  if (!any) return;
  load(in.hidden.weights_row(y), rows.weights);
  const std::size_t width = first < last ? static_cast<std::size_t>(last - first) : 0;
  const std::span left = std::span(rows.left).first(3 * width);
  std::ranges::fill(left, 1.f);
  if (width > 0) in.receivers.multiply_by_left(y, {first, y, last, y + 1}, left);
  std::vector<float>* const ratios[] = {&rows.r, &rows.g, &rows.b};
  for (int x = x0; x < x1; ++x) {
    const float *const taken = &rows.hidden[in_hidden(x)], *const weight =
                                                               &rows.weights[in_hidden(x)];
    if (taken[3] <= 0) continue;
    const float seen = 1 - taken[3];
    for (std::size_t c = 0; c < 3; ++c) {
      float& s = (*ratios[c])[static_cast<std::size_t>(x - in.area.x0)];
      const float plane =
          seen > 0 ? seen * std::max(left[c * width + static_cast<std::size_t>(x - first)],
                                     kMinPlaneWeight)
                   : 0;
      s = 1 + (plane * (s - 1) - taken[c]) / (plane + weight[c]);
    }
  }
}

/// Ratios of the row; real geometry in front of the receiver brings its own. False when no shadow
/// reaches it: then they are 1.
inline bool load_shadows(const Layered& in, int y, RowBuffers& rows) {
  const auto width = static_cast<std::size_t>(in.area.width());
  for (auto* v : {&rows.r, &rows.g, &rows.b}) std::fill_n(v->begin(), width, 1.f);
  const bool on_planes =
      in.receivers.load_row(y, in.area, rows.r.data(), rows.g.data(), rows.b.data());
  if (on_planes) spare_foreground(in, y, rows);
  if (!has_row(in.hidden, y)) return on_planes;
  weigh_surfaces(in, y, rows);
  return true;
}

}  // namespace penumbra::compositor
