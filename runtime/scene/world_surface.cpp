#include <cstdint>
#include <glm/gtc/quaternion.hpp>
#include <glm/mat3x3.hpp>
#include <limits>
#include <memory>
#include <utility>

#include "core/result.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"
#include "runtime/scene/scene.h"

namespace penumbra::runtime {

namespace {

// Nothing is mirrored; the tint tells the albedo.
prt::Material lambertian() {
  return {.name = "Lambertian", .metallic = 0, .roughness = 1, .specular = 0};
}

class SurfaceOfWorld {
 public:
  SurfaceOfWorld() { out_->materials.push_back(lambertian()); }

  void add(const prt::Mesh& mesh) {
    add_defaults(mesh.positions.size());
    out_->material.insert(out_->material.end(), mesh.positions.size(), 0);
    out_->tint.insert(out_->tint.end(), mesh.albedo.begin(), mesh.albedo.end());
  }

  Result<void> add(const prt::SurfaceMaterials& s, const glm::mat3& turn) {
    const std::size_t first = out_->materials.size(), vertices = s.material.size();
    if (first + s.materials.size() > std::numeric_limits<std::uint16_t>::max() + std::size_t{1})
      return fail(ErrorCode::kInvalid, "scene", "has more than 65,536 materials");
    out_->materials.insert(out_->materials.end(), s.materials.begin(), s.materials.end());
    for (const std::uint16_t m : s.material)
      out_->material.push_back(static_cast<std::uint16_t>(first + m));
    const std::size_t begin = out_->tangents.size();
    add_defaults(vertices);
    for (std::size_t i = 0; i < vertices; ++i) {
      for (std::size_t k = 0; k < 2; ++k)  // the first set stands for one that is not there
        if (const auto& set = s.coordinates[s.coordinates[k].empty() ? 0 : k]; !set.empty())
          out_->coordinates[k][begin + i] = set[i];
      out_->tint.push_back(s.tint.empty() ? Rgb{1, 1, 1} : s.tint[i]);
      if (!s.tangents.empty())
        out_->tangents[begin + i] = glm::vec4(turn * glm::vec3(s.tangents[i]), s.tangents[i].w);
    }
    return {};
  }

  std::shared_ptr<const prt::SurfaceMaterials> take() { return std::move(out_); }

 private:
  void add_defaults(std::size_t vertices) {
    for (auto& set : out_->coordinates) set.resize(set.size() + vertices, glm::vec2(0));
    out_->tangents.resize(out_->tangents.size() + vertices, glm::vec4(1, 0, 0, 1));
  }

  std::shared_ptr<prt::SurfaceMaterials> out_ = std::make_shared<prt::SurfaceMaterials>();
};

}  // namespace

Result<std::shared_ptr<const prt::SurfaceMaterials>> world_surface(const PreparedScene& scene,
                                                                   bool with_objects,
                                                                   double seconds) {
  SurfaceOfWorld out;
  bool any = false;
  out.add(scene.real_mesh);
  for (const PreparedObject& o : scene.objects) {
    if (!with_objects || !o.visible) continue;
    const prt::FineForm* const fine = o.baked.fine.get();
    if (const auto& surface = fine ? fine->surface : o.baked.surface) {
      PENUMBRA_TRY(out.add(*surface, glm::mat3_cast(glm::quat(o.pose_at(seconds).rotation))));
      any = true;
    } else {
      out.add(o.mesh_at(seconds));
    }
  }
  return any ? out.take() : nullptr;
}

}  // namespace penumbra::runtime
