#include "runtime/shading/free_transfer.h"

#include <exception>
#include <memory>
#include <utility>

#include "core/io/log.h"
#include "prt/bake/bake.h"

namespace penumbra::runtime {

FreeTransfer::FreeTransfer(prt::Mesh mesh, int bands) {
  // Work that is copied from thread to thread takes no mesh along.
  const auto shared = std::make_shared<prt::Mesh>(std::move(mesh));
  tracing_.run([this, shared, bands] {
    try {
      trace(std::move(*shared), bands);
    } catch (const std::exception& e) {
      log_warning("lifted object: its own transfer is not known: {}", e.what());
    }
  });
}

void FreeTransfer::trace(prt::Mesh mesh, int bands) {
  prt::BakeOptions options;
  options.bands = options.reflected_bands = bands;
  options.bounces = 3;
  options.rays = kRays;
  auto baked = prt::bake(std::move(mesh), options);
  if (!baked) {
    log_warning("lifted object: its own transfer is not known: {} {}", baked.error().where,
                baked.error().detail);
    return;
  }
  surface_ = std::move(baked->transfer);
  reflected_ = std::move(baked->reflected);
  ready_ = true;
}

}  // namespace penumbra::runtime
