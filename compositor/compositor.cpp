#include "compositor/compositor.h"

#include <fmt/format.h>
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>

#include "compositor/gl.h"
#include "compositor/half_rows.h"
#include "compositor/layers.h"

namespace penumbra::compositor {

namespace {

// Access to one kind of pixel: linear signal in, linear signal out.
template <class Code>
struct Coded {
  const CodeCurve& curve;
  template <class Pixel>
  static constexpr bool matches = sizeof(Pixel) == 3 * sizeof(Code);
  float decode(int c, Code code) const { return curve.decode(c, code); }
  Code encode(int c, float v) const { return static_cast<Code>(curve.encode(c, v)); }
};
struct Linear {
  static float decode(int, float v) { return v; }
  static float encode(int, float v) { return v; }
};

// The fused pass over one row of the touched rectangle.
template <class Pixel, class Codec>
std::size_t composite_row(const Codec& codec, Pixel* row, int y, const Rect& area, const Layer& objects,
                          const Layer& shadows, std::span<float> object_row, std::span<float> shadow_row) {
  const bool has_objects = y >= objects.rect.y0 && y < objects.rect.y1;
  const bool has_shadows = y >= shadows.rect.y0 && y < shadows.rect.y1;
  if (has_objects) floats_from_halves(objects.row(y), object_row.first(objects.row(y).size()));
  if (has_shadows) floats_from_halves(shadows.row(y), shadow_row.first(shadows.row(y).size()));
  constexpr float kNoObject[4] = {0, 0, 0, 0}, kNoShadow[4] = {1, 1, 1, 1};
  std::size_t touched = 0;
  for (int x = area.x0; x < area.x1; ++x) {
    const float* v = kNoObject;
    const float* s = kNoShadow;
    if (has_objects && x >= objects.rect.x0 && x < objects.rect.x1)
      v = &object_row[static_cast<std::size_t>(x - objects.rect.x0) * 4];
    if (has_shadows && x >= shadows.rect.x0 && x < shadows.rect.x1)
      s = &shadow_row[static_cast<std::size_t>(x - shadows.rect.x0) * 4];
    if (v[3] == 0 && s[0] == 1 && s[1] == 1 && s[2] == 1) continue;
    ++touched;
    const float behind = 1 - v[3];
    Pixel& p = row[x];
    p.r = codec.encode(0, v[0] + behind * s[0] * codec.decode(0, p.r));
    p.g = codec.encode(1, v[1] + behind * s[1] * codec.decode(1, p.g));
    p.b = codec.encode(2, v[2] + behind * s[2] * codec.decode(2, p.b));
  }
  return touched;
}

template <class Pixel, class Codec>
std::size_t composite_pixels(const Codec& codec, Image<Pixel>& frame, const Layer& objects,
                             const Layer& shadows) {
  const Rect area = united(objects.rect, shadows.rect);
  std::atomic<std::size_t> touched = 0;
  tbb::parallel_for(tbb::blocked_range<int>(area.y0, area.y0 + area.height(), 16), [&](const auto& rows) {
    thread_local std::vector<float> object_row, shadow_row;  // grow once per thread
    object_row.resize(static_cast<std::size_t>(frame.width()) * 4);
    shadow_row.resize(static_cast<std::size_t>(frame.width()) * 4);
    std::size_t count = 0;
    for (int y = rows.begin(); y < rows.end(); ++y)
      count += composite_row(codec, frame.row(y).data(), y, area, objects, shadows, object_row, shadow_row);
    touched += count;
  });
  return touched;
}

constexpr const char* kShowVertex = R"(#version 310 es
out vec2 uv;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;
  uv = vec2(corner.x, 1.0 - corner.y);
  gl_Position = vec4(corner * 2.0 - 1.0, 0, 1);
})";
constexpr const char* kShowFragment = R"(#version 310 es
precision mediump float;
in vec2 uv;
uniform sampler2D picture;
out vec4 colour;
void main() { colour = vec4(texture(picture, uv).rgb, 1); }
)";

}  // namespace

struct Compositor::Impl {
  int width = 0, height = 0;
  std::unique_ptr<GlContext> context;  // destroyed last: the names below live in it
  std::unique_ptr<Layers> layers;
  std::unique_ptr<GlProgram> show;
  std::unique_ptr<GlTexture> picture;
  Layer objects, shadows;
};

Compositor::Compositor(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Compositor::~Compositor() {
  if (impl_ && impl_->context) impl_->context->make_current();
}

Result<std::unique_ptr<Compositor>> Compositor::create(int width, int height, Surface surface,
                                                       const std::string& title) {
  if (width < 1 || height < 1) return fail(ErrorCode::kInvalid, "compositor", "empty frame size");
  auto context = surface == Surface::kWindow ? make_window_context(width, height, title)
                                             : make_offscreen_context();
  if (!context) return std::unexpected(context.error());
  auto impl = std::make_unique<Impl>();
  impl->width = width;
  impl->height = height;
  impl->context = std::move(*context);
  auto layers = Layers::create(width, height);
  if (!layers) return std::unexpected(layers.error());
  impl->layers = std::make_unique<Layers>(std::move(*layers));
  if (impl->context->has_window()) {
    auto show = make_program(kShowVertex, kShowFragment);
    if (!show) return std::unexpected(show.error());
    impl->show = std::make_unique<GlProgram>(std::move(*show));
    impl->picture = std::make_unique<GlTexture>();
    glBindTexture(GL_TEXTURE_2D, impl->picture->get());
    glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGB8, width, height);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  }
  return std::unique_ptr<Compositor>(new Compositor(std::move(impl)));
}

int Compositor::add_object(const prt::BakedObject& object) { return impl_->layers->add_object(object); }
void Compositor::set_pose(int object, const Pose& pose) { impl_->layers->set_pose(object, pose); }
void Compositor::set_light(int object, std::span<const float> relit, const shadows::PlanarShadow& shadow) {
  impl_->layers->set_light(object, relit, shadow);
}
void Compositor::add_occluder(const prt::Mesh& mesh) { impl_->layers->add_occluder(mesh); }

Result<Touched> Compositor::composite(const View& view, FramePixels& frame) {
  const auto [width, height] =
      std::visit([](const auto& f) { return std::pair(f.width(), f.height()); }, frame);
  if (width != impl_->width || height != impl_->height)
    return fail(ErrorCode::kInvalid, "frame",
                fmt::format("{}x{} pixels, expected {}x{}", width, height, impl_->width, impl_->height));
  const unsigned needed = std::holds_alternative<Image<Rgb8>>(frame)    ? 255u
                          : std::holds_alternative<Image<Rgb16>>(frame) ? 65535u : 0u;
  if (needed && (view.curve == nullptr || view.curve->largest_code() != needed))
    return fail(ErrorCode::kInvalid, "frame", "no response curve of its bit depth");
  PENUMBRA_TRY(impl_->layers->draw(view, impl_->objects, impl_->shadows));
  Touched touched;
  if (auto* f8 = std::get_if<Image<Rgb8>>(&frame))
    touched.pixels = composite_pixels(Coded<std::uint8_t>{*view.curve}, *f8, impl_->objects, impl_->shadows);
  else if (auto* f16 = std::get_if<Image<Rgb16>>(&frame))
    touched.pixels = composite_pixels(Coded<std::uint16_t>{*view.curve}, *f16, impl_->objects, impl_->shadows);
  else
    touched.pixels = composite_pixels(Linear{}, std::get<Image<Rgb>>(frame), impl_->objects, impl_->shadows);
  touched.fraction = static_cast<double>(touched.pixels) / (static_cast<double>(width) * height);
  return touched;
}

bool Compositor::present(const Image<Rgb8>& picture) {
  if (!impl_->context->has_window()) return true;
  const auto [width, height] = impl_->context->size();
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
  glDisable(GL_SCISSOR_TEST);
  glDisable(GL_DEPTH_TEST);
  glViewport(0, 0, width, height);
  glBindTexture(GL_TEXTURE_2D, impl_->picture->get());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, picture.width(), picture.height(), GL_RGB, GL_UNSIGNED_BYTE,
                  picture.pixels().data());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 4);
  glUseProgram(impl_->show->get());
  glDrawArrays(GL_TRIANGLES, 0, 3);
  return impl_->context->show();
}

std::string Compositor::renderer() const {
  const auto* name = reinterpret_cast<const char*>(glGetString(GL_RENDERER));
  return name ? name : "unknown";
}

}  // namespace penumbra::compositor
