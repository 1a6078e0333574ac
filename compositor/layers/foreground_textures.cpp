#include "compositor/layers/foreground_textures.h"

#include <algorithm>

namespace penumbra::compositor {

const char* const kNoForeground = R"(
float seen_past_foreground() { return 1.0; }
vec4 with_foreground(vec4 c) { return c; }
)";

// Between half of a margin and one and a half a thing goes from the front to the back.
const char* const kBehindForeground = R"(
uniform highp sampler2D foreground_cover, foreground_distance;
uniform vec3 foreground_place;  // of the canvas's corner in it, pixels a sample
uniform ivec2 foreground_size;
uniform vec2 foreground_margin;  // the least, and by distance
vec4 foreground_cover_here() {
  vec2 at = foreground_place.xy + gl_FragCoord.xy * foreground_place.z;
  ivec2 i = ivec2(floor(at));
  if (any(lessThan(i, ivec2(0))) || any(greaterThanEqual(i, foreground_size))) return vec4(0);
  float d = texelFetch(foreground_distance, i, 0).r;
  float margin = max(foreground_margin.x, foreground_margin.y * d);
  float farther = (1.0 / gl_FragCoord.w - d) / margin;
  return clamp(farther - 0.5, 0.0, 1.0) * texelFetch(foreground_cover, i, 0);
}
float seen_past_foreground() { return 1.0 - foreground_cover_here().a; }
vec4 with_foreground(vec4 c) {
  vec4 f = foreground_cover_here();
  return vec4(c.rgb * (1.0 - f.a) + c.a * f.rgb, c.a * (1.0 - f.a));
}
)";

void ForegroundTextures::make_room(int width, int height) {
  constexpr int kStep = 64;  // a thing that moves does not ask for another size each frame
  const auto room = [](int pixels) { return (pixels + kStep - 1) / kStep * kStep; };
  if (textures_ && textures_->width >= width && textures_->height >= height) return;
  const int wide = textures_ ? std::max(textures_->width, width) : width,
            high = textures_ ? std::max(textures_->height, height) : height;
  CoverTextures& t = textures_.emplace();
  t.width = room(wide), t.height = room(high);
  for (const auto& [texture, format] :
       {std::pair(t.cover.get(), GL_RGBA32F), {t.distance.get(), GL_R32F}}) {
    glBindTexture(GL_TEXTURE_2D, texture);
    glTexStorage2D(GL_TEXTURE_2D, 1, static_cast<GLenum>(format), t.width, t.height);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  }
}

void ForegroundTextures::set(const std::shared_ptr<const Foreground>& foreground) {
  const auto now = foreground && !foreground->area.empty() ? foreground : nullptr;
  if (now == foreground_) return;
  foreground_ = now;
  if (!now) return;
  const int width = now->area.width(), height = now->area.height();
  make_room(width, height);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, textures_->cover.get());
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, width, height, GL_RGBA, GL_FLOAT, now->cover.data());
  glBindTexture(GL_TEXTURE_2D, textures_->distance.get());
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, width, height, GL_RED, GL_FLOAT, now->distance_m.data());
}

void ForegroundTextures::place(const Rect& canvas, int scale) {
  canvas_ = canvas;
  scale_ = scale;
}

void ForegroundTextures::bind(GLuint program) const {
  if (!foreground_) return;
  const auto at = [&](const char* name) { return glGetUniformLocation(program, name); };
  const Rect& area = foreground_->area;
  glUniform3f(at("foreground_place"), static_cast<float>(canvas_.x0 - area.x0),
              static_cast<float>(canvas_.y0 - area.y0), 1.f / static_cast<float>(scale_));
  glUniform2i(at("foreground_size"), area.width(), area.height());
  glUniform2f(at("foreground_margin"), Foreground::kMinMargin_m, Foreground::kMargin);
  for (const auto& [name, unit, texture] :
       {std::tuple("foreground_cover", kCoverUnit, textures_->cover.get()),
        {"foreground_distance", kDistanceUnit, textures_->distance.get()}}) {
    glActiveTexture(GL_TEXTURE0 + static_cast<GLenum>(unit));
    glBindTexture(GL_TEXTURE_2D, texture);
    glUniform1i(at(name), unit);
  }
  glActiveTexture(GL_TEXTURE0);
}

}  // namespace penumbra::compositor
