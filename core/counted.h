// Numbers of things in messages.
// threads: reentrant
#pragma once

#include <fmt/format.h>

#include <string>

#pragma GCC visibility push(default)
namespace penumbra {

/// "1 light", "2 lights".
std::string counted(auto number, const char* thing) {
  return fmt::format("{} {}{}", number, thing, number == 1 ? "" : "s");
}

}  // namespace penumbra
#pragma GCC visibility pop
