// A glTF 2.0 file: its JSON and its bytes. Every index is checked before it is used.
// threads: one thread at a time, as it keeps what it has decoded
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace penumbra::prt::gltf {

using Json = nlohmann::json;
using Bytes = std::span<const unsigned char>;

/// What `of` calls `key`; null where `of` is no object or has none.
const Json* member(const Json& of, const char* key);
/// The extension's object of a material, a primitive and the like, if any.
const Json* extension(const Json& of, const char* name);
/// A number of it between `low` and `high`, which values beyond are brought to.
float number(const Json& of, const char* key, float fallback, float low, float high);
/// "node 3 (\"wheel\")", for messages.
std::string called(const char* kind, std::size_t index, const Json& thing);

class Document {
 public:
  /// errors: kNotFound, kUnreadable (neither glTF 2.0 nor its binary form), kInvalid (another
  /// version; an extension that is required and not read)
  static Result<Document> open(const std::filesystem::path& path);
  /// The same from memory; `path` stands in errors, and what the file names lies beside it.
  static Result<Document> parse(std::vector<unsigned char> bytes,
                                const std::filesystem::path& path);

  const Json& root() const { return root_; }
  const std::string& file() const { return file_; }
  /// The chunk of a binary file, if any.
  std::optional<Bytes> binary() const {
    if (!has_binary_) return std::nullopt;
    return Bytes(bytes_).subspan(binary_from_, binary_size_);
  }

  /// How many things the top-level list `list` ("meshes") has, and one of them.
  std::size_t count(const char* list) const;
  const Json& at(const char* list, std::size_t index) const;
  /// The number in `of[key]` that names one of `list`; nothing where it is absent.
  /// errors: kInvalid (no number, or not in the list), which begin with `whose`
  Result<std::optional<std::size_t>> reference(const Json& of, const char* key, const char* list,
                                               const std::string& whose) const;

  struct ViewBytes {
    Bytes bytes;
    std::size_t stride = 0;  // bytes from element to element; 0: without gaps
  };
  /// A buffer view, unpacked where EXT_meshopt_compression packed it.
  /// errors: kInvalid (beyond its buffer), kUnreadable (its buffer), kNotFound
  Result<ViewBytes> view(std::size_t index);
  /// The bytes that a URI names: a data URI, or a file in the asset's folder or below.
  /// errors: kInvalid (a network scheme, a way out of the folder), kNotFound, kUnreadable
  Result<std::vector<unsigned char>> resource(const std::string& uri,
                                              const std::string& whose) const;

  /// Notes once that something of the file is not drawn, or not as the file has it.
  void leave_out(std::string line);
  std::vector<std::string> left_out() && { return std::move(left_out_); }
  std::vector<std::string> extensions() const;

  std::unexpected<Error> invalid(std::string detail) const {
    return fail(ErrorCode::kInvalid, file_, std::move(detail));
  }

 private:
  Result<void> parse_json(Bytes text);
  Result<void> check_extensions();
  Result<Bytes> buffer(std::size_t index);
  /// `length` bytes of `of` ("byteOffset", "byteLength") in its buffer.
  Result<Bytes> slice(const Json& of, const std::string& whose);
  Result<Bytes> unpacked(std::size_t index, const Json& packed);

  std::filesystem::path path_;
  std::string file_;
  std::vector<unsigned char> bytes_;
  std::size_t binary_from_ = 0, binary_size_ = 0;  // the binary chunk of a .glb
  bool has_binary_ = false;
  Json root_;
  std::map<std::size_t, std::vector<unsigned char>> buffers_, unpacked_;
  std::vector<std::string> left_out_;
};

/// A whole number in `of[key]`: `fallback` where it is absent, nothing where it is none.
std::optional<std::uint64_t> whole(const Json& of, const char* key, std::uint64_t fallback);

}  // namespace penumbra::prt::gltf
