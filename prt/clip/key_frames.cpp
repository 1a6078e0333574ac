#include "prt/clip/key_frames.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "prt/clip/sequence.h"
#include "prt/transfer/transfer.h"

namespace penumbra::prt {

double KeyFrames::frame_at(double clips) const {
  const double whole = std::floor(clips), place = (clips - whole) * parts;
  const auto next = std::upper_bound(at.begin() + 1, at.end(), place);
  const auto before = static_cast<std::size_t>(next - at.begin()) - 1;
  return whole * static_cast<double>(at.size()) + static_cast<double>(before) +
         (place - at[before]) / width(before);
}

namespace {

// Mean square of the second derivative by part at a frame, from it and those before and after.
double mean_square_bend(const Transfer& before, const Transfer& here, const Transfer& after,
                        double h_before, double h_after) {
  constexpr std::size_t kStep = 7;  // of the points: a sample is plenty
  const auto energy = mean_band_energy();
  double sum = 0, samples = 0;
  for (int c = 0; c < here.channels; ++c) {
    for (int l = 0; l < here.bands; ++l)
      for (int n = sh_index(l, -l); n <= sh_index(l, l); ++n)
        for (std::size_t p = 0; p < here.points; p += kStep) {
          const double v = here.value(c, n, p);
          const double bend =
              2 / (h_before + h_after) *
              ((after.value(c, n, p) - v) / h_after - (v - before.value(c, n, p)) / h_before);
          sum += double(energy[static_cast<std::size_t>(l)]) * bend * bend;
        }
    samples += static_cast<double>((here.points + kStep - 1) / kStep);
  }
  return samples > 0 ? sum / samples : 0;
}

}  // namespace

std::vector<double> interpolation_errors(const KeyFrames& keys, std::span<const Transfer> frames) {
  constexpr std::size_t kFewest = 4;
  const std::size_t count = frames.size();
  if (count < kFewest) return std::vector<double>(count, std::numeric_limits<double>::infinity());
  std::vector<double> bend(count), out(count);
  for (std::size_t f = 0; f < count; ++f) {
    const std::size_t before = (f + count - 1) % count;
    bend[f] = mean_square_bend(frames[before], frames[f], frames[(f + 1) % count],
                               keys.width(before), keys.width(f));
  }
  for (std::size_t f = 0; f < count; ++f) {
    const double h = keys.width(f);
    out[f] = h * h / 4 * std::sqrt(std::max(bend[f], bend[(f + 1) % count]));
  }
  return out;
}

}  // namespace penumbra::prt
