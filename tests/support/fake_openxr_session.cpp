// The fake OpenXR runtime's session: its states and a paced frame loop.
// threads: thread-safe
#include <cstring>

#include "tests/support/fake_openxr_internal.h"

namespace fake_xr {

Session session;

XrResult alive(XrSession of) {
  if (of != kSession || !session.lives)
    return fault("a session that does not live", XR_ERROR_HANDLE_INVALID);
  return session.lost ? XR_ERROR_INSTANCE_LOST : XR_SUCCESS;
}

namespace {

// Enters a state when its event is read, as applications see it.
XRAPI_ATTR XrResult XRAPI_CALL fake_poll_event(XrInstance, XrEventDataBuffer* out) {
  const std::lock_guard lock(mutex);
  if (!has_type(out, XR_TYPE_EVENT_DATA_BUFFER)) return fault("xrPollEvent: type");
  if (session.lost) return XR_ERROR_INSTANCE_LOST;
  if (session.events.empty()) return XR_EVENT_UNAVAILABLE;
  session.state = session.events.front();
  session.events.pop_front();
  const XrEventDataSessionStateChanged event = {XR_TYPE_EVENT_DATA_SESSION_STATE_CHANGED, nullptr,
                                                kSession, session.state,
                                                monotonic_ns() + FakeOpenXrState::kTimeAhead_ns};
  std::memcpy(out, &event, sizeof event);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_create_session(XrInstance, const XrSessionCreateInfo* info,
                                                   XrSession* out) {
  const std::lock_guard lock(mutex);
  if (knobs.refuses("session")) return XR_ERROR_RUNTIME_FAILURE;
  if (!has_type(info, XR_TYPE_SESSION_CREATE_INFO)) return fault("xrCreateSession: type");
  if (info->systemId != kSystem) return fault("xrCreateSession: system");
  const auto* egl = static_cast<const XrGraphicsBindingEGLMNDX*>(info->next);
  if (egl && egl->type != XR_TYPE_GRAPHICS_BINDING_EGL_MNDX) egl = nullptr;
  const auto* glx = static_cast<const XrGraphicsBindingOpenGLXlibKHR*>(info->next);
  if (glx && glx->type != XR_TYPE_GRAPHICS_BINDING_OPENGL_XLIB_KHR) glx = nullptr;
  if ((egl && !session.asked_for_gles) || (glx && !session.asked_for_gl))
    return fault("xrCreateSession: graphics requirements",
                 XR_ERROR_GRAPHICS_REQUIREMENTS_CALL_MISSING);
  if (egl && (egl->context == EGL_NO_CONTEXT || !egl->getProcAddress ||
              egl->context != eglGetCurrentContext()))
    return fault("xrCreateSession: context", XR_ERROR_GRAPHICS_DEVICE_INVALID);
  if (glx && (!glx->xDisplay || !glx->glxFBConfig || !glx->visualid || !glx->glxDrawable ||
              !glx->glxContext || glx->glxContext != glXGetCurrentContext() ||
              glx->xDisplay != glXGetCurrentDisplay()))
    return fault("xrCreateSession: GLX context", XR_ERROR_GRAPHICS_DEVICE_INVALID);
  session = Session{};
  session.lives = true, session.has_graphics = egl || glx, session.has_glx = glx;
  state.sessions = 1;
  session.events = {XR_SESSION_STATE_IDLE};
  if (!knobs.refuses("ready")) session.events.push_back(XR_SESSION_STATE_READY);
  state.frames_waited = state.frames_begun = state.frames_ended = 0;
  session.next_frame_ns = monotonic_ns();
  *out = kSession;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_destroy_session(XrSession of) {
  const std::lock_guard lock(mutex);
  if (of != kSession || !session.lives) return fault("xrDestroySession: handle");
  // Allowed, but a runtime that has gone may keep the caller waiting for ever.
  if (session.lost) fault("xrDestroySession: after the loss");
  state.sessions_left += session.asked_to_exit && !session.begun;
  end_session();
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_begin_session(XrSession of, const XrSessionBeginInfo* info) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (!has_type(info, XR_TYPE_SESSION_BEGIN_INFO)) return fault("xrBeginSession: type");
  if (info->primaryViewConfigurationType != view_type())
    return XR_ERROR_VIEW_CONFIGURATION_TYPE_UNSUPPORTED;
  if (session.state != XR_SESSION_STATE_READY)
    return fault("xrBeginSession: not ready", XR_ERROR_SESSION_NOT_READY);
  session.begun = true;
  for (const auto next :
       {XR_SESSION_STATE_SYNCHRONIZED, XR_SESSION_STATE_VISIBLE, XR_SESSION_STATE_FOCUSED})
    session.events.push_back(next);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_request_exit(XrSession of) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (!session.begun) return XR_ERROR_SESSION_NOT_RUNNING;
  if (std::exchange(session.asked_to_exit, true)) return fault("xrRequestExitSession: twice");
  session.events.push_back(XR_SESSION_STATE_STOPPING);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_end_session(XrSession of) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (session.state != XR_SESSION_STATE_STOPPING)
    return fault("xrEndSession: not stopping", XR_ERROR_SESSION_NOT_STOPPING);
  session.begun = false;
  session.events.push_back(XR_SESSION_STATE_IDLE);
  if (session.asked_to_exit) session.events.push_back(XR_SESSION_STATE_EXITING);
  return XR_SUCCESS;
}

// ---- Frames. ----

void take_off_or_put_on(int frame) {
  if (knobs.put_up == 0) return;
  if (frame == knobs.put_down) session.events.push_back(XR_SESSION_STATE_SYNCHRONIZED);
  if (frame == knobs.put_up) {
    session.events.push_back(XR_SESSION_STATE_VISIBLE);
    session.events.push_back(XR_SESSION_STATE_FOCUSED);
  }
}

XRAPI_ATTR XrResult XRAPI_CALL fake_wait_frame(XrSession of, const XrFrameWaitInfo* info,
                                               XrFrameState* out) {
  std::int64_t wait_ns = 0;
  {
    const std::lock_guard lock(mutex);
    if (session.lost) return fault("xrWaitFrame: after the loss", XR_ERROR_INSTANCE_LOST);
    if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
    if (!has_type(info, XR_TYPE_FRAME_WAIT_INFO) || !has_type(out, XR_TYPE_FRAME_STATE))
      return fault("xrWaitFrame: type");
    if (!session.begun) return fault("xrWaitFrame: before begin", XR_ERROR_SESSION_NOT_RUNNING);
    if (knobs.lose_after && state.frames_waited >= knobs.lose_after) {
      session.lost = true;
      return XR_ERROR_INSTANCE_LOST;
    }
    wait_ns = session.next_frame_ns - monotonic_ns();
  }
  if (wait_ns > 0) {
    const timespec t = {static_cast<time_t>(wait_ns / 1'000'000'000),
                        static_cast<long>(wait_ns % 1'000'000'000)};
    ::nanosleep(&t, nullptr);
  }
  const std::lock_guard lock(mutex);
  const auto period_ns = static_cast<std::int64_t>(1e9 / knobs.rate_hz);
  session.next_frame_ns = std::max(session.next_frame_ns + period_ns, monotonic_ns());
  session.predicted_ns = session.next_frame_ns;
  out->predictedDisplayTime = session.predicted_ns + FakeOpenXrState::kTimeAhead_ns;
  out->predictedDisplayPeriod = period_ns;
  const int frame = state.frames_waited++;
  take_off_or_put_on(frame);
  const bool away = frame >= knobs.put_down && frame < knobs.put_up;
  out->shouldRender = frame > 0 && !away;  // not the first, as other runtimes do
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_begin_frame(XrSession of, const XrFrameBeginInfo* info) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (!has_type(info, XR_TYPE_FRAME_BEGIN_INFO)) return fault("xrBeginFrame: type");
  if (state.frames_begun >= state.frames_waited)
    return fault("xrBeginFrame: order", XR_ERROR_CALL_ORDER_INVALID);
  ++state.frames_begun;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_end_frame(XrSession of, const XrFrameEndInfo* info) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (!has_type(info, XR_TYPE_FRAME_END_INFO)) return fault("xrEndFrame: type");
  if (state.frames_ended >= state.frames_begun)
    return fault("xrEndFrame: order", XR_ERROR_CALL_ORDER_INVALID);
  if (info->displayTime != session.predicted_ns + FakeOpenXrState::kTimeAhead_ns)
    return fault("xrEndFrame: another time than predicted", XR_ERROR_TIME_INVALID);
  if (info->environmentBlendMode != XR_ENVIRONMENT_BLEND_MODE_OPAQUE &&
      !(knobs.alpha && info->environmentBlendMode == XR_ENVIRONMENT_BLEND_MODE_ALPHA_BLEND))
    return fault("xrEndFrame: blend mode", XR_ERROR_ENVIRONMENT_BLEND_MODE_UNSUPPORTED);
  ++state.frames_ended;
  state.layers_of_last_frame = info->layerCount;
  return keep_layers(*info);
}

}  // namespace

Functions session_functions() {
  return {{"xrPollEvent", any(fake_poll_event)},
          {"xrCreateSession", any(fake_create_session)},
          {"xrDestroySession", any(fake_destroy_session)},
          {"xrBeginSession", any(fake_begin_session)},
          {"xrRequestExitSession", any(fake_request_exit)},
          {"xrEndSession", any(fake_end_session)},
          {"xrWaitFrame", any(fake_wait_frame)},
          {"xrBeginFrame", any(fake_begin_frame)},
          {"xrEndFrame", any(fake_end_frame)}};
}

}  // namespace fake_xr
