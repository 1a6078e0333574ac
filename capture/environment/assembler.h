// A camera's merged picture as part of a lat-long environment.
// threads: thread-bound
#pragma once

#include <cstdint>
#include <glm/gtc/quaternion.hpp>
#include <glm/mat3x3.hpp>
#include <vector>

#include "calib/camera/camera_model.h"
#include "capture/camera_regions.h"
#include "capture/frames.h"
#include "capture/hdr/merge.h"
#include "core/environment.h"
#include "core/half.h"
#include "core/image.h"
#include "core/pose.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

struct GatherSample;  // private: gather_kernel.h

/// Gathers a camera's merged image into a lat-long environment in world directions.
class EnvironmentAssembler {
 public:
  EnvironmentAssembler(const calib::CameraModel& projection, const Pose& world_from_camera,
                       int width, int height, const glm::dmat3& colour = glm::dmat3(1));
  EnvironmentAssembler(const CameraRegion& region, const Pose& world_from_camera, int width,
                       int height, const glm::dmat3& colour = glm::dmat3(1));
  ~EnvironmentAssembler();
  EnvironmentAssembler(EnvironmentAssembler&&) noexcept;
  EnvironmentAssembler& operator=(EnvironmentAssembler&&) noexcept;
  /// Bilinear gather; where the camera does not find_pixel, radiance and confidence are 0.
  /// threads: internally parallel; no allocation once `out` has its size and has held as many
  /// clipped pixels
  void assemble(const MergedImage& merged, Environment& out);

 private:
  void make_samples(const PixelLookup& find_pixel, const glm::dquat& camera_from_world);
  void list_seen();
  void gather_rows(int first_row, int last_row, const std::uint16_t* source, float scale,
                   Image<Rgb>& out);
  void list_clipped(const Image<HalfRgba>& source, std::vector<std::uint32_t>& out) const;
  struct ColumnSpan {
    int first, last;  // columns [first, last) of a row hold everything that is seen
  };
  glm::mat3 colour_;
  int source_width_, source_height_, width_, height_;
  bool complete_ = true;
  std::vector<ColumnSpan> spans_;      // one a row
  std::vector<int> seen_;              // pixels a row
  std::vector<double> alpha_;          // sum of the confidence a row, of the newest image
  std::vector<GatherSample> samples_;  // empty: the source is the environment already
  std::vector<float> gains_;           // by pixel of the map, against vignetting; empty: all 1
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
