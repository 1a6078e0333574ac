#include "compositor/layers/layers.h"

#include <fmt/format.h>

#include <algorithm>
#include <glm/gtc/type_ptr.hpp>

#include "prt/clip/light_map.h"

namespace penumbra::compositor {

namespace {

constexpr const char* kObjectVertex = R"(#version 310 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 radiance;
uniform mat4 clip_from_object;
uniform float signal_per_radiance;
out vec3 signal;
void main() {
  signal = signal_per_radiance * radiance;
  gl_Position = clip_from_object * vec4(position, 1);
})";

// Back faces are black, as in the bake and in the reference.
constexpr const char* kObjectFragment = R"(#version 310 es
precision highp float;
in vec3 signal;
out vec4 colour;
void main() { colour = vec4(gl_FrontFacing ? min(signal, 1000.0) : vec3(0), 1); }
)";

// With pictures of albedo, of light, or of both; what is not a picture is white, or comes by
// vertex.
constexpr const char* kTexturedVertex = R"(#version 310 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 radiance;
layout(location = 2) in vec2 albedo_place;
layout(location = 3) in vec2 light_place;
uniform mat4 clip_from_object;
uniform float signal_per_radiance;
out vec3 signal;
out vec2 in_albedo, in_light;
void main() {
  signal = signal_per_radiance * radiance;
  in_albedo = albedo_place;
  in_light = light_place;
  gl_Position = clip_from_object * vec4(position, 1);
})";
constexpr const char* kTexturedFragment = R"(#version 310 es
precision highp float;
in vec3 signal;
in vec2 in_albedo, in_light;
uniform sampler2D albedo_map, light_map;
out vec4 colour;
void main() {
  vec3 shown = signal * texture(albedo_map, in_albedo).rgb * texture(light_map, in_light).rgb;
  colour = vec4(gl_FrontFacing ? min(shown, 1000.0) : vec3(0), 1);
}
)";

constexpr const char* kOccluderVertex = R"(#version 310 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 deficit;
uniform mat4 clip_from_object;
out vec3 loss;
void main() {
  loss = deficit;
  gl_Position = clip_from_object * vec4(position, 1);
})";
constexpr const char* kOccluderFragment = R"(#version 310 es
precision highp float;
in vec3 loss;
out vec4 colour;
void main() { colour = vec4(loss, 1); }
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

// Planes that hide less of an object than this do not, metres.
constexpr double kTouching = 1e-4;

double area_m2(const prt::Mesh& mesh) {
  double sum = 0;
  for (const auto& [a, b, c] : mesh.triangles)
    sum += glm::length(
        glm::cross(mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]));
  return .5 * sum;
}

GLsizeiptr bytes_of(const auto& v) {
  return static_cast<GLsizeiptr>(v.size() * sizeof(v[0]));
}

}  // namespace

namespace {

GlTexture one_texel() {
  GlTexture texture;
  const std::uint8_t white[4] = {255, 255, 255, 255};
  glBindTexture(GL_TEXTURE_2D, texture.get());
  glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGBA8, 1, 1);
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, 1, 1, GL_RGBA, GL_UNSIGNED_BYTE, white);
  return texture;
}

GlTexture albedo_texture(const Image<Rgb8>& picture) {
  GlTexture texture;
  int levels = 1;
  while ((std::max(picture.width(), picture.height()) >> levels) > 0) ++levels;
  glBindTexture(GL_TEXTURE_2D, texture.get());
  glTexStorage2D(GL_TEXTURE_2D, levels, GL_SRGB8_ALPHA8, picture.width(), picture.height());
  std::vector<std::uint8_t> codes;
  codes.reserve(4 * picture.area());
  for (const Rgb8& c : picture.pixels()) codes.insert(codes.end(), {c.r, c.g, c.b, 255});
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, picture.width(), picture.height(), GL_RGBA,
                  GL_UNSIGNED_BYTE, codes.data());
  glGenerateMipmap(GL_TEXTURE_2D);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
  return texture;
}

void upload_coordinates(GLuint buffer, GLuint location, std::span<const glm::vec2> coordinates) {
  if (coordinates.empty()) return;  // the attribute stays one constant place
  glBindBuffer(GL_ARRAY_BUFFER, buffer);
  glBufferData(GL_ARRAY_BUFFER, bytes_of(coordinates), coordinates.data(), GL_STATIC_DRAW);
  attribute(location, 2, 0);
}

}  // namespace

Result<Layers> Layers::create(int width, int height, int oversampling) {
  PENUMBRA_ASSIGN(object, make_program(kObjectVertex, kObjectFragment));
  PENUMBRA_ASSIGN(textured, make_program(kTexturedVertex, kTexturedFragment));
  PENUMBRA_ASSIGN(occluder, make_program(kOccluderVertex, kOccluderFragment));
  return Layers(width, height, oversampling, std::move(object), std::move(textured),
                std::move(occluder), one_texel());
}

// In the object's vertex array.
void Layers::add_pictures(DrawnObject& o, const prt::BakedObject& baked,
                          const Appearance& appearance) {
  if (!appearance.texture && appearance.texels.empty()) return;
  if (appearance.texture) {
    o.albedo.assign(baked.mesh.positions.size(), Rgb{1, 1, 1});
    std::ranges::copy(appearance.tint, o.albedo.begin());
    o.albedo_map = albedo_texture(*appearance.texture);
    upload_coordinates(o.texture_coordinates.get(), 2, appearance.texture_coordinates);
  } else {
    o.albedo_map = one_texel();
  }
  if (appearance.texels.empty()) return;
  LightMap map{.width = appearance.light_width,
               .height = appearance.light_height,
               .first = baked.mesh.positions.size() - appearance.texels.size()};
  for (const prt::SurfaceLayout::Texel& t : appearance.texels) map.places.push_back({t.x, t.y});
  map.pixels.resize(static_cast<std::size_t>(map.width) * static_cast<std::size_t>(map.height));
  glBindTexture(GL_TEXTURE_2D, map.texture.get());
  glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGB16F, map.width, map.height);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  for (const GLenum wrap : {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T})
    glTexParameteri(GL_TEXTURE_2D, wrap, GL_CLAMP_TO_EDGE);
  upload_coordinates(o.light_coordinates.get(), 3, appearance.light_coordinates);
  // Light comes from the map; vertices tint it where a picture gives the albedo.
  o.colours.assign(baked.mesh.positions.size(), Rgb{1, 1, 1});
  if (appearance.texture) std::ranges::copy(appearance.tint, o.colours.begin());
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(o.colours), o.colours.data());
  o.light_map = std::move(map);
}

void Layers::fill_light_map(LightMap& map, std::span<const float> relit, std::size_t stride,
                            const std::vector<Rgb>& albedo) {
  for (std::size_t i = 0; i < map.places.size(); ++i) {
    const std::size_t point = map.first + i;
    const auto [x, y] = map.places[i];
    const Rgb lit{std::max(relit[point], 0.f), std::max(relit[stride + point], 0.f),
                  std::max(relit[2 * stride + point], 0.f)};
    map.pixels[static_cast<std::size_t>(y) * static_cast<std::size_t>(map.width) +
               static_cast<std::size_t>(x)] = albedo[point] * lit;
  }
  glBindTexture(GL_TEXTURE_2D, map.texture.get());
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, map.width, map.height, GL_RGB, GL_FLOAT,
                  map.pixels.data());
}

int Layers::add_object(const prt::BakedObject& baked, const Appearance& appearance) {
  const prt::Mesh& mesh = baked.mesh;
  const prt::Bounds bounds = bounds_of(mesh);
  const bool pictures = appearance.texture || !appearance.texels.empty();
  DrawnObject o{.triangles = mesh.triangles,
                .closed = is_closed(mesh),
                .albedo = mesh.albedo,
                .colours = std::vector<Rgb>(mesh.positions.size()),
                .stride = baked.transfer.stride,
                .bounds = bounds,
                .area_m2 = area_m2(mesh)};
  if (!fine_ && !pictures) {
    o.contour.emplace(mesh);
    o.positions = mesh.positions;
  }
  glBindVertexArray(o.geometry.get());
  glBindBuffer(GL_ARRAY_BUFFER, o.vertices.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(mesh.positions), mesh.positions.data(), GL_STATIC_DRAW);
  attribute(0, 3, 0);
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(o.colours), o.colours.data(), GL_DYNAMIC_DRAW);
  attribute(1, 3, 0);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, o.indices.get());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, bytes_of(o.triangles), o.triangles.data(), GL_STATIC_DRAW);
  o.index_count = static_cast<GLsizei>(3 * o.triangles.size());
  add_pictures(o, baked, appearance);
  glBindVertexArray(0);
  objects_.push_back(std::move(o));
  drawn_.reset();
  return static_cast<int>(objects_.size()) - 1;
}

void Layers::update_vertices(int object, const prt::Mesh& mesh) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  o.bounds = bounds_of(mesh);
  if (o.contour) o.positions = mesh.positions;
  glBindBuffer(GL_ARRAY_BUFFER, o.vertices.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(mesh.positions), mesh.positions.data());
  o.changed = true;
  o.contour_known = false;
}

void Layers::set_pose(int object, const Pose& world_from_bake) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  if (o.world_from_bake == world_from_bake) return;
  o.world_from_bake = world_from_bake;
  o.changed = true;
  o.contour_known = false;
}

void Layers::show(int object, bool visible) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  if (std::exchange(o.visible, visible) != visible) o.changed = true;
}

void Layers::set_light(int object, std::span<const float> relit) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  if (o.light_map) {
    fill_light_map(*o.light_map, relit, o.stride, o.albedo);
    o.changed = true;
    return;
  }
  bool changed = false;
  for (std::size_t i = 0; i < o.colours.size(); ++i) {
    const auto lit = [&](std::size_t c) { return std::max(relit[c * o.stride + i], 0.f); };
    const Rgb colour{o.albedo[i].r * lit(0), o.albedo[i].g * lit(1), o.albedo[i].b * lit(2)};
    changed |= !(colour == o.colours[i]);
    o.colours[i] = colour;
  }
  if (!changed) return;  // a shadow moved, or a neighbour
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(o.colours), o.colours.data());
  o.changed = true;
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
  planes_.push_back({point, normal, upload(quad)});
  drawn_.reset();
}

namespace {

// Real geometry lies a little further away, so that it never hides what rests on it.
class PushedBack {
 public:
  explicit PushedBack(GLuint program) {
    glUseProgram(program);
    glEnable(GL_POLYGON_OFFSET_FILL);
    glPolygonOffset(1, 4);
  }
  ~PushedBack() { glDisable(GL_POLYGON_OFFSET_FILL); }
};

}  // namespace

void Layers::draw_occluders(const glm::dmat4& clip_from_world) {
  const PushedBack state(occluder_program_.get());
  set_matrix(occluder_program_.get(), clip_from_world);
  for (const Occluder& o : occluders_) {
    glBindVertexArray(o.geometry.get());
    glDrawElements(GL_TRIANGLES, o.index_count, GL_UNSIGNED_INT, nullptr);
  }
}

void Layers::draw_hiding_planes(const glm::dvec3& eye, const glm::dmat4& clip_from_world) {
  const PushedBack state(occluder_program_.get());
  set_matrix(occluder_program_.get(), clip_from_world);
  for (const DrawnPlane& p : planes_) {
    if (std::ranges::none_of(objects_, [&](const DrawnObject& o) {
          return o.visible && hidden_m(p, o, eye) > kTouching;
        }))
      continue;
    glBindVertexArray(p.quad.geometry.get());
    glDrawElements(GL_TRIANGLES, p.quad.index_count, GL_UNSIGNED_INT, nullptr);
  }
}

void Layers::bind_pictures(const DrawnObject& o, GLuint program) const {
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, o.light_map ? o.light_map->texture.get() : white_.get());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, o.albedo_map->get());
  glUniform1i(glGetUniformLocation(program, "albedo_map"), 0);
  glUniform1i(glGetUniformLocation(program, "light_map"), 1);
}

void Layers::draw_objects(const View& view, const glm::dmat4& clip_from_world, const Rect& region,
                          bool seen_alone) {
  for (DrawnObject& o : objects_) {
    if (!o.visible || !meet(reach_of(o, clip_from_world), region)) continue;
    const GLuint program = (o.albedo_map ? textured_program_ : object_program_).get();
    glUseProgram(program);
    glUniform1f(glGetUniformLocation(program, "signal_per_radiance"), view.signal_per_radiance);
    if (o.albedo_map) bind_pictures(o, program);
    if (fronts_only(o, view.camera.world_from_camera.translation)) glEnable(GL_CULL_FACE);
    set_matrix(program, clip_from_world * o.world_from_bake.matrix());
    glBindVertexArray(o.geometry.get());
    glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, (seen_alone ? o.seen : o.indices).get());
    glDrawElements(GL_TRIANGLES, seen_alone ? o.seen_count : o.index_count, GL_UNSIGNED_INT,
                   nullptr);
    glDisable(GL_CULL_FACE);
  }
}

Rect Layers::reach_of(const glm::dmat4& clip_from_bounds, const prt::Bounds& bounds) const {
  const glm::vec3 &a = bounds.low, &b = bounds.high;
  const glm::dvec3 corners[8] = {{a.x, a.y, a.z}, {b.x, a.y, a.z}, {a.x, b.y, a.z},
                                 {b.x, b.y, a.z}, {a.x, a.y, b.z}, {b.x, a.y, b.z},
                                 {a.x, b.y, b.z}, {b.x, b.y, b.z}};
  return reach(clip_from_bounds, corners, width_, height_);
}

// Nothing of one that is not shown.
Rect Layers::reach_of(const DrawnObject& o, const glm::dmat4& clip_from_world) const {
  return o.visible ? reach_of(clip_from_world * o.world_from_bake.matrix(), o.bounds) : Rect{};
}

Rect Layers::reach_of_objects(const prt::PinholeView& camera) const {
  const glm::dmat4 clip_from_world = clip_from_world_of(camera);
  Rect out;
  for (const DrawnObject& o : objects_) out = united(out, reach_of(o, clip_from_world));
  return out;
}

// True where one sample a pixel did.
Result<bool> Layers::draw_layer_of_objects(const View& view, const glm::dmat4& clip_from_world,
                                           Layer& out) {
  out.rect = reach_of_objects(view.camera);
  if (out.rect.empty()) return false;
  if (one_sample_does(view.camera, clip_from_world) &&
      find_contours(view.camera, clip_from_world, out.rect)) {
    PENUMBRA_TRY(draw_on(plain_canvas_, view, clip_from_world, out));
    if (smoother_.smooth(lines_, out)) return true;
  }
  PENUMBRA_TRY(draw_on(objects_canvas_, view, clip_from_world, out));
  return false;
}

Result<void> Layers::draw_on(Canvas& canvas, const View& view, const glm::dmat4& clip_from_world,
                             Layer& out) {
  PENUMBRA_TRY(canvas.begin(out.rect, width_, height_));
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  draw_occluders(clip_from_world);
  draw_hiding_planes(view.camera.world_from_camera.translation, clip_from_world);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  draw_objects(view, clip_from_world, out.rect, &canvas == &plain_canvas_);
  canvas.finish(out);
  return {};
}

namespace {

Result<void> check_gl() {
  const GLenum error = glGetError();
  if (error == GL_NO_ERROR) return {};
  return fail(ErrorCode::kUnavailable, "GL", fmt::format("error 0x{:04x} while drawing", error));
}

}  // namespace

Result<void> Layers::draw(const View& view, const Rect& receiver_area, CommonLayer& objects_layer,
                          CommonLayer& hidden_layer) {
  // A camera on a tripod: what unchanged objects in unchanged light show still holds.
  if (drawn_ && drawn_->shows(view, receiver_area, has_occluders())) {
    PENUMBRA_ASSIGN(done, redraw_changed(view, objects_layer));
    if (done) {
      const auto drawn = check_gl();
      if (!drawn) drawn_.reset();
      return drawn;
    }
  }
  drawn_.reset();
  Layer &objects = objects_layer.renewed(), &hidden = hidden_layer.renewed();
  const glm::dmat4 clip_from_world = clip_from_world_of(view.camera);
  PENUMBRA_ASSIGN(by_contours, draw_layer_of_objects(view, clip_from_world, objects));
  hidden.rect = occluders_.empty() ? Rect{} : receiver_area;
  for (const OccluderMesh& mesh : occluder_meshes_)
    if (mesh.shaded) hidden.rect = united(hidden.rect, reach_of(clip_from_world, *mesh.shaded));
  if (!hidden.rect.empty()) {
    PENUMBRA_TRY(hidden_canvas_.begin(hidden.rect, width_, height_));
    draw_occluders(clip_from_world);
    hidden_canvas_.finish(hidden);
  }
  PENUMBRA_TRY(check_gl());
  keep_as_drawn(clip_from_world);
  drawn_ = DrawnLayers{view, receiver_area, by_contours};
  return {};
}

}  // namespace penumbra::compositor
