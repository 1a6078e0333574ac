// The harness behind `chart`: one scene, one reference a light, and any method measured against it.
#pragma once

#include <functional>
#include <string>

#include "lighting/governor.h"
#include "lighting/light_estimate.h"
#include "prt/geometry/pinhole_view.h"
#include "prt/transfer/transfer.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/governor/single_thread_time.h"
#include "runtime/scene/scene.h"
#include "tools/chart/measures/accuracy.h"
#include "tools/pictures/still.h"

namespace penumbra::tools {

/// As if it had been baked with so many bands, at most those that there are: the same coefficients,
/// further ones left out.
prt::Transfer with_bands(const prt::Transfer& transfer, int bands);

/// An object on a 40 % grey floor before a camera that sees both.
class ChartScene {
 public:
  /// rays: of the bake, a vertex and a receiver texel
  /// errors: as prepare and make_masks
  static Result<ChartScene> make(const std::string& asset, int rays);

  const std::string& name() const { return name_; }
  /// Baked with kMaxBands.
  const runtime::PreparedScene& prepared() const { return prepared_; }
  /// As if it had been baked with so many.
  runtime::PreparedScene prepared_with(int bands) const;
  const Masks& masks() const { return masks_; }
  StillScene in(const Image<Rgb>& environment) const { return {&prepared_, &environment, view_}; }
  const prt::PinholeView& view() const { return view_; }

 private:
  std::string name_;
  runtime::PreparedScene prepared_;
  Masks masks_;
  prt::PinholeView view_;
};

/// What the governor takes for one environment by itself, as the program does at its default
/// budget.
/// errors: as extract_lights and project_latlong
Result<lighting::Plan> default_plan(const ChartScene& scene, const Image<Rgb>& environment,
                                    const lighting::CostModel& costs);

/// What every method is held against.
struct Truth {
  Still empty;  // the floor without the object
  Still full;   // path traced with it
};
/// errors: as render_reference
Result<Truth> trace_truth(const ChartScene& scene, const Image<Rgb>& environment, double error);

/// Composite under `light` and figures against the truth. `scene` may treat the objects in another
/// way than the bench's own does.
struct Measured {
  Accuracy accuracy;
  double flip = 0;
  runtime::LightTime time;  // of CompositeStage::shade on one thread, everything traced anew
};
Result<Measured> measure(const ChartScene& bench, const runtime::PreparedScene& scene,
                         const lighting::LightEstimate& light,
                         const runtime::ShadowSampling& sampling, const Truth& truth);

/// Its time alone, once more.
Result<runtime::LightTime> time_updates(const ChartScene& bench,
                                        const runtime::PreparedScene& scene,
                                        const lighting::LightEstimate& light,
                                        const runtime::ShadowSampling& sampling);

/// What a pipeline keeps of transfer and visibility, and the lights' maps, in bytes.
std::size_t memory_of(const runtime::PreparedScene& scene, std::size_t lights, int map_size);

}  // namespace penumbra::tools
