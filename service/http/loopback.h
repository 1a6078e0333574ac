// Which addresses stay on this machine.
// threads: reentrant
#pragma once

#include <arpa/inet.h>

#include <string>

namespace penumbra::service {

/// By number, since a name like 127.example may lead anywhere.
inline bool is_loopback(const std::string& address) {
  in_addr numbers{};
  if (address == "localhost" || address == "::1") return true;
  return inet_pton(AF_INET, address.c_str(), &numbers) == 1 && (ntohl(numbers.s_addr) >> 24) == 127;
}

}  // namespace penumbra::service
