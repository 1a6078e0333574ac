#include "compositor/layers/layer_programs.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/type_ptr.hpp>
#include <string>

namespace penumbra::compositor {

namespace {

constexpr const char* kVersion = "#version 310 es\nprecision highp float;\n";

// place_in_picture() of a vertex and, in fragments, is_shown().
constexpr const char* kPinholeVertex = R"(
uniform mat4 picture_from_points;
vec4 place_in_picture(vec3 position) { return picture_from_points * vec4(position, 1); }
)";
constexpr const char* kWholeFragment = "bool is_shown() { return true; }\n";

// Where a vertex lies, for fragments that may be cut.
constexpr const char* kTellsNothing = "void tell_place(vec3 p) {}\n";
constexpr const char* kTellsPlace = R"(
out vec3 in_camera;
void tell_place(vec3 p) { in_camera = p; }
)";

// As ViewLens::pixel. Clip w is the distance, which is positive all around the camera.
constexpr const char* kLensVertex = R"(
uniform mat4 picture_from_points;
uniform highp sampler2D radius;
uniform vec4 scale_and_offset;
uniform vec3 decentring;
uniform vec2 depth;
vec4 place_in_picture(vec3 position) {
  vec3 p = (picture_from_points * vec4(position, 1)).xyz;
  tell_place(p);
  float side = length(p.xy), w = length(p);
  int last = textureSize(radius, 0).x - 1;
  float at = side / max(side + w - p.z, 1e-20) * float(last);
  int i = clamp(int(at), 0, last - 1);
  float r = mix(texelFetch(radius, ivec2(i, 0), 0).r, texelFetch(radius, ivec2(i + 1, 0), 0).r,
                at - float(i));
  vec2 along = side > 0.0 ? vec2(p.x, -p.y) / side : vec2(1, 0);
  vec2 q = along * r;
  if (decentring.xy != vec2(0)) {
    float tangent = p.z < 0.0 ? min(side / -p.z, decentring.z) : decentring.z;
    vec2 u = along * tangent;
    float rr = tangent * tangent, xy = 2.0 * u.x * u.y;
    q += vec2(decentring.x * xy + decentring.y * (rr + 2.0 * u.x * u.x),
              decentring.x * (rr + 2.0 * u.y * u.y) + decentring.y * xy);
  }
  return vec4((q * scale_and_offset.xy + scale_and_offset.zw) * w, depth.x * w + depth.y, w);
}
)";
// A triangle around the axis behind the camera would otherwise cover the picture.
constexpr const char* kCutFragment = R"(
in vec3 in_camera;
uniform float min_cosine;
uniform vec4 planes[16];
uniform int plane_count;
bool is_shown() {
  if (-in_camera.z < min_cosine * length(in_camera)) return false;
  for (int i = 0; i < plane_count; ++i)
    if (dot(planes[i], vec4(in_camera, 1)) < 0.0) return false;
  return true;
}
)";

// An edge is no sharper than a pixel. a: as EdgedLight::lit.
constexpr const char* kBesideEdge = R"(
vec3 light_beside_edge(vec4 e) {
  return e.rgb * clamp(0.5 + (e.a - 0.5) / max(fwidth(e.a), 1.0), 0.0, 1.0);
}
)";

constexpr const char* kObjectVertex = R"(
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 radiance;
layout(location = 10) in vec4 edged_light;
uniform float signal_per_radiance;
out vec3 signal;
out vec4 edged;
void main() {
  signal = signal_per_radiance * radiance;
  edged = vec4(signal_per_radiance * edged_light.rgb, edged_light.a);
  gl_Position = place_in_picture(position);
})";

// Back faces are black, as in the bake and in the reference.
constexpr const char* kObjectFragment = R"(
in vec3 signal;
in vec4 edged;
out vec4 colour;
void main() {
  vec3 shown = signal + light_beside_edge(edged);
  if (!is_shown()) discard;
  colour = with_foreground(vec4(gl_FrontFacing ? min(shown, 1000.0) : vec3(0), 1));
}
)";

// With pictures of albedo, of light, or of both; what is not a picture is white, or comes by
// vertex.
constexpr const char* kTexturedVertex = R"(
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 radiance;
layout(location = 2) in vec2 albedo_place;
layout(location = 3) in vec2 light_place;
layout(location = 10) in vec4 edged_light;
uniform float signal_per_radiance;
out vec3 signal;
out vec4 edged;
out vec2 in_albedo, in_light;
void main() {
  signal = signal_per_radiance * radiance;
  edged = vec4(signal_per_radiance * edged_light.rgb, edged_light.a);
  in_albedo = albedo_place;
  in_light = light_place;
  gl_Position = place_in_picture(position);
})";
constexpr const char* kTexturedFragment = R"(
in vec3 signal;
in vec4 edged;
in vec2 in_albedo, in_light;
uniform sampler2D albedo_map, light_map;
out vec4 colour;
void main() {
  vec3 shown = (signal + light_beside_edge(edged)) * texture(albedo_map, in_albedo).rgb *
               texture(light_map, in_light).rgb;
  if (!is_shown()) discard;
  colour = with_foreground(vec4(gl_FrontFacing ? min(shown, 1000.0) : vec3(0), 1));
}
)";

constexpr const char* kRealMeshVertex = R"(
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 deficit;
layout(location = 2) in vec3 vertex_weight;
out vec3 loss, weight;
void main() {
  loss = deficit;
  weight = vertex_weight;
  gl_Position = place_in_picture(position);
})";
constexpr const char* kRealMeshFragment = R"(
in vec3 loss, weight;
layout(location = 0) out vec4 colour;
layout(location = 1) out vec4 share;
void main() {
  if (!is_shown()) discard;
  colour = vec4(clamp(weight * loss * seen_past_foreground(), -60000.0, 60000.0), 1);
  share = vec4(weight, 1);
}
)";

constexpr int kRadiusUnit = 2;  // beside the pictures of albedo and light

GlTexture radius_texture(const ViewLens& lens) {
  GlTexture texture;
  const auto steps = static_cast<GLsizei>(lens.radius().size());
  glBindTexture(GL_TEXTURE_2D, texture.get());
  glTexStorage2D(GL_TEXTURE_2D, 1, GL_R32F, steps, 1);
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, steps, 1, GL_RED, GL_FLOAT, lens.radius().data());
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  return texture;
}

void set_lens(GLuint program, const ViewLens& lens, GLuint radius) {
  const calib::CameraModel& m = lens.model();
  const auto at = [&](const char* name) { return glGetUniformLocation(program, name); };
  const auto set = [](double v) { return static_cast<float>(v); };
  // Clip y grows downwards, as in clip_from_world_of.
  glUniform4f(at("scale_and_offset"), set(2 * m.focal_px.x / m.width),
              set(2 * m.focal_px.y / m.height), set(2 * m.principal_px.x / m.width - 1),
              set(2 * m.principal_px.y / m.height - 1));
  glUniform3f(at("decentring"), set(lens.decentring().x), set(lens.decentring().y),
              set(lens.max_tangent()));
  glUniform2f(at("depth"), set((kFarPlane + kNearPlane) / (kFarPlane - kNearPlane)),
              set(2 * kFarPlane * kNearPlane / (kNearPlane - kFarPlane)));
  glUniform1f(at("min_cosine"), set(std::cos(lens.max_angle_rad())));
  glUniform1i(at("plane_count"), 0);
  glActiveTexture(GL_TEXTURE0 + kRadiusUnit);
  glBindTexture(GL_TEXTURE_2D, radius);
  glActiveTexture(GL_TEXTURE0);
  glUniform1i(at("radius"), kRadiusUnit);
}

}  // namespace

namespace {

std::string vertex_head(bool lens, bool cut) {
  return std::string(kVersion) + (cut ? kTellsPlace : kTellsNothing) +
         (lens ? kLensVertex : kPinholeVertex);
}
std::string fragment_head(bool cut, bool foreground) {
  return std::string(kVersion) + (cut ? kCutFragment : kWholeFragment) +
         (foreground ? kBehindForeground : kNoForeground) + kBesideEdge;
}

}  // namespace

Result<LayerPrograms::Programs> LayerPrograms::make(ProgramKind kind) {
  const bool cut = kind.way == Way::kCutLens;
  const std::string vertex = vertex_head(kind.way != Way::kPinhole, cut),
                    fragment = fragment_head(cut, kind.foreground);
  const auto one = [&](const char* v, const char* f) {
    return make_program((vertex + v).c_str(), (fragment + f).c_str());
  };
  PENUMBRA_ASSIGN(object, one(kObjectVertex, kObjectFragment));
  PENUMBRA_ASSIGN(textured, one(kTexturedVertex, kTexturedFragment));
  PENUMBRA_ASSIGN(real_mesh, one(kRealMeshVertex, kRealMeshFragment));
  return Programs{std::move(object), std::move(textured), std::move(real_mesh)};
}

Result<LayerPrograms> LayerPrograms::create() {
  LayerPrograms out;
  PENUMBRA_TRY(out.prepare(ProgramKind{}));
  return out;
}

Result<void> LayerPrograms::prepare(ProgramKind kind) {
  if (programs_.contains(kind)) return {};
  PENUMBRA_ASSIGN(made, make(kind));
  programs_.emplace(kind, std::move(made));
  return {};
}

// What may be drawn until the next prepare().
std::array<LayerPrograms::ProgramKind, 2> LayerPrograms::kinds() const {
  const bool foreground = foreground_.any();
  const ProgramKind pinhole{Way::kPinhole, foreground};
  if (!through_lens_) return {pinhole, pinhole};
  return {ProgramKind{Way::kLens, foreground}, ProgramKind{Way::kCutLens, foreground}};
}

Result<void> LayerPrograms::prepare(const std::shared_ptr<const ViewLens>& lens,
                                    const std::shared_ptr<const Foreground>& foreground) {
  through_lens_ = lens != nullptr;
  foreground_.set(foreground);
  for (const ProgramKind kind : kinds()) PENUMBRA_TRY(prepare(kind));
  if (lens && std::ranges::find(tables_, lens, &LensTable::lens) == tables_.end())
    tables_.push_back({lens, radius_texture(*lens)});
  return {};
}

Result<void> LayerPrograms::prepare_glossy(GlossyFeatures features) {
  for (const ProgramKind kind : kinds()) {
    if (glossy_.contains({kind, features})) continue;
    const bool cut = kind.way == Way::kCutLens;
    const std::string defines = glossy_defines(features, cut),
                      vertex = vertex_head(through_lens_, cut),
                      fragment = fragment_head(cut, kind.foreground);
    PENUMBRA_ASSIGN(made, make_program((vertex + defines + kGlossyVertex).c_str(),
                                       (fragment + defines + kGlossyFragment).c_str()));
    glossy_.emplace(std::pair(kind, features), std::move(made));
  }
  return {};
}

void LayerPrograms::set_up(GLuint program, const ViewProjection& from_points) const {
  glUseProgram(program);
  const glm::mat4 single(from_points.matrix());
  glUniformMatrix4fv(glGetUniformLocation(program, "picture_from_points"), 1, GL_FALSE,
                     glm::value_ptr(single));
  foreground_.bind(program);
  const ViewLens* const lens = from_points.lens();
  if (!lens) return;
  const auto table =
      std::ranges::find_if(tables_, [&](const LensTable& t) { return t.lens.get() == lens; });
  set_lens(program, *lens, table->radius.get());
}

LayerPrograms::ProgramKind LayerPrograms::kind_of(const ViewProjection& from_points,
                                                  bool cut) const {
  return {!from_points.lens() ? Way::kPinhole
          : cut               ? Way::kCutLens
                              : Way::kLens,
          foreground_.any()};
}

GLuint LayerPrograms::use(LayerDrawing drawing, const ViewProjection& from_points, bool cut) const {
  const Programs& programs = programs_.at(kind_of(from_points, cut));
  const GLuint program = programs[static_cast<std::size_t>(drawing)].get();
  set_up(program, from_points);
  return program;
}

GLuint LayerPrograms::use_glossy(GlossyFeatures features, const ViewProjection& from_points,
                                 bool cut) const {
  const GLuint program = glossy_.at({kind_of(from_points, cut), features}).get();
  set_up(program, from_points);
  return program;
}

void LayerPrograms::set_hiding_planes(GLuint program, std::span<const glm::dvec4> planes) const {
  std::array<glm::vec4, kMaxPlanes> single{};
  const std::size_t count = std::min(planes.size(), kMaxPlanes);
  std::copy_n(planes.begin(), count, single.begin());
  glUniform1i(glGetUniformLocation(program, "plane_count"), static_cast<GLint>(count));
  if (count > 0)
    glUniform4fv(glGetUniformLocation(program, "planes"), static_cast<GLsizei>(count),
                 glm::value_ptr(single[0]));
}

}  // namespace penumbra::compositor
