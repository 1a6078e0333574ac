#include "compositor/layers.h"

#include <fmt/format.h>

#include <algorithm>
#include <glm/gtc/type_ptr.hpp>

namespace penumbra::compositor {

namespace {

constexpr const char* kObjectVertex = R"(#version 310 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 albedo;
layout(location = 2) in float light_r;
layout(location = 3) in float light_g;
layout(location = 4) in float light_b;
uniform mat4 clip_from_object;
uniform float signal_per_radiance;
out vec3 signal;
void main() {
  signal = signal_per_radiance * albedo * max(vec3(light_r, light_g, light_b), 0.0);
  gl_Position = clip_from_object * vec4(position, 1);
})";

// Back faces are black, as in the bake and in the reference.
constexpr const char* kObjectFragment = R"(#version 310 es
precision highp float;
in vec3 signal;
out vec4 colour;
void main() { colour = vec4(gl_FrontFacing ? min(signal, 1000.0) : vec3(0), 1); }
)";

constexpr const char* kOccluderVertex = R"(#version 310 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 deficit;
uniform mat4 clip_from_object;
out vec3 taken;
void main() {
  taken = deficit;
  gl_Position = clip_from_object * vec4(position, 1);
})";
constexpr const char* kOccluderFragment = R"(#version 310 es
precision highp float;
in vec3 taken;
out vec4 colour;
void main() { colour = vec4(taken, 1); }
)";

void set_matrix(GLuint program, const glm::dmat4& m) {
  const glm::mat4 single(m);
  glUniformMatrix4fv(glGetUniformLocation(program, "clip_from_object"), 1, GL_FALSE,
                     glm::value_ptr(single));
}

void attribute(GLuint location, int components, std::size_t offset_bytes) {
  glEnableVertexAttribArray(location);
  glVertexAttribPointer(location, components, GL_FLOAT, GL_FALSE, 0,
                        reinterpret_cast<const void*>(offset_bytes));
}

GLsizeiptr bytes_of(const auto& v) {
  return static_cast<GLsizeiptr>(v.size() * sizeof(v[0]));
}

}  // namespace

Result<Layers> Layers::create(int width, int height, int oversampling) {
  auto object = make_program(kObjectVertex, kObjectFragment);
  if (!object) return std::unexpected(object.error());
  auto occluder = make_program(kOccluderVertex, kOccluderFragment);
  if (!occluder) return std::unexpected(occluder.error());
  Layers layers(width, height, oversampling, std::move(*object), std::move(*occluder));
  PENUMBRA_TRY(layers.make_targets());
  return layers;
}

// Drawn larger and averaged: without a GPU that takes less time than multisampling.
Result<void> Layers::make_targets() {
  for (int scale = oversampling_; scale >= 1; scale /= 2) {
    Target t;
    t.scale = scale;
    glBindFramebuffer(GL_FRAMEBUFFER, t.framebuffer.get());
    glBindTexture(GL_TEXTURE_2D, t.colour.get());
    glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGBA16F, scale * width_, scale * height_);
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, t.colour.get(), 0);
    if (scale == oversampling_) {
      glBindRenderbuffer(GL_RENDERBUFFER, fine_depth_.get());
      glRenderbufferStorage(GL_RENDERBUFFER, GL_DEPTH_COMPONENT24, scale * width_, scale * height_);
      glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_RENDERBUFFER,
                                fine_depth_.get());
    }
    if (glCheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE)
      return fail(ErrorCode::kUnavailable, "GL", "cannot draw to half-float pictures of this size");
    targets_.push_back(std::move(t));
  }
  return {};
}

int Layers::add_object(const prt::BakedObject& baked) {
  Object o;
  const prt::Mesh& mesh = baked.mesh;
  o.bounds = bounds_of(mesh);
  o.stride = baked.transfer.stride;
  o.index_count = static_cast<GLsizei>(mesh.triangles.size() * 3);
  glBindVertexArray(o.geometry.get());
  glBindBuffer(GL_ARRAY_BUFFER, o.vertices.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(mesh.positions) + bytes_of(mesh.albedo), nullptr,
               GL_STATIC_DRAW);
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(mesh.positions), mesh.positions.data());
  glBufferSubData(GL_ARRAY_BUFFER, bytes_of(mesh.positions), bytes_of(mesh.albedo),
                  mesh.albedo.data());
  attribute(0, 3, 0);
  attribute(1, 3, mesh.positions.size() * sizeof(glm::vec3));
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  const std::vector<float> dark(3 * o.stride, 0.f);
  glBufferData(GL_ARRAY_BUFFER, bytes_of(dark), dark.data(), GL_DYNAMIC_DRAW);
  for (GLuint c = 0; c < 3; ++c) attribute(2 + c, 1, c * o.stride * sizeof(float));
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, o.indices.get());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, bytes_of(mesh.triangles), mesh.triangles.data(),
               GL_STATIC_DRAW);
  glBindVertexArray(0);
  objects_.push_back(std::move(o));
  drawn_.reset();
  return static_cast<int>(objects_.size()) - 1;
}

void Layers::set_pose(int object, const Pose& world_from_bake) {
  Pose& pose = objects_[static_cast<std::size_t>(object)].world_from_bake;
  if (pose == world_from_bake) return;
  pose = world_from_bake;
  drawn_.reset();
}

void Layers::set_light(int object, std::span<const float> relit) {
  const Object& o = objects_[static_cast<std::size_t>(object)];
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, static_cast<GLsizeiptr>(3 * o.stride * sizeof(float)),
                  relit.data());
  drawn_.reset();
}

Layers::Occluder Layers::upload(const prt::Mesh& mesh) {
  Occluder o;
  o.index_count = static_cast<GLsizei>(mesh.triangles.size() * 3);
  glBindVertexArray(o.geometry.get());
  glBindBuffer(GL_ARRAY_BUFFER, o.vertices.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(mesh.positions), mesh.positions.data(), GL_STATIC_DRAW);
  attribute(0, 3, 0);
  // Nothing taken until set_ratios says otherwise; zeros stay zeros under interpolation.
  const std::vector<float> zeros(3 * mesh.positions.size(), 0.f);
  glBindBuffer(GL_ARRAY_BUFFER, o.deficits.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(zeros), zeros.data(), GL_DYNAMIC_DRAW);
  attribute(1, 3, 0);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, o.indices.get());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, bytes_of(mesh.triangles), mesh.triangles.data(),
               GL_STATIC_DRAW);
  glBindVertexArray(0);
  return o;
}

int Layers::add_occluder(const prt::Mesh& mesh) {
  occluders_.push_back(upload(mesh));
  occluder_meshes_.push_back({mesh.positions, mesh.triangles, {}});
  drawn_.reset();
  return static_cast<int>(occluders_.size()) - 1;
}

void Layers::set_ratios(int occluder, std::span<const Rgb> ratios) {
  const auto index = static_cast<std::size_t>(occluder);
  std::vector<Rgb> deficits;
  for (const Rgb& s : ratios) deficits.push_back({1 - s.r, 1 - s.g, 1 - s.b});
  glBindBuffer(GL_ARRAY_BUFFER, occluders_[index].deficits.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(deficits), deficits.data());
  OccluderMesh& mesh = occluder_meshes_[index];
  const Rgb open{1, 1, 1};
  std::optional<prt::Bounds> shaded;
  for (const auto& t : mesh.triangles) {
    if (ratios[t[0]] == open && ratios[t[1]] == open && ratios[t[2]] == open) continue;
    for (const std::uint32_t v : t) {
      const glm::vec3& p = mesh.positions[v];
      shaded = shaded ? prt::Bounds{glm::min(shaded->low, p), glm::max(shaded->high, p)}
                      : prt::Bounds{p, p};
    }
  }
  mesh.shaded = shaded;
  drawn_.reset();
}

void Layers::add_plane(const glm::dvec3& point, const glm::dvec3& normal) {
  constexpr double kHalfSide = 300;  // metres; beyond, nothing of an object could be told apart
  const glm::dvec3 u = glm::normalize(
      glm::cross(normal, std::abs(normal.y) < .9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0)));
  const glm::dvec3 v = glm::cross(normal, u);
  prt::Mesh quad;
  for (const auto& [a, b] : {std::pair{-1., -1.}, {1., -1.}, {1., 1.}, {-1., 1.}})
    quad.positions.emplace_back(point + kHalfSide * (a * u + b * v));
  quad.triangles = {{0, 1, 2}, {0, 2, 3}};
  planes_.push_back(upload(quad));
  drawn_.reset();
}

// The viewport is moved so that the rectangle lies in the framebuffer's corner.
void Layers::begin(const Rect& rect) {
  glBindFramebuffer(GL_FRAMEBUFFER, targets_.front().framebuffer.get());
  glViewport(-oversampling_ * rect.x0, -oversampling_ * rect.y0, oversampling_ * width_,
             oversampling_ * height_);
  glEnable(GL_SCISSOR_TEST);
  glScissor(0, 0, oversampling_ * rect.width(), oversampling_ * rect.height());
  glEnable(GL_DEPTH_TEST);
  glClearColor(0, 0, 0, 0);
  glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
  glFrontFace(GL_CW);  // clip y points down
}

void Layers::draw_occluders(const std::vector<Occluder>& occluders,
                            const glm::dmat4& clip_from_world) {
  glUseProgram(occluder_program_.get());
  set_matrix(occluder_program_.get(), clip_from_world);
  // Away from the camera, so that real geometry never hides what rests on it.
  glEnable(GL_POLYGON_OFFSET_FILL);
  glPolygonOffset(1, 4);
  for (const Occluder& o : occluders) {
    glBindVertexArray(o.geometry.get());
    glDrawElements(GL_TRIANGLES, o.index_count, GL_UNSIGNED_INT, nullptr);
  }
  glDisable(GL_POLYGON_OFFSET_FILL);
}

void Layers::draw_objects(const View& view, const glm::dmat4& clip_from_world) {
  glUseProgram(object_program_.get());
  glUniform1f(glGetUniformLocation(object_program_.get(), "signal_per_radiance"),
              view.signal_per_radiance);
  for (const Object& o : objects_) {
    set_matrix(object_program_.get(), clip_from_world * o.world_from_bake.matrix());
    glBindVertexArray(o.geometry.get());
    glDrawElements(GL_TRIANGLES, o.index_count, GL_UNSIGNED_INT, nullptr);
  }
}

void Layers::finish(Layer& out) {
  glDisable(GL_SCISSOR_TEST);
  const int w = out.rect.width(), h = out.rect.height();
  for (std::size_t i = 1; i < targets_.size(); ++i) {
    // A linear blit of exactly two to one reads between four samples: their mean.
    const int from = targets_[i - 1].scale, to = targets_[i].scale;
    glBindFramebuffer(GL_READ_FRAMEBUFFER, targets_[i - 1].framebuffer.get());
    glBindFramebuffer(GL_DRAW_FRAMEBUFFER, targets_[i].framebuffer.get());
    glBlitFramebuffer(0, 0, from * w, from * h, 0, 0, to * w, to * h, GL_COLOR_BUFFER_BIT,
                      GL_LINEAR);
  }
  out.halves.resize(static_cast<std::size_t>(w) * static_cast<std::size_t>(h) * 4);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, targets_.back().framebuffer.get());
  glReadPixels(0, 0, w, h, GL_RGBA, GL_HALF_FLOAT, out.halves.data());
}

Rect Layers::reach_of(const glm::dmat4& clip_from_bounds, const prt::Bounds& bounds) const {
  const glm::vec3 &a = bounds.low, &b = bounds.high;
  const glm::dvec3 corners[8] = {{a.x, a.y, a.z}, {b.x, a.y, a.z}, {a.x, b.y, a.z},
                                 {b.x, b.y, a.z}, {a.x, a.y, b.z}, {b.x, a.y, b.z},
                                 {a.x, b.y, b.z}, {b.x, b.y, b.z}};
  return reach(clip_from_bounds, corners, width_, height_);
}

Result<void> Layers::draw(const View& view, const Rect& receiver_area, Layer& objects,
                          Layer& hidden) {
  // A camera on a tripod before unchanged objects in unchanged light: the layers still hold.
  if (drawn_ && drawn_->view.camera == view.camera && drawn_->receiver_area == receiver_area &&
      drawn_->view.signal_per_radiance == view.signal_per_radiance)
    return {};
  drawn_.reset();
  const glm::dmat4 clip_from_world =
      clip_from_camera(view.camera) * view.camera.world_from_camera.inverse().matrix();
  objects.rect = {};
  for (const Object& o : objects_)
    objects.rect =
        united(objects.rect, reach_of(clip_from_world * o.world_from_bake.matrix(), o.bounds));
  if (!objects.rect.empty()) {
    begin(objects.rect);
    glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
    draw_occluders(occluders_, clip_from_world);
    draw_occluders(planes_, clip_from_world);
    glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
    draw_objects(view, clip_from_world);
    finish(objects);
  }
  hidden.rect = occluders_.empty() ? Rect{} : receiver_area;
  for (const OccluderMesh& mesh : occluder_meshes_)
    if (mesh.shaded) hidden.rect = united(hidden.rect, reach_of(clip_from_world, *mesh.shaded));
  if (!hidden.rect.empty()) {
    begin(hidden.rect);
    draw_occluders(occluders_, clip_from_world);
    finish(hidden);
  }
  if (const GLenum error = glGetError(); error != GL_NO_ERROR)
    return fail(ErrorCode::kUnavailable, "GL", fmt::format("error 0x{:04x} while drawing", error));
  drawn_ = Drawn{view, receiver_area};
  return {};
}

}  // namespace penumbra::compositor
