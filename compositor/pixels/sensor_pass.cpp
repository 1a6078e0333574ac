// The pass over the touched pixels with the camera's look.

#include <atomic>

#include "compositor/pixels/code_row.h"
#include "compositor/pixels/layered_rows.h"
#include "compositor/pixels/sensor_effects.h"
#include "core/threads/parallel.h"

namespace penumbra::compositor {

namespace {

// The variance that quantisation leaves in the signal, by 8-bit code; finer codes leave none.
template <class Code>
using Roundings = std::array<std::array<float, sizeof(Code) == 1 ? 256 : 0>, 3>;

template <class Codec>
Roundings<std::uint8_t> roundings_of(const Codec& codec, std::uint8_t) {
  Roundings<std::uint8_t> out;
  for (int c = 0; c < 3; ++c)
    for (int z = 0; z < 256; ++z) {
      const int below = std::max(z - 1, 0), above = std::min(z + 1, 255);
      const float step = (codec.curve.decode(c, static_cast<unsigned>(above)) -
                          codec.curve.decode(c, static_cast<unsigned>(below))) /
                         static_cast<float>(above - below);
      out[static_cast<std::size_t>(c)][static_cast<std::size_t>(z)] = step * step / 12;
    }
  return out;
}
template <class Codec, class Code>
Roundings<Code> roundings_of(const Codec&, Code) {
  return {};
}

// Rows of one worker: six planes of V and 1 - T, then three each of real signal, its rounding and
// the result.
struct SensorBuffers {
  RowBuffers layers;
  std::vector<float> planes, real, rounding, out;
  std::vector<std::uint32_t> touched;  // 0 where nothing changes
  void resize(std::size_t width, std::size_t stride) {
    layers.resize(width);
    planes.resize(6 * stride);
    for (auto* v : {&real, &rounding, &out}) v->resize(3 * stride, 0.f);
    touched.resize(stride);
  }
};

struct Loaded {
  bool objects = false, shadows = false;
};

// V and 1 - T of a row of in.area before any blur.
Loaded load_planes(const Layered& in, int y, std::size_t stride, SensorBuffers& rows) {
  RowBuffers& layers = rows.layers;
  const Loaded loaded{has_row(in.objects, y), load_shadows(in, y, layers)};
  if (!loaded.objects && !loaded.shadows) return loaded;
  const auto width = static_cast<std::size_t>(in.area.width()),
             padded = padded_row(in.area.width());
  const float* const ratio[3] = {layers.r.data(), layers.g.data(), layers.b.data()};
  for (std::size_t c = 0; c < 3; ++c) {
    float* const deficit = &rows.planes[(3 + c) * stride];
    for (std::size_t i = 0; i < width; ++i) deficit[i] = 1 - ratio[c][i];
    std::fill(deficit + width, deficit + padded, 0.f);
    std::fill_n(&rows.planes[c * stride], padded, 0.f);
  }
  if (!loaded.objects) return loaded;
  load_objects(in, y, layers.object);
  const auto first = static_cast<std::size_t>(in.objects.rect.x0 - in.area.x0),
             count = static_cast<std::size_t>(in.objects.rect.width());
  for (std::size_t c = 0; c < 3; ++c) {
    float* const added = &rows.planes[c * stride + first];
    float* const deficit = &rows.planes[(3 + c) * stride + first];
    for (std::size_t i = 0; i < count; ++i) {
      added[i] = layers.object[4 * i + c];
      deficit[i] += layers.object[4 * i + 3] * (1 - deficit[i]);
    }
  }
  return loaded;
}

// The same after the blur, of a row of planes.taken.area(). False when nothing reaches it.
bool load_blurred(const SensorPlanes& planes, int y, std::size_t stride, SensorBuffers& rows) {
  std::fill_n(rows.planes.begin(), 3 * stride, 0.f);
  const Rect &area = planes.deficit.area(), &objects = planes.added.area();
  if (!objects.empty())
    planes.added.load_row(y, &rows.planes[static_cast<std::size_t>(objects.x0 - area.x0)], stride);
  return planes.deficit.load_row(y, &rows.planes[3 * stride], stride);  // takes wherever it adds
}

template <class Codec, class Pixel>
void decode_row(const Codec& codec, const auto&, const Pixel* pixels, std::size_t count,
                const SignalRows& out) {
  for (std::size_t i = 0; i < count; ++i) {
    out.signal[i] = codec.decode(0, pixels[i].r);
    out.signal[out.stride + i] = codec.decode(1, pixels[i].g);
    out.signal[2 * out.stride + i] = codec.decode(2, pixels[i].b);
  }
}
template <class Codec, class Pixel>
void encode_row(const Codec& codec, const SignalRows& in, const std::uint32_t* touched,
                std::size_t count, Pixel* pixels) {
  for (std::size_t i = 0; i < count; ++i)
    if (touched[i])
      pixels[i] = {codec.encode(0, in.signal[i]), codec.encode(1, in.signal[in.stride + i]),
                   codec.encode(2, in.signal[2 * in.stride + i])};
}

// Eight bits are what cameras deliver live: in vectors.
void decode_row(const CodedPixels<std::uint8_t>& codec, const Roundings<std::uint8_t>& roundings,
                const Rgb8* pixels, std::size_t count, const SignalRows& out) {
  const float* const tables[] = {roundings[0].data(), roundings[1].data(), roundings[2].data()};
  decode_codes(codec.curve, codec.clipped, tables, pixels, count, out);
}
void encode_row(const CodedPixels<std::uint8_t>& codec, const SignalRows& in,
                const std::uint32_t* touched, std::size_t count, Rgb8* pixels) {
  encode_codes(codec.curve, in, touched, count, pixels);
}

template <class Pixel, class Codec, class Code>
std::size_t effects_row(const Codec& codec, const Roundings<Code>& roundings,
                        const SensorEffects& effects, Pixel* row, int y, const Rect& area,
                        std::size_t stride, SensorBuffers& rows) {
  const auto [first, last] = mark_touched(
      rows.planes.data(), stride, static_cast<std::size_t>(area.width()), rows.touched.data());
  if (first == last) return 0;
  const std::size_t from = first / kSensorLanes * kSensorLanes,
                    count = (last - from + kSensorLanes - 1) / kSensorLanes * kSensorLanes;
  Pixel* const pixels = row + area.x0 + first;
  const std::uint32_t* const touched = &rows.touched[first];
  decode_row(codec, roundings, pixels, last - first,
             {&rows.real[first], &rows.rounding[first], stride});
  for (std::size_t c = 0; c < 3; ++c) {
    const auto key = noise_key(effects.frame, y, static_cast<int>(c));
    add_with_noise({&rows.planes[c * stride + from],
                    &rows.planes[(3 + c) * stride + from],
                    &rows.real[c * stride + from],
                    &rows.rounding[c * stride + from],
                    {key[0], key[1]},
                    static_cast<std::uint32_t>(area.x0) + static_cast<std::uint32_t>(from)},
                   effects.shot_gain, effects.read_noise * effects.read_noise, count,
                   &rows.out[c * stride + from]);
  }
  encode_row(codec, {&rows.out[first], nullptr, stride}, touched, last - first, pixels);
  return last - first - static_cast<std::size_t>(std::count(touched, touched + (last - first), 0u));
}

// Without blur one pass; with it the planes of all rows come first.
template <class Pixel, class Codec>
std::size_t composite_rows(const Codec& codec, Image<Pixel>& frame, const Layered& in,
                           const SensorEffects& effects, SensorPlanes& planes) {
  using Code = decltype(Pixel::r);
  const auto roundings = roundings_of(codec, Code{});
  const bool blurs = effects.psf_sigma_px > 0;
  if (blurs) {
    planes.added.prepare(in.objects.rect, effects.psf_sigma_px, frame.width(), frame.height());
    planes.deficit.prepare(in.area, effects.psf_sigma_px, frame.width(), frame.height());
  }
  const Rect area = blurs ? planes.deficit.area() : in.area;
  // Room for load_row's excess, and for that of vectors which start at any pixel.
  const std::size_t stride = padded_row(area.width()) + 2 * kSensorLanes;
  const auto each_row = [&](const Rect& rect, const auto& work) {
    parallel_for(rect.y0, rect.y0 + rect.height(), 8, [&](const auto& range) {
      thread_local SensorBuffers rows;  // grow once per thread
      rows.resize(static_cast<std::size_t>(frame.width()), stride);
      for (int y = range.begin(); y < range.end(); ++y) work(y, rows);
    });
  };
  if (blurs)
    each_row(in.area, [&](int y, SensorBuffers& rows) {
      const Loaded loaded = load_planes(in, y, stride, rows);
      if (loaded.objects)
        planes.added.set_row(
            y, &rows.planes[static_cast<std::size_t>(in.objects.rect.x0 - in.area.x0)], stride);
      if (loaded.objects || loaded.shadows)
        planes.deficit.set_row(y, &rows.planes[3 * stride], stride);
    });
  std::atomic<std::size_t> touched = 0;
  each_row(area, [&](int y, SensorBuffers& rows) {
    Rect part = area;
    if (blurs) {
      if (!load_blurred(planes, y, stride, rows)) return;
    } else {
      const Layered row = in.row(y);
      part = row.area;
      if (const Loaded l = load_planes(row, y, stride, rows); !l.objects && !l.shadows) return;
    }
    touched += effects_row<Pixel, Codec, Code>(codec, roundings, effects, frame.row(y).data(), y,
                                               part, stride, rows);
  });
  return touched;
}

}  // namespace

std::size_t composite_effects(const View& view, FramePixels& frame, const Layered& in,
                              SensorPlanes& planes) {
  if (auto* f8 = std::get_if<Image<Rgb8>>(&frame))
    return composite_rows(CodedPixels<std::uint8_t>(view), *f8, in, view.effects, planes);
  if (auto* f16 = std::get_if<Image<Rgb16>>(&frame))
    return composite_rows(CodedPixels<std::uint16_t>(view), *f16, in, view.effects, planes);
  return composite_rows(Linear{}, std::get<Image<Rgb>>(frame), in, view.effects, planes);
}

}  // namespace penumbra::compositor
