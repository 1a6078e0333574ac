#include <algorithm>
#include <span>
#include <vector>

#include "service/http/internal/context.h"
#include "service/http/internal/page_files.h"

namespace penumbra::service {

namespace {

// "/v1/objects/{name}": all that begins and ends so, with a name between.
struct DescribedPath {
  std::string begin, end;
  bool names_something = false;
  std::string methods;  // as an answer lists them

  bool is(std::string_view path) const {
    return names_something ? path.size() > begin.size() + end.size() && path.starts_with(begin) &&
                                 path.ends_with(end)
                           : path == begin;
  }
};

DescribedPath described(const std::string& path, const nlohmann::json& operations) {
  DescribedPath out{.begin = path, .end = {}, .methods = {}};
  if (const std::size_t open = path.find('{'); open != std::string::npos) {
    out.begin = path.substr(0, open);
    out.end = path.substr(path.find('}') + 1);
    out.names_something = true;
  }
  for (const auto& [key, value] : operations.items()) {
    if (key == "parameters") continue;
    std::string method = key;
    std::ranges::transform(method, method.begin(), [](char c) { return char(c - 'a' + 'A'); });
    if (!out.methods.empty()) out.methods += ", ";
    out.methods += method == "GET" ? "GET, HEAD" : method;
  }
  return out;
}

std::vector<DescribedPath> described_paths() {
  std::vector<DescribedPath> out;
  const auto files = std::span(kPageFiles, kPageFileCount);
  const auto file = std::ranges::find(files, "/openapi.json", &PageFile::path);
  const auto document = nlohmann::json::parse(file->text);
  for (const auto& [path, operations] : document.at("paths").items())
    out.push_back(described(path, operations));
  return out;
}

}  // namespace

std::string allowed_methods(const std::string& path) {
  static const std::vector<DescribedPath> paths = described_paths();
  const auto found =
      std::ranges::find_if(paths, [&](const DescribedPath& one) { return one.is(path); });
  return found == paths.end() ? std::string() : found->methods;
}

}  // namespace penumbra::service
