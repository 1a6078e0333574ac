// How much of a pixel a thing covers, by the colours on both sides of its edge.
// threads: plain values
#pragma once

#include <cstdint>
#include <vector>

#include "calib/camera/response_table.h"
#include "calib/camera/vignetting.h"
#include "compositor/foreground.h"
#include "core/image.h"
#include "runtime/foreground/internal/depth_splat.h"

namespace penumbra::runtime {

/// Keeps its room from frame to frame.
struct EdgeScratch {
  /// Colours of one side of an edge, within a block of pixels.
  struct EdgeSide {
    float count = 0;
    Rgb sum, squares;
  };
  struct EdgeBlock {
    EdgeSide thing, background;
    float nearest_m = Silhouettes::kNothing;
    bool has_edge = false, near_edge = false;
  };
  std::vector<std::uint8_t> mask;
  std::vector<std::uint16_t> sums, covered;
  std::vector<EdgeBlock> blocks;
};

/// Depth says within some pixels where a thing ends. There, a pixel is a mixture of what the
/// picture shows of the thing and of the background nearby; where both look alike, or change too
/// much, depth alone tells.
/// source: alpha as the projection onto the line between two colours, Ruzon & Tomasi 2000
void find_cover(const Silhouettes& silhouettes, const FramePixels& picture,
                const ResponseTable* curve, const Vignetting& vignetting, EdgeScratch& scratch,
                compositor::Foreground& out);

}  // namespace penumbra::runtime
