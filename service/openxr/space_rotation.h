// Turns vectors and harmonics from Penumbra's world into an application's space.
// threads: reentrant
#pragma once

#include <openxr/openxr.h>

#include <array>

namespace penumbra::openxr {

using Vector3 = std::array<float, 3>;
using Harmonics = float[9][3];  // three bands of RGB, in the order of the page

/// A rotation matrix, in rows.
struct SpaceRotation {
  std::array<Vector3, 3> rows = {Vector3{1, 0, 0}, Vector3{0, 1, 0}, Vector3{0, 0, 1}};

  friend bool operator==(const SpaceRotation&, const SpaceRotation&) = default;
};

/// Of any length but 0.
SpaceRotation rotation_of(const XrQuaternionf& q);
SpaceRotation inverse(const SpaceRotation& r);
Vector3 rotated(const SpaceRotation& r, const Vector3& v);

/// The same light on other axes.
/// in: of the world; out: of the application, and not `in`
void rotate_harmonics(const SpaceRotation& application_from_world, const Harmonics& in,
                      Harmonics& out);

}  // namespace penumbra::openxr
