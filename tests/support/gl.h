// Test support: what draws needs a graphics driver, which a machine may lack.
#pragma once

#include <gtest/gtest.h>

#include "core/result.h"

/// Skips the test where `made`, a Result, says that there is no OpenGL ES.
#define PENUMBRA_NEED_GL(made)                                   \
  if (!(made) && (made).error().code == ErrorCode::kUnavailable) \
  GTEST_SKIP() << "no OpenGL ES 3.1 here: " << (made).error().detail
