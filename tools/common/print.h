// What commands print: JSON on standard output.
#pragma once

#include <cstdio>
#include <nlohmann/json.hpp>

namespace penumbra::tools {

inline void print_json(const nlohmann::json& value) {
  std::printf("%s\n", value.dump(2).c_str());
}

}  // namespace penumbra::tools
