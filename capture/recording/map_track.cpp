#include "capture/recording/internal/map_track.h"

#include <fmt/format.h>

#include <utility>

namespace penumbra::capture {

Result<MapTrack> MapTrack::open(const AVStream& light, const AVStream& seen,
                                const CameraInfo& track) {
  const calib::CameraModel& size = track.projection;
  for (const AVCodecParameters* c : {light.codecpar, seen.codecpar})
    if (c->width != size.width || c->height != size.height)
      return fail(ErrorCode::kInvalid, track.name,
                  fmt::format("has maps of {}x{} pixels instead of {}x{}", c->width, c->height,
                              size.width, size.height));
  PENUMBRA_ASSIGN(decoder, MapDecoder::open(*light.codecpar, *seen.codecpar));
  MapTrack out(std::move(decoder));
  out.seen = seen.index;
  return out;
}

Result<std::optional<Environment>> MapTrack::decode(const AVPacket& light, std::uint64_t number,
                                                    const MapLabel& label) {
  while (!waiting_seen.empty() && waiting_seen.front()->pts < light.pts) waiting_seen.pop_front();
  const bool begins = (light.flags & AV_PKT_FLAG_KEY) != 0;
  const auto expected = std::exchange(next_, std::nullopt);
  if (!begins && expected != number) {
    if (!expected) return std::nullopt;
    return fail(ErrorCode::kUnreadable, "map", "builds on one that is missing");
  }
  if (waiting_seen.empty() || waiting_seen.front()->pts != light.pts)
    return fail(ErrorCode::kUnreadable, "map", "does not tell what was seen");
  const Packet mask = std::move(waiting_seen.front());
  waiting_seen.pop_front();
  PENUMBRA_ASSIGN(map, decoder_.decode(light, *mask, label));
  next_ = number + 1;
  return map;
}

}  // namespace penumbra::capture
