#include <embree3/rtcore.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>
#include <limits>

#include "prt/geometry/mesh.h"
#include "prt/rays/internal/embree_mesh.h"
#include "prt/rays/rays.h"

namespace penumbra::prt {

struct RayScene::Impl {
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
  ~Impl() {
    if (scene) rtcReleaseScene(scene);
    if (device) rtcReleaseDevice(device);
  }
};

RayScene::RayScene(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RayScene::~RayScene() = default;
RayScene::RayScene(RayScene&&) noexcept = default;
RayScene& RayScene::operator=(RayScene&&) noexcept = default;

namespace {

// Where Embree 3.13 finds no memory half way it ends the program: so much more than it takes is
// asked for, and given back.
bool has_room_for(const Mesh& mesh) {
  constexpr std::size_t kAtOnce = std::size_t{64} << 20, kPerTriangle = 512;
  void* volatile room = std::malloc(kAtOnce + kPerTriangle * mesh.triangles.size());
  std::free(room);
  return room != nullptr;
}

}  // namespace

RTCScene build_embree_scene(RTCDevice device, const Mesh& mesh, RTCSceneFlags flags) {
  if (!has_room_for(mesh)) return nullptr;
  RTCScene scene = rtcNewScene(device);
  rtcSetSceneFlags(scene, flags);
  rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0,
                                                               RTC_FORMAT_FLOAT3, 3 * sizeof(float),
                                                               mesh.positions.size()));
  auto* indices = static_cast<std::uint32_t*>(
      rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                              3 * sizeof(std::uint32_t), mesh.triangles.size()));
  if (vertices && indices) {
    std::copy_n(&mesh.positions[0].x, 3 * mesh.positions.size(), vertices);
    std::copy_n(mesh.triangles[0].data(), 3 * mesh.triangles.size(), indices);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
  }
  rtcReleaseGeometry(geometry);
  rtcCommitScene(scene);
  if (rtcGetDeviceError(device) == RTC_ERROR_NONE && vertices && indices) return scene;
  rtcReleaseScene(scene);
  return nullptr;
}

void set_embree_form(RTCScene scene, const Mesh& form) {
  RTCGeometry geometry = rtcGetGeometry(scene, 0);
  rtcSetSceneFlags(scene, rtcGetSceneFlags(scene) | RTC_SCENE_FLAG_DYNAMIC);
  rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_LOW);
  rtcSetGeometryBuildQuality(geometry, RTC_BUILD_QUALITY_LOW);
  auto* vertices =
      static_cast<float*>(rtcGetGeometryBufferData(geometry, RTC_BUFFER_TYPE_VERTEX, 0));
  std::copy_n(&form.positions[0].x, 3 * form.positions.size(), vertices);
  rtcUpdateGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0);
  rtcCommitGeometry(geometry);
  rtcCommitScene(scene);
}

Result<RayScene> RayScene::build(const Mesh& mesh) {
  if (mesh.triangles.empty()) return fail(ErrorCode::kInvalid, "mesh", "has no triangles");
  auto impl = std::make_unique<Impl>();
  impl->device = rtcNewDevice(nullptr);
  if (!impl->device) return fail(ErrorCode::kUnavailable, "Embree", "cannot create a device");
  // Robust: no ray slips through the shared edge of two triangles.
  impl->scene = build_embree_scene(impl->device, mesh, RTC_SCENE_FLAG_ROBUST);
  if (!impl->scene)
    return fail(ErrorCode::kUnavailable, "Embree", "finds no memory for the ray scene");
  return RayScene(std::move(impl));
}

namespace {

RTCRay make_ray(const glm::vec3& o, const glm::vec3& d, float near, float far) {
  RTCRay ray{};
  ray.org_x = o.x, ray.org_y = o.y, ray.org_z = o.z;
  ray.dir_x = d.x, ray.dir_y = d.y, ray.dir_z = d.z;
  ray.tnear = near, ray.tfar = far, ray.mask = 0xffffffffu;
  return ray;
}

constexpr int kPacket = RayScene::kPacket;
alignas(64) const
    int kAllActive[kPacket] = {-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1};

void fill(RTCRay16& ray, const glm::vec3& o, float near, const RayScene::RayPacket& p) {
  std::fill_n(ray.org_x, kPacket, o.x);
  std::fill_n(ray.org_y, kPacket, o.y);
  std::fill_n(ray.org_z, kPacket, o.z);
  std::copy_n(p.x, kPacket, ray.dir_x);
  std::copy_n(p.y, kPacket, ray.dir_y);
  std::copy_n(p.z, kPacket, ray.dir_z);
  std::fill_n(ray.tnear, kPacket, near);
  std::fill_n(ray.tfar, kPacket, 1e30f);
  std::fill_n(ray.time, kPacket, 0.f);
  std::fill_n(ray.mask, kPacket, 0xffffffffu);
  std::fill_n(ray.flags, kPacket, 0u);
}

RTCIntersectContext coherent_context() {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  return context;
}

}  // namespace

namespace {

// Weights of b and c of the place of a triangle that is nearest to p.
// source: Ericson 2004, section 5.1.5
glm::vec2 nearest_place(const glm::vec3& p, const glm::vec3& a, const glm::vec3& b,
                        const glm::vec3& c) {
  const glm::vec3 ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const float d1 = glm::dot(ab, ap), d2 = glm::dot(ac, ap), d3 = glm::dot(ab, bp),
              d4 = glm::dot(ac, bp), d5 = glm::dot(ab, cp), d6 = glm::dot(ac, cp);
  if (d1 <= 0 && d2 <= 0) return {0, 0};
  if (d3 >= 0 && d4 <= d3) return {1, 0};
  if (d6 >= 0 && d5 <= d6) return {0, 1};
  const float vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return {d1 / (d1 - d3), 0};
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return {0, d2 / (d2 - d6)};
  if (va <= 0 && d4 >= d3 && d5 >= d6) {
    const float w = (d4 - d3) / (d4 - d3 + (d5 - d6));
    return {1 - w, w};
  }
  const float sum = va + vb + vc;
  return sum > 0 ? glm::vec2(vb / sum, vc / sum) : glm::vec2(0);
}

struct NearestQuery {
  const glm::vec3* vertices;
  const std::array<std::uint32_t, 3>* triangles;
  glm::vec3 point, normal;
  float behind;
  Hit best;
};

bool keep_nearest(RTCPointQueryFunctionArguments* arguments) {
  auto& q = *static_cast<NearestQuery*>(arguments->userPtr);
  const auto& [i, j, k] = q.triangles[arguments->primID];
  const glm::vec3 &a = q.vertices[i], &b = q.vertices[j], &c = q.vertices[k];
  const glm::vec2 place = nearest_place(q.point, a, b, c);
  const glm::vec3 at = a * (1 - place.x - place.y) + b * place.x + c * place.y;
  const bool front = glm::dot(glm::cross(b - a, c - a), q.normal) > 0;
  const float distance = glm::length(at - q.point) + (front ? 0 : q.behind);
  if (!(distance < q.best.distance)) return false;  // nor of a triangle without area
  q.best = {arguments->primID, distance, place.x, place.y, front};
  arguments->query->radius = distance;
  return true;
}

}  // namespace

Hit RayScene::nearest(const glm::vec3& point, const glm::vec3& normal, float behind) const {
  RTCGeometry geometry = rtcGetGeometry(impl_->scene, 0);
  NearestQuery query{
      static_cast<const glm::vec3*>(rtcGetGeometryBufferData(geometry, RTC_BUFFER_TYPE_VERTEX, 0)),
      static_cast<const std::array<std::uint32_t, 3>*>(
          rtcGetGeometryBufferData(geometry, RTC_BUFFER_TYPE_INDEX, 0)),
      point,
      normal,
      behind,
      {0, std::numeric_limits<float>::infinity(), 0, 0, true}};
  RTCPointQuery where{point.x, point.y, point.z, 0, std::numeric_limits<float>::infinity()};
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  rtcPointQuery(impl_->scene, &where, &context, keep_nearest, &query);
  return query.best;
}

void RayScene::update_vertices(const Mesh& form) {
  set_embree_form(impl_->scene, form);
}

std::optional<Hit> RayScene::intersect(const glm::vec3& o, const glm::vec3& d, float near,
                                       float far) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRayHit query{};
  query.ray = make_ray(o, d, near, far);
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(impl_->scene, &context, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  const float facing = query.hit.Ng_x * d.x + query.hit.Ng_y * d.y + query.hit.Ng_z * d.z;
  return Hit{query.hit.primID, query.ray.tfar, query.hit.u, query.hit.v, facing < 0};
}

bool RayScene::occluded(const glm::vec3& o, const glm::vec3& d, float near, float far) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRay ray = make_ray(o, d, near, far);
  rtcOccluded1(impl_->scene, &context, &ray);
  return ray.tfar < 0;
}

void RayScene::intersect(const glm::vec3& origin, float near, RayPacket& p) const {
  RTCIntersectContext context = coherent_context();
  RTCRayHit16 query;
  fill(query.ray, origin, near, p);
  std::fill_n(query.hit.geomID, kPacket, RTC_INVALID_GEOMETRY_ID);
  std::fill_n(query.hit.instID[0], kPacket, RTC_INVALID_GEOMETRY_ID);
  rtcIntersect16(kAllActive, impl_->scene, &context, &query);
  for (int i = 0; i < kPacket; ++i) {
    const bool hit = query.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID;
    p.triangle[i] = hit ? query.hit.primID[i] : kMiss;
    p.distance[i] = query.ray.tfar[i];
    p.u[i] = query.hit.u[i];
    p.v[i] = query.hit.v[i];
    p.front[i] =
        query.hit.Ng_x[i] * p.x[i] + query.hit.Ng_y[i] * p.y[i] + query.hit.Ng_z[i] * p.z[i] < 0;
  }
}

std::uint32_t RayScene::occluded(const glm::vec3& origin, float near, const RayPacket& p) const {
  RTCIntersectContext context = coherent_context();
  RTCRay16 ray;
  fill(ray, origin, near, p);
  rtcOccluded16(kAllActive, impl_->scene, &context, &ray);
  std::uint32_t blocked = 0;
  for (int i = 0; i < kPacket; ++i)
    if (ray.tfar[i] < 0) blocked |= 1u << i;
  return blocked;
}

}  // namespace penumbra::prt
