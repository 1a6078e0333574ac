// What clients send: bodies of changes to their readers, whole requests to a server on a socket.
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "service/http/http_api.h"
#include "service/scene/scene_control.h"
#include "tests/support/temp_folder.h"

namespace {

using namespace penumbra;

// Before any light, for the life of the process.
struct Served {
  test::TempFolder folder;
  service::PublishedState state;
  StageTimes times;
  service::SceneControl objects;
  service::CameraControl cameras;
  service::LiveRecording recording{folder.path()};
  sockaddr_un name{.sun_family = AF_UNIX, .sun_path = {}};
  std::unique_ptr<service::HttpApi> api;

  Served() {
    service::HttpOptions options;
    options.socket = folder.path() / "s";
    options.socket.string().copy(name.sun_path, sizeof name.sun_path - 1);
    auto started = service::HttpApi::start(options, {state, times, objects, recording, cameras});
    if (!started) std::abort();
    api = std::move(*started);
  }
  // Whether the bytes that come back begin as an answer does; nothing may come, too.
  bool answers(std::string_view request) const {
    const int socket = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (::connect(socket, reinterpret_cast<const sockaddr*>(&name), sizeof name) != 0) return false;
    (void)::send(socket, request.data(), request.size(), MSG_NOSIGNAL);
    ::shutdown(socket, SHUT_WR);
    char begin[5] = {};
    const auto size = ::recv(socket, begin, sizeof begin, MSG_WAITALL);
    ::close(socket);
    return size <= 0 || std::string_view(begin, sizeof begin) == "HTTP/";
  }
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const Served served;
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  (void)service::read_object_change(text);
  (void)service::read_lamp_change(text, {});
  if (const auto file = service::scene_file_in(served.folder.path(), text))
    (void)runtime::read_scene(*file);
  if (const auto object = service::read_new_object(text, served.folder.path()))
    if (!object->asset.starts_with("builtin:")) __builtin_trap();  // the folder has no files
  if (!served.answers(text)) __builtin_trap();
  return 0;
}
