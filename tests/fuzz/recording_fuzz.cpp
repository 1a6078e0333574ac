// A recording: its cameras and responses, its pictures and maps and their labels.
#include "capture/capture.h"
#include "tests/fuzz/file_input.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace penumbra;
  auto source =
      capture::open_capture(test::as_file({data, size}, ".mkv"), capture::RecordedLight::kBoth);
  if (!source) return 0;
  constexpr int kMaxFrames = 64;
  for (int n = 0; n < kMaxFrames; ++n) {
    const auto frame = (*source)->next();
    if (!frame || !*frame) break;
    if (!((*frame)->exposure.product() > 0)) __builtin_trap();
  }
  return 0;
}
