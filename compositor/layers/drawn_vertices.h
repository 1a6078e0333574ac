// The vertices that GL draws of an object, from those that it has.
// threads: reentrant
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "prt/geometry/fine_form.h"

namespace penumbra::compositor {

using EdgeMiddles = std::vector<std::array<std::uint32_t, 2>>;

/// The object's own, or those of its fine form in their place; then what a lens takes beyond them,
/// each in the middle of two earlier ones.
class DrawnVertices {
 public:
  DrawnVertices() = default;
  DrawnVertices(std::shared_ptr<const prt::FineForm> fine, EdgeMiddles middles)
      : fine_(std::move(fine)), middles_(std::move(middles)) {}

  const prt::FineForm* fine() const { return fine_.get(); }
  const EdgeMiddles& middles() const { return middles_; }
  bool are_own() const { return !fine_ && middles_.empty(); }

  /// in: of the object's own
  template <class Value>
  void spread(std::vector<Value>& values) const {
    if (fine_) values = prt::at_fine_vertices(*fine_, values);
    extend(values);
  }
  /// in: of all but the middles
  template <class Value>
  void extend(std::vector<Value>& values) const {
    for (const auto& [a, b] : middles_) values.push_back((values[a] + values[b]) * .5f);
  }

 private:
  std::shared_ptr<const prt::FineForm> fine_;
  EdgeMiddles middles_;
};

}  // namespace penumbra::compositor
