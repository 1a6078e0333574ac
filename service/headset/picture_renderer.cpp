#include "service/headset/internal/picture_renderer.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <glm/geometric.hpp>
#include <glm/gtc/type_ptr.hpp>
#include <glm/mat4x4.hpp>
#include <variant>

#include "codec/display.h"
#include "compositor/layers/gl/gl.h"
#include "service/headset/internal/lens_mesh.h"

namespace penumbra::service {

namespace {

// A ray of the camera, c + s d in the eye's frame, meets a plane n.x = e at 1/s = n.d / (e - n.c).
// Of two planes the nearer one has the larger 1/s. So (c + s d, 1) is (c/s + d, 1/s) in homogeneous
// coordinates, which is linear in d: the triangles of the mesh are exact on a plane.
constexpr const char* kLensVertexShader = R"glsl(#version 310 es
layout(location = 0) in highp vec3 direction;
layout(location = 1) in highp vec2 place;
uniform highp mat3 eye_from_camera;
uniform highp vec3 camera_in_eye;
uniform highp vec3 plane, ground;  // n / (e - n.c)
uniform highp mat4 clip_from_eye;
out highp vec2 at;
void main() {
  highp vec3 d = eye_from_camera * direction;
  highp float nearness = max(max(dot(plane, d), dot(ground, d)), 0.0);
  gl_Position = clip_from_eye * vec4(camera_in_eye * nearness + d, nearness);
  at = place;
})glsl";

constexpr const char* kLensFragmentShader = R"glsl(#version 310 es
uniform lowp sampler2D picture;
in highp vec2 at;
out lowp vec4 colour;
void main() {
  colour = vec4(texture(picture, at).rgb, 1.0);
})glsl";

glm::mat4 clip_from_eye(const EyeOptics& o) {
  const double l = std::tan(o.left), r = std::tan(o.right), u = std::tan(o.up),
               d = std::tan(o.down), n = o.near_m, f = o.far_m;
  glm::dmat4 m(0);
  m[0][0] = 2 / (r - l), m[2][0] = (r + l) / (r - l);
  m[1][1] = 2 / (u - d), m[2][1] = (u + d) / (u - d);
  m[2][2] = -(f + n) / (f - n), m[3][2] = -2 * f * n / (f - n);
  m[2][3] = -1;
  return m;
}

// n / (e - n.c) of a plane through `point` that the camera stands before, in the eye's frame.
glm::vec3 scaled_normal(const Pose& eye_from_world, const glm::dvec3& normal,
                        const glm::dvec3& point, const glm::dvec3& camera) {
  constexpr double kLeast_m = .01;  // a camera on the plane or behind it still shows something
  const double before_m = std::max(glm::dot(normal, point - camera), kLeast_m);
  return eye_from_world.rotation * normal / before_m;
}

}  // namespace

struct PictureRenderer::Parts {
  struct EyeParts {
    compositor::GlTexture texture;
    compositor::GlVertexArray vertices;
    compositor::GlBuffer buffer;
    GLsizei vertex_count = 0;
    std::optional<calib::CameraModel> camera;
    int width = 0, height = 0;  // of the texture
  };
  compositor::GlProgram program;
  compositor::GlFramebuffer framebuffer;
  std::array<EyeParts, 2> eyes;
  GLint eye_from_camera = -1, camera_in_eye = -1, plane = -1, ground = -1, clip = -1;

  void upload_mesh(EyeParts& eye, const calib::CameraModel& camera);
  void upload_pixels(EyeParts& eye, const Image<Rgb8>& pixels);
};

PictureRenderer::PictureRenderer(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
PictureRenderer::~PictureRenderer() = default;

Result<std::unique_ptr<PictureRenderer>> PictureRenderer::make() {
  PENUMBRA_ASSIGN(program, compositor::make_program(kLensVertexShader, kLensFragmentShader));
  auto parts = std::make_unique<Parts>();
  parts->program = std::move(program);
  const auto place = [&](const char* name) {
    return glGetUniformLocation(parts->program.get(), name);
  };
  parts->eye_from_camera = place("eye_from_camera");
  parts->camera_in_eye = place("camera_in_eye");
  parts->plane = place("plane");
  parts->ground = place("ground");
  parts->clip = place("clip_from_eye");
  return std::unique_ptr<PictureRenderer>(new PictureRenderer(std::move(parts)));
}

void PictureRenderer::Parts::upload_mesh(EyeParts& eye, const calib::CameraModel& camera) {
  const std::vector<LensVertex> mesh = make_lens_mesh(camera);
  eye.camera = camera;
  eye.vertex_count = static_cast<GLsizei>(mesh.size());
  glBindVertexArray(eye.vertices.get());
  glBindBuffer(GL_ARRAY_BUFFER, eye.buffer.get());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(mesh.size() * sizeof(LensVertex)),
               mesh.data(), GL_STATIC_DRAW);
  const auto attribute = [](GLuint index, GLint count, std::size_t offset) {
    glEnableVertexAttribArray(index);
    glVertexAttribPointer(index, count, GL_FLOAT, GL_FALSE, sizeof(LensVertex),
                          reinterpret_cast<const void*>(offset));
  };
  attribute(0, 3, offsetof(LensVertex, direction));
  attribute(1, 2, offsetof(LensVertex, place));
}

void PictureRenderer::Parts::upload_pixels(EyeParts& eye, const Image<Rgb8>& pixels) {
  glBindTexture(GL_TEXTURE_2D, eye.texture.get());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  if (eye.width != pixels.width() || eye.height != pixels.height()) {
    eye.width = pixels.width(), eye.height = pixels.height();
    glTexImage2D(GL_TEXTURE_2D, 0, GL_SRGB8, eye.width, eye.height, 0, GL_RGB, GL_UNSIGNED_BYTE,
                 pixels.pixels().data());
    for (const GLenum filter : {GL_TEXTURE_MIN_FILTER, GL_TEXTURE_MAG_FILTER})
      glTexParameteri(GL_TEXTURE_2D, filter, GL_LINEAR);
    for (const GLenum wrap : {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T})
      glTexParameteri(GL_TEXTURE_2D, wrap, GL_CLAMP_TO_EDGE);
  } else {
    glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, eye.width, eye.height, GL_RGB, GL_UNSIGNED_BYTE,
                    pixels.pixels().data());
  }
}

void PictureRenderer::set_picture(std::size_t eye, const FramePixels& pixels,
                                  const calib::CameraModel& camera) {
  Parts::EyeParts& parts = parts_->eyes[eye];
  if (!parts.camera || !(*parts.camera == camera)) parts_->upload_mesh(parts, camera);
  if (const auto* eight_bit = std::get_if<Image<Rgb8>>(&pixels))
    parts_->upload_pixels(parts, *eight_bit);
  else
    parts_->upload_pixels(parts, codec::to_display(pixels));
}

Result<void> PictureRenderer::draw(std::size_t eye, const Pose& world_from_camera,
                                   const EyeOptics& optics, const PictureSurface& surface,
                                   const EyeTarget& target) {
  const Parts::EyeParts& parts = parts_->eyes[eye];
  glBindFramebuffer(GL_FRAMEBUFFER, parts_->framebuffer.get());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, target.texture, 0);
  if (glCheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE)
    return fail(ErrorCode::kUnavailable, "headset", "the runtime's images cannot be drawn into");
  glViewport(0, 0, target.width, target.height);
  for (const GLenum off : {GL_SCISSOR_TEST, GL_DEPTH_TEST, GL_BLEND, GL_CULL_FACE}) glDisable(off);
  glClearColor(0, 0, 0, 1);
  glClear(GL_COLOR_BUFFER_BIT);

  const Pose eye_from_world = optics.world_from_eye.inverse();
  const Pose eye_from_camera = eye_from_world * world_from_camera;
  const glm::dvec3 camera = world_from_camera.translation;
  const glm::dvec3 forward = surface.world_from_head.rotation * glm::dvec3(0, 0, -1);
  const glm::vec3 plane =
      scaled_normal(eye_from_world, forward,
                    surface.world_from_head.translation + surface.distance_m * forward, camera);
  glm::vec3 ground(0);
  if (surface.floor_height_m && *surface.floor_height_m < camera.y)
    ground = scaled_normal(eye_from_world, {0, -1, 0}, {0, *surface.floor_height_m, 0}, camera);
  const glm::mat3 turn(eye_from_camera.rotation_matrix());
  const glm::vec3 place(eye_from_camera.translation);
  const glm::mat4 clip = clip_from_eye(optics);
  glUseProgram(parts_->program.get());
  glUniformMatrix3fv(parts_->eye_from_camera, 1, GL_FALSE, glm::value_ptr(turn));
  glUniform3fv(parts_->camera_in_eye, 1, glm::value_ptr(place));
  glUniform3fv(parts_->plane, 1, glm::value_ptr(plane));
  glUniform3fv(parts_->ground, 1, glm::value_ptr(ground));
  glUniformMatrix4fv(parts_->clip, 1, GL_FALSE, glm::value_ptr(clip));
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, parts.texture.get());
  glBindVertexArray(parts.vertices.get());
  glDrawArrays(GL_TRIANGLES, 0, parts.vertex_count);
  // The texture is the runtime's: nothing of ours may hold it when a session ends.
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, 0, 0);
  if (const GLenum error = glGetError(); error != GL_NO_ERROR)
    return fail(ErrorCode::kUnavailable, "headset", "the picture cannot be drawn");
  return {};
}

}  // namespace penumbra::service
