// Errors as values: every edge of the program (file, device, GL, socket, configuration) returns
// one.
// threads: plain values
#pragma once

#include <expected>
#include <string>
#include <utility>

#pragma GCC visibility push(default)
namespace penumbra {

enum class ErrorCode {
  kNotFound,      // a file, device or name that is not there
  kUnreadable,    // there, but damaged, truncated or of an unknown kind
  kUnwritable,    // the output cannot be made
  kInvalid,       // a value outside its range, an unknown key, inconsistent sizes
  kNonFinite,     // NaN or infinity where a number is needed
  kUndetermined,  // the data cannot determine the answer (all black, all clipped, degenerate)
  kUnavailable,   // the machine lacks the thing (no EGL, no display, no codec)
  kClosed,        // the other end has gone
};

/// where: the thing (a path, a device, a key); detail: the reason. Printed as "penumbra: WHERE:
/// DETAIL".
struct Error {
  ErrorCode code;
  std::string where;
  std::string detail;
};

template <class T>
using Result = std::expected<T, Error>;

inline std::unexpected<Error> fail(ErrorCode code, std::string where, std::string detail) {
  return std::unexpected(Error{code, std::move(where), std::move(detail)});
}

}  // namespace penumbra
#pragma GCC visibility pop

// Returns the error of a Result from the calling function, or goes on.
#define PENUMBRA_TRY(...)                                    \
  do {                                                       \
    if (auto&& try_result = (__VA_ARGS__); !try_result)      \
      return std::unexpected(std::move(try_result).error()); \
  } while (false)

// Declares `name` as the value of a Result, or returns its error from the calling function.
// NOLINTBEGIN(bugprone-macro-parentheses): a declared name cannot stand in parentheses
#define PENUMBRA_ASSIGN(name, ...)                                              \
  auto name##_result = (__VA_ARGS__);                                           \
  if (!name##_result) return std::unexpected(std::move(name##_result).error()); \
  auto& name = *name##_result
// NOLINTEND(bugprone-macro-parentheses)
