// What an exception of a library says to a user.
// threads: reentrant
#pragma once

#include <exception>
#include <new>
#include <string>

#pragma GCC visibility push(default)
namespace penumbra {

/// Short enough for strings to hold without memory.
inline std::string reason_of(const std::exception& e) {
  return dynamic_cast<const std::bad_alloc*>(&e) ? "out of memory" : e.what();
}

}  // namespace penumbra
#pragma GCC visibility pop
