// The HTTP library's server, with bounds that it lacks: of bytes and of time for a request.
// threads: as httplib::Server; stop_waiting() thread-safe
#pragma once

#include <httplib.h>

#include <atomic>
#include <cstddef>

namespace penumbra::service {

/// A request that is too long or too slow, or whose body nobody read, ends its connection: what
/// follows on it would be taken for the next request, whoever wrote it.
class GuardedServer : public httplib::Server {
 public:
  static constexpr std::size_t kMaxClients = 256, kMaxRequest_bytes = 128 << 10;

  /// In place of the library's few connections that may wait to be taken.
  /// in: bound
  void widen_queue() const;
  /// No request that has not come as a whole is waited for any longer.
  void stop_waiting() { stopping_ = true; }

 private:
  class Client;  // its connection
  bool process_and_close_socket(socket_t socket) override;
  void serve(Client& client);

  std::atomic<bool> stopping_ = false;
  std::atomic<std::size_t> clients_ = 0;
};

}  // namespace penumbra::service
