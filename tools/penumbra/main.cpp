// The `penumbra` program. The demo, calibrations and evaluation are programs of their own beside
// it, so that this one links neither a solver nor a metric; `penumbra calibrate` and the like start
// them.
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "tools/common/command.h"
#include "tools/penumbra/commands.h"

namespace {

using namespace penumbra;
using namespace penumbra::tools;

constexpr std::array kSiblings{
    Sibling{"demo", "penumbra-demo",
            "Run the whole pipeline in a synthetic studio: writes a video, a still and a summary",
            false},
    Sibling{"calibrate", "penumbra-calibrate", "Calibrate cameras and rigs", false},
    Sibling{"chart", "penumbra-chart",
            "Measure error against time for many settings, as a table and plots", true},
    Sibling{"compare", "penumbra-chart", "Measure the difference between two pictures", true},
};

// Becomes the program that stands beside this one. Returns only when that fails.
int become(const Sibling& sibling, int argc, char** argv) {
  std::error_code failed;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", failed);
  const std::string program = (self.parent_path() / sibling.program).string();
  std::vector<char*> arguments{const_cast<char*>(program.c_str())};
  if (sibling.is_subcommand) arguments.push_back(argv[1]);
  arguments.insert(arguments.end(), argv + 2, argv + argc);
  arguments.push_back(nullptr);
  execv(program.c_str(), arguments.data());
  const char* const reason =
      errno == ENOENT ? "is not installed beside penumbra" : std::strerror(errno);
  std::fprintf(stderr, "penumbra: %s: %s\n", program.c_str(), reason);
  return 2;
}

void add_commands(CLI::App& app, Action& action) {
  app.require_subcommand(1);
  add_composite(app, action);
  add_render(app, action);
  add_serve(app, action);
  add_record(app, action);
  add_bake(app, action);
  CLI::App* hdr = app.add_subcommand("hdr", "Make HDR pictures");
  hdr->require_subcommand(1);
  add_hdr_merge(*hdr, action);
  add_hdr_environment(*hdr, action);
  add_tonemap(app, action);
  add_encode(app, action);
  add_decode(app, action);
  CLI::App* light = app.add_subcommand("light", "Measure the light of an environment");
  light->require_subcommand(1);
  add_light_estimate(*light, action);
  add_inspect(app, action);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc > 1)
    for (const Sibling& s : kSiblings)
      if (std::string_view(argv[1]) == s.command) return become(s, argc, argv);
  return run_program(argc, argv, "penumbra",
                     "Mixed reality under measured light: HDR capture, precomputed radiance "
                     "transfer, differential rendering",
                     add_commands, kSiblings);
}
