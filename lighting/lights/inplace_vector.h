// A list of at most so many elements that takes nothing from the heap (as std::inplace_vector of
// C++26).
// threads: as a plain value
#pragma once

#include <algorithm>
#include <array>
#include <cassert>
#include <cstddef>

#pragma GCC visibility push(default)
namespace penumbra::lighting {

template <class T, std::size_t kMax>
class InplaceVector {
 public:
  using value_type = T;

  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  void clear() { size_ = 0; }
  /// in: fewer than kMax elements
  T& push_back(const T& value) {
    assert(size_ < kMax);
    return elements_[size_++] = value;
  }

  T* begin() { return elements_.data(); }
  T* end() { return begin() + size_; }
  const T* begin() const { return elements_.data(); }
  const T* end() const { return begin() + size_; }
  T& operator[](std::size_t i) {
    assert(i < size_);
    return elements_[i];
  }
  const T& operator[](std::size_t i) const {
    assert(i < size_);
    return elements_[i];
  }
  const T& back() const { return (*this)[size_ - 1]; }
  friend bool operator==(const InplaceVector& a, const InplaceVector& b) {
    return std::equal(a.begin(), a.end(), b.begin(), b.end());
  }

 private:
  std::array<T, kMax> elements_{};
  std::size_t size_ = 0;
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
