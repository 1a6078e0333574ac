// The file that a shard leaves: there as a whole or not at all, however often it is begun.
// threads: reentrant; several processes may make one shard at a time
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/result.h"

namespace penumbra::tools {

/// Beside the output: OUTPUT.shard-1-of-12 for index 0 of 12. Rounds from 1 on, in which what
/// the round before asks for is baked, end in .round-1 and so on.
std::filesystem::path shard_file(const std::string& output, int index, int count, int round = 0);
/// Those of all shards of a round, in order.
std::vector<std::filesystem::path> shard_files(const std::string& output, int count, int round = 0);

/// Makes `file` unless it is whole. Each attempt writes into a file of its own beside it, which
/// begins with what the attempt that came furthest has left, and is renamed once it is whole. So an
/// attempt whose machine was given up and lives on disturbs nobody, and the last to end wins with
/// the same frames.
/// is_whole: of a file that is there; its errors are passed on: another bake's file is not replaced
/// bake:     adds what is missing to a file that may be there
/// errors:   of both, kUnwritable
Result<void> make_shard(const std::filesystem::path& file,
                        const std::function<Result<bool>(const std::filesystem::path&)>& is_whole,
                        const std::function<Result<void>(const std::filesystem::path&)>& bake);

/// Of how many shards those beside the output are, attempts too; 0 without any, or of several
/// counts.
int count_of_shards(const std::string& output);

/// Removes shards and what attempts at them have left.
void remove_shards(const std::vector<std::filesystem::path>& files);

}  // namespace penumbra::tools
