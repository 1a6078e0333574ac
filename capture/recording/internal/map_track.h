// A light track's maps as a recording is read: what belongs together, and what comes after damage.
// threads: thread-bound
#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>

#include "capture/frames.h"
#include "capture/recording/internal/map_coding.h"

extern "C" {
#include <libavformat/avformat.h>
}

namespace penumbra::capture {

class MapTrack {
 public:
  /// errors: kInvalid (another size than the track's), as MapDecoder::open
  static Result<MapTrack> open(const AVStream& light, const AVStream& seen,
                               const CameraInfo& track);
  /// out: nothing for a map that builds on one that is missing or damaged
  /// errors: kUnreadable, once for each damage
  Result<std::optional<Environment>> decode(const AVPacket& light, std::uint64_t number,
                                            const MapLabel& label);

  int seen = -1;                    // stream
  std::deque<Packet> waiting_seen;  // packets of it

 private:
  explicit MapTrack(MapDecoder decoder) : decoder_(std::move(decoder)) {}
  MapDecoder decoder_;
  std::optional<std::uint64_t> next_;  // map that can be decoded beside those that stand alone
};

}  // namespace penumbra::capture
