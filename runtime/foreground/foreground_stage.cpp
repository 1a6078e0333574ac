#include "runtime/foreground/foreground_stage.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>
#include <variant>

#include "runtime/foreground/internal/depth_splat.h"
#include "runtime/foreground/internal/soft_edges.h"

namespace penumbra::runtime {

struct ForegroundStage::Impl {
  struct Source {
    int camera;
    capture::CameraInfo info;
    DepthRays rays;  // of a depth camera
    std::optional<capture::Frame> newest{};
  };

  void lay(const Source& source, const capture::Frame& view, const calib::CameraModel& camera,
           const compositor::ViewLens* lens);
  std::shared_ptr<compositor::Foreground> unused();

  std::vector<Source> sources;
  std::vector<prt::Plane> planes;
  Silhouettes silhouettes;  // scratch, as rows
  DepthRows rows;
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
                                                std::span<const prt::Plane> planes) {
  auto impl = std::make_unique<Impl>();
  impl->planes.assign(planes.begin(), planes.end());
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const capture::CameraInfo& c = cameras[i];
    if (capture::sees_light(c.role)) continue;
    Impl::Source source{static_cast<int>(i), c, {}};
    if (c.role == capture::Role::kDepth) {
      auto rays = DepthRays::create(c.projection);
      if (!rays) return fail(rays.error().code, c.name, rays.error().detail);
      source.rays = std::move(*rays);
    }
    impl->sources.push_back(std::move(source));
  }
  return ForegroundStage(std::move(impl));
}

Result<void> ForegroundStage::add(const capture::Frame& frame) {
  const auto source = std::ranges::find(impl_->sources, frame.camera, &Impl::Source::camera);
  if (source == impl_->sources.end() || !frame.pixels)
    return fail(ErrorCode::kInvalid, "frame", "belongs to no depth camera and no mask");
  const capture::CameraInfo& info = source->info;
  const bool depth = info.role == capture::Role::kDepth;
  if (depth && !std::holds_alternative<Image<Rgb16>>(*frame.pixels))
    return fail(ErrorCode::kInvalid, info.name, "has depth that is not of 16 bits");
  if (std::holds_alternative<Image<Rgb>>(*frame.pixels))
    return fail(ErrorCode::kInvalid, info.name, "has a mask that is not of 8 or 16 bits");
  const int w = capture::width(*frame.pixels), h = capture::height(*frame.pixels);
  if (w != info.projection.width || h != info.projection.height)
    return fail(ErrorCode::kInvalid, info.name,
                fmt::format("has a frame of {}x{} pixels instead of {}x{}", w, h,
                            info.projection.width, info.projection.height));
  source->newest = frame;
  return {};
}

// One that nobody looks at any more.
std::shared_ptr<compositor::Foreground> ForegroundStage::Impl::unused() {
  const auto free =
      std::ranges::find_if(handed_out, [](const auto& f) { return f.use_count() == 1; });
  if (free != handed_out.end()) return *free;
  return handed_out.emplace_back(std::make_shared<compositor::Foreground>());
}

void ForegroundStage::Impl::lay(const Source& s, const capture::Frame& view,
                                const calib::CameraModel& camera,
                                const compositor::ViewLens* lens) {
  const FramePixels& pixels = *s.newest->pixels;
  if (s.info.role == capture::Role::kDepth)
    splat_depth({std::get<Image<Rgb16>>(pixels), static_cast<float>(s.info.depth_unit_m), s.rays,
                 s.newest->world_from_camera},
                planes, {camera, lens, view.world_from_camera}, rows, silhouettes);
  else if (const auto* const mask = std::get_if<Image<Rgb8>>(&pixels))
    lay_mask(*mask, silhouettes);
  else
    lay_mask(std::get<Image<Rgb16>>(pixels), silhouettes);
}

std::shared_ptr<const compositor::Foreground> ForegroundStage::in_front_of(
    const capture::Frame& view, const calib::CameraModel& camera, const compositor::ViewLens* lens,
    const ResponseTable* curve) {
  const auto tells = [&](const Impl::Source& s) {
    return s.newest && std::abs(Seconds(view.time - s.newest->time).count()) <= kOldest.count();
  };
  if (std::ranges::none_of(impl_->sources, tells)) return nullptr;
  impl_->silhouettes.reset(camera.width, camera.height);
  for (const Impl::Source& s : impl_->sources)
    if (tells(s)) impl_->lay(s, view, camera, lens);
  if (impl_->silhouettes.area.empty()) return nullptr;
  auto out = impl_->unused();
  find_cover(impl_->silhouettes, *view.pixels, curve, *out);
  return out;
}

}  // namespace penumbra::runtime
