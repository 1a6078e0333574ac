#include "compositor/layers.h"

#include <fmt/format.h>

#include <algorithm>
#include <glm/gtc/type_ptr.hpp>
#include <limits>

namespace penumbra::compositor {

namespace {

constexpr double kNear = .02, kFar = 1000;  // metres
// Two by two samples a pixel. Drawn twice as large and averaged: without a GPU that takes a third of the
// time of four-fold multisampling.
constexpr int kOversampling = 2;
constexpr int kReceiverCells = 48;  // along each side of a receiver's mesh

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

// A mesh over the visible part of the shadow, dense enough that texture coordinates, which follow the
// grid's stretch, are linear within a cell.
constexpr const char* kReceiverVertex = R"(#version 310 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec2 texture_position;
uniform mat4 clip_from_object;
out vec2 uv;
void main() {
  uv = texture_position;
  gl_Position = clip_from_object * vec4(position, 1);
})";

constexpr const char* kReceiverFragment = R"(#version 310 es
precision highp float;
in vec2 uv;
uniform sampler2D ratio;
out vec4 colour;
void main() { colour = vec4(texture(ratio, uv).rgb, 1); }
)";

constexpr const char* kDepthVertex = R"(#version 310 es
layout(location = 0) in vec3 position;
uniform mat4 clip_from_object;
void main() { gl_Position = clip_from_object * vec4(position, 1); }
)";
constexpr const char* kDepthFragment = R"(#version 310 es
precision mediump float;
void main() {}
)";

// Row 0 of the framebuffer is the top of the picture: clip y grows downwards.
glm::dmat4 clip_from_camera(const prt::PinholeView& v) {
  glm::dmat4 m(0);
  m[0][0] = 2 * v.focal_px.x / v.width;
  m[2][0] = 1 - 2 * v.principal_px.x / v.width;
  m[1][1] = -2 * v.focal_px.y / v.height;
  m[2][1] = 1 - 2 * v.principal_px.y / v.height;
  m[2][2] = (kFar + kNear) / (kNear - kFar);
  m[3][2] = 2 * kFar * kNear / (kNear - kFar);
  m[2][3] = -1;
  return m;
}

// Pixels that a convex set of points can reach, cut at the near plane by taking the whole frame.
Rect reach(const glm::dmat4& clip_from_points, std::span<const glm::dvec3> points, int width, int height) {
  double x0 = width, y0 = height, x1 = 0, y1 = 0;
  int behind = 0;
  for (const glm::dvec3& p : points) {
    const glm::dvec4 c = clip_from_points * glm::dvec4(p, 1);
    if (c.w < kNear) {
      ++behind;
      continue;
    }
    const double x = (c.x / c.w + 1) / 2 * width, y = (c.y / c.w + 1) / 2 * height;
    x0 = std::min(x0, x), x1 = std::max(x1, x), y0 = std::min(y0, y), y1 = std::max(y1, y);
  }
  if (behind == static_cast<int>(points.size())) return {};
  if (behind > 0) return {0, 0, width, height};
  const auto clamped = [](double v, int limit) {
    return static_cast<int>(std::clamp(v, 0., static_cast<double>(limit)));
  };
  return {clamped(std::floor(x0) - 1, width), clamped(std::floor(y0) - 1, height),
          clamped(std::ceil(x1) + 1, width), clamped(std::ceil(y1) + 1, height)};
}

void set_matrix(GLuint program, const glm::dmat4& m) {
  const glm::mat4 single(m);
  glUniformMatrix4fv(glGetUniformLocation(program, "clip_from_object"), 1, GL_FALSE, glm::value_ptr(single));
}

void attribute(GLuint location, int components, std::size_t offset_bytes) {
  glEnableVertexAttribArray(location);
  glVertexAttribPointer(location, components, GL_FLOAT, GL_FALSE, 0,
                        reinterpret_cast<const void*>(offset_bytes));
}

GLsizeiptr bytes_of(const auto& v) { return static_cast<GLsizeiptr>(v.size() * sizeof(v[0])); }

}  // namespace

Rect united(const Rect& a, const Rect& b) {
  if (a.empty()) return b;
  if (b.empty()) return a;
  return {std::min(a.x0, b.x0), std::min(a.y0, b.y0), std::max(a.x1, b.x1), std::max(a.y1, b.y1)};
}

Result<Layers> Layers::create(int width, int height) {
  auto object = make_program(kObjectVertex, kObjectFragment);
  if (!object) return std::unexpected(object.error());
  auto receiver = make_program(kReceiverVertex, kReceiverFragment);
  if (!receiver) return std::unexpected(receiver.error());
  auto depth = make_program(kDepthVertex, kDepthFragment);
  if (!depth) return std::unexpected(depth.error());
  Layers layers(width, height, std::move(*object), std::move(*receiver), std::move(*depth));
  PENUMBRA_TRY(layers.make_targets());
  layers.make_receiver_indices();
  return layers;
}

Result<void> Layers::make_targets() {
  Targets& t = targets_;
  const auto complete = [](const char* which) -> Result<void> {
    if (glCheckFramebufferStatus(GL_FRAMEBUFFER) == GL_FRAMEBUFFER_COMPLETE) return {};
    return fail(ErrorCode::kUnavailable, "GL", fmt::format("no half-float {} target", which));
  };
  const auto depth = [&](const GlRenderbuffer& r, int scale) {
    glBindRenderbuffer(GL_RENDERBUFFER, r.get());
    glRenderbufferStorage(GL_RENDERBUFFER, GL_DEPTH_COMPONENT24, scale * width_, scale * height_);
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_RENDERBUFFER, r.get());
  };
  const auto colour = [&](const GlTexture& x, int scale) {
    glBindTexture(GL_TEXTURE_2D, x.get());
    glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGBA16F, scale * width_, scale * height_);
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, x.get(), 0);
  };
  glBindFramebuffer(GL_FRAMEBUFFER, t.fine.get());
  colour(t.fine_colour, kOversampling);
  depth(t.fine_depth, kOversampling);
  PENUMBRA_TRY(complete("object"));
  glBindFramebuffer(GL_FRAMEBUFFER, t.averaged.get());
  colour(t.averaged_colour, 1);
  PENUMBRA_TRY(complete("averaged"));
  glBindFramebuffer(GL_FRAMEBUFFER, t.ratio.get());
  colour(t.ratio_colour, 1);
  depth(t.ratio_depth, 1);
  return complete("shadow");
}

void Layers::make_receiver_indices() {
  std::vector<std::uint16_t> indices;
  for (int j = 0; j < kReceiverCells; ++j)
    for (int i = 0; i < kReceiverCells; ++i) {
      const auto a = static_cast<std::uint16_t>(j * (kReceiverCells + 1) + i);
      const auto b = static_cast<std::uint16_t>(a + 1), c = static_cast<std::uint16_t>(a + kReceiverCells + 1);
      const auto d = static_cast<std::uint16_t>(c + 1);
      indices.insert(indices.end(), {a, b, d, a, d, c});
    }
  glBindVertexArray(0);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, receiver_indices_.get());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, bytes_of(indices), indices.data(), GL_STATIC_DRAW);
}

int Layers::add_object(const prt::BakedObject& baked) {
  Object o;
  const prt::Mesh& mesh = baked.mesh;
  o.bounds = bounds_of(mesh);
  o.stride = baked.transfer.stride;
  o.index_count = static_cast<GLsizei>(mesh.triangles.size() * 3);
  glBindVertexArray(o.geometry.get());
  glBindBuffer(GL_ARRAY_BUFFER, o.vertices.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(mesh.positions) + bytes_of(mesh.albedo), nullptr, GL_STATIC_DRAW);
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(mesh.positions), mesh.positions.data());
  glBufferSubData(GL_ARRAY_BUFFER, bytes_of(mesh.positions), bytes_of(mesh.albedo), mesh.albedo.data());
  attribute(0, 3, 0);
  attribute(1, 3, mesh.positions.size() * sizeof(glm::vec3));
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  const std::vector<float> dark(3 * o.stride, 0.f);
  glBufferData(GL_ARRAY_BUFFER, bytes_of(dark), dark.data(), GL_DYNAMIC_DRAW);
  for (GLuint c = 0; c < 3; ++c) attribute(2 + c, 1, c * o.stride * sizeof(float));
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, o.indices.get());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, bytes_of(mesh.triangles), mesh.triangles.data(), GL_STATIC_DRAW);
  glBindVertexArray(0);
  if (baked.receiver) {
    o.has_receiver = true;
    o.grid = baked.receiver->grid;
    glBindTexture(GL_TEXTURE_2D, o.shadow.get());
    glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGB16F, o.grid.size, o.grid.size);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  }
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

void Layers::set_light(int object, std::span<const float> relit, const shadows::PlanarShadow& shadow) {
  Object& o = objects_[static_cast<std::size_t>(object)];
  drawn_.reset();
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, static_cast<GLsizeiptr>(3 * o.stride * sizeof(float)), relit.data());
  o.shadow_visible = o.has_receiver && !shadow.empty();
  if (!o.shadow_visible) return;
  glBindTexture(GL_TEXTURE_2D, o.shadow.get());
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, o.grid.size, o.grid.size, GL_RGB, GL_FLOAT, shadow.ratio.pixels().data());
  upload_receiver(o, shadow);
}

// The mesh of the visible texels and one more on each side: bilinear reads reach half a texel out.
void Layers::upload_receiver(Object& o, const shadows::PlanarShadow& shadow) {
  const auto size = static_cast<float>(o.grid.size);
  const glm::vec2 low(static_cast<float>(std::max(0, shadow.x0 - 1)), static_cast<float>(std::max(0, shadow.y0 - 1)));
  const glm::vec2 high(static_cast<float>(std::min(o.grid.size, shadow.x1 + 1)),
                       static_cast<float>(std::min(o.grid.size, shadow.y1 + 1)));
  struct Corner {
    glm::vec3 position;
    glm::vec2 uv;
  };
  Corner corners[(kReceiverCells + 1) * (kReceiverCells + 1)];
  for (int j = 0; j <= kReceiverCells; ++j)
    for (int i = 0; i <= kReceiverCells; ++i) {
      const glm::vec2 share(static_cast<float>(i) / kReceiverCells, static_cast<float>(j) / kReceiverCells);
      const glm::vec2 uv = (low + share * (high - low)) / size;
      const glm::vec2 place = o.grid.position(uv);
      corners[j * (kReceiverCells + 1) + i] = {{place.x, o.grid.height, place.y}, uv};
    }
  o.shadow_low = o.grid.position(low / size);
  o.shadow_high = o.grid.position(high / size);
  glBindVertexArray(o.receiver_geometry.get());
  glBindBuffer(GL_ARRAY_BUFFER, o.receiver_vertices.get());
  glBufferData(GL_ARRAY_BUFFER, sizeof corners, corners, GL_DYNAMIC_DRAW);
  glEnableVertexAttribArray(0);
  glEnableVertexAttribArray(1);
  glVertexAttribPointer(0, 3, GL_FLOAT, GL_FALSE, sizeof(Corner), nullptr);
  glVertexAttribPointer(1, 2, GL_FLOAT, GL_FALSE, sizeof(Corner), reinterpret_cast<const void*>(sizeof(glm::vec3)));
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, receiver_indices_.get());
  glBindVertexArray(0);
}

void Layers::add_occluder(const prt::Mesh& mesh) {
  Occluder o;
  o.index_count = static_cast<GLsizei>(mesh.triangles.size() * 3);
  glBindVertexArray(o.geometry.get());
  glBindBuffer(GL_ARRAY_BUFFER, o.vertices.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(mesh.positions), mesh.positions.data(), GL_STATIC_DRAW);
  attribute(0, 3, 0);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, o.indices.get());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, bytes_of(mesh.triangles), mesh.triangles.data(), GL_STATIC_DRAW);
  glBindVertexArray(0);
  occluders_.push_back(std::move(o));
  drawn_.reset();
}

// The viewport is moved so that the rectangle lies in the framebuffer's corner.
void Layers::begin(GLuint framebuffer, const Rect& rect, int scale, bool depth, float clear) {
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer);
  glViewport(-scale * rect.x0, -scale * rect.y0, scale * width_, scale * height_);
  glEnable(GL_SCISSOR_TEST);
  glScissor(0, 0, scale * rect.width(), scale * rect.height());
  (depth ? glEnable : glDisable)(GL_DEPTH_TEST);
  glDepthMask(GL_TRUE);
  glClearColor(clear, clear, clear, clear);
  glClear(GL_COLOR_BUFFER_BIT | (depth ? GL_DEPTH_BUFFER_BIT : 0u));
  glFrontFace(GL_CW);  // clip y points down
}

void Layers::read(GLuint framebuffer, Layer& out) {
  out.halves.resize(static_cast<std::size_t>(out.rect.width()) * static_cast<std::size_t>(out.rect.height()) * 4);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer);
  glReadPixels(0, 0, out.rect.width(), out.rect.height(), GL_RGBA, GL_HALF_FLOAT, out.halves.data());
}

void Layers::draw_occluders(const glm::dmat4& clip_from_world) {
  if (occluders_.empty()) return;
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glUseProgram(depth_program_.get());
  set_matrix(depth_program_.get(), clip_from_world);
  // Away from the camera, so that real geometry never hides what rests on it.
  glEnable(GL_POLYGON_OFFSET_FILL);
  glPolygonOffset(1, 4);
  for (const Occluder& o : occluders_) {
    glBindVertexArray(o.geometry.get());
    glDrawElements(GL_TRIANGLES, o.index_count, GL_UNSIGNED_INT, nullptr);
  }
  glDisable(GL_POLYGON_OFFSET_FILL);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
}

void Layers::draw_objects(const View& view, const glm::dmat4& clip_from_world, Layer& out) {
  out.rect = {};
  for (const Object& o : objects_) {
    const glm::vec3 &a = o.bounds.low, &b = o.bounds.high;
    const glm::dvec3 corners[8] = {{a.x, a.y, a.z}, {b.x, a.y, a.z}, {a.x, b.y, a.z}, {b.x, b.y, a.z},
                                   {a.x, a.y, b.z}, {b.x, a.y, b.z}, {a.x, b.y, b.z}, {b.x, b.y, b.z}};
    out.rect = united(out.rect, reach(clip_from_world * o.world_from_bake.matrix(), corners, width_, height_));
  }
  if (out.rect.empty()) return;
  begin(targets_.fine.get(), out.rect, kOversampling, true, 0);
  draw_occluders(clip_from_world);
  glUseProgram(object_program_.get());
  glUniform1f(glGetUniformLocation(object_program_.get(), "signal_per_radiance"), view.signal_per_radiance);
  for (const Object& o : objects_) {
    set_matrix(object_program_.get(), clip_from_world * o.world_from_bake.matrix());
    glBindVertexArray(o.geometry.get());
    glDrawElements(GL_TRIANGLES, o.index_count, GL_UNSIGNED_INT, nullptr);
  }
  glDisable(GL_SCISSOR_TEST);
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, targets_.averaged.get());
  const int w = out.rect.width(), h = out.rect.height();
  // A linear blit of exactly two to one reads between four samples: their mean.
  glBlitFramebuffer(0, 0, kOversampling * w, kOversampling * h, 0, 0, w, h, GL_COLOR_BUFFER_BIT, GL_LINEAR);
  read(targets_.averaged.get(), out);
}

void Layers::draw_receivers(const glm::dmat4& clip_from_world, Layer& out) {
  out.rect = {};
  for (const Object& o : objects_) {
    if (!o.shadow_visible) continue;
    const double h = o.grid.height;
    const glm::dvec3 corners[4] = {{o.shadow_low.x, h, o.shadow_low.y}, {o.shadow_high.x, h, o.shadow_low.y},
                                   {o.shadow_low.x, h, o.shadow_high.y}, {o.shadow_high.x, h, o.shadow_high.y}};
    out.rect = united(out.rect, reach(clip_from_world * o.world_from_bake.matrix(), corners, width_, height_));
  }
  if (out.rect.empty()) return;
  begin(targets_.ratio.get(), out.rect, 1, !occluders_.empty(), 1);
  draw_occluders(clip_from_world);
  // Ratios of several objects multiply: always inside the bounds of what all of them can block together.
  glBlendFunc(GL_DST_COLOR, GL_ZERO);
  glDepthMask(GL_FALSE);
  glUseProgram(receiver_program_.get());
  glActiveTexture(GL_TEXTURE0);
  glUniform1i(glGetUniformLocation(receiver_program_.get(), "ratio"), 0);
  for (const Object& o : objects_) {
    if (!o.shadow_visible) continue;
    set_matrix(receiver_program_.get(), clip_from_world * o.world_from_bake.matrix());
    glBindVertexArray(o.receiver_geometry.get());
    glBindTexture(GL_TEXTURE_2D, o.shadow.get());
    glDrawElements(GL_TRIANGLES, 6 * kReceiverCells * kReceiverCells, GL_UNSIGNED_SHORT, nullptr);
    glEnable(GL_BLEND);  // from the second on
  }
  glDisable(GL_BLEND);
  read(targets_.ratio.get(), out);
}

Result<void> Layers::draw(const View& view, Layer& objects, Layer& shadows) {
  // A camera on a tripod before unchanged objects in unchanged light: the layers still hold.
  if (drawn_ && drawn_->camera == view.camera && drawn_->signal_per_radiance == view.signal_per_radiance) return {};
  drawn_.reset();
  const glm::dmat4 clip_from_world =
      clip_from_camera(view.camera) * view.camera.world_from_camera.inverse().matrix();
  draw_objects(view, clip_from_world, objects);
  draw_receivers(clip_from_world, shadows);
  if (const GLenum error = glGetError(); error != GL_NO_ERROR)
    return fail(ErrorCode::kUnavailable, "GL", fmt::format("error 0x{:04x} while drawing", error));
  drawn_ = view;
  return {};
}

}  // namespace penumbra::compositor
