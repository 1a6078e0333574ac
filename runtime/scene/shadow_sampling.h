// How finely what is traced in a frame is: shadows of distant lights, and mirrors.
// threads: a plain value
#pragma once

#include "shadows/silhouette/shadow_map.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

struct ShadowSampling {
  /// Rays a vertex and light; one casts a hard shadow. Half of them, at least two, serve a weak
  /// light on what knows its visibility: one that sends who faces it less than the mean light of
  /// all normals. That may be a fill light, too, on the side that the others do not reach.
  int object = 4;
  shadows::ShadowMapOptions plane;
  /// False: what surfaces mirror of virtual objects is left to their transfer, as for charts.
  bool mirrored_objects = true;
};

}  // namespace penumbra::runtime
#pragma GCC visibility pop
