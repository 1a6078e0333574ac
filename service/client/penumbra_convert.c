#include "penumbra_convert.h"

#include <string.h>

// In front of the polynomial of each harmonic, times A_l/pi = 1, 2/3, 1/4: of a radiance's
// coefficient it makes the polynomial's of E/pi, which a white surface sends (Ramamoorthi and
// Hanrahan 2001, equation 9).
static const float kIrradiance[9] = {
    .2820948f,                                             // 1
    .3257350f, .3257350f, .3257350f,                       // y, z, x
    .2731371f, .2731371f, .0788479f, .2731371f, .1365686f  // xy, yz, 3zz - 1, xz, xx - yy
};
static const float kHalfRoot3 = .8660254f;

// Y_lm has an even or odd power of z as l + m is even or odd, and z is the only axis that changes
// its sign: so the coefficients with odd l + m do.
static int is_odd_in_z(int l, int m) {
  return (l + m) & 1;
}

// The Condon-Shortley phase is (-1)^m.
static int has_odd_order(int l, int m) {
  (void)l;
  return m & 1;
}

static void flip(int (*flips)(int, int), int bands, float sh[][3]) {
  for (int l = 0; l < bands; ++l)
    for (int m = -l; m <= l; ++m)
      if (flips(l, m))
        for (int c = 0; c < 3; ++c) sh[l * l + l + m][c] = -sh[l * l + l + m][c];
}

static void to_irradiance(int bands, float sh[][3]) {
  for (int n = 0; n < bands * bands; ++n)
    for (int c = 0; c < 3; ++c) sh[n][c] *= kIrradiance[n];
}

// Unreal's axes are X = -z, Y = x, Z = y, its basis has the phase (-1)^m. Each harmonic of ours is
// written in X, Y, Z and compared with theirs:
//   band 1: y = Z, z = -X, x = Y against (-Y, Z, -X)
//   band 2: xy = YZ, yz = -XZ, xz = -XY against (XY, -YZ, -XZ);
//           with p = 3ZZ - 1 and q = XX - YY on the unit sphere
//           3zz - 1 = 3XX - 1 = (3q - p)/2 and xx - yy = YY - ZZ = -(p + q)/2,
//           and the factor of q is root 3 times that of p.
static void to_unreal(int bands, float sh[][3]) {
  float in[9][3];
  memcpy(in, sh, sizeof(float) * 3 * (size_t)(bands * bands));
  for (int c = 0; c < 3 && bands > 1; ++c) {
    sh[1][c] = -in[3][c];
    sh[2][c] = in[1][c];
    sh[3][c] = in[2][c];
  }
  for (int c = 0; c < 3 && bands > 2; ++c) {
    sh[4][c] = -in[7][c];
    sh[5][c] = -in[4][c];
    sh[6][c] = -.5f * in[6][c] - kHalfRoot3 * in[8][c];
    sh[7][c] = in[5][c];
    sh[8][c] = kHalfRoot3 * in[6][c] - .5f * in[8][c];
  }
}

static int most_bands(enum penumbra_convention convention) {
  switch (convention) {
    case PENUMBRA_CONVENTION_WEBXR:
    case PENUMBRA_CONVENTION_ARCORE:
    case PENUMBRA_CONVENTION_GODOT:
      return PENUMBRA_PAGE_BANDS;
    case PENUMBRA_CONVENTION_FILAMENT:
    case PENUMBRA_CONVENTION_UNITY:
    case PENUMBRA_CONVENTION_UNREAL:
      return 3;
  }
  return 0;
}

int penumbra_sh_convert(enum penumbra_convention convention, const float in[][3], int bands,
                        float out[][3]) {
  if (!in || !out || bands < 1 || bands > most_bands(convention)) return PENUMBRA_ARGUMENT;
  memmove(out, in, sizeof(float) * 3 * (size_t)(bands * bands));
  switch (convention) {
    case PENUMBRA_CONVENTION_WEBXR:
      break;                          // the same basis on the same axes
    case PENUMBRA_CONVENTION_ARCORE:  // the same axes, a basis with the phase
      flip(has_odd_order, bands, out);
      break;
    case PENUMBRA_CONVENTION_GODOT:  // its shader looks the light up at a mirrored z
      flip(is_odd_in_z, bands, out);
      break;
    case PENUMBRA_CONVENTION_FILAMENT:  // the same axes, polynomials of E/pi
      to_irradiance(bands, out);
      break;
    case PENUMBRA_CONVENTION_UNITY:  // left-handed: z = -z; polynomials of E/pi
      flip(is_odd_in_z, bands, out);
      to_irradiance(bands, out);
      break;
    case PENUMBRA_CONVENTION_UNREAL:
      to_unreal(bands, out);
      break;
  }
  return PENUMBRA_OK;
}

int penumbra_direction_convert(enum penumbra_convention convention, const float in[3],
                               float out[3]) {
  if (!in || !out || most_bands(convention) == 0) return PENUMBRA_ARGUMENT;
  const float x = in[0], y = in[1], z = in[2];
  out[0] = x, out[1] = y, out[2] = z;
  if (convention == PENUMBRA_CONVENTION_UNITY) out[2] = -z;  // z points forward
  if (convention == PENUMBRA_CONVENTION_UNREAL)              // x forward, y right, z up
    out[0] = -z, out[1] = x, out[2] = y;
  return PENUMBRA_OK;
}
