// Environments by name: built in, or real ones of the shared data.
#pragma once

#include <string>

#include "capture/capture.h"
#include "runtime/pipeline/light_file.h"
#include "tests/support/shared_data.h"

namespace penumbra::test {

/// "room" and "clear_sky", or a shared map of 1024x512.
/// errors: kNotFound where the shared data is absent, else what reading says
inline Result<Image<Rgb>> environment_map(const std::string& name) {
  if (name == "room") return capture::make_room_environment(1024, 512);
  if (name == "clear_sky") return capture::make_sky_environment(1024, 512, .8);
  const std::string file = "envmaps/" + name + "_1k.hdr";
  const auto path = shared_data(file);
  if (!path)
    return fail(ErrorCode::kNotFound, "shared data file absent: " + file,
                "set PENUMBRA_SHARED_DATA to the folder that holds it");
  auto light = runtime::read_light(path->string());
  if (!light) return std::unexpected(light.error());
  return runtime::whole_latlong(*light);
}

}  // namespace penumbra::test

// Declares `var` as an environment's map, skips the test where the shared data is absent, fails it
// where reading fails.
#define PENUMBRA_NEED_ENVIRONMENT(var, name)                                                \
  const auto var##_read = ::penumbra::test::environment_map(name);                          \
  if (!var##_read && var##_read.error().code == ErrorCode::kNotFound)                       \
    GTEST_SKIP() << var##_read.error().where << ": " << var##_read.error().detail;          \
  ASSERT_TRUE(var##_read) << var##_read.error().where << ": " << var##_read.error().detail; \
  const Image<Rgb>& var = *var##_read
