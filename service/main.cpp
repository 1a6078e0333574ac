// The `penumbrad` program: the live service alone.
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>

#include "service/serve.h"

namespace {

int report(const penumbra::Error& error) {
  std::fprintf(stderr, "penumbrad: %s: %s\n", error.where.c_str(), error.detail.c_str());
  return 2;
}

}  // namespace

int main(int argc, char** argv) {
  using namespace penumbra;
  spdlog::set_default_logger(spdlog::stderr_color_mt("penumbrad"));
  spdlog::set_pattern("%^%l%$: %v");
  CLI::App app("The mixed reality service: cameras in, light and composited frames out",
               "penumbrad");
  service::ServeOptions options;
  app.set_version_flag("--version", std::string("penumbrad ") + PENUMBRA_VERSION);
  app.add_option("--config", options.config, "rig.toml")->required();
  try {
    app.parse(argc, argv);
  } catch (const CLI::Success& e) {
    return app.exit(e);  // help and version
  } catch (const CLI::ParseError& e) {
    return report({ErrorCode::kInvalid, "arguments", e.what()});
  }
  try {
    const auto silent = [](const std::string&) { return std::function<void(double)>(); };
    if (const auto served = service::serve(options, silent); !served) return report(served.error());
  } catch (const std::exception& e) {
    return report({ErrorCode::kUnavailable, "internal", e.what()});
  }
  return 0;
}
