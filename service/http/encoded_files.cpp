#include "service/http/internal/encoded_files.h"

#include <cstddef>
#include <string>

#include "codec/codec.h"
#include "codec/cube_ktx.h"
#include "codec/display.h"
#include "codec/gain_map_jpeg.h"
#include "core/io/files.h"
#include "service/http/internal/scratch_file.h"

namespace penumbra::service {

namespace {

template <class Bytes>
std::string text_of(const Bytes& bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

// Writers of pictures write files.
template <class Write>
Result<std::string> written(const std::string& extension, const Write& write) {
  constexpr std::size_t kMost_bytes = std::size_t{1} << 30;
  const ScratchFile file(extension);
  PENUMBRA_TRY(write(file.path()));
  PENUMBRA_ASSIGN(bytes, read_bytes(file.path(), kMost_bytes));
  return text_of(bytes);
}

}  // namespace

Result<EncodedFile> FrameFiles::jpeg(const FramePointer& frame, TimestampNs time) {
  return jpeg_.of(frame, time, [](const FramePixels& pixels) -> Result<std::string> {
    PENUMBRA_ASSIGN(bytes, codec::encode_jpeg(codec::to_display(pixels)));
    return text_of(bytes);
  });
}

Result<EncodedFile> FrameFiles::png(const FramePointer& frame, TimestampNs time) {
  return png_.of(frame, time, [](const FramePixels& pixels) {
    return written(".png", [&](const auto& path) {
      return codec::write_frame(path, codec::to_display(pixels));
    });
  });
}

Result<EncodedFile> EnvironmentFiles::jpeg(const MapPointer& map) {
  return jpeg_.of(map, map->time, [this](const Environment& e) -> Result<std::string> {
    if (e.time < toned_) tone_.restart();
    toned_ = e.time;
    PENUMBRA_ASSIGN(base, tone_.map(e.radiance, e.time));
    PENUMBRA_ASSIGN(bytes, codec::encode_gain_map_jpeg(e.radiance, base.pixels));
    return text_of(bytes);
  });
}

Result<EncodedFile> EnvironmentFiles::cube(const MapPointer& map) {
  return cube_.of(map, map->time, [this](const Environment& e) -> Result<std::string> {
    const Image<Rgb>& radiance = e.radiance;
    if (!faces_ || !faces_->fits(radiance))
      faces_.emplace(radiance.width(), radiance.height(), kCubeEdge);
    PENUMBRA_ASSIGN(bytes, codec::encode_cube_ktx(faces_->apply(radiance), kCubeEdge));
    return text_of(bytes);
  });
}

Result<EncodedFile> EnvironmentFiles::exr(const MapPointer& map) {
  return exr_.of(map, map->time, [](const Environment& e) {
    return written(".exr", [&](const auto& path) {
      return codec::write_hdr(path, e.radiance, codec::Depth::kHalf,
                              codec::EnvironmentAttribute::kLatLong, e.confidence,
                              clipped_pixels(e));
    });
  });
}

Result<EncodedFile> EnvironmentFiles::hdr(const MapPointer& map) {
  return hdr_.of(map, map->time, [](const Environment& e) {
    return written(".hdr", [&](const auto& path) { return codec::write_hdr(path, e.radiance); });
  });
}

}  // namespace penumbra::service
