// OpenXR with all of its extensions that the headset uses, for whichever file comes first.
// threads: plain data
#pragma once

#include <EGL/egl.h>
#include <GLES3/gl31.h>
#include <time.h>

#define XR_USE_TIMESPEC
#define XR_USE_PLATFORM_EGL
#define XR_USE_GRAPHICS_API_OPENGL_ES
#include <openxr/openxr.h>
// After openxr.h and egl.h, which it needs.
#include <openxr/openxr_platform.h>
