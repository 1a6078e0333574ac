#include <vector>

#include "core/threads/parallel.h"
#include "prt/bake/bake.h"
#include "prt/bake/bake_rules.h"
#include "prt/transfer/transfer.h"

namespace penumbra::prt {

namespace {

struct ScaledTransfer {
  const Transfer* transfer;
  Rgb factor;
};

// The sum on the bands of the first, and on as many channels as the factors ask for.
Transfer with_added(const Transfer& to, const ScaledTransfer (&parts)[2]) {
  const bool grey = is_grey(parts[0].factor);
  Transfer out(to.bands, grey ? to.channels : 3, to.points);
  parallel_for(0, out.channels * coefficient_count(to.bands), [&](int row) {
    const int c = row / coefficient_count(to.bands), n = row % coefficient_count(to.bands),
              from = std::min(c, to.channels - 1);
    std::vector<float> sum(to.points);
    for (std::size_t p = 0; p < to.points; ++p) sum[p] = to.value(from, n, p);
    for (const auto& [part, factor] : parts)
      for (std::size_t p = 0; n < coefficient_count(part->bands) && p < to.points; ++p)
        sum[p] += factor[c] * part->value(from, n, p);
    for (std::size_t p = 0; p < to.points; ++p) out.set(c, n, p, sum[p]);
  });
  return out;
}

}  // namespace

BakedObject on_floor(const BakedObject& baked, const Rgb& albedo) {
  BakedObject out = baked;
  out.floor = out.ground_floor = out.floor_again = out.ground_floor_again = {};
  out.floor_echo = {};
  if (!out.receiver || baked.floor.points == 0) return out;
  out.receiver->albedo = albedo;
  if (albedo == Rgb{}) return out;
  Rgb again;
  for (int c = 0; c < 3; ++c)
    again[c] = albedo[c] * albedo[c] / (1 - albedo[c] * baked.floor_echo[c]);
  const auto lit = [&](const Transfer& t, float sign, const Transfer& once, const Transfer& more) {
    return with_added(t, {{&once, sign * albedo}, {&more, sign * again}});
  };
  out.transfer = lit(baked.transfer, 1, baked.floor, baked.floor_again);
  out.reflected = lit(baked.reflected, 1, baked.floor, baked.floor_again);
  out.ground_deficit = lit(baked.ground_deficit, -1, baked.ground_floor, baked.ground_floor_again);
  out.ground_reflected =
      lit(baked.ground_reflected, 1, baked.ground_floor, baked.ground_floor_again);
  return out;
}

}  // namespace penumbra::prt
