#include "prt/bake/internal/hemi_oct_sums.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>

#include "core/conventions.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/rotation.h"

namespace penumbra::prt {

namespace {

constexpr int kFineSide = VisibilityMap::kFineCells, kSide = VisibilityMap::kCells,
              kBlockSide = VisibilityMap::kBlocks;
constexpr std::uint64_t kAll = ~std::uint64_t{0};

glm::dvec3 on_octahedron(glm::dvec2 place) {
  const double across = .5 * (place.x + place.y), along = .5 * (place.x - place.y);
  return {across, along, 1 - std::abs(across) - std::abs(along)};
}

// Cells of half the side, of four each.
std::vector<float> sums_of_four(const std::vector<float>& table, int side, std::size_t terms) {
  const int half = side / 2;
  std::vector<float> out(static_cast<std::size_t>(half * half) * terms);
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x)
      for (std::size_t n = 0; n < terms; ++n)
        out[static_cast<std::size_t>(half * (y / 2) + x / 2) * terms + n] +=
            table[static_cast<std::size_t>(side * y + x) * terms + n];
  return out;
}

}  // namespace

HemiOctSums::HemiOctSums(int bands)
    : bands_(bands),
      terms_(static_cast<std::size_t>(coefficient_count(bands))),
      fine_(static_cast<std::size_t>(kFineSide * kFineSide) * terms_) {
  constexpr int kInside = 2;  // places of a cell along a side
  double basis[kMaxCoefficients];
  for (int y = 0; y < kFineSide; ++y)
    for (int x = 0; x < kFineSide; ++x) {
      float* const sum = &fine_[static_cast<std::size_t>(kFineSide * y + x) * terms_];
      for (int k = 0; k < kInside * kInside; ++k) {
        const glm::dvec2 at(x + (k % kInside + .5) / kInside, y + (k / kInside + .5) / kInside);
        const glm::dvec3 p = on_octahedron(2. * at / double(kFineSide) - 1.);
        const double length = glm::length(p);
        // dw = dA / |p|^3 on the octahedron's plane seen from above, of which a cell is 2 / kFineSide^2
        const double weight = 2. / (kFineSide * kFineSide * kInside * kInside) /
                              std::pow(length, 3) * p.z / length / kPi;
        lighting::evaluate_basis(bands, p / length, basis);
        for (std::size_t n = 0; n < terms_; ++n) sum[n] += static_cast<float>(weight * basis[n]);
      }
      const glm::dvec3 middle =
          on_octahedron((2. * glm::dvec2(x, y) + 1.) / double(kFineSide) - 1.);
      x_.push_back(static_cast<float>(middle.x));
      y_.push_back(static_cast<float>(middle.y));
      z_.push_back(static_cast<float>(middle.z));
    }
  cells_ = sums_of_four(fine_, kFineSide, terms_);
  blocks_ = sums_of_four(sums_of_four(cells_, kSide, terms_), kSide / 2, terms_);
}

// Of the cosine; Y_0 is a constant.
float HemiOctSums::weight(const std::vector<float>& table, std::size_t cell) const {
  static const auto kPerConstant = static_cast<float>(std::sqrt(4 * kPi));
  return kPerConstant * table[cell * terms_];
}

float HemiOctSums::wide_weight(int x, int y) const {
  float sum = 0;
  for (int k = 0; k < 4; ++k)
    sum += weight(cells_, static_cast<std::size_t>(kSide * (2 * y + k / 2) + 2 * x + k % 2));
  return sum;
}

void HemiOctSums::add(const std::vector<float>& table, std::size_t cell,
                      std::span<float> sum) const {
  const float* const of_cell = &table[cell * terms_];
  for (std::size_t n = 0; n < terms_; ++n) sum[n] += of_cell[n];
}

OpenCells HemiOctSums::cells_below(const HemiOctFrame& frame) const {
  OpenCells out{};
  for (std::size_t i = 0; i < x_.size(); ++i) {
    const float up = frame.first.y * x_[i] + frame.second.y * y_[i] + frame.normal.y * z_[i];
    const std::size_t x = i % kFineSide, y = i / kFineSide;
    out[kBlockSide * (y / 8) + x / 8] |= std::uint64_t{up < 0} << (8 * (y % 8) + x % 8);
  }
  return out;
}

HemiOctSums::Blocked HemiOctSums::add_blocked(const OpenCells& open, const HemiOctFrame& frame,
                                              bool below, std::span<float> coefficients) const {
  const OpenCells below_plane = below ? cells_below(frame) : OpenCells{};
  Blocked out;
  float sum[kMaxCoefficients] = {};
  const std::span<float> sums(sum, terms_);
  for (std::size_t block = 0; block < open.size(); ++block) {
    const std::uint64_t blocked = ~open[block] | below_plane[block];
    if (blocked == 0) continue;
    if (blocked == kAll) {
      add(blocks_, block, sums);
      out.white += .5f * weight(blocks_, block), out.black += .5f * weight(blocks_, block);
      continue;
    }
    for (std::size_t i = 0; i < 16; ++i) {  // cells of the block, each of four finer ones
      const std::size_t shift = 16 * (i / 4) + 2 * (i % 4);
      const std::uint64_t quad = blocked >> shift & 0x303;
      if (quad == 0) continue;
      const std::size_t x = 4 * (block % kBlockSide) + i % 4, y = 4 * (block / kBlockSide) + i / 4;
      const float of_each = .25f * weight(cells_, kSide * y + x);
      constexpr int kBits[] = {0, 1, 8, 9};
      for (std::size_t k = 0; k < 4; ++k) {
        if ((quad >> kBits[k] & 1) == 0) continue;
        (k == 0 || k == 3 ? out.white : out.black) += of_each;
        if (quad != 0x303) add(fine_, kFineSide * (2 * y + k / 2) + 2 * x + k % 2, sums);
      }
      if (quad == 0x303) add(cells_, kSide * y + x, sums);
    }
  }
  const lighting::ShRotation turn(glm::dmat3(frame.first, frame.second, frame.normal), bands_);
  for (int l = 0; l < bands_; ++l)
    for (int m = -l; m <= l; ++m) {
      double turned = 0;
      for (int k = -l; k <= l; ++k) turned += turn.entry(l, m, k) * double(sum[sh_index(l, k)]);
      coefficients[static_cast<std::size_t>(sh_index(l, m))] += static_cast<float>(turned);
    }
  return out;
}

}  // namespace penumbra::prt
