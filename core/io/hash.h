// A fingerprint of bytes: tells versions and damage apart, not forgeries.
// threads: a plain value
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra {

/// source: Fowler, Noll & Vo, FNV-1a, 64 bit
class Fnv1a {
 public:
  Fnv1a& add(const void* data, std::size_t bytes) {
    const auto* p = static_cast<const unsigned char*>(data);
    for (std::size_t i = 0; i < bytes; ++i) value_ = (value_ ^ p[i]) * 0x100000001b3ull;
    return *this;
  }
  template <class T>
  requires std::is_trivially_copyable_v<T> Fnv1a& add(const T& value) {
    return add(&value, sizeof value);
  }
  template <class T>
  requires std::is_trivially_copyable_v<T> Fnv1a& add(const std::vector<T>& values) {
    add(values.size());
    return add(values.data(), values.size() * sizeof(T));
  }
  std::uint64_t value() const { return value_; }

 private:
  std::uint64_t value_ = 0xcbf29ce484222325ull;
};

}  // namespace penumbra
#pragma GCC visibility pop
