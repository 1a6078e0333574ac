// The programs that draw layers, through a pinhole or through a lens.
// threads: thread-bound, to the one of the GL context
#pragma once

#include <array>
#include <compare>
#include <cstdint>
#include <glm/vec4.hpp>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "compositor/layers/foreground_textures.h"
#include "compositor/layers/gl/gl.h"
#include "compositor/layers/glossy_program.h"
#include "compositor/projection.h"
#include "compositor/view_lens.h"

namespace penumbra::compositor {

class LayerPrograms {
 public:
  enum class LayerDrawing { kObject, kTexturedObject, kRealMesh };

  static Result<LayerPrograms> create();

  /// What drawing through this lens takes, null for a pinhole, and behind this foreground, null
  /// without. What follows is for both, until the next call.
  /// errors: kUnavailable
  Result<void> prepare(const std::shared_ptr<const ViewLens>& lens,
                       const std::shared_ptr<const Foreground>& foreground);
  /// Of the canvas that is drawn on next: its corner in the picture, and its samples a pixel along
  /// each axis.
  void place_foreground(const Rect& canvas, int scale) { foreground_.place(canvas, scale); }

  /// Makes a program current for points of the projection's frame, whose lens is prepared.
  /// cut: whether some may lie beside all that a lens shows, or behind hiding planes, which takes
  /// longer; without a lens GL cuts by itself
  GLuint use(LayerDrawing drawing, const ViewProjection& from_points, bool cut) const;

  /// Programs of surfaces with materials: without a GPU what a program leaves out is what it does
  /// not pay for, so there is one for each set of features.
  /// errors: kUnavailable
  Result<void> prepare_glossy(GlossyFeatures features);
  /// features: prepared
  GLuint use_glossy(GlossyFeatures features, const ViewProjection& from_points, bool cut) const;

  /// Planes in the camera's frame, n.p + d < 0 behind them: what a lens shows of objects ends
  /// there, for a plane that is drawn itself would have to be bent. At most kMaxPlanes count.
  static constexpr std::size_t kMaxPlanes = 16;
  void set_hiding_planes(GLuint program, std::span<const glm::dvec4> planes) const;

 private:
  using Programs = std::array<GlProgram, 3>;  // by LayerDrawing
  struct LensTable {
    std::shared_ptr<const ViewLens> lens;
    GlTexture radius{};
  };
  enum class Way : std::uint8_t { kPinhole, kLens, kCutLens };
  struct ProgramKind {
    Way way = Way::kPinhole;
    bool foreground = false;
    friend auto operator<=>(const ProgramKind&, const ProgramKind&) = default;
  };
  static Result<Programs> make(ProgramKind kind);
  Result<void> prepare(ProgramKind kind);
  std::array<ProgramKind, 2> kinds() const;
  ProgramKind kind_of(const ViewProjection& from_points, bool cut) const;
  void set_up(GLuint program, const ViewProjection& from_points) const;

  std::map<ProgramKind, Programs> programs_;
  std::map<std::pair<ProgramKind, GlossyFeatures>, GlProgram> glossy_;
  std::vector<LensTable> tables_;  // one a camera
  bool through_lens_ = false;
  ForegroundTextures foreground_;
};

}  // namespace penumbra::compositor
