// The HTTP interface: on a Unix socket, on loopback, or for who has the token.
// threads: thread-bound; requests are answered on threads of its own
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/result.h"
#include "core/threads/stage_times.h"
#include "service/http/camera_control.h"
#include "service/http/published_state.h"
#include "service/recording/live_recording.h"
#include "service/scene/scene_control.h"

namespace penumbra::service {

struct HttpOptions {
  std::filesystem::path socket;   // empty: none
  bool socket_for_group = false;  // of mode 0660, else 0600
  std::string address = "127.0.0.1";
  std::optional<int> port{};           // 0: any free one; nothing: no TCP
  std::string token;                   // needed of every request over TCP where it is not empty
  std::vector<std::string> origins{};  // whose pages may read and change, as they say themselves
  double stale_after_s = 1;
  std::filesystem::path assets;  // the folder that objects may be added from; empty: none
};

/// What is shown and changed; all outlive the interface.
struct HttpSources {
  PublishedState& state;
  const StageTimes& times;
  SceneControl& objects;
  LiveRecording& recording;
  CameraControl& cameras;
};

/// Serves until destroyed.
class HttpApi {
 public:
  /// errors: kUnavailable (an address or a socket in use, a folder that is not there), kInvalid (an
  ///         address that is not loopback, without a token; a socket's name that is too long)
  static Result<std::unique_ptr<HttpApi>> start(const HttpOptions& options,
                                                const HttpSources& sources);
  ~HttpApi();
  /// Of TCP; 0: none.
  int port() const;
  /// Empty: none.
  const std::filesystem::path& socket() const;

 private:
  struct Impl;
  explicit HttpApi(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra::service
