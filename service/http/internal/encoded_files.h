// What clients read as files: frames and environment maps, encoded once for all of them.
// threads: thread-safe
#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "codec/tone/temporal_tone.h"
#include "core/environment.h"
#include "core/image.h"
#include "core/result.h"
#include "core/units.h"
#include "lighting/reflections/cube_map.h"

namespace penumbra::service {

/// A file that clients read.
struct EncodedFile {
  TimestampNs time;  // of the capture
  std::shared_ptr<const std::string> bytes;
};

/// The newest of something as a file, encoded once however many clients ask, and by one of them at
/// a time. Who waited for that gets the newer one.
template <class Source>
class NewestFile {
 public:
  template <class Encode>  // Result<std::string>(const Source&)
  Result<EncodedFile> of(const std::shared_ptr<const Source>& source, TimestampNs time,
                         const Encode& encode) {
    constexpr Seconds kOvertaken(1);  // further back a capture began anew
    const std::scoped_lock lock(mutex_);
    const Seconds step = source_ ? time - file_.time : Seconds(0);
    if (source_ == source || (step < Seconds(0) && step > -kOvertaken)) return file_;
    PENUMBRA_ASSIGN(bytes, encode(*source));
    file_ = {time, std::make_shared<const std::string>(std::move(bytes))};
    source_ = source;
    return file_;
  }

 private:
  std::mutex mutex_;
  std::shared_ptr<const Source> source_;
  EncodedFile file_;
};

using FramePointer = std::shared_ptr<const FramePixels>;
class FrameFiles {
 public:
  Result<EncodedFile> jpeg(const FramePointer& frame, TimestampNs time);
  Result<EncodedFile> png(const FramePointer& frame, TimestampNs time);

 private:
  NewestFile<FramePixels> jpeg_, png_;
};

/// The environment map. What the base of its JPEG with a gain map is adapted to follows the light
/// as an eye does, so that a row of them does not flicker.
using MapPointer = std::shared_ptr<const Environment>;
class EnvironmentFiles {
 public:
  static constexpr int kCubeEdge = 128;  // texels

  Result<EncodedFile> jpeg(const MapPointer& map);
  Result<EncodedFile> cube(const MapPointer& map);
  Result<EncodedFile> exr(const MapPointer& map);
  Result<EncodedFile> hdr(const MapPointer& map);

 private:
  NewestFile<Environment> jpeg_, cube_, exr_, hdr_;
  tone::TemporalTone tone_{{.op = tone::ToneOperator::kPhotographic}};  // in the lock of jpeg_
  TimestampNs toned_;                                                   // as well
  std::optional<lighting::CubeMap> faces_;  // of the last map's size; in the lock of cube_
};

}  // namespace penumbra::service
