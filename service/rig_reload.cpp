#include "service/rig_reload.h"

#include <fmt/format.h>

#include <map>
#include <sstream>

#include "core/io/toml_keys.h"

namespace penumbra::service {

namespace {

using Values = std::map<std::string, std::string>;

void flatten(const toml::node& node, const std::string& place, Values& out) {
  if (const toml::table* table = node.as_table()) {
    for (const auto& [key, value] : *table)
      flatten(value,
              place.empty() ? std::string(key.str()) : fmt::format("{}.{}", place, key.str()), out);
  } else if (const toml::array* array = node.as_array(); array && array->is_array_of_tables()) {
    for (std::size_t i = 0; i < array->size(); ++i)
      flatten((*array)[i], fmt::format("{}[{}]", place, i), out);
  } else {
    std::ostringstream text;
    node.visit([&](const auto& value) { text << value; });
    out[place] = text.str();
  }
}

}  // namespace

Result<std::vector<std::string>> changed_keys(std::string_view before, std::string_view now,
                                              const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(old_root, parse_toml_text(before, path));
  PENUMBRA_ASSIGN(new_root, parse_toml_text(now, path));
  Values old_values, new_values;
  flatten(old_root, "", old_values);
  flatten(new_root, "", new_values);
  std::vector<std::string> out;
  for (const auto& [key, value] : old_values)
    if (const auto found = new_values.find(key);
        found == new_values.end() || found->second != value)
      out.push_back(key);
  for (const auto& [key, value] : new_values)
    if (!old_values.contains(key)) out.push_back(key);
  return out;
}

}  // namespace penumbra::service
