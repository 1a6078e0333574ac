#include "tools/pictures/camera_film.h"

#include <fmt/format.h>

#include <algorithm>

#include "capture/recording/undamaged_frames.h"

namespace penumbra::tools {

Result<CameraFilm> CameraFilm::of(std::unique_ptr<capture::FrameSource> source,
                                  const std::string& path, const std::string& camera) {
  const auto& cameras = source->cameras();
  const auto found = std::ranges::find(cameras, camera, &capture::CameraInfo::name);
  if (found == cameras.end())
    return fail(ErrorCode::kNotFound, path, fmt::format("has no camera \"{}\"", camera));
  const auto index = static_cast<std::size_t>(found - cameras.begin());
  return CameraFilm(std::move(source), index);
}

Result<CameraFilm> CameraFilm::open(const std::string& path, const std::string& camera) {
  PENUMBRA_ASSIGN(source, capture::UndamagedFrames::open(path));
  return of(std::move(source), path, camera);
}

Result<std::optional<capture::Frame>> CameraFilm::next() {
  while (true) {
    auto frame = source_->next();
    if (!frame || !*frame || (*frame)->camera == static_cast<int>(index_)) return frame;
  }
}

}  // namespace penumbra::tools
