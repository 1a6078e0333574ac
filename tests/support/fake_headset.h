// Test support: the fake OpenXR runtime below Debian's loader, for tests of the headset.
// threads: thread-bound
#pragma once

#include <dlfcn.h>

#include <chrono>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "tests/support/fake_openxr_runtime.h"
#include "tests/support/temp_folder.h"

namespace penumbra::test {

/// Sets the loader's variables while it lives. One at a time.
class FakeHeadset {
 public:
  FakeHeadset() {
    set("XR_RUNTIME_JSON", manifest().string());
    set("XR_LOADER_DEBUG", "none");  // of which some tests would have many lines
    install();
    frames();
    faults();
    state().sessions_left = 0, state().instances_made = 0;
    state().place_tracked = true;
  }
  ~FakeHeadset() {
    for (const std::string& name : variables_) ::unsetenv(name.c_str());
  }
  FakeHeadset(const FakeHeadset&) = delete;
  FakeHeadset& operator=(const FakeHeadset&) = delete;

  /// knob: without its PENUMBRA_FAKE_XR_
  void turn(const std::string& knob, const std::string& value) {
    set("PENUMBRA_FAKE_XR_" + knob, value);
  }
  /// The runtime's manifest: without it there is no runtime.
  void install() const {
    std::ofstream(manifest()) << R"({"file_format_version": "1.0.0", "runtime": {"library_path": ")"
                              << PENUMBRA_FAKE_OPENXR_RUNTIME << R"("}})";
  }
  void uninstall() const { std::filesystem::remove(manifest()); }

  static FakeOpenXrState& state() {
    return *function<FakeOpenXrStateFunction>(kFakeOpenXrStateFunction)();
  }
  static std::vector<FakeOpenXrFrame> frames() {
    std::vector<FakeOpenXrFrame> out;
    function<FakeOpenXrFramesFunction>(kFakeOpenXrFramesFunction)(&out);
    return out;
  }
  static std::string faults() {
    std::string out;
    function<FakeOpenXrFaultsFunction>(kFakeOpenXrFaultsFunction)(&out);
    return out;
  }

 private:
  [[nodiscard]] std::filesystem::path manifest() const { return folder_.path() / "runtime.json"; }
  void set(const std::string& name, const std::string& value) {
    variables_.push_back(name);
    ::setenv(name.c_str(), value.c_str(), 1);
  }
  template <class Function>
  static Function* function(const char* name) {
    static void* const library = ::dlopen(PENUMBRA_FAKE_OPENXR_RUNTIME, RTLD_NOW);
    return reinterpret_cast<Function*>(::dlsym(library, name));
  }

  TempFolder folder_;
  std::vector<std::string> variables_;
};

/// Looks every five milliseconds; false when `seconds` have passed without it.
inline bool within(double seconds, const std::function<bool()>& what) {
  using namespace std::chrono;
  const auto end = steady_clock::now() + duration<double>(seconds);
  while (!what()) {
    if (steady_clock::now() > end) return false;
    std::this_thread::sleep_for(milliseconds(5));
  }
  return true;
}

}  // namespace penumbra::test
