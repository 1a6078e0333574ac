#include "service/openxr/space_rotation.h"

#include <cmath>

namespace penumbra::openxr {

SpaceRotation rotation_of(const XrQuaternionf& q) {
  const float n = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w;
  const float s = n > 0 ? 2 / n : 0;
  return {{Vector3{1 - s * (q.y * q.y + q.z * q.z), s * (q.x * q.y - q.z * q.w),
                   s * (q.x * q.z + q.y * q.w)},
           Vector3{s * (q.x * q.y + q.z * q.w), 1 - s * (q.x * q.x + q.z * q.z),
                   s * (q.y * q.z - q.x * q.w)},
           Vector3{s * (q.x * q.z - q.y * q.w), s * (q.y * q.z + q.x * q.w),
                   1 - s * (q.x * q.x + q.y * q.y)}}};
}

SpaceRotation inverse(const SpaceRotation& r) {
  SpaceRotation out;
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j) out.rows[i][j] = r.rows[j][i];
  return out;
}

Vector3 rotated(const SpaceRotation& r, const Vector3& v) {
  Vector3 out{};
  for (std::size_t i = 0; i < 3; ++i)
    out[i] = r.rows[i][0] * v[0] + r.rows[i][1] * v[1] + r.rows[i][2] * v[2];
  return out;
}

namespace {

// Factors of xy, yz, xz; of 3zz - 1; of xx - yy.
constexpr float kCross = 1.0925484f, kZonal = .3153916f, kDifference = .5462742f;

// Band 1 is a vector. Band 2 is the form d'Md of a symmetric matrix without trace, which turns as
// RMR': on the unit sphere 3zz - 1 = 2zz - xx - yy.
void rotate_band2(const SpaceRotation& r, const Harmonics& in, std::size_t c, Harmonics& out) {
  const float xy = kCross * in[4][c] / 2, yz = kCross * in[5][c] / 2, xz = kCross * in[7][c] / 2;
  const float p = kZonal * in[6][c], q = kDifference * in[8][c];
  const SpaceRotation m = {
      {Vector3{q - p, xy, xz}, Vector3{xy, -q - p, yz}, Vector3{xz, yz, 2 * p}}};
  SpaceRotation turned_rows;  // the rows of M' R', M being symmetric
  for (std::size_t i = 0; i < 3; ++i) turned_rows.rows[i] = rotated(r, m.rows[i]);
  const SpaceRotation columns = inverse(turned_rows);
  std::array<Vector3, 3> t;  // the columns of R M R'
  for (std::size_t j = 0; j < 3; ++j) t[j] = rotated(r, columns.rows[j]);
  out[4][c] = 2 * t[1][0] / kCross;
  out[5][c] = 2 * t[2][1] / kCross;
  out[6][c] = t[2][2] / (2 * kZonal);
  out[7][c] = 2 * t[2][0] / kCross;
  out[8][c] = (t[0][0] - t[1][1]) / (2 * kDifference);
}

}  // namespace

void rotate_harmonics(const SpaceRotation& application_from_world, const Harmonics& in,
                      Harmonics& out) {
  for (std::size_t c = 0; c < 3; ++c) {
    out[0][c] = in[0][c];
    const Vector3 v = rotated(application_from_world, {in[3][c], in[1][c], in[2][c]});
    out[3][c] = v[0], out[1][c] = v[1], out[2][c] = v[2];
    rotate_band2(application_from_world, in, c, out);
  }
}

}  // namespace penumbra::openxr
