#include "compositor/layers/canvas.h"

#include <utility>

namespace penumbra::compositor {

namespace {

// Room is made in such steps, so that a rectangle that grows or moves rarely needs a new canvas.
constexpr int kStep = 64;
int rounded_up(int pixels) {
  return (pixels + kStep - 1) / kStep * kStep;
}

constexpr GLenum kAttachments[] = {GL_COLOR_ATTACHMENT0, GL_COLOR_ATTACHMENT1};

}  // namespace

bool Canvas::fits(const Rect& rect) const {
  const int w = rounded_up(rect.width()), h = rounded_up(rect.height());
  return w <= width_ && h <= height_ && static_cast<long>(width_) * height_ <= 2l * w * h;
}

// What is drawn on: depth beside colour, in samples or larger than the rest.
void Canvas::attach_fine(Target& t) {
  const GLsizei samples = multisampled() ? kSamples : 0;
  const int width = t.scale * width_, height = t.scale * height_;
  if (multisampled()) {
    glBindRenderbuffer(GL_RENDERBUFFER, samples_.get());
    glRenderbufferStorageMultisample(GL_RENDERBUFFER, samples, GL_RGBA16F, width, height);
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_RENDERBUFFER,
                              samples_.get());
  }
  glBindRenderbuffer(GL_RENDERBUFFER, fine_depth_.get());
  glRenderbufferStorageMultisample(GL_RENDERBUFFER, samples, GL_DEPTH_COMPONENT24, width, height);
  glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_RENDERBUFFER,
                            fine_depth_.get());
}

void Canvas::attach_pictures(Target& t) const {
  const std::size_t count = picture_count();
  for (std::size_t i = 0; i < count; ++i) {
    glBindTexture(GL_TEXTURE_2D, t.pictures[i].get());
    glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGBA16F, t.scale * width_, t.scale * height_);
    glFramebufferTexture2D(GL_FRAMEBUFFER, kAttachments[i], GL_TEXTURE_2D, t.pictures[i].get(), 0);
  }
  glDrawBuffers(static_cast<GLsizei>(count), kAttachments);
}

// Larger and averaged: without a GPU that takes less time than multisampling, as long as shading
// takes next to none.
Result<void> Canvas::make_targets() {
  targets_.clear();
  fine_depth_ = {};
  samples_ = {};
  const auto add = [&](int scale, bool fine) -> Result<void> {
    Target t;
    t.scale = scale;
    glBindFramebuffer(GL_FRAMEBUFFER, t.framebuffer.get());
    if (!fine || !multisampled()) attach_pictures(t);
    if (fine) attach_fine(t);
    if (glCheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
      width_ = height_ = 0;
      return fail(ErrorCode::kUnavailable, "GL",
                  "cannot render to half-float framebuffers of this size");
    }
    targets_.push_back(std::move(t));
    return {};
  };
  PENUMBRA_TRY(add(oversampling_, true));
  if (multisampled()) PENUMBRA_TRY(add(oversampling_, false));
  for (int scale = oversampling_ / 2; scale >= 1; scale /= 2) PENUMBRA_TRY(add(scale, false));
  return {};
}

Result<void> Canvas::begin(const Rect& rect, int frame_width, int frame_height) {
  if (!fits(rect)) {
    width_ = rounded_up(rect.width());
    height_ = rounded_up(rect.height());
    PENUMBRA_TRY(make_targets());
  }
  glBindFramebuffer(GL_FRAMEBUFFER, targets_.front().framebuffer.get());
  glViewport(-oversampling_ * rect.x0, -oversampling_ * rect.y0, oversampling_ * frame_width,
             oversampling_ * frame_height);
  glDisable(GL_SCISSOR_TEST);
  glEnable(GL_DEPTH_TEST);
  glClearColor(0, 0, 0, 0);
  glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
  glFrontFace(GL_CW);  // clip y points down
  return {};
}

// All of the drawing before the first read, which waits for it.
void Canvas::finish(Layer& out) {
  for (std::size_t i = 0; i < picture_count(); ++i) halve(i, out.rect);
  read(0, out.rect, out.halves);
  if (kind_ == CanvasKind::kWeighted) read(1, out.rect, out.weights);
}

// A linear blit of exactly two to one reads between four samples: their mean.
void Canvas::halve(std::size_t picture, const Rect& rect) const {
  const int w = rect.width(), h = rect.height();
  const std::array<GLenum, 2> only{picture == 0 ? GLenum{GL_COLOR_ATTACHMENT0} : GLenum{GL_NONE},
                                   GL_COLOR_ATTACHMENT1};
  for (std::size_t i = 1; i < targets_.size(); ++i) {
    const int from = targets_[i - 1].scale, to = targets_[i].scale;
    glBindFramebuffer(GL_READ_FRAMEBUFFER, targets_[i - 1].framebuffer.get());
    glReadBuffer(kAttachments[picture]);
    glBindFramebuffer(GL_DRAW_FRAMEBUFFER, targets_[i].framebuffer.get());
    glDrawBuffers(static_cast<GLsizei>(picture + 1), only.data());
    glBlitFramebuffer(0, 0, from * w, from * h, 0, 0, to * w, to * h, GL_COLOR_BUFFER_BIT,
                      from == to ? GL_NEAREST : GL_LINEAR);
  }
}

void Canvas::read(std::size_t picture, const Rect& rect, std::vector<std::uint16_t>& out) const {
  out.resize(static_cast<std::size_t>(rect.width()) * static_cast<std::size_t>(rect.height()) * 4);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, targets_.back().framebuffer.get());
  glReadBuffer(kAttachments[picture]);
  glReadPixels(0, 0, rect.width(), rect.height(), GL_RGBA, GL_HALF_FLOAT, out.data());
}

}  // namespace penumbra::compositor
