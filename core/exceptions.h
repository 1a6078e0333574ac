// What an exception of a library says to a user.
// threads: reentrant
#pragma once

#include <exception>
#include <new>
#include <string>

#pragma GCC visibility push(default)
namespace penumbra {

inline std::string reason_of(const std::exception& e) {
  return dynamic_cast<const std::bad_alloc*>(&e) ? "needs more memory than there is" : e.what();
}

}  // namespace penumbra
#pragma GCC visibility pop
