#include "runtime/foreground/foreground_stage.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <utility>
#include <variant>

#include "prt/rays/rays.h"
#include "runtime/foreground/internal/depth_splat.h"
#include "runtime/foreground/internal/soft_edges.h"
#include "runtime/scene/depth_mesh.h"

namespace penumbra::runtime {

struct ForegroundStage::Impl {
  struct ForegroundSource {
    int camera;
    capture::CameraInfo info;
    DepthRays rays;  // of a depth camera
    std::optional<capture::Frame> newest{};
    DepthFront front{};  // of the newest, of a depth camera

    bool is_depth() const { return info.role == capture::Role::kDepth; }
    bool tells_of(TimestampNs time) const {
      return newest && std::abs(Seconds(time - newest->time).count()) <= kOldest.count();
    }
  };

  Result<void> check(const ForegroundSource& source, const FramePixels& pixels) const;
  void lay(const ForegroundSource& source, const SplatView& view);
  std::shared_ptr<compositor::Foreground> unused();
  bool is_known(const glm::dvec3& eye, const glm::dvec3& point) const;

  std::vector<ForegroundSource> sources;
  std::vector<prt::Plane> planes;
  std::optional<prt::RayScene> mesh;  // of the scene
  std::uint64_t depth_frames = 0;
  Silhouettes silhouettes;  // scratch, as the next two
  SplatRow row;
  EdgeScratch edges;
  std::vector<std::shared_ptr<compositor::Foreground>> handed_out;
};

ForegroundStage::ForegroundStage(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ForegroundStage::~ForegroundStage() = default;
ForegroundStage::ForegroundStage(ForegroundStage&&) noexcept = default;
ForegroundStage& ForegroundStage::operator=(ForegroundStage&&) noexcept = default;

bool ForegroundStage::any() const {
  return !impl_->sources.empty();
}

Result<ForegroundStage> ForegroundStage::create(const std::vector<capture::CameraInfo>& cameras,
                                                std::span<const prt::Plane> planes,
                                                const prt::Mesh& mesh) {
  auto impl = std::make_unique<Impl>();
  impl->planes.assign(planes.begin(), planes.end());
  const auto views = std::ranges::count(cameras, capture::Role::kView, &capture::CameraInfo::role);
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const capture::CameraInfo& c = cameras[i];
    if (capture::sees_light(c.role)) continue;
    if (c.role == capture::Role::kMask && views > 1)
      return fail(ErrorCode::kInvalid, c.name, "is a mask, which goes with one view camera alone");
    Impl::ForegroundSource source{static_cast<int>(i), c, {}};
    if (source.is_depth()) {
      auto rays = DepthRays::create(c.projection);
      if (!rays) return fail(rays.error().code, c.name, rays.error().detail);
      source.rays = std::move(*rays);
      if (!mesh.triangles.empty() && !impl->mesh) {
        PENUMBRA_ASSIGN(known, prt::RayScene::build(mesh));
        impl->mesh.emplace(std::move(known));
      }
    }
    impl->sources.push_back(std::move(source));
  }
  return ForegroundStage(std::move(impl));
}

Result<void> ForegroundStage::Impl::check(const ForegroundSource& source,
                                          const FramePixels& pixels) const {
  const calib::CameraModel& camera = source.info.projection;
  if (source.is_depth() && !std::holds_alternative<Image<Rgb16>>(pixels))
    return fail(ErrorCode::kInvalid, source.info.name, "has depth that is not of 16 bits");
  if (std::holds_alternative<Image<Rgb>>(pixels))
    return fail(ErrorCode::kInvalid, source.info.name, "has a mask that is not of 8 or 16 bits");
  const int w = capture::width(pixels), h = capture::height(pixels);
  if (w == camera.width && h == camera.height) return {};
  return fail(ErrorCode::kInvalid, source.info.name,
              fmt::format("has a frame of {}x{} pixels instead of {}x{}", w, h, camera.width,
                          camera.height));
}

Result<void> ForegroundStage::add(const capture::Frame& frame) {
  const auto source =
      std::ranges::find(impl_->sources, frame.camera, &Impl::ForegroundSource::camera);
  if (source == impl_->sources.end() || !frame.pixels)
    return fail(ErrorCode::kInvalid, "frame", "belongs to no depth camera and no mask");
  PENUMBRA_TRY(impl_->check(*source, *frame.pixels));
  source->newest = frame;
  if (!source->is_depth()) return {};
  ++impl_->depth_frames;
  find_front(std::get<Image<Rgb16>>(*frame.pixels), static_cast<float>(source->info.depth_unit_m),
             source->rays, frame.world_from_camera, impl_->planes, source->front);
  return {};
}

bool ForegroundStage::tells_of(TimestampNs time) const {
  return std::ranges::any_of(impl_->sources, [&](const Impl::ForegroundSource& s) {
    return s.is_depth() && s.tells_of(time);
  });
}

std::uint64_t ForegroundStage::depth_frames() const {
  return impl_->depth_frames;
}

// Whether a point that is seen from `eye` is on the scene's own mesh, or behind it.
bool ForegroundStage::Impl::is_known(const glm::dvec3& eye, const glm::dvec3& point) const {
  if (!mesh) return false;
  const double distance = glm::distance(eye, point);
  const auto hit = mesh->intersect(glm::vec3(eye), glm::vec3((point - eye) / distance), 0);
  const float far = static_cast<float>(distance);
  return hit && hit->distance < far + compositor::Foreground::margin_m(far);
}

prt::Mesh ForegroundStage::surface_near(std::span<const shadows::BoundingSphere> spheres,
                                        TimestampNs time) const {
  constexpr double kReach_m = 1;    // what stands farther off is where lights may stand, too
  constexpr int kMaxVertices = 96;  // along the longer side
  const auto source = std::ranges::find_if(impl_->sources, [&](const Impl::ForegroundSource& s) {
    return s.is_depth() && s.tells_of(time) && !s.front.area.empty();
  });
  if (source == impl_->sources.end()) return {};
  const DepthFront& front = source->front;
  const compositor::Rect& area = front.area;
  Image<float> depth(area.width(), area.height());
  for (int y = 0; y < area.height(); ++y)
    std::ranges::copy(front.depth_m.row(area.y0 + y)
                          .subspan(static_cast<std::size_t>(area.x0), depth.row(y).size()),
                      depth.row(y).begin());
  const auto is_near = [&](const glm::dvec3& point) {
    return std::ranges::any_of(spheres, [&](const shadows::BoundingSphere& s) {
      return glm::distance(point, s.centre) < s.radius + kReach_m;
    });
  };
  const auto ray = [&](const glm::dvec2& pixel, float d) -> std::optional<glm::dvec2> {
    const int x = area.x0 + std::min(static_cast<int>(pixel.x), area.width() - 1),
              y = area.y0 + std::min(static_cast<int>(pixel.y), area.height() - 1);
    const glm::dvec2 towards(source->rays.x.at(x, y), source->rays.y.at(x, y));
    if (!std::isfinite(towards.x) || !std::isfinite(towards.y)) return std::nullopt;
    const glm::dvec3 point = front.world_from_camera * (double(d) * glm::dvec3(towards, -1));
    const bool counts =
        is_near(point) && !impl_->is_known(front.world_from_camera.translation, point);
    return counts ? std::optional(towards) : std::nullopt;
  };
  auto mesh = mesh_from_depth(depth, ray, front.world_from_camera, {}, kMaxVertices);
  return mesh ? std::move(*mesh) : prt::Mesh{};
}

// One that nobody looks at any more.
std::shared_ptr<compositor::Foreground> ForegroundStage::Impl::unused() {
  const auto free =
      std::ranges::find_if(handed_out, [](const auto& f) { return f.use_count() == 1; });
  if (free != handed_out.end()) return *free;
  return handed_out.emplace_back(std::make_shared<compositor::Foreground>());
}

void ForegroundStage::Impl::lay(const ForegroundSource& source, const SplatView& view) {
  const FramePixels& pixels = *source.newest->pixels;
  if (source.is_depth())
    splat_depth(source.front, source.rays, view, row, silhouettes);
  else if (const auto* const mask = std::get_if<Image<Rgb8>>(&pixels))
    lay_mask(*mask, silhouettes);
  else
    lay_mask(std::get<Image<Rgb16>>(pixels), silhouettes);
}

void ForegroundStage::go_on_from(const ForegroundStage& before) {
  for (const Impl::ForegroundSource& s : before.impl_->sources)
    if (s.newest) (void)add(*s.newest);  // of the same cameras, which took it
}

std::shared_ptr<const compositor::Foreground> ForegroundStage::in_front_of(
    const capture::Frame& view, const ViewOptics& optics,
    std::span<const shadows::BoundingSphere> spheres) {
  const auto tells = [&](const Impl::ForegroundSource& s) { return s.tells_of(view.time); };
  if (std::ranges::none_of(impl_->sources, tells)) return nullptr;
  // A wall behind all objects hides none of them, and is background to a hand before it.
  double farthest = 0;
  for (const shadows::BoundingSphere& s : spheres)
    farthest =
        std::max(farthest, glm::distance(s.centre, view.world_from_camera.translation) + s.radius);
  const SplatView to{optics.camera, optics.lens, view.world_from_camera,
                     static_cast<float>(farthest)};
  impl_->silhouettes.reset(optics.camera.width, optics.camera.height);
  for (const Impl::ForegroundSource& s : impl_->sources)
    if (tells(s)) impl_->lay(s, to);
  if (impl_->silhouettes.area.empty()) return nullptr;
  auto out = impl_->unused();
  find_cover(impl_->silhouettes, *view.pixels, optics.curve, optics.vignetting, impl_->edges, *out);
  return out;
}

}  // namespace penumbra::runtime
