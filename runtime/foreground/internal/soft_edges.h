// How much of a pixel a thing covers, by the colours on both sides of its edge.
// threads: plain values
#pragma once

#include "calib/camera/response_table.h"
#include "calib/camera/vignetting.h"
#include "compositor/foreground.h"
#include "core/image.h"
#include "runtime/foreground/internal/depth_splat.h"

namespace penumbra::runtime {

/// Depth says within some pixels where a thing ends. There, a pixel is a mixture of what the
/// picture shows of the thing and of the background nearby; where both look alike, or change too
/// much, depth alone tells.
/// source: alpha as the projection onto the line between two colours, Ruzon & Tomasi 2000
void find_cover(const Silhouettes& silhouettes, const FramePixels& picture,
                const ResponseTable* curve, const Vignetting& vignetting,
                compositor::Foreground& out);

}  // namespace penumbra::runtime
