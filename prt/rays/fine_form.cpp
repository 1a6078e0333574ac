#include "prt/rays/fine_form.h"

#include "core/threads/parallel.h"
#include "prt/rays/rays.h"

namespace penumbra::prt {

Result<FineForm> lit_by(Mesh fine, const Mesh& coarse) {
  constexpr float kBehind = .05f;  // of the radius
  PENUMBRA_ASSIGN(scene, RayScene::build(coarse));
  const float behind = kBehind * radius_of(coarse);
  FineForm out{.mesh = std::move(fine), .surface = nullptr, .lit_at = {}};
  out.lit_at.resize(out.mesh.positions.size());
  parallel_for(0, static_cast<int>(out.lit_at.size()), 256, [&](const auto& vertices) {
    for (int i = vertices.begin(); i < vertices.end(); ++i) {
      const auto vertex = static_cast<std::size_t>(i);
      const Hit at = scene.nearest(out.mesh.positions[vertex], out.mesh.normals[vertex], behind);
      out.lit_at[vertex] = {coarse.triangles[at.triangle], at.u, at.v};
    }
  });
  return out;
}

}  // namespace penumbra::prt
