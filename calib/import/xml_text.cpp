// The XML that OpenCV's FileStorage writes: elements with attributes, which mean nothing here, and
// text. No entities beyond the five of XML, no document types, no sections of raw text.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>

#include "calib/import/internal/import_fields.h"

namespace penumbra::calib {

namespace {

using nlohmann::json;

class StorageXml {
 public:
  StorageXml(std::string_view text, std::string where) : text_(text), where_(std::move(where)) {}

  Result<json> root() {
    PENUMBRA_TRY(skip_between());
    PENUMBRA_ASSIGN(tag, open_tag());
    if (tag.name != "opencv_storage") return damaged("does not begin with opencv_storage");
    PENUMBRA_ASSIGN(out, content(tag, 0));
    return out;
  }

 private:
  struct Tag {
    std::string name;
    bool closed = false;  // <name/>
  };

  std::unexpected<Error> damaged(const char* why) const {
    const auto line = 1 + std::count(text_.begin(), text_.begin() + std::ptrdiff_t(at_), '\n');
    return fail(ErrorCode::kUnreadable, fmt::format("{}:{}", where_, line), why);
  }
  bool at(std::string_view word) const { return text_.substr(at_).starts_with(word); }
  bool is_name(char c) const {
    return std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '-' || c == '.';
  }
  void skip_blanks() {
    while (at_ < text_.size() && std::isspace(static_cast<unsigned char>(text_[at_]))) ++at_;
  }
  Result<void> skip_past(std::string_view end) {
    const std::size_t found = text_.find(end, at_);
    if (found == std::string_view::npos) return damaged("ends too early");
    at_ = found + end.size();
    return {};
  }
  // Blanks, comments and the declaration.
  Result<void> skip_between() {
    for (;;) {
      skip_blanks();
      if (at("<!--"))
        PENUMBRA_TRY(skip_past("-->"));
      else if (at("<?"))
        PENUMBRA_TRY(skip_past("?>"));
      else
        return {};
    }
  }

  Result<Tag> open_tag() {
    if (!at("<") || at("</") || at("<!")) return damaged("has no element where one is needed");
    ++at_;
    Tag out;
    while (at_ < text_.size() && is_name(text_[at_])) out.name += text_[at_++];
    if (out.name.empty()) return damaged("has an element without a name");
    // Attributes: only their quotes matter, in which a '>' may stand.
    for (char quote = 0; at_ < text_.size(); ++at_) {
      const char c = text_[at_];
      if (quote) {
        if (c == quote) quote = 0;
      } else if (c == '"' || c == '\'') {
        quote = c;
      } else if (c == '>') {
        out.closed = text_[at_ - 1] == '/';
        ++at_;
        return out;
      }
    }
    return damaged("ends within an element");
  }

  std::string plain_text() {
    constexpr std::array<std::pair<std::string_view, char>, 5> kEntities = {
        {{"&lt;", '<'}, {"&gt;", '>'}, {"&amp;", '&'}, {"&quot;", '"'}, {"&apos;", '\''}}};
    std::string out;
    while (at_ < text_.size() && text_[at_] != '<') {
      const auto entity =
          std::ranges::find_if(kEntities, [&](const auto& one) { return at(one.first); });
      out += entity == kEntities.end() ? text_[at_] : entity->second;
      at_ += entity == kEntities.end() ? 1 : entity->first.size();
    }
    const std::size_t first = out.find_first_not_of(" \t\r\n");
    if (first == std::string::npos) return {};
    out = out.substr(first, out.find_last_not_of(" \t\r\n") + 1 - first);
    // Short text is in quotes where it could be taken for a number.
    if (out.size() >= 2 && out.front() == '"' && out.back() == '"')
      out = out.substr(1, out.size() - 2);
    return out;
  }

  // Up to the closing tag: a table, a list of <_>, or text.
  Result<json> content(const Tag& tag, int depth) {
    if (depth > kDeepestImport) return damaged("is nested too deeply");
    if (++values_ > kMaxImportValues) return damaged("has too many values");
    if (tag.closed) return json();
    json out;
    std::string text;
    for (;;) {
      text += plain_text();
      PENUMBRA_TRY(skip_between());
      if (at("</")) break;
      if (at_ >= text_.size()) return damaged("ends too early");
      if (!at("<")) continue;
      PENUMBRA_ASSIGN(inner, open_tag());
      PENUMBRA_ASSIGN(value, content(inner, depth + 1));
      const bool item = inner.name == "_";
      if (out.is_null()) out = item ? json::array() : json::object();
      if (out.is_array() != item) return damaged("mixes a list with a table");
      if (item)
        out.push_back(std::move(value));
      else
        out[inner.name] = std::move(value);
    }
    at_ += 2;
    if (!at(tag.name)) return damaged("closes another element than it opened");
    PENUMBRA_TRY(skip_past(">"));
    if (out.is_null()) return json(text);
    return out;
  }

  std::string_view text_;
  std::string where_;
  std::size_t at_ = 0;
  int values_ = 0;
};

}  // namespace

Result<json> parse_storage_xml(std::string_view text, const std::string& where) {
  return StorageXml(text, where).root();
}

}  // namespace penumbra::calib
