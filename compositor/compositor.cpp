#include "compositor/compositor.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>

#include "compositor/camera_look.h"
#include "compositor/code_row.h"
#include "compositor/gl.h"
#include "compositor/gpu_relight.h"
#include "compositor/layered_rows.h"
#include "core/parallel.h"

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
std::size_t composite_part(const Coded<std::uint8_t>& codec, const float* object, const float* r,
                           const float* g, const float* b, Rgb8* pixels, std::size_t count) {
  return composite_codes(codec.curve, object, r, g, b, pixels, count);
}

// One row of the touched rectangle, the part with objects in the middle by itself.
template <class Pixel, class Codec>
std::size_t composite_row(const Codec& codec, Pixel* row, int y, const Layered& in,
                          RowBuffers& rows) {
  const bool has_objects = has_row(in.objects, y), has_shadows = load_shadows(in, y, rows);
  if (!has_objects && !has_shadows) return 0;
  if (has_objects) load_objects(in, y, rows.object);
  const auto part = [&](int x0, int x1, const float* object) -> std::size_t {
    if (x0 >= x1) return 0;
    const auto i = static_cast<std::size_t>(x0 - in.area.x0);
    return composite_part(codec, object, &rows.r[i], &rows.g[i], &rows.b[i], row + x0,
                          static_cast<std::size_t>(x1 - x0));
  };
  if (!has_objects) return part(in.area.x0, in.area.x1, nullptr);
  return part(in.area.x0, in.objects.rect.x0, nullptr) +
         part(in.objects.rect.x0, in.objects.rect.x1, rows.object.data()) +
         part(in.objects.rect.x1, in.area.x1, nullptr);
}

template <class Pixel, class Codec>
std::size_t composite_pixels(const Codec& codec, Image<Pixel>& frame, const Layered& in) {
  std::atomic<std::size_t> touched = 0;
  parallel_for(in.area.y0, in.area.y0 + in.area.height(), 8, [&](const auto& range) {
    thread_local RowBuffers rows;  // grow once per thread
    rows.resize(static_cast<std::size_t>(frame.width()));
    std::size_t count = 0;
    for (int y = range.begin(); y < range.end(); ++y)
      count += composite_row(codec, frame.row(y).data(), y, in.row(y), rows);
    touched += count;
  });
  return touched;
}

bool valid(const CameraLook& look) {
  const auto within = [](float v, float most) { return v >= 0 && v <= most; };  // NaN is not
  return within(look.psf_sigma_px, CameraLook::kLargestPsfSigma) && within(look.shot_gain, 1e6f) &&
         within(look.read_noise, 1e6f);
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

Touched put(const View& view, const Layered& in, FramePixels& frame, LookPlanes& look) {
  Touched out;
  if (!view.look.none())
    out.pixels = composite_look(view, frame, in, look);
  else if (auto* f8 = std::get_if<Image<Rgb8>>(&frame))
    out.pixels = composite_pixels(Coded<std::uint8_t>{*view.curve}, *f8, in);
  else if (auto* f16 = std::get_if<Image<Rgb16>>(&frame))
    out.pixels = composite_pixels(Coded<std::uint16_t>{*view.curve}, *f16, in);
  else
    out.pixels = composite_pixels(Linear{}, std::get<Image<Rgb>>(frame), in);
  const auto all = std::visit([](const auto& f) { return f.area(); }, frame);
  out.fraction = static_cast<double>(out.pixels) / static_cast<double>(all);
  return out;
}

Layered layered(const Layer& objects, const Layer& hidden, const Receivers& receivers,
                const Rect& receiver_area, const View& view) {
  return {objects, hidden, receivers, united(united(objects.rect, receiver_area), hidden.rect),
          view.vignetting};
}

}  // namespace

struct Drawn::Impl {
  View view;
  std::shared_ptr<Layer> objects, hidden;  // given back by draw()
  Receivers receivers{2};
  Rect receiver_area;
  LookPlanes look;
};

Drawn::Drawn() : impl_(std::make_unique<Impl>()) {}
Drawn::~Drawn() = default;
Drawn::Drawn(Drawn&&) noexcept = default;
Drawn& Drawn::operator=(Drawn&&) noexcept = default;

Touched Drawn::put_into(FramePixels& frame) {
  Impl& d = *impl_;
  return put(d.view, layered(*d.objects, *d.hidden, d.receivers, d.receiver_area, d.view), frame,
             d.look);
}

struct Compositor::Impl {
  explicit Impl(int oversampling) : receivers(oversampling) {}
  Result<Rect> draw(const View& view, const FramePixels& frame);

  int width = 0, height = 0;
  std::unique_ptr<GlContext> context;  // destroyed last: the names below live in it
  std::unique_ptr<Layers> layers;
  std::unique_ptr<GlProgram> show;
  std::unique_ptr<GlTexture> picture;
  std::vector<std::optional<GpuRelight>> clips;  // empty where removed
  Receivers receivers;
  std::vector<int> receiver_of;  // by object, -1 without
  SharedLayer objects, hidden;
  LookPlanes look;
};

Compositor::Compositor(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Compositor::~Compositor() {
  if (impl_ && impl_->context) impl_->context->make_current();
}

Result<std::unique_ptr<Compositor>> Compositor::create(int width, int height, Surface surface,
                                                       int oversampling, const std::string& title) {
  if (width < 1 || height < 1) return fail(ErrorCode::kInvalid, "compositor", "empty frame size");
  if (oversampling != 2 && oversampling != 4)
    return fail(ErrorCode::kInvalid, "compositor", "oversampling is 2 or 4");
  auto context = surface == Surface::kWindow ? make_window_context(width, height, title)
                                             : make_offscreen_context();
  if (!context) return std::unexpected(context.error());
  auto impl = std::make_unique<Impl>(oversampling);
  impl->width = width;
  impl->height = height;
  impl->context = std::move(*context);
  auto layers = Layers::create(width, height, oversampling);
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

int Compositor::add_object(const prt::BakedObject& object, const Appearance& appearance) {
  impl_->context->make_current();
  impl_->receiver_of.push_back(object.receiver ? impl_->receivers.add(object.receiver->grid) : -1);
  return impl_->layers->add_object(object, appearance);
}

void Compositor::set_form(int object, const prt::Mesh& mesh) {
  impl_->context->make_current();
  impl_->layers->set_form(object, mesh);
}

void Compositor::set_pose(int object, const Pose& world_from_bake) {
  impl_->layers->set_pose(object, world_from_bake);
  if (const int r = impl_->receiver_of[static_cast<std::size_t>(object)]; r >= 0)
    impl_->receivers.set_pose(r, world_from_bake);
}

void Compositor::set_light(int object, std::span<const float> relit,
                           const shadows::PlanarShadow& shadow) {
  impl_->context->make_current();
  impl_->layers->set_light(object, relit);
  if (const int r = impl_->receiver_of[static_cast<std::size_t>(object)]; r >= 0)
    impl_->receivers.set_shadow(r, shadow);
}

Result<int> Compositor::add_clip(const prt::TransferSequence& sequence) {
  impl_->context->make_current();
  auto clip = GpuRelight::create(sequence);
  if (!clip) return std::unexpected(clip.error());
  impl_->clips.push_back(std::move(*clip));
  return static_cast<int>(impl_->clips.size()) - 1;
}

Result<void> Compositor::relight(int clip, double frame, const RadianceSh& light,
                                 std::span<const glm::mat3> turns, std::span<float> out) {
  impl_->context->make_current();
  return impl_->clips[static_cast<std::size_t>(clip)]->relight(frame, light, turns, out);
}

void Compositor::remove_clip(int clip) {
  impl_->context->make_current();
  impl_->clips[static_cast<std::size_t>(clip)].reset();
}

void Compositor::add_real_receiver(const prt::GroundGrid& grid, const Pose& world_from_grid) {
  impl_->receivers.add_real(grid, world_from_grid);
}

void Compositor::set_real_shadow(const shadows::PlanarShadow& shadow) {
  impl_->receivers.set_real_shadow(shadow);
}

void Compositor::set_disc_shadows(std::span<const DiscShadowOnPlane> discs) {
  impl_->receivers.set_disc_shadows(discs);
}

void Compositor::add_plane(const glm::dvec3& point, const glm::dvec3& normal) {
  impl_->context->make_current();
  impl_->layers->add_plane(point, normal);
  impl_->receivers.add_plane(point, normal);
}

int Compositor::add_occluder(const prt::Mesh& mesh) {
  impl_->context->make_current();
  return impl_->layers->add_occluder(mesh);
}

void Compositor::set_ratios(int occluder, std::span<const Rgb> ratios) {
  impl_->context->make_current();
  impl_->layers->set_ratios(occluder, ratios);
}

// The pixels that shadows can reach.
Result<Rect> Compositor::Impl::draw(const View& view, const FramePixels& frame) {
  context->make_current();
  const auto [w, h] =
      std::visit([](const auto& f) { return std::pair(f.width(), f.height()); }, frame);
  if (w != width || h != height)
    return fail(ErrorCode::kInvalid, "frame",
                fmt::format("{}x{} pixels, expected {}x{}", w, h, width, height));
  const unsigned needed = std::holds_alternative<Image<Rgb8>>(frame)    ? 255u
                          : std::holds_alternative<Image<Rgb16>>(frame) ? 65535u
                                                                        : 0u;
  if (needed && (view.curve == nullptr || view.curve->largest_code() != needed))
    return fail(ErrorCode::kInvalid, "frame", "no response curve of its bit depth");
  if (!valid(view.look))
    return fail(ErrorCode::kInvalid, "camera look", "blur or noise is negative or too large");
  const Rect receiver_area = receivers.prepare(view.camera);
  PENUMBRA_TRY(layers->draw(view, receiver_area, objects, hidden));
  return receiver_area;
}

Result<Touched> Compositor::composite(const View& view, FramePixels& frame) {
  PENUMBRA_ASSIGN(area, impl_->draw(view, frame));
  return put(view, layered(*impl_->objects.now, *impl_->hidden.now, impl_->receivers, area, view),
             frame, impl_->look);
}

Result<void> Compositor::draw(const View& view, const FramePixels& frame, Drawn& out) {
  Drawn::Impl& d = *out.impl_;
  impl_->objects.spare = std::move(d.objects);
  impl_->hidden.spare = std::move(d.hidden);
  PENUMBRA_ASSIGN(area, impl_->draw(view, frame));
  d.view = view;
  d.objects = impl_->objects.now;
  d.hidden = impl_->hidden.now;
  d.receivers = impl_->receivers;
  d.receivers.prepare(view.camera);  // its lookups point into itself
  d.receiver_area = area;
  return {};
}

bool Compositor::has_window() const {
  return impl_->context->has_window();
}

bool Compositor::present(const Image<Rgb8>& picture) {
  if (!impl_->context->has_window()) return true;
  impl_->context->make_current();
  const auto [width, height] = impl_->context->size();
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
  glDisable(GL_SCISSOR_TEST);
  glDisable(GL_DEPTH_TEST);
  glViewport(0, 0, width, height);
  glBindTexture(GL_TEXTURE_2D, impl_->picture->get());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, picture.width(), picture.height(), GL_RGB,
                  GL_UNSIGNED_BYTE, picture.pixels().data());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 4);
  glUseProgram(impl_->show->get());
  glDrawArrays(GL_TRIANGLES, 0, 3);
  return impl_->context->show();
}

std::string Compositor::renderer() const {
  impl_->context->make_current();
  const auto* name = reinterpret_cast<const char*>(glGetString(GL_RENDERER));
  return name ? name : "unknown";
}

}  // namespace penumbra::compositor
