// The newest light in a file that other programs map, written without ever waiting for them.
// threads: thread-safe
#pragma once

#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <span>

#include "core/environment.h"
#include "core/result.h"
#include "lighting/light_estimate.h"
#include "lighting/reflections/cube_map.h"
#include "runtime/shading/object_moves.h"

struct penumbra_light_page;

namespace penumbra::service {

/// source: service/client/penumbra_light_page.h tells layout and sequences
class LightPage {
 public:
  /// errors: kUnwritable (the folder, the file), kUnavailable (another service writes it)
  static Result<std::unique_ptr<LightPage>> create(const std::filesystem::path& path);
  ~LightPage();

  void write(const lighting::LightEstimate& light);
  /// Of at most 64 objects.
  void write(std::span<const runtime::ObjectState> objects, TimestampNs time);
  /// The map as a cube, at most ten times a second.
  void write(const Environment& environment);

 private:
  LightPage(std::filesystem::path path, int file, penumbra_light_page* page);
  const std::filesystem::path path_;
  const int file_;
  std::mutex mutex_;
  penumbra_light_page* const page_;  // written in the lock
  std::int64_t cube_written_ns_ = 0;
  std::optional<lighting::CubeMap> cube_of_map_;  // of the last map's size
};

}  // namespace penumbra::service
