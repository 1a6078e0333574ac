// For measurements in this repository: a pipeline's stage by itself. Not installed.
// threads: plain functions
#pragma once

namespace penumbra {
class Pipeline;
}

namespace penumbra::runtime {

class CompositeStage;

struct StageAccess {
  /// It stays the pipeline's, on whose thread it is used.
  static CompositeStage& stage_of(Pipeline& pipeline);
};

}  // namespace penumbra::runtime
