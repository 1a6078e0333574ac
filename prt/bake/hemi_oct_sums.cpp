#include "prt/bake/internal/hemi_oct_sums.h"

#include <algorithm>
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
    : bands_(bands), terms_(static_cast<std::size_t>(coefficient_count(bands))) {
  constexpr int kPlaces = 4 * kFineSide;  // along the square's side
  for (std::size_t k = 0; k < tables_.size(); ++k) {
    Tables& t = tables_[k];
    t.fine.resize(static_cast<std::size_t>(kFineSide * kFineSide) * terms_);
    const glm::dvec2 shift = .25 + .5 * glm::dvec2(k % 2, k / 2);
    for (int i = 0; i < kFineSide * kFineSide; ++i) {
      const glm::dvec2 ray = glm::dvec2(i % kFineSide, i / kFineSide) + shift;
      const glm::dvec3 p = on_octahedron(2. * ray / double(kFineSide) - 1.);
      t.x.push_back(static_cast<float>(p.x));
      t.y.push_back(static_cast<float>(p.y));
      t.z.push_back(static_cast<float>(p.z));
    }
  }
  double basis[kMaxCoefficients];
  for (int y = 0; y < kPlaces; ++y)
    for (int x = 0; x < kPlaces; ++x) {
      const glm::dvec3 p = on_octahedron((2. * glm::dvec2(x, y) + 1.) / double(kPlaces) - 1.);
      const double length = glm::length(p);
      // dw = dA / |p|^3 on the octahedron seen from above, of which a place is 2 / kPlaces^2
      const double weight = 2. / (kPlaces * kPlaces) / std::pow(length, 4) * p.z / kPi;
      lighting::evaluate_basis(bands, p / length, basis);
      constexpr int kPlacesOfWide = kPlaces / VisibilityBake::kWideCells;
      wide_[static_cast<std::size_t>(VisibilityBake::kWideCells * (y / kPlacesOfWide) +
                                     x / kPlacesOfWide)] += static_cast<float>(weight);
      for (std::size_t k = 0; k < tables_.size(); ++k) {
        // The nearest ray's: those at a quarter reach a quarter back, those at three a quarter on.
        const auto cell = [](int place, bool late) {
          return std::clamp((place + (late ? -1 : 1)) >> 2, 0, kFineSide - 1);
        };
        float* const sum =
            &tables_[k].fine[static_cast<std::size_t>(kFineSide * cell(y, k / 2 != 0) +
                                                      cell(x, k % 2 != 0)) *
                             terms_];
        for (std::size_t n = 0; n < terms_; ++n) sum[n] += static_cast<float>(weight * basis[n]);
      }
    }
  for (Tables& t : tables_) {
    t.cells = sums_of_four(t.fine, kFineSide, terms_);
    t.blocks = sums_of_four(sums_of_four(t.cells, kSide, terms_), kSide / 2, terms_);
  }
}

// The cosine from its product with Y_0, a constant.
static const auto kPerConstant = static_cast<float>(std::sqrt(4 * kPi));

float HemiOctSums::weight(const std::vector<float>& table, std::size_t cell) const {
  return kPerConstant * table[cell * terms_];
}

void HemiOctSums::add(const std::vector<float>& table, std::size_t cell,
                      std::span<float> sum) const {
  const float* const of_cell = &table[cell * terms_];
  for (std::size_t n = 0; n < terms_; ++n) sum[n] += of_cell[n];
}

OpenCells HemiOctSums::cells_below(const Tables& t, const HemiOctFrame& frame) {
  OpenCells out{};
  for (std::size_t i = 0; i < t.x.size(); ++i) {
    const float up = frame.first.y * t.x[i] + frame.second.y * t.y[i] + frame.normal.y * t.z[i];
    const std::size_t x = i % kFineSide, y = i / kFineSide;
    out[kBlockSide * (y / 8) + x / 8] |= std::uint64_t{up < 0} << (8 * (y % 8) + x % 8);
  }
  return out;
}

HemiOctSums::Blocked HemiOctSums::add_blocked(const OpenCells& open, const HemiOctFrame& frame,
                                              bool below, std::span<float> coefficients) const {
  const Tables& t = tables_[which(frame.fine_shift)];
  const OpenCells below_plane = below ? cells_below(t, frame) : OpenCells{};
  float white_less_black = 0;
  float sum[kMaxCoefficients] = {};
  const std::span<float> sums(sum, terms_);
  for (std::size_t block = 0; block < open.size(); ++block) {
    const std::uint64_t blocked = ~open[block] | below_plane[block];
    if (blocked == 0) continue;
    if (blocked == kAll) {
      add(t.blocks, block, sums);
      continue;
    }
    for (std::size_t i = 0; i < 16; ++i) {  // cells of the block, each of four finer ones
      const std::size_t shift = 16 * (i / 4) + 2 * (i % 4);
      const std::uint64_t quad = blocked >> shift & 0x303;
      if (quad == 0) continue;
      const std::size_t x = 4 * (block % kBlockSide) + i % 4, y = 4 * (block / kBlockSide) + i / 4;
      const float of_each = .25f * weight(t.cells, kSide * y + x);
      constexpr int kBits[] = {0, 1, 8, 9};
      for (std::size_t k = 0; k < 4; ++k) {
        if ((quad >> kBits[k] & 1) == 0) continue;
        white_less_black += k == 0 || k == 3 ? of_each : -of_each;
        if (quad != 0x303) add(t.fine, kFineSide * (2 * y + k / 2) + 2 * x + k % 2, sums);
      }
      if (quad == 0x303) add(t.cells, kSide * y + x, sums);
    }
  }
  const lighting::ShRotation turn(glm::dmat3(frame.first, frame.second, frame.normal), bands_);
  for (int l = 0; l < bands_; ++l)
    for (int m = -l; m <= l; ++m) {
      double turned = 0;
      for (int k = -l; k <= l; ++k) turned += turn.entry(l, m, k) * double(sum[sh_index(l, k)]);
      coefficients[static_cast<std::size_t>(sh_index(l, m))] += static_cast<float>(turned);
    }
  return {kPerConstant * sum[0], std::abs(white_less_black)};
}

}  // namespace penumbra::prt
