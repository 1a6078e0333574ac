// Puts bytes into the one buffer of a tinygltf model.
// threads: one thread at a time
#pragma once

#include "prt/bake/internal/tinygltf.h"

#include <cstddef>
#include <vector>

namespace penumbra::prt {

class ModelWriter {
 public:
  explicit ModelWriter(tinygltf::Model& model) : model_(model) { model_.buffers.emplace_back(); }

  /// Returns the buffer view.
  int add_view(const void* data, std::size_t bytes, int target) {
    auto& buffer = model_.buffers[0].data;
    buffer.resize((buffer.size() + 3) / 4 * 4);
    tinygltf::BufferView view;
    view.buffer = 0;
    view.byteOffset = buffer.size();
    view.byteLength = bytes;
    view.target = target;
    const auto* first = static_cast<const unsigned char*>(data);
    buffer.insert(buffer.end(), first, first + bytes);
    model_.bufferViews.push_back(view);
    return static_cast<int>(model_.bufferViews.size()) - 1;
  }
  /// Returns the accessor.
  int add(const void* data, std::size_t bytes, std::size_t count, int component, int type,
          int target) {
    tinygltf::Accessor accessor;
    accessor.bufferView = add_view(data, bytes, target);
    accessor.componentType = component;
    accessor.type = type;
    accessor.count = count;
    model_.accessors.push_back(accessor);
    return static_cast<int>(model_.accessors.size()) - 1;
  }
  template <class T>
  int add_vertices(const std::vector<T>& data, int type) {
    return add(data.data(), data.size() * sizeof(T), data.size(), TINYGLTF_COMPONENT_TYPE_FLOAT,
               type, TINYGLTF_TARGET_ARRAY_BUFFER);
  }
  tinygltf::Model& model() { return model_; }

 private:
  tinygltf::Model& model_;
};

}  // namespace penumbra::prt
