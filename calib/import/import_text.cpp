// JSON and YAML as one kind of tree.
#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <charconv>

#include "calib/import/internal/import_fields.h"

namespace penumbra::calib {

namespace {

using nlohmann::json;

class YamlTree {
 public:
  explicit YamlTree(std::string where) : where_(std::move(where)) {}

  // An alias stands for all that it names, so values are counted as they are written out.
  Result<json> tree(const YAML::Node& node, int depth) {
    if (depth > kDeepestImport) return fail(ErrorCode::kUnreadable, where_, "is nested too deeply");
    if (++values_ > kMaxImportValues)
      return fail(ErrorCode::kUnreadable, where_, "has too many values");
    switch (node.Type()) {
      case YAML::NodeType::Scalar:
        return scalar(node);
      case YAML::NodeType::Sequence: {
        json out = json::array();
        for (const YAML::Node& one : node) {
          PENUMBRA_ASSIGN(value, tree(one, depth + 1));
          out.push_back(std::move(value));
        }
        return out;
      }
      case YAML::NodeType::Map: {
        json out = json::object();
        for (const auto& entry : node) {
          if (!entry.first.IsScalar())
            return fail(ErrorCode::kUnreadable, where_, "has a key that is not text");
          PENUMBRA_ASSIGN(value, tree(entry.second, depth + 1));
          out[entry.first.Scalar()] = std::move(value);
        }
        return out;
      }
      default:
        return json();
    }
  }

 private:
  static json scalar(const YAML::Node& node) {
    const std::string& text = node.Scalar();
    double value = 0;
    const char* const end = text.data() + text.size();
    // "!" marks text in quotes.
    const auto [at, error] = std::from_chars(text.data(), end, value);
    if (node.Tag() != "!" && !text.empty() && error == std::errc() && at == end) return value;
    return text;
  }

  std::string where_;
  int values_ = 0;
};

Result<json> parse_yaml(std::string_view text, const std::string& where) {
  // OpenCV's own first line is no directive of YAML.
  if (text.starts_with("%YAML:")) text.remove_prefix(std::min(text.find('\n'), text.size()));
  try {
    return YamlTree(where).tree(YAML::Load(std::string(text)), 0);
  } catch (const YAML::Exception& e) {
    return fail(ErrorCode::kUnreadable, fmt::format("{}:{}", where, e.mark.line + 1), e.msg);
  }
}

}  // namespace

Result<json> parse_import_text(std::string_view text, const std::string& where) {
  const std::size_t first = text.find_first_not_of(" \t\r\n");
  if (first == std::string_view::npos) return fail(ErrorCode::kUnreadable, where, "is empty");
  if (text[first] == '<') return parse_storage_xml(text.substr(first), where);
  if (text[first] != '{') return parse_yaml(text, where);
  try {
    return json::parse(text);
  } catch (const json::parse_error& e) {
    return fail(ErrorCode::kUnreadable, where, fmt::format("is no JSON at byte {}", e.byte));
  }
}

}  // namespace penumbra::calib
