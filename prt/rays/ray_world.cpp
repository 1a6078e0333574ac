#include <embree3/rtcore.h>

#include <algorithm>
#include <utility>

#include "prt/geometry/mesh.h"
#include "prt/rays/internal/embree_mesh.h"
#include "prt/rays/rays.h"

namespace penumbra::prt {

namespace {

// Rays into the frame of a mesh. RayPacket traversal looks at the bounds of all lanes: unused ones
// repeat the first ray.
void turn_rays(const RayWorld::Rays& in, int count, const glm::mat3& turn, const glm::vec3& shift,
               RTCRay16& out) {
  for (int i = 0; i < RayWorld::kPacket; ++i) {
    const int from = i < count ? i : 0;
    const glm::vec3 o = turn * glm::vec3(in.ox[from], in.oy[from], in.oz[from]) + shift;
    const glm::vec3 d = turn * glm::vec3(in.dx[from], in.dy[from], in.dz[from]);
    out.org_x[i] = o.x, out.org_y[i] = o.y, out.org_z[i] = o.z;
    out.dir_x[i] = d.x, out.dir_y[i] = d.y, out.dir_z[i] = d.z;
  }
}

// Lanes whose ray meets the sphere.
std::uint32_t near_sphere(const RTCRay16& rays, const glm::vec3& centre, float radius) {
  std::uint32_t mask = 0;
  for (int i = 0; i < RayWorld::kPacket; ++i) {
    const glm::vec3 to = centre - glm::vec3(rays.org_x[i], rays.org_y[i], rays.org_z[i]);
    const glm::vec3 d(rays.dir_x[i], rays.dir_y[i], rays.dir_z[i]);
    const float along = glm::dot(to, d), square = glm::dot(to, to), r2 = radius * radius;
    if (square <= r2 || (along > 0 && square - along * along <= r2)) mask |= 1u << i;
  }
  return mask;
}

}  // namespace

// One scene a mesh and no instancing: a handful of meshes costs a turn of the rays each, which a
// sphere around the mesh often spares. Shadow rays to a light scatter along silhouettes, so packets
// are declared incoherent: twice as fast for wide lights (and coherent packets of Embree 3.13 do
// not end in instanced scenes).
struct RayWorld::Impl {
  struct Body {
    RTCScene scene;
    glm::vec3 centre;  // mesh frame
    float radius;
    Pose world_from_mesh;
    glm::mat3 turn;  // mesh from world
    glm::vec3 shift;

    std::uint32_t occluded(const Rays& rays, int count, std::uint32_t wanted) const;
    void intersect(const Rays& rays, int mesh, Hits& nearest) const;
  };
  RTCDevice device = nullptr;
  std::vector<Body> bodies;
  void clear() {
    for (const Body& b : bodies) rtcReleaseScene(b.scene);
    bodies.clear();
  }
  ~Impl() {
    clear();
    if (device) rtcReleaseDevice(device);
  }
};

std::uint32_t RayWorld::Impl::Body::occluded(const Rays& rays, int count,
                                             std::uint32_t wanted) const {
  RTCRay16 query;
  turn_rays(rays, count, turn, shift, query);
  wanted &= near_sphere(query, centre, 1.001f * radius);
  if (wanted == 0) return 0;
  alignas(64) int active[kPacket];
  for (int i = 0; i < kPacket; ++i) active[i] = wanted >> i & 1 ? -1 : 0;
  std::fill_n(query.tnear, kPacket, 0.f);
  for (int i = 0; i < kPacket; ++i) query.tfar[i] = rays.far[i < count ? i : 0];
  std::fill_n(query.time, kPacket, 0.f);
  std::fill_n(query.mask, kPacket, 0xffffffffu);
  std::fill_n(query.flags, kPacket, 0u);
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
  rtcOccluded16(active, scene, &context, &query);
  std::uint32_t blocked = 0;
  for (int i = 0; i < count; ++i)
    if (query.tfar[i] < 0) blocked |= 1u << i;
  return blocked;
}

void RayWorld::Impl::Body::intersect(const Rays& rays, int mesh, Hits& nearest) const {
  RTCRayHit16 query;
  turn_rays(rays, kPacket, turn, shift, query.ray);
  const std::uint32_t wanted = near_sphere(query.ray, centre, 1.001f * radius);
  if (wanted == 0) return;
  alignas(64) int active[kPacket];
  for (int i = 0; i < kPacket; ++i) {
    active[i] = wanted >> i & 1 ? -1 : 0;
    query.ray.tnear[i] = 0;
    query.ray.tfar[i] = nearest.distance[i];
    query.ray.time[i] = 0;
    query.ray.mask[i] = 0xffffffffu;
    query.ray.flags[i] = 0;
    query.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
    query.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
  }
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
  rtcIntersect16(active, scene, &context, &query);
  for (int i = 0; i < kPacket; ++i) {
    if (query.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID) continue;
    nearest.distance[i] = query.ray.tfar[i];
    nearest.u[i] = query.hit.u[i], nearest.v[i] = query.hit.v[i];
    nearest.triangle[i] = query.hit.primID[i];
    nearest.mesh[i] = mesh;
  }
}

RayWorld::RayWorld(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RayWorld::~RayWorld() = default;
RayWorld::RayWorld(RayWorld&&) noexcept = default;
RayWorld& RayWorld::operator=(RayWorld&&) noexcept = default;

Result<RayWorld> RayWorld::create() {
  auto impl = std::make_unique<Impl>();
  impl->device = rtcNewDevice(nullptr);
  if (!impl->device) return fail(ErrorCode::kUnavailable, "Embree", "cannot create a device");
  return RayWorld(std::move(impl));
}

Result<int> RayWorld::add(const Mesh& mesh) {
  if (mesh.triangles.empty()) return fail(ErrorCode::kInvalid, "mesh", "has no triangles");
  // Not robust, a quarter faster: one ray in a million may slip through an edge, of sixteen that
  // are averaged.
  RTCScene scene = build_embree_scene(impl_->device, mesh, RTC_SCENE_FLAG_NONE);
  if (!scene) return fail(ErrorCode::kUnavailable, "Embree", "finds no memory for the ray scene");
  const glm::vec3 centre = bounds_of(mesh).centre();
  impl_->bodies.push_back(
      {scene, centre, radius_around(mesh, centre), {}, glm::mat3(1), {0, 0, 0}});
  return static_cast<int>(impl_->bodies.size()) - 1;
}

void RayWorld::set_pose(int mesh, const Pose& world_from_mesh) {
  Impl::Body& body = impl_->bodies[static_cast<std::size_t>(mesh)];
  const Pose mesh_from_world = world_from_mesh.inverse();
  body.world_from_mesh = world_from_mesh;
  body.turn = glm::mat3(mesh_from_world.rotation_matrix());
  body.shift = glm::vec3(mesh_from_world.translation);
}

void RayWorld::update_vertices(int mesh, const Mesh& form) {
  Impl::Body& body = impl_->bodies[static_cast<std::size_t>(mesh)];
  set_embree_form(body.scene, form);
  body.centre = bounds_of(form).centre();
  body.radius = radius_around(form, body.centre);
}

void RayWorld::clear() {
  impl_->clear();
}

bool RayWorld::empty() const {
  return impl_->bodies.empty();
}

std::uint32_t RayWorld::occluded(const Rays& rays, int count, int except) const {
  std::uint32_t open = (1u << count) - 1, blocked = 0;
  for (std::size_t i = 0; i < impl_->bodies.size() && open != 0; ++i) {
    if (static_cast<int>(i) == except) continue;
    blocked |= impl_->bodies[i].occluded(rays, count, open);
    open &= ~blocked;
  }
  return blocked;
}

std::uint32_t RayWorld::occluded_by(int mesh, const Rays& rays, int count) const {
  return impl_->bodies[static_cast<std::size_t>(mesh)].occluded(rays, count, (1u << count) - 1);
}

void RayWorld::intersect(int mesh, const Rays& rays, Hits& nearest) const {
  impl_->bodies[static_cast<std::size_t>(mesh)].intersect(rays, mesh, nearest);
}

}  // namespace penumbra::prt
