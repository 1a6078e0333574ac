// A vector that copies share until one of them is written.
// threads: as a plain value; copies in different threads are independent of each other
#pragma once

#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

namespace penumbra::prt {

/// Reads through a const object never copy; any access that could write first makes the memory its
/// own. Where several threads write parts of one vector, make_own() comes before them.
template <class T>
class CowVector {
 public:
  using value_type = T;
  CowVector() = default;
  explicit CowVector(std::size_t count, const T& value = {})
      : shared_(std::make_shared<std::vector<T>>(count, value)) {}

  std::size_t size() const { return all().size(); }
  bool empty() const { return all().empty(); }
  const T* data() const { return all().data(); }
  auto begin() const { return all().begin(); }
  auto end() const { return all().end(); }
  const T& operator[](std::size_t i) const { return all()[i]; }

  T* data() { return own().data(); }
  auto begin() { return own().begin(); }
  auto end() { return own().end(); }
  T& operator[](std::size_t i) { return own()[i]; }
  void resize(std::size_t count) { own().resize(count); }
  void push_back(const T& value) { own().push_back(value); }
  void pop_back() { own().pop_back(); }
  void assign(std::size_t count, const T& value) { own().assign(count, value); }

  void make_own() { own(); }
  /// Whether both stand in the same memory.
  bool shares(const CowVector& other) const { return shared_ == other.shared_; }
  friend bool operator==(const CowVector& a, const CowVector& b) {
    return a.shares(b) || a.all() == b.all();
  }

 private:
  const std::vector<T>& all() const {
    static const std::vector<T> none;
    return shared_ ? *shared_ : none;
  }
  std::vector<T>& own() {
    if (!shared_)
      shared_ = std::make_shared<std::vector<T>>();
    else if (shared_.use_count() > 1)
      shared_ = std::make_shared<std::vector<T>>(*shared_);
    return *shared_;
  }
  std::shared_ptr<std::vector<T>> shared_;
};

}  // namespace penumbra::prt
