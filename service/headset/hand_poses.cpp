#include "service/headset/internal/hand_poses.h"

#include <cstdio>

#include "service/headset/internal/xr_runtime.h"

namespace penumbra::service {

namespace {

constexpr std::array kHands = {"/user/hand/left", "/user/hand/right"};
constexpr std::array kProfiles = {
    "/interaction_profiles/khr/simple_controller", "/interaction_profiles/valve/index_controller",
    "/interaction_profiles/htc/vive_controller", "/interaction_profiles/oculus/touch_controller",
    "/interaction_profiles/microsoft/motion_controller"};

Result<XrPath> path_of(XrInstance instance, const std::string& text) {
  XrPath out = XR_NULL_PATH;
  PENUMBRA_TRY(xr_try(xrStringToPath(instance, text.c_str(), &out), "a path"));
  return out;
}

Result<void> suggest(XrInstance instance, XrAction action, const char* profile) {
  std::array<XrActionSuggestedBinding, 2> bindings{};
  for (std::size_t i = 0; i < kHands.size(); ++i) {
    PENUMBRA_ASSIGN(path, path_of(instance, std::string(kHands[i]) + "/input/grip/pose"));
    bindings[i] = {action, path};
  }
  PENUMBRA_ASSIGN(of, path_of(instance, profile));
  XrInteractionProfileSuggestedBinding suggested{};
  suggested.type = XR_TYPE_INTERACTION_PROFILE_SUGGESTED_BINDING;
  suggested.interactionProfile = of;
  suggested.countSuggestedBindings = static_cast<std::uint32_t>(bindings.size());
  suggested.suggestedBindings = bindings.data();
  const XrResult done = xrSuggestInteractionProfileBindings(instance, &suggested);
  if (done == XR_ERROR_PATH_UNSUPPORTED) return {};  // a controller that the runtime does not know
  return xr_try(done, "the controllers' bindings");
}

}  // namespace

Result<std::unique_ptr<HandPoses>> HandPoses::make(XrInstance instance, XrSession session) {
  auto out = std::make_unique<HandPoses>();
  XrActionSetCreateInfo set{};
  set.type = XR_TYPE_ACTION_SET_CREATE_INFO;
  std::snprintf(set.actionSetName, sizeof set.actionSetName, "hands");
  std::snprintf(set.localizedActionSetName, sizeof set.localizedActionSetName, "Hands");
  PENUMBRA_TRY(xr_try(xrCreateActionSet(instance, &set, &out->set_), "an action set"));
  std::array<XrPath, 2> hands{};
  for (std::size_t i = 0; i < kHands.size(); ++i) {
    PENUMBRA_ASSIGN(path, path_of(instance, kHands[i]));
    hands[i] = path;
  }
  XrActionCreateInfo info{};
  info.type = XR_TYPE_ACTION_CREATE_INFO;
  info.actionType = XR_ACTION_TYPE_POSE_INPUT;
  std::snprintf(info.actionName, sizeof info.actionName, "grip");
  std::snprintf(info.localizedActionName, sizeof info.localizedActionName, "Grip");
  info.countSubactionPaths = static_cast<std::uint32_t>(hands.size());
  info.subactionPaths = hands.data();
  PENUMBRA_TRY(xr_try(xrCreateAction(out->set_, &info, &out->action_), "an action"));
  for (const char* profile : kProfiles) PENUMBRA_TRY(suggest(instance, out->action_, profile));
  for (std::size_t i = 0; i < hands.size(); ++i) {
    XrActionSpaceCreateInfo space{};
    space.type = XR_TYPE_ACTION_SPACE_CREATE_INFO;
    space.action = out->action_;
    space.subactionPath = hands[i];
    space.poseInActionSpace.orientation.w = 1;
    PENUMBRA_TRY(xr_try(xrCreateActionSpace(session, &space, &out->grips_[i]), "a grip's space"));
  }
  XrSessionActionSetsAttachInfo attach{};
  attach.type = XR_TYPE_SESSION_ACTION_SETS_ATTACH_INFO;
  attach.countActionSets = 1;
  attach.actionSets = &out->set_;
  PENUMBRA_TRY(xr_try(xrAttachSessionActionSets(session, &attach), "the action set"));
  return out;
}

Result<void> HandPoses::sync(XrSession session) const {
  const XrActiveActionSet active = {set_, XR_NULL_PATH};
  XrActionsSyncInfo info{};
  info.type = XR_TYPE_ACTIONS_SYNC_INFO;
  info.countActiveActionSets = 1;
  info.activeActionSets = &active;
  return xr_try(xrSyncActions(session, &info), "the controllers");
}

}  // namespace penumbra::service
