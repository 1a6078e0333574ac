// Private to capture: what writer and reader of recordings share.
#pragma once

extern "C" {
#include <libavutil/error.h>
#include <libavutil/rational.h>
}

#include <string>
#include <string_view>

namespace penumbra::capture {

inline constexpr std::string_view kCamerasAttachment = "cameras.toml";
inline constexpr std::string_view kResponseSuffix = ".response.toml";

// Of cameras.toml, where a light track stands beside the cameras: its name and size.
inline constexpr std::string_view kLightTrack = "light_track";
inline constexpr int kVersionWithLight = 2;  // of cameras.toml
inline constexpr AVRational kMilliseconds{1, 1000};
inline std::string seen_title(const std::string& track) {
  return track + ": seen";
}
inline std::string label_title(const std::string& camera) {  // of the track
  return camera + ": labels";
}

inline std::string av_reason(int code) {
  char text[AV_ERROR_MAX_STRING_SIZE] = {};
  av_strerror(code, text, sizeof text);
  return text;
}

}  // namespace penumbra::capture
