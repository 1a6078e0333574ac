// Sums over one lat-long row, with run-time choice of the vector instructions.
// threads: reentrant; RowTables with their scratch belong to one thread
#pragma once

#include "lighting/sh/map_luminance.h"

namespace penumbra::lighting {

/// Cosine and sine tables over the first quarter turn: cosine[m * stride + k] = cos(m p_k),
/// p_k = 2 pi (k + .5)/width, k < width/4, zero up to the stride; sine likewise.
struct RowTables {
  int width = 0, bands = 0;
  int stride = 0;  // width/4 rounded up to a multiple of 64 floats
  const float* cosine = nullptr;
  const float* sine = nullptr;
  float* scratch = nullptr;  // 12 * stride floats
};

/// out_cos[m][c] = sum over the row of L_c cos(m p), out_sin likewise; m < bands.
void row_fourier_sums(const RowTables& tables, const float* rgb, double (*out_cos)[3],
                      double (*out_sin)[3]);

/// The sum of a row's luminance, not finite where a pixel is not. peaks: the largest value, at
/// least 0, of each kPeakBlock pixels; peak_blocks(width) of them.
double row_luminance(const float* rgb, int width, float* peaks);
/// The sum of what is above the level.
double row_luminance_above(const float* rgb, int width, float level);
/// Of each pixel.
void pixel_luminance(const float* rgb, int width, float* out);

/// What was cut off some pixels of a row.
struct CutSums {
  double rgb[3] = {};
  double square = 0;    // of luminance over its unit
  double x = 0, z = 0;  // luminance times the column's direction
};
/// Cuts brighter pixels down to a luminance `level`, at least 0. column_x, column_z: a direction
/// for each pixel. unit: about the largest luminance, of which squares must neither vanish nor
/// overflow.
/// out: what was cut off, 0 of darker pixels; adds it to `sums`
void cut_row(float* rgb, int width, float level, float unit, const float* column_x,
             const float* column_z, float* excess_rgb, float* excess_luminance, CutSums& sums);

}  // namespace penumbra::lighting
