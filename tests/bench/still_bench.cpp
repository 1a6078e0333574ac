// A still as log JPEG 2000 to a wanted error, beside what its coder of wavelets takes alone; the
// built-in room with a camera's noise, 512 x 256 pixels of it or 1024 x 512, one thread of coders.
#include <random>

#include "bench/harness.h"
#include "capture/studio/environments.h"
#include "codec/codec.h"
#include "codec/internal/light_planes.h"
#include "codec/internal/wavelets.h"
#include "codec/log/log_jpeg2000.h"

namespace penumbra::bench {
namespace {

Image<Rgb> noisy_room(int rows) {
  Image<Rgb> out = capture::make_room_environment(2 * rows, rows);
  std::mt19937 random(1);
  std::normal_distribution<float> noise(1, .02f);
  for (Rgb& p : out.pixels()) p = p * std::max(.1f, noise(random));
  return out;
}

void code_still(benchmark::State& state) {
  const Image<Rgb> picture = noisy_room(static_cast<int>(state.range(0)));
  const codec::StillGoal goal{.deviation = .0213};
  std::vector<double> write_ms, read_ms, encoder_ms, decoder_ms;
  std::size_t bytes = 0;
  const auto planes = codec::planes_from_rgb(picture, 2048);
  for (auto _ : state) {
    Result<codec::CodedStill> coded;
    write_ms.push_back(time_ms(
        [&] { coded = codec::encode_log_jpeg2000(picture, goal, codec::WaveletCoder::kFast); }));
    if (!coded) {
      state.SkipWithError(coded.error().detail.c_str());
      return;
    }
    read_ms.push_back(time_ms([&] { (void)codec::decode_log_jpeg2000(coded->bytes, "picture"); }));
    std::vector<unsigned char> stream;
    encoder_ms.push_back(time_ms([&] { stream = *codec::encode_fast_wavelets(*planes, .006); }));
    decoder_ms.push_back(time_ms([&] { (void)codec::decode_wavelets(stream, "picture"); }));
    state.SetIterationTime(1e-3 * write_ms.back());
    bytes = coded->bytes.size();
  }
  state.counters["KB"] = static_cast<double>(bytes) / 1000;
  state.counters["write_ms"] = median(write_ms);
  state.counters["read_ms"] = median(read_ms);
  state.counters["encoder_alone_ms"] = median(encoder_ms);
  state.counters["decoder_alone_ms"] = median(decoder_ms);
}
BENCHMARK(code_still)
    ->Name("codec/still")
    ->ArgName("rows")
    ->Arg(256)
    ->Arg(512)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
