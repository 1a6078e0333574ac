// The shadow of things that stand together, as one map.
#pragma once

#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "shadows/silhouette/shadow_map.h"

namespace penumbra::shadows {

// Empty where nothing throws a shadow. Things far apart fail.
inline void render_shadow_map(const ShadowCasters& casters, const prt::Plane& plane,
                              const lighting::DistantLight& source, const ShadowMapOptions& options,
                              ShadowMap& out) {
  std::vector<ShadowMap> maps(1);
  maps[0] = std::move(out);
  render_shadow_maps(casters, plane, source, options, maps);
  ASSERT_EQ(maps.size(), 1u);
  out = std::move(maps[0]);
}

}  // namespace penumbra::shadows
