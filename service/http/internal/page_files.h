// Files of service/page and the OpenAPI description, as they are built in.
// threads: plain data
#pragma once

#include <string_view>

namespace penumbra::service {

struct PageFile {
  std::string_view path, type, text;
};
/// By path.
extern const PageFile kPageFiles[];
extern const std::size_t kPageFileCount;

}  // namespace penumbra::service
