#include "tools/calibrate/lens_parts.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "capture/camera_regions.h"

namespace penumbra::tools {

std::vector<RigPart> parts_of(const capture::CameraInfo& camera, std::size_t index) {
  if (camera.lenses.empty()) return {{index, std::nullopt, {camera.name, camera.projection}}};
  std::vector<RigPart> out;
  for (std::size_t k = 0; k < camera.lenses.size(); ++k)
    out.push_back(
        {index, k, {fmt::format("{} lens {}", camera.name, k + 1), camera.lenses[k].projection}});
  return out;
}

FramePixels picture_of(const RigPart& part, const capture::CameraInfo& camera,
                       const FramePixels& whole) {
  if (!part.lens) return whole;
  const capture::Lens& lens = camera.lenses[*part.lens];
  capture::CameraRegion region = capture::plain_region(lens.projection);
  region.x_px = lens.x_px, region.y_px = lens.y_px;
  return capture::cut_out(whole, region);
}

std::vector<JoinedCamera> join(std::span<const RigPart> parts, std::span<const Pose> poses,
                               const std::vector<capture::CameraInfo>& cameras) {
  std::vector<JoinedCamera> out;
  for (std::size_t i = 0; i < parts.size(); ++i) {
    const RigPart& part = parts[i];
    if (!part.lens) {
      out.push_back({part.camera, i, poses[i], {}, {}, {}});
      continue;
    }
    const std::vector<capture::Lens>& told = cameras[part.camera].lenses;
    if (*part.lens == 0)
      out.push_back(
          {part.camera,
           i,
           Pose{poses[i].rotation * glm::conjugate(told[0].camera_from_lens), poses[i].translation},
           {},
           {},
           {}});
    JoinedCamera& joined = out.back();
    capture::Lens lens = told[*part.lens];
    const glm::dquat turn =
        glm::normalize(glm::conjugate(joined.pose.rotation) * poses[i].rotation);
    const double cosine = std::abs(glm::dot(turn, lens.camera_from_lens));
    lens.camera_from_lens = turn;
    joined.lenses.push_back(lens);
    joined.apart_m.push_back(glm::distance(poses[i].translation, joined.pose.translation));
    joined.turned_rad.push_back(2 * std::acos(std::min(1., cosine)));
  }
  return out;
}

}  // namespace penumbra::tools
