// What `penumbra inspect` says of what programs write to be read by people: tables, plots, pages.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "core/result.h"

namespace penumbra::tools {

/// A .csv: its columns, and the number of rows.
/// errors: kUnreadable (has no row of names), as read_bytes
Result<nlohmann::json> inspect_table(const std::string& file);
/// A .svg: its size and title.
/// errors: kUnreadable (is no SVG), as read_bytes
Result<nlohmann::json> inspect_plot(const std::string& file);
/// A .pdf of `calibrate board`: its board, as `--board` takes it, and the page's size.
/// errors: kUnreadable (is another page), as read_bytes
Result<nlohmann::json> inspect_page(const std::string& file);

}  // namespace penumbra::tools
