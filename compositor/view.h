// What a picture is made of: the view, what its camera does to it, how objects look, the shadows of
// lights.
// threads: plain values
#pragma once

#include <cstdint>
#include <glm/vec2.hpp>
#include <memory>
#include <span>

#include "calib/camera/response_table.h"
#include "calib/camera/vignetting.h"
#include "core/image.h"
#include "prt/clip/light_map.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/pinhole_view.h"
#include "shadows/silhouette/shadow_map.h"

#pragma GCC visibility push(default)
namespace penumbra::compositor {

class ViewLens;
struct Foreground;

/// What the camera does to all it sees, and so must happen to what is inserted. The blur of its
/// optics is a Gaussian. The noise of its sensor has the variance g y + r^2 at signal y. Real
/// pixels are not blurred again; a shadowed one gets what its noise lacks to that of a really
/// darker one. By default nothing happens.
/// source: Klein & Murray 2010; noise Hasinoff et al. 2010
struct SensorEffects {
  static constexpr float kLargestPsfSigma = 20;

  float psf_sigma_px = 0;   // 0..kLargestPsfSigma; the pixel grid keeps edges too sharp under .6
  float shot_gain = 0;      // g, variance per unit of signal; signal in fractions of full scale
  float read_noise = 0;     // r, standard deviation in signal
  std::uint64_t frame = 0;  // another number, another pattern: must differ from frame to frame and
                            // from eye to eye; the same number gives the same bytes

  bool none() const { return psf_sigma_px == 0 && shot_gain == 0 && read_noise == 0; }
};

/// One eye of one frame.
struct View {
  prt::PinholeView camera;
  const ResponseTable* curve = nullptr;  // of 8 or 16 bit as the frame; unused for float frames
  float signal_per_radiance = 1;  // sensor signal (fraction of full scale) per unit of radiance
  SensorEffects effects{};
  Vignetting vignetting{};  // of what is inserted; shadows are ratios and do not ask
  /// What the largest code stands for, in signal, where a shadow or an object's edge lies over it.
  /// It is what the code says, or more where the surface is known to be brighter. Not for float
  /// frames.
  Rgb clipped_signal{};
  /// Null: the pinhole of `camera`. Else of `camera` only size and pose count, and the focal length
  /// near the axis. Stays for as long as what was drawn through it.
  std::shared_ptr<const ViewLens> lens{};
  /// What real things stand in front; null: none that the scene does not know. Another pointer,
  /// other contents.
  std::shared_ptr<const Foreground> foreground{};
};

/// How an object looks beyond its vertices.
struct Appearance {
  /// A picture of its albedo, coded in sRGB, and where each vertex lies in it. `tint` is what else
  /// there is of albedo, by vertex.
  const Image<Rgb8>* texture = nullptr;
  std::span<const glm::vec2> texture_coordinates{};
  std::span<const Rgb> tint{};
  /// A light map: its texels are the points behind the mesh's vertices, in order.
  int light_width = 0, light_height = 0;
  std::span<const glm::vec2> light_coordinates{};
  std::span<const prt::SurfaceLayout::Texel> texels{};
};

/// A light's shadow and what it is a part of.
struct ShadowMapOnPlane {
  const shadows::ShadowMap* shadow;
  // E_light/E_0 on the open plane, 0..1; negative: light of a virtual lamp, which is added
  Rgb part;
  /// What real things take of the same light further around (its `virtual_occlusion`), one map for
  /// all shadows of the light on that plane; null without real things.
  const shadows::ShadowMap* real = nullptr;
};

/// The mouse over a window and the number keys, after the last picture.
struct Pointer {
  glm::dvec2 place{0, 0};            // in the picture, from its upper left corner (0, 0) to (1, 1)
  bool left = false, right = false;  // buttons that are held
  double wheel = 0;                  // notches, away from the user, since the picture before
  int number = 0;                    // key 1 to 9 that was pressed since then; 0: none
  bool space = false;                // the space bar was pressed since then
  bool shift = false;                // a shift key is held
};

}  // namespace penumbra::compositor
#pragma GCC visibility pop
