#include "compositor/pixels/pixel_pass.h"

#include <atomic>

#include "compositor/pixels/code_row.h"
#include "compositor/pixels/layered_rows.h"
#include "core/threads/parallel.h"

namespace penumbra::compositor {

namespace {

// The fused pass over neighbouring pixels; see composite_codes, which is the same for eight bits.
template <class Pixel, class Codec>
std::size_t composite_part(const Codec& codec, const float* object, const float* r, const float* g,
                           const float* b, Pixel* pixels, std::size_t count) {
  constexpr float kNoObject[4] = {0, 0, 0, 0};
  std::size_t touched = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const float* const v = object ? object + 4 * i : kNoObject;
    if (v[3] == 0 && r[i] == 1 && g[i] == 1 && b[i] == 1) continue;
    ++touched;
    const float behind = 1 - v[3];
    Pixel& p = pixels[i];
    p.r = codec.encode(0, v[0] + behind * r[i] * codec.decode(0, p.r));
    p.g = codec.encode(1, v[1] + behind * g[i] * codec.decode(1, p.g));
    p.b = codec.encode(2, v[2] + behind * b[i] * codec.decode(2, p.b));
  }
  return touched;
}

// Eight bits are what cameras deliver live: in vectors.
std::size_t composite_part(const CodedPixels<std::uint8_t>& codec, const float* object,
                           const float* r, const float* g, const float* b, Rgb8* pixels,
                           std::size_t count) {
  return composite_codes(codec.curve, codec.clipped, object, r, g, b, pixels, count);
}

// The pixels of one row from in.area; `object`: their row of the layer, or none.
template <class Pixel, class Codec>
std::size_t composite_span(const Codec& codec, Pixel* row, int y, const Layered& in,
                           const float* object, RowBuffers& rows) {
  if (in.area.empty()) return 0;
  const bool has_shadows = load_shadows(in, y, rows);
  if (!object && !has_shadows) return 0;
  return composite_part(codec, object, rows.r.data(), rows.g.data(), rows.b.data(),
                        row + in.area.x0, static_cast<std::size_t>(in.area.width()));
}

template <class Pixel, class Codec>
std::size_t composite_beside(const Codec& codec, Pixel* row, int y, const Layered& in,
                             RowBuffers& rows) {
  const auto span = [&](int x0, int x1) {
    return composite_span(codec, row, y, in.within({x0, y, x1, y + 1}), nullptr, rows);
  };
  const Rect reach = in.row(y).area, &objects = in.objects.rect;
  if (!has_row(in.objects, y)) return span(reach.x0, reach.x1);
  return span(reach.x0, objects.x0) + span(objects.x1, reach.x1);
}

template <class Pixel, class Codec>
std::size_t composite_objects(const Codec& codec, Pixel* row, int y, const Layered& in,
                              RowBuffers& rows) {
  load_objects(in, y, rows.object);
  return composite_span(codec, row, y,
                        in.within({in.objects.rect.x0, y, in.objects.rect.x1, y + 1}),
                        rows.object.data(), rows);
}

template <class Pixel, class Codec>
std::size_t composite_rows(FrameRegion fraction, const Codec& codec, Image<Pixel>& frame,
                           const Layered& in) {
  const Rect& area = fraction == FrameRegion::kBeside ? in.area : in.objects.rect;
  std::atomic<std::size_t> touched = 0;
  parallel_for(area.y0, area.y1, 8, [&](const auto& range) {
    thread_local RowBuffers rows;  // grow once per thread
    rows.resize(static_cast<std::size_t>(frame.width()));
    std::size_t count = 0;
    for (int y = range.begin(); y < range.end(); ++y) {
      Pixel* const row = frame.row(y).data();
      count += fraction == FrameRegion::kBeside ? composite_beside(codec, row, y, in, rows)
                                                : composite_objects(codec, row, y, in, rows);
    }
    touched += count;
  });
  return touched;
}

}  // namespace

std::size_t composite_fraction(FrameRegion fraction, const View& view, FramePixels& frame,
                               const Layered& in) {
  if (auto* f8 = std::get_if<Image<Rgb8>>(&frame))
    return composite_rows(fraction, CodedPixels<std::uint8_t>(view), *f8, in);
  if (auto* f16 = std::get_if<Image<Rgb16>>(&frame))
    return composite_rows(fraction, CodedPixels<std::uint16_t>(view), *f16, in);
  return composite_rows(fraction, Linear{}, std::get<Image<Rgb>>(frame), in);
}

}  // namespace penumbra::compositor
