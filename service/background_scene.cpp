#include "service/background_scene.h"

#include <exception>

namespace penumbra::service {

BackgroundScene::BackgroundScene(const runtime::Scene& scene, const runtime::BakeSettings& settings,
                                 const ProgressOf& progress)
    : prepared_(std::async(std::launch::async,
                           [scene, settings, progress]() -> Result<runtime::PreparedScene> {
                             try {
                               return runtime::prepare(scene, settings, progress);
                             } catch (const std::exception& e) {
                               return fail(ErrorCode::kUnavailable, "the scene", e.what());
                             }
                           })) {}

bool BackgroundScene::is_ready(std::chrono::milliseconds within) const {
  return prepared_.wait_for(within) == std::future_status::ready;
}

Result<runtime::PreparedScene> BackgroundScene::take() {
  return prepared_.get();
}

}  // namespace penumbra::service
