#include "compositor/composite/compositor.h"

#include <fmt/format.h>

#include <cassert>

#include "compositor/layers/gl/gl.h"
#include "compositor/pixels/layered_rows.h"
#include "compositor/pixels/pixel_pass.h"
#include "compositor/pixels/sensor_effects.h"
#include "compositor/projection.h"
#include "core/threads/background_task.h"

namespace penumbra::compositor {

namespace {

bool valid(const SensorEffects& effects) {
  const auto within = [](float v, float largest) { return v >= 0 && v <= largest; };  // NaN is not
  return within(effects.psf_sigma_px, SensorEffects::kLargestPsfSigma) &&
         within(effects.shot_gain, 1e6f) && within(effects.read_noise, 1e6f);
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

CompositeStats touched(std::size_t pixels, const FramePixels& frame) {
  const auto all = std::visit([](const auto& f) { return f.area(); }, frame);
  return {pixels, static_cast<double>(pixels) / static_cast<double>(all)};
}

void begin_with(const FramePixels& camera, FramePixels& out) {
  if (&camera != &out) out = camera;
}

CompositeStats put(const View& view, const Layered& in, FramePixels& frame, SensorPlanes& planes) {
  if (!view.effects.none()) return touched(composite_effects(view, frame, in, planes), frame);
  return touched(composite_fraction(FrameRegion::kBeside, view, frame, in) +
                     composite_fraction(FrameRegion::kObjects, view, frame, in),
                 frame);
}

Layered layered(const Layer& objects, const Layer& hidden, const Receivers& receivers,
                const Rect& receiver_area, const View& view) {
  return {objects,         hidden,
          receivers,       united(united(objects.rect, receiver_area), hidden.rect),
          view.vignetting, view.foreground.get()};
}

}  // namespace

struct Drawn::Impl {
  View view;
  std::shared_ptr<Layer> objects, hidden;  // given back by draw()
  Receivers receivers{2};
  Rect receiver_area;
  SensorPlanes planes;
};

Drawn::Drawn() : impl_(std::make_unique<Impl>()) {}
Drawn::~Drawn() = default;
Drawn::Drawn(Drawn&&) noexcept = default;
Drawn& Drawn::operator=(Drawn&&) noexcept = default;

CompositeStats Drawn::composite_into(FramePixels& frame) {
  Impl& d = *impl_;
  return put(d.view, layered(*d.objects, *d.hidden, d.receivers, d.receiver_area, d.view), frame,
             d.planes);
}

struct Compositor::Impl {
  explicit Impl(int oversampling) : receivers(oversampling) {}
  Result<void> check(const View& view, const FramePixels& frame) const;
  void mirror_floor();
  Result<Rect> draw(const View& view);
  Result<CompositeStats> composite_while_drawing(const View& view, const FramePixels& camera,
                                                 FramePixels& out);

  int width = 0, height = 0;
  std::unique_ptr<GlContext> context;  // destroyed last: the names below live in it
  std::unique_ptr<Layers> layers;
  std::unique_ptr<GlProgram> show;
  std::unique_ptr<GlTexture> picture;
  Receivers receivers;
  std::vector<int> receiver_of;          // by object, -1 without
  int mirrored_changes = -1;             // of the receivers, that mirrors show
  std::vector<Image<Rgb>> floor_ratios;  // by object, as mirrored; empty where none is
  CommonLayer objects, hidden;
  SensorPlanes planes;
};

Compositor::Compositor(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Compositor::~Compositor() {
  if (impl_ && impl_->context) impl_->context->make_current();
}

Result<std::unique_ptr<Compositor>> Compositor::create(int width, int height, Surface surface,
                                                       int oversampling, const std::string& title) {
  if (width < 1 || height < 1)
    return fail(ErrorCode::kInvalid, "compositor", "has an empty frame size");
  if (oversampling != 2 && oversampling != 4)
    return fail(ErrorCode::kInvalid, "compositor", "has an oversampling that is neither 2 nor 4");
  PENUMBRA_ASSIGN(context, surface == Surface::kWindow ? make_window_context(width, height, title)
                                                       : make_offscreen_context());
  auto impl = std::make_unique<Impl>(oversampling);
  impl->width = width;
  impl->height = height;
  impl->context = std::move(context);
  PENUMBRA_ASSIGN(layers, Layers::create(width, height, oversampling));
  impl->layers = std::make_unique<Layers>(std::move(layers));
  if (impl->context->has_window()) {
    PENUMBRA_ASSIGN(show, make_program(kShowVertex, kShowFragment));
    impl->show = std::make_unique<GlProgram>(std::move(show));
    impl->picture = std::make_unique<GlTexture>();
    glBindTexture(GL_TEXTURE_2D, impl->picture->get());
    glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGB8, width, height);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  }
  return std::unique_ptr<Compositor>(new Compositor(std::move(impl)));
}

void Compositor::use_lens(const ViewLens& lens) {
  impl_->layers->use_lens(lens);
}

int Compositor::add_object(const prt::BakedObject& object, const Appearance& appearance) {
  impl_->context->make_current();
  impl_->floor_ratios.emplace_back();
  impl_->receiver_of.push_back(object.receiver ? impl_->receivers.add(object.receiver->grid) : -1);
  return impl_->layers->add_object(object, appearance);
}

void Compositor::update_vertices(int object, const prt::Mesh& mesh) {
  impl_->context->make_current();
  impl_->layers->update_vertices(object, mesh);
}

void Compositor::set_pose(int object, const Pose& world_from_bake, const Pose& world_from_floor) {
  impl_->layers->set_pose(object, world_from_bake, world_from_floor);
  if (const int r = impl_->receiver_of[static_cast<std::size_t>(object)]; r >= 0)
    impl_->receivers.set_pose(r, world_from_floor);
}

void Compositor::show(int object, bool visible) {
  impl_->layers->show(object, visible);
  if (const int r = impl_->receiver_of[static_cast<std::size_t>(object)]; r >= 0)
    impl_->receivers.show(r, visible);
}

void Compositor::set_light(int object, std::span<const float> relit,
                           const shadows::PlanarShadow& shadow, const Rgb& of_open,
                           const EdgedLight* edged) {
  impl_->context->make_current();
  impl_->layers->set_light(object, relit, edged);
  if (const int r = impl_->receiver_of[static_cast<std::size_t>(object)]; r >= 0)
    impl_->receivers.set_shadow(r, shadow, of_open);
}

void Compositor::set_surroundings(const Surroundings& surroundings) {
  impl_->context->make_current();
  impl_->layers->set_surroundings(surroundings);
}

void Compositor::set_light_fractions(int object, std::span<const std::array<float, 4>> fractions) {
  impl_->context->make_current();
  impl_->layers->set_light_fractions(object, fractions);
}

void Compositor::set_mirrored(int object, const MirroredPicture& picture) {
  impl_->context->make_current();
  impl_->layers->set_mirrored(object, picture);
}

const Image<Rgb>* Compositor::mirrored_floor(int object) {
  impl_->context->make_current();
  impl_->mirror_floor();
  const Image<Rgb>& ratios = impl_->floor_ratios[static_cast<std::size_t>(object)];
  return ratios.empty() ? nullptr : &ratios;
}

void Compositor::add_real_receiver(const prt::GroundGrid& grid, const Pose& world_from_grid) {
  impl_->receivers.add_real(grid, world_from_grid);
}

void Compositor::set_real_shadow(const shadows::PlanarShadow& shadow) {
  impl_->receivers.set_real_shadow(shadow);
}

void Compositor::set_shadow_maps(std::span<const ShadowMapOnPlane> lights) {
  impl_->receivers.set_shadow_maps(lights);
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

void Compositor::set_weights(int occluder, std::span<const Rgb> weights) {
  impl_->context->make_current();
  impl_->layers->set_weights(occluder, weights);
}

Result<void> Compositor::Impl::check(const View& view, const FramePixels& frame) const {
  const auto [w, h] =
      std::visit([](const auto& f) { return std::pair(f.width(), f.height()); }, frame);
  if (w != width || h != height)
    return fail(ErrorCode::kInvalid, "frame",
                fmt::format("has {}x{} pixels instead of {}x{}", w, h, width, height));
  if (view.camera.width != w || view.camera.height != h)
    return fail(ErrorCode::kInvalid, "view",
                fmt::format("has a camera of {}x{} pixels for a frame of {}x{}", view.camera.width,
                            view.camera.height, w, h));
  const unsigned needed = std::holds_alternative<Image<Rgb8>>(frame)    ? 255u
                          : std::holds_alternative<Image<Rgb16>>(frame) ? 65535u
                                                                        : 0u;
  if (needed && (view.curve == nullptr || view.curve->largest_code() != needed))
    return fail(ErrorCode::kInvalid, "frame", "has no response curve of its bit depth");
  if (!valid(view.effects))
    return fail(
        ErrorCode::kInvalid, "sensor effects",
        "have a blur that is not within 0..20 px, or a noise that is negative or too large");
  return {};
}

// What stands on the floor sees its own shadow there.
void Compositor::Impl::mirror_floor() {
  if (receivers.changes() == mirrored_changes) return;
  mirrored_changes = receivers.changes();
  for (std::size_t i = 0; i < receiver_of.size(); ++i) {
    const int object = static_cast<int>(i);
    if (receiver_of[i] >= 0 && layers->mirrors(object) && receivers.is_shown(receiver_of[i]))
      layers->set_floor(object,
                        floor_ratios[i] = receivers.ratios_on(receiver_of[i], kMirroredFloor));
  }
}

// The pixels that shadows can reach.
Result<Rect> Compositor::Impl::draw(const View& view) {
  context->make_current();
  mirror_floor();
  const Rect receiver_area = receivers.prepare(view);
  PENUMBRA_TRY(layers->draw(view, receiver_area, objects, hidden));
  return receiver_area;
}

// Without a GPU drawing begins on one core alone: another one copies the frame and composites what
// no layer reaches.
Result<CompositeStats> Compositor::Impl::composite_while_drawing(const View& view,
                                                                 const FramePixels& camera,
                                                                 FramePixels& out) {
  context->make_current();
  mirror_floor();
  const Rect area = receivers.prepare(view);
  const Layer room{layers->reach_of_objects(ViewProjection(view.camera, view.lens.get())), {}},
      nothing;
  std::size_t beside = 0;
  BackgroundTask aside;
  aside.run([&] {
    begin_with(camera, out);
    beside = composite_fraction(FrameRegion::kBeside, view, out,
                                layered(room, nothing, receivers, area, view));
  });
  const Result<void> drawn = layers->draw(view, area, objects, hidden);
  aside.wait();
  PENUMBRA_TRY(drawn);
  assert(objects.now->rect == room.rect);
  return touched(beside + composite_fraction(FrameRegion::kObjects, view, out,
                                             layered(*objects.now, nothing, receivers, area, view)),
                 out);
}

Result<CompositeStats> Compositor::composite(const View& view, const FramePixels& camera,
                                             FramePixels& out) {
  Impl& i = *impl_;
  PENUMBRA_TRY(i.check(view, camera));
  if (view.effects.none() && !i.layers->has_occluders())
    return i.composite_while_drawing(view, camera, out);
  PENUMBRA_ASSIGN(area, i.draw(view));
  begin_with(camera, out);
  return put(view, layered(*i.objects.now, *i.hidden.now, i.receivers, area, view), out, i.planes);
}

Result<void> Compositor::draw(const View& view, const FramePixels& frame, Drawn& out) {
  PENUMBRA_TRY(impl_->check(view, frame));
  Drawn::Impl& d = *out.impl_;
  impl_->objects.spare = std::move(d.objects);
  impl_->hidden.spare = std::move(d.hidden);
  PENUMBRA_ASSIGN(area, impl_->draw(view));
  d.view = view;
  d.objects = impl_->objects.now;
  d.hidden = impl_->hidden.now;
  d.receivers = impl_->receivers;
  d.receivers.prepare(view);  // its lookups point into itself
  d.receiver_area = area;
  return {};
}

void Compositor::release() {
  impl_->context->release();
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

Pointer Compositor::pointer() const {
  return impl_->context->pointer();
}

std::string Compositor::renderer() const {
  impl_->context->make_current();
  const auto* name = reinterpret_cast<const char*>(glGetString(GL_RENDERER));
  return name ? name : "unknown";
}

}  // namespace penumbra::compositor
