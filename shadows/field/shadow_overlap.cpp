#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <glm/ext/vector_int2.hpp>
#include <span>

#include "core/threads/parallel.h"
#include "lighting/sh/rotation.h"
#include "prt/bake/bake.h"
#include "prt/geometry/receiver.h"
#include "prt/transfer/transfer.h"
#include "shadows/field/internal/overlap_kernel.h"
#include "shadows/field/planar_shadow.h"

namespace penumbra::shadows {

namespace {

// `s` of the first object below which the second cannot be divided out
constexpr float kDarkest = .02f;

// Whether there can be something in common: not where one takes what the other brings.
bool meet(float first, float second) {
  return (1 - first) * (1 - second) > 0 && first >= kDarkest;
}

// The second ratio so that its product with the first counts once what both take, or both bring.
float without_common(float first, float second, float of_first, float of_second) {
  const float a = 1 - first, b = 1 - second;
  if (!meet(first, second)) return second;
  const float size_a = std::abs(a), size_b = std::abs(b);
  // Both estimates of the common part agree for even light; either keeps inside the proven
  // interval.
  const float largest = std::min(size_a, size_b),
              smallest = std::min(std::max(0.f, a + b - 1), largest);
  const float common =
      std::clamp(.5f * (of_first * size_a + of_second * size_b), smallest, largest);
  return std::max(0.f, (1 - (a + b - std::copysign(common, a))) / first);
}

// Entries of a rotation of the harmonics, as the kernel reads them; none where nothing turns.
class TexelRotation {
 public:
  TexelRotation(const glm::dmat3& turn, int bands) {
    if (std::abs(turn[0].x - 1) <= 1e-9) return;
    const lighting::ShRotation rotation(turn, bands);
    for (int l = 0; l < bands; ++l)
      for (int m = -l; m <= l; ++m)
        for (int n = -l; n <= l; ++n)
          entries_[count_++] = static_cast<float>(rotation.entry(l, m, n));
  }
  std::span<const float> entries() const { return {entries_.data(), count_}; }

 private:
  std::array<float, kMaxBands*(4 * kMaxBands * kMaxBands - 1) / 3> entries_;  // band by band
  std::size_t count_ = 0;
};

// Two placed shadows, texel by texel of the second's. Where they meet, texels wait until they fill
// a batch, since the harmonics of one take as long as those of sixteen.
class MeetingTexels {
 public:
  MeetingTexels(const PlacedShadow& first, const PlacedShadow& second, const TexelRotation& turn,
                int bands, PlanarShadow& out)
      : first_(first), second_(second), turn_(turn), bands_(bands), out_(out) {}

  void add(glm::ivec2 of_first, glm::ivec2 of_second) {
    const Rgb& taken = first_.shadow->ratio.at(of_first.x, of_first.y);
    const Rgb& s = out_.ratio.at(of_second.x, of_second.y);
    if (!meet(taken.r, s.r) && !meet(taken.g, s.g) && !meet(taken.b, s.b)) return;
    waiting_[count_++] = {of_first, of_second};
    if (count_ == waiting_.size()) flush();
  }

  void flush() {
    if (count_ == 0) return;
    gather(*first_.object, &TexelPair::first, deficits_.first);
    gather(*second_.object, &TexelPair::second, deficits_.second);
    find_overlap(deficits_, bands_, turn_.entries(), overlap_);
    for (std::size_t i = 0; i < count_; ++i) {
      const auto& [at_first, at_second] = waiting_[i];
      const Rgb& taken = first_.shadow->ratio.at(at_first.x, at_first.y);
      Rgb& s = out_.ratio.at(at_second.x, at_second.y);
      for (int c = 0; c < 3; ++c)
        s[c] = without_common(taken[c], s[c], overlap_.of_first[i], overlap_.of_second[i]);
    }
    count_ = 0;
  }

 private:
  struct TexelPair {
    glm::ivec2 first, second;
  };

  // What the object takes there of its first channel; nothing in places that wait for no texel.
  void gather(const prt::BakedObject& object, glm::ivec2 TexelPair::*at,
              std::uint16_t (&out)[kMaxCoefficients][DeficitBatch::kTexels]) const {
    const prt::Transfer& t = object.ground_deficit;
    const int size = object.receiver->grid.size;
    std::size_t texels[DeficitBatch::kTexels];
    for (std::size_t i = 0; i < count_; ++i)
      texels[i] = static_cast<std::size_t>((waiting_[i].*at).y * size + (waiting_[i].*at).x);
    const std::uint16_t* from = t.values.data();
    for (int n = 0; n < coefficient_count(bands_); ++n, from += t.stride) {
      for (std::size_t i = 0; i < count_; ++i) out[n][i] = from[texels[i]];
      for (std::size_t i = count_; i < DeficitBatch::kTexels; ++i) out[n][i] = 0;
    }
  }

  const PlacedShadow &first_, &second_;
  const TexelRotation& turn_;
  int bands_;
  PlanarShadow& out_;
  std::array<TexelPair, DeficitBatch::kTexels> waiting_;
  std::size_t count_ = 0;
  DeficitBatch deficits_;
  OverlapBatch overlap_;
};

}  // namespace

void combine_shadows(const PlacedShadow& first, const PlacedShadow& second, PlanarShadow& out) {
  if (first.shadow->empty() || out.empty()) return;
  const prt::GroundGrid &grid = second.object->receiver->grid,
                        &grid_of_first = first.object->receiver->grid;
  const Pose first_from_second = first.world_from_bake.inverse() * second.world_from_bake;
  const int bands =
      std::min(first.object->ground_deficit.bands, second.object->ground_deficit.bands);
  const TexelRotation turn(glm::transpose(first_from_second.rotation_matrix()), bands);
  parallel_for(out.y0, out.y1, 8, [&](const auto& rows) {
    MeetingTexels texels(first, second, turn, bands, out);
    for (int y = rows.begin(); y < rows.end(); ++y)
      for (int x = out.x0; x < out.x1; ++x) {
        if (out.ratio.at(x, y) == Rgb{1, 1, 1}) continue;
        const glm::vec2 p =
            grid.position({(static_cast<float>(x) + .5f) / static_cast<float>(grid.size),
                           (static_cast<float>(y) + .5f) / static_cast<float>(grid.size)});
        const glm::dvec3 at = first_from_second * glm::dvec3(p.x, grid.height, p.y);
        if (const auto texel = texel_at(grid_of_first, {at.x, at.z})) texels.add(*texel, {x, y});
      }
    texels.flush();
  });
}

}  // namespace penumbra::shadows
