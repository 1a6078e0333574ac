// The fake OpenXR runtime's poses: spaces, a head that turns, and controllers.
// threads: thread-safe
#include <cmath>
#include <cstring>

#include "tests/support/fake_openxr_internal.h"

namespace fake_xr {

std::map<XrSpace, Space> spaces;
std::set<XrAction> actions;
std::set<XrActionSet> action_sets;

bool is_pose(const XrPosef& p) {
  const XrQuaternionf& q = p.orientation;
  const float n = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w;
  return std::abs(n - 1) < .01f && std::isfinite(p.position.x + p.position.y + p.position.z);
}

namespace {

XrQuaternionf times(const XrQuaternionf& a, const XrQuaternionf& b) {
  return {
      a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y, a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
      a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w, a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z};
}

XrQuaternionf conjugate(const XrQuaternionf& q) {
  return {-q.x, -q.y, -q.z, q.w};
}

XrVector3f turned(const XrQuaternionf& q, const XrVector3f& v) {
  const XrQuaternionf r = times(times(q, {v.x, v.y, v.z, 0}), conjugate(q));
  return {r.x, r.y, r.z};
}

XrPosef times(const XrPosef& a, const XrPosef& b) {
  const XrVector3f p = turned(a.orientation, b.position);
  return {times(a.orientation, b.orientation),
          {a.position.x + p.x, a.position.y + p.y, a.position.z + p.z}};
}

XrPosef inverse(const XrPosef& p) {
  const XrQuaternionf q = conjugate(p.orientation);
  return {q, turned(q, {-p.position.x, -p.position.y, -p.position.z})};
}

XrPosef head_at(XrTime time) {
  const double half = fake_openxr_yaw(knobs.turn_deg_s, time - FakeOpenXrState::kTimeAhead_ns) / 2;
  return {{0, static_cast<float>(std::sin(half)), 0, static_cast<float>(std::cos(half))},
          {0, static_cast<float>(kFakeOpenXrEyeHeight_m), 0}};
}

// The head turns in its place; the local space begins there, turned as the knob says. Hands are
// held still.
XrPosef in_stage(const Space& space, XrTime time) {
  XrPosef origin = {{0, 0, 0, 1}, {0, 0, 0}};
  if (space.hand >= 0)
    origin.position = {space.hand == 0 ? -.2f : .2f, 1.2f, -.4f};
  else if (space.type == XR_REFERENCE_SPACE_TYPE_LOCAL)
    origin = {knobs.local, {0, static_cast<float>(kFakeOpenXrEyeHeight_m), 0}};
  else if (space.type == XR_REFERENCE_SPACE_TYPE_VIEW)
    origin = head_at(time);
  return times(origin, space.pose);
}

XRAPI_ATTR XrResult XRAPI_CALL fake_enumerate_reference_spaces(XrSession, std::uint32_t capacity,
                                                               std::uint32_t* count,
                                                               XrReferenceSpaceType* out) {
  return give(std::array{XR_REFERENCE_SPACE_TYPE_VIEW, XR_REFERENCE_SPACE_TYPE_LOCAL,
                         XR_REFERENCE_SPACE_TYPE_STAGE},
              knobs.refuses("stage") ? 2 : 3, capacity, count, out);
}

XrSpace add_space(const Space& space) {
  const auto out = new_handle<XrSpace>();
  spaces[out] = space;
  state.spaces = static_cast<int>(spaces.size());
  return out;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_create_reference_space(XrSession of,
                                                           const XrReferenceSpaceCreateInfo* info,
                                                           XrSpace* out) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (!has_type(info, XR_TYPE_REFERENCE_SPACE_CREATE_INFO))
    return fault("xrCreateReferenceSpace: type");
  if (!is_pose(info->poseInReferenceSpace))
    return fault("xrCreateReferenceSpace: pose", XR_ERROR_POSE_INVALID);
  if (info->referenceSpaceType == XR_REFERENCE_SPACE_TYPE_STAGE && knobs.refuses("stage"))
    return XR_ERROR_REFERENCE_SPACE_UNSUPPORTED;
  *out = add_space({info->referenceSpaceType, -1, info->poseInReferenceSpace});
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_bounds(XrSession, XrReferenceSpaceType, XrExtent2Df* out) {
  *out = {0, 0};
  return XR_SPACE_BOUNDS_UNAVAILABLE;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_destroy_space(XrSpace space) {
  const std::lock_guard lock(mutex);
  const bool known = spaces.erase(space) == 1;
  state.spaces = static_cast<int>(spaces.size());
  return known ? XR_SUCCESS : fault("xrDestroySpace: handle", XR_ERROR_HANDLE_INVALID);
}

constexpr XrSpaceLocationFlags kLocated =
    XR_SPACE_LOCATION_ORIENTATION_VALID_BIT | XR_SPACE_LOCATION_POSITION_VALID_BIT |
    XR_SPACE_LOCATION_ORIENTATION_TRACKED_BIT | XR_SPACE_LOCATION_POSITION_TRACKED_BIT;

XRAPI_ATTR XrResult XRAPI_CALL fake_locate_space(XrSpace space, XrSpace base, XrTime time,
                                                 XrSpaceLocation* out) {
  const std::lock_guard lock(mutex);
  if (session.lost) return XR_ERROR_INSTANCE_LOST;
  if (!spaces.contains(space) || !spaces.contains(base))
    return fault("xrLocateSpace: handle", XR_ERROR_HANDLE_INVALID);
  if (!has_type(out, XR_TYPE_SPACE_LOCATION)) return fault("xrLocateSpace: type");
  if (time <= 0) return XR_ERROR_TIME_INVALID;
  const Space& of = spaces[space];
  // Controllers are seen only by who has the focus and asks for actions.
  const bool seen = of.hand < 0 || (session.synced && session.state == XR_SESSION_STATE_FOCUSED);
  out->locationFlags = knobs.refuses("tracking") || !seen ? 0 : kLocated;
  if (!state.place_tracked) out->locationFlags &= ~XR_SPACE_LOCATION_POSITION_TRACKED_BIT;
  out->pose = times(inverse(in_stage(spaces[base], time)), in_stage(of, time));
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_locate_views(XrSession of, const XrViewLocateInfo* info,
                                                 XrViewState* view_state, std::uint32_t capacity,
                                                 std::uint32_t* count, XrView* out) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (!has_type(info, XR_TYPE_VIEW_LOCATE_INFO) || !has_type(view_state, XR_TYPE_VIEW_STATE))
    return fault("xrLocateViews: type");
  if (info->viewConfigurationType != view_type()) return fault("xrLocateViews: views");
  if (!spaces.contains(info->space)) return fault("xrLocateViews: handle", XR_ERROR_HANDLE_INVALID);
  if (info->displayTime <= 0) return XR_ERROR_TIME_INVALID;
  view_state->viewStateFlags = knobs.refuses("tracking") ? 0 : kLocated;
  const XrPosef head =
      times(inverse(in_stage(spaces[info->space], info->displayTime)), head_at(info->displayTime));
  std::array<XrView, 2> views{};
  for (std::size_t i = 0; i < 2; ++i) {
    constexpr auto kSide = static_cast<float>(kFakeOpenXrHalfIpd_m);
    const float side = knobs.views == 1 ? 0 : (i == 0 ? -kSide : kSide);
    // Each eye sees farther outwards, as in headsets.
    const float left = i == 0 || knobs.views == 1 ? -.78f : -.7f;
    const float right = i == 1 || knobs.views == 1 ? .78f : .7f;
    views[i] = {XR_TYPE_VIEW,
                nullptr,
                times(head, {{0, 0, 0, 1}, {side, 0, 0}}),
                {left, right, .78f, -.78f}};
  }
  return give(views, knobs.views, capacity, count, out);
}

// ---- Controllers. ----

XRAPI_ATTR XrResult XRAPI_CALL fake_create_action_set(XrInstance, const XrActionSetCreateInfo* info,
                                                      XrActionSet* out) {
  const std::lock_guard lock(mutex);
  if (!has_type(info, XR_TYPE_ACTION_SET_CREATE_INFO)) return fault("xrCreateActionSet: type");
  *out = new_handle<XrActionSet>();
  action_sets.insert(*out);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_create_action(XrActionSet set, const XrActionCreateInfo* info,
                                                  XrAction* out) {
  const std::lock_guard lock(mutex);
  if (!has_type(info, XR_TYPE_ACTION_CREATE_INFO) || !action_sets.contains(set))
    return fault("xrCreateAction: type or handle");
  if (session.attached) return fault("xrCreateAction: after attaching");
  *out = new_handle<XrAction>();
  actions.insert(*out);
  return XR_SUCCESS;
}

// Paths keep their text's first letters, which tell hands apart.
XRAPI_ATTR XrResult XRAPI_CALL fake_string_to_path(XrInstance, const char* text, XrPath* out) {
  if (!text || text[0] != '/') return fault("xrStringToPath: text", XR_ERROR_PATH_FORMAT_INVALID);
  const std::string_view path = text;
  *out = path.starts_with("/user/hand/left") ? 1 : path.starts_with("/user/hand/right") ? 2 : 3;
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_suggest(XrInstance,
                                            const XrInteractionProfileSuggestedBinding* suggested) {
  const std::lock_guard lock(mutex);
  if (!has_type(suggested, XR_TYPE_INTERACTION_PROFILE_SUGGESTED_BINDING))
    return fault("xrSuggestInteractionProfileBindings: type");
  if (session.attached) return fault("xrSuggestInteractionProfileBindings: after attaching");
  for (std::uint32_t i = 0; i < suggested->countSuggestedBindings; ++i)
    if (!actions.contains(suggested->suggestedBindings[i].action))
      return fault("xrSuggestInteractionProfileBindings: handle");
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_create_action_space(XrSession of,
                                                        const XrActionSpaceCreateInfo* info,
                                                        XrSpace* out) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (!has_type(info, XR_TYPE_ACTION_SPACE_CREATE_INFO) || !actions.contains(info->action))
    return fault("xrCreateActionSpace: type or handle");
  if (!is_pose(info->poseInActionSpace))
    return fault("xrCreateActionSpace: pose", XR_ERROR_POSE_INVALID);
  *out = add_space({XR_REFERENCE_SPACE_TYPE_STAGE, static_cast<int>(info->subactionPath) - 1,
                    info->poseInActionSpace});
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_attach(XrSession of,
                                           const XrSessionActionSetsAttachInfo* info) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (!has_type(info, XR_TYPE_SESSION_ACTION_SETS_ATTACH_INFO))
    return fault("xrAttachSessionActionSets: type");
  if (std::exchange(session.attached, true))
    return fault("xrAttachSessionActionSets: twice", XR_ERROR_ACTIONSETS_ALREADY_ATTACHED);
  return XR_SUCCESS;
}

XRAPI_ATTR XrResult XRAPI_CALL fake_sync_actions(XrSession of, const XrActionsSyncInfo* info) {
  const std::lock_guard lock(mutex);
  if (const XrResult dead = alive(of); XR_FAILED(dead)) return dead;
  if (!has_type(info, XR_TYPE_ACTIONS_SYNC_INFO)) return fault("xrSyncActions: type");
  if (!session.attached) return fault("xrSyncActions: before attaching");
  session.synced = true;
  return session.state == XR_SESSION_STATE_FOCUSED ? XR_SUCCESS : XR_SESSION_NOT_FOCUSED;
}

}  // namespace

Functions space_functions() {
  return {{"xrEnumerateReferenceSpaces", any(fake_enumerate_reference_spaces)},
          {"xrCreateReferenceSpace", any(fake_create_reference_space)},
          {"xrGetReferenceSpaceBoundsRect", any(fake_bounds)},
          {"xrDestroySpace", any(fake_destroy_space)},
          {"xrLocateSpace", any(fake_locate_space)},
          {"xrLocateViews", any(fake_locate_views)},
          {"xrCreateActionSet", any(fake_create_action_set)},
          {"xrCreateAction", any(fake_create_action)},
          {"xrStringToPath", any(fake_string_to_path)},
          {"xrSuggestInteractionProfileBindings", any(fake_suggest)},
          {"xrCreateActionSpace", any(fake_create_action_space)},
          {"xrAttachSessionActionSets", any(fake_attach)},
          {"xrSyncActions", any(fake_sync_actions)}};
}

}  // namespace fake_xr
