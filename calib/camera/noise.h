// How noisy a camera's signal is.
// threads: reentrant; plain values
#pragma once

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// Signal y in fractions of full scale at gain g:
/// var(y) = g y / full_well_electrons + (g read_noise)^2, where `full_well_electrons` is at gain 1
/// and `read_noise` in fractions of full scale at gain 1. Quantisation is added by whoever knows
/// the bit depth.
/// source: Hasinoff et al. 2010, eq. 1-3
struct NoiseModel {
  double full_well_electrons = 20000;
  double read_noise = 5e-4;
  double variance(double y, double gain) const {
    return gain * y / full_well_electrons + gain * gain * read_noise * read_noise;
  }
};

}  // namespace penumbra::calib
#pragma GCC visibility pop
