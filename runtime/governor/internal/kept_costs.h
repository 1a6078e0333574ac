// A cost model kept between starts of one machine.
// threads: reentrant
#pragma once

#include <functional>
#include <string>

#include "core/result.h"
#include "lighting/governor.h"
#include "runtime/scene/scene.h"

namespace penumbra::runtime {

/// Of the first processor: times of one say nothing of another. Empty where the kernel tells none.
std::string processor_name();

/// Of this scene on this processor, from the cache folder of bakes, else fitted and put there. One
/// that is damaged is fitted anew; one that cannot be written is fitted at every start.
/// errors: of `fit`
Result<lighting::CostModel> recall_or_fit(const PreparedScene& scene,
                                          const std::function<Result<lighting::CostModel>()>& fit);

}  // namespace penumbra::runtime
