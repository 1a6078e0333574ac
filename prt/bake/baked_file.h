// Baked objects in files.
// threads: reentrant
#pragma once

#include <filesystem>

#include "core/result.h"
#include "prt/bake/bake.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// The baked file: binary glTF that any viewer opens, transfer in underscore attributes.
/// errors: kUnwritable / kNotFound, kUnreadable, kInvalid (not baked by us, another version)
Result<void> write_baked(const std::filesystem::path& path, const BakedObject& object);
Result<BakedObject> read_baked(const std::filesystem::path& path);
/// True when the file is a glTF that carries our transfer.
bool is_baked_file(const std::filesystem::path& path);

}  // namespace penumbra::prt
#pragma GCC visibility pop
