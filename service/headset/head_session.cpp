#include "service/headset/internal/head_session.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "core/conventions.h"

namespace penumbra::service {

namespace {

// The first: codes go to the eye as they are. The others take linear light.
constexpr std::array<std::int64_t, 3> kSwapchainFormats = {GL_SRGB8_ALPHA8, GL_RGBA16F, GL_RGBA8};
constexpr XrPosef kNoTurn = {{0, 0, 0, 1}, {0, 0, 0}};
constexpr std::uint32_t kMaxListed = 64, kMaxPixels = 16384;

template <class Value, class Call>
Result<std::vector<Value>> listed(Call call, const char* what, Value empty = {}) {
  std::uint32_t count = 0;
  PENUMBRA_TRY(xr_try(call(0, &count, nullptr), what));
  std::vector<Value> out(std::min(count, kMaxListed), empty);
  PENUMBRA_TRY(xr_try(call(static_cast<std::uint32_t>(out.size()), &count, out.data()), what));
  out.resize(std::min<std::size_t>(count, out.size()));
  return out;
}

bool is_view(const XrView& view) {
  const XrFovf& f = view.fov;
  constexpr double kWidest = .49 * kPi;
  const auto inside = [](float angle) { return std::abs(angle) < kWidest; };  // false for NaN
  return is_pose(view.pose) && inside(f.angleLeft) && inside(f.angleRight) && inside(f.angleUp) &&
         inside(f.angleDown) && f.angleLeft < f.angleRight && f.angleDown < f.angleUp;
}

}  // namespace

Result<std::unique_ptr<HeadSession>> HeadSession::open(XrRuntime& runtime,
                                                       HeadsetGraphics& graphics) {
  std::unique_ptr<HeadSession> out(new HeadSession(runtime));
  PENUMBRA_TRY(out->make_session(graphics));
  PENUMBRA_TRY(out->make_spaces());
  PENUMBRA_TRY(out->choose_views());
  PENUMBRA_TRY(out->make_swapchains(graphics));
  PENUMBRA_ASSIGN(hands, HandPoses::make(runtime.instance(), out->session_));
  out->hands_ = std::move(hands);
  return out;
}

HeadSession::~HeadSession() {
  // Swapchains and spaces end with it. Of a runtime that has gone only the instance can be ended.
  if (session_ && !abandoned_) xrDestroySession(session_);
}

Result<void> HeadSession::make_session(HeadsetGraphics& graphics) {
  const XrSessionCreateInfo info = {XR_TYPE_SESSION_CREATE_INFO, graphics.binding(), 0,
                                    runtime_.system()};
  const XrResult made = xrCreateSession(runtime_.instance(), &info, &session_);
  if (XR_FAILED(made)) session_ = XR_NULL_HANDLE;
  return xr_try(made, "a session");
}

Result<void> HeadSession::make_spaces() {
  PENUMBRA_ASSIGN(kinds, listed<XrReferenceSpaceType>(
                             [&](std::uint32_t n, std::uint32_t* count, XrReferenceSpaceType* to) {
                               return xrEnumerateReferenceSpaces(session_, n, count, to);
                             },
                             "the spaces"));
  on_stage_ = std::ranges::find(kinds, XR_REFERENCE_SPACE_TYPE_STAGE) != kinds.end();
  const auto make = [&](XrReferenceSpaceType type, XrSpace& out) {
    const XrReferenceSpaceCreateInfo info = {XR_TYPE_REFERENCE_SPACE_CREATE_INFO, nullptr, type,
                                             kNoTurn};
    return xr_try(xrCreateReferenceSpace(session_, &info, &out), "a space");
  };
  PENUMBRA_TRY(
      make(on_stage_ ? XR_REFERENCE_SPACE_TYPE_STAGE : XR_REFERENCE_SPACE_TYPE_LOCAL, world_));
  return make(XR_REFERENCE_SPACE_TYPE_VIEW, view_);
}

Result<void> HeadSession::choose_views() {
  const XrInstance instance = runtime_.instance();
  const XrSystemId system = runtime_.system();
  PENUMBRA_ASSIGN(kinds,
                  listed<XrViewConfigurationType>(
                      [&](std::uint32_t n, std::uint32_t* count, XrViewConfigurationType* to) {
                        return xrEnumerateViewConfigurations(instance, system, n, count, to);
                      },
                      "the views"));
  const auto known = std::ranges::find_if(kinds, [](XrViewConfigurationType kind) {
    return kind == XR_VIEW_CONFIGURATION_TYPE_PRIMARY_STEREO ||
           kind == XR_VIEW_CONFIGURATION_TYPE_PRIMARY_MONO;
  });
  if (known == kinds.end())
    return fail(ErrorCode::kUnavailable, "headset", "has neither one eye nor two");
  views_ = *known;
  PENUMBRA_ASSIGN(
      blends, listed<XrEnvironmentBlendMode>(
                  [&](std::uint32_t n, std::uint32_t* count, XrEnvironmentBlendMode* to) {
                    return xrEnumerateEnvironmentBlendModes(instance, system, views_, n, count, to);
                  },
                  "the blend modes"));
  if (blends.empty()) return fail(ErrorCode::kUnavailable, "headset", "has no blend mode");
  const bool opaque = std::ranges::find(blends, XR_ENVIRONMENT_BLEND_MODE_OPAQUE) != blends.end();
  blend_ = opaque ? XR_ENVIRONMENT_BLEND_MODE_OPAQUE : blends.front();
  return {};
}

Result<void> HeadSession::make_swapchains(HeadsetGraphics& graphics) {
  PENUMBRA_ASSIGN(formats, listed<std::int64_t>(
                               [&](std::uint32_t n, std::uint32_t* count, std::int64_t* to) {
                                 return xrEnumerateSwapchainFormats(session_, n, count, to);
                               },
                               "the formats"));
  const auto format = std::ranges::find_if(kSwapchainFormats, [&](std::int64_t one) {
    return std::ranges::find(formats, one) != formats.end();
  });
  if (format == kSwapchainFormats.end())
    return fail(ErrorCode::kUnavailable, "headset",
                "the OpenXR runtime takes none of SRGB8_ALPHA8, RGBA16F and RGBA8");
  XrViewConfigurationView empty{};
  empty.type = XR_TYPE_VIEW_CONFIGURATION_VIEW;
  PENUMBRA_ASSIGN(sizes,
                  listed<XrViewConfigurationView>(
                      [&](std::uint32_t n, std::uint32_t* count, XrViewConfigurationView* to) {
                        return xrEnumerateViewConfigurationViews(
                            runtime_.instance(), runtime_.system(), views_, n, count, to);
                      },
                      "the views' sizes", empty));
  if (sizes.empty() || sizes.size() > 2)
    return fail(ErrorCode::kUnavailable, "headset", "has neither one eye nor two");
  for (const XrViewConfigurationView& size : sizes) {
    if (size.recommendedImageRectWidth - 1 >= kMaxPixels ||
        size.recommendedImageRectHeight - 1 >= kMaxPixels)
      return fail(ErrorCode::kUnavailable, "headset", "recommends a size that is not a picture's");
    XrSwapchainCreateInfo info{};
    info.type = XR_TYPE_SWAPCHAIN_CREATE_INFO;
    info.usageFlags = XR_SWAPCHAIN_USAGE_COLOR_ATTACHMENT_BIT;
    info.format = *format;
    info.width = size.recommendedImageRectWidth, info.height = size.recommendedImageRectHeight;
    info.sampleCount = info.faceCount = info.arraySize = info.mipCount = 1;
    EyeSwapchain one;
    one.width = static_cast<int>(info.width), one.height = static_cast<int>(info.height);
    PENUMBRA_TRY(xr_try(xrCreateSwapchain(session_, &info, &one.handle), "a swapchain"));
    PENUMBRA_ASSIGN(images, graphics.images(one.handle));
    one.images = std::move(images);
    swapchains_.push_back(std::move(one));
  }
  return {};
}

// ---- States. ----

Result<void> HeadSession::enter(XrSessionState state) {
  state_ = state;
  if (state == XR_SESSION_STATE_READY) {
    const XrSessionBeginInfo info = {XR_TYPE_SESSION_BEGIN_INFO, nullptr, views_};
    PENUMBRA_TRY(xr_try(xrBeginSession(session_, &info), "the session's begin"));
    begun_ = true;
  } else if (state == XR_SESSION_STATE_STOPPING) {
    begun_ = false;
    PENUMBRA_TRY(xr_try(xrEndSession(session_), "the session's end"));
  } else if (state == XR_SESSION_STATE_EXITING || state == XR_SESSION_STATE_LOSS_PENDING) {
    begun_ = false;
    over_ = true;
  }
  return {};
}

Result<void> HeadSession::poll() {
  for (;;) {
    XrEventDataBuffer event{};
    event.type = XR_TYPE_EVENT_DATA_BUFFER;
    const XrResult got = xrPollEvent(runtime_.instance(), &event);
    if (got == XR_EVENT_UNAVAILABLE) return {};
    PENUMBRA_TRY(xr_try(got, "the runtime's events"));
    if (event.type == XR_TYPE_EVENT_DATA_SESSION_STATE_CHANGED) {
      XrEventDataSessionStateChanged changed;
      std::memcpy(&changed, &event, sizeof changed);
      if (changed.session == session_) PENUMBRA_TRY(enter(changed.state));
    } else if (event.type == XR_TYPE_EVENT_DATA_INSTANCE_LOSS_PENDING) {
      over_ = true;
    } else if (event.type == XR_TYPE_EVENT_DATA_REFERENCE_SPACE_CHANGE_PENDING) {
      moved_origin_ = true;
    }
  }
}

bool HeadSession::request_exit() {
  return begun_ && XR_SUCCEEDED(xrRequestExitSession(session_));
}

// ---- Frames. ----

Result<XrFrameState> HeadSession::wait_frame() {
  XrFrameState out{};
  out.type = XR_TYPE_FRAME_STATE;
  const XrFrameWaitInfo info = {XR_TYPE_FRAME_WAIT_INFO, nullptr};
  PENUMBRA_TRY(xr_try(xrWaitFrame(session_, &info, &out), "a frame's time"));
  return out;
}

Result<void> HeadSession::begin_frame() {
  const XrFrameBeginInfo info = {XR_TYPE_FRAME_BEGIN_INFO, nullptr};
  return xr_try(xrBeginFrame(session_, &info), "a frame's begin");
}

Result<void> HeadSession::end_frame(XrTime display,
                                    const std::vector<XrCompositionLayerProjectionView>& views) {
  XrCompositionLayerProjection layer{};
  layer.type = XR_TYPE_COMPOSITION_LAYER_PROJECTION;
  layer.space = world_;
  layer.viewCount = static_cast<std::uint32_t>(views.size());
  layer.views = views.data();
  const XrCompositionLayerBaseHeader* const layers[] = {
      reinterpret_cast<const XrCompositionLayerBaseHeader*>(&layer)};
  XrFrameEndInfo info{};
  info.type = XR_TYPE_FRAME_END_INFO;
  info.displayTime = display;
  info.environmentBlendMode = blend_;
  info.layerCount = views.empty() ? 0 : 1;
  info.layers = views.empty() ? nullptr : layers;
  return xr_try(xrEndFrame(session_, &info), "a frame's end");
}

Result<std::uint32_t> HeadSession::acquire_image(std::size_t view) {
  const EyeSwapchain& chain = swapchains_[view];
  std::uint32_t index = 0;
  const XrSwapchainImageAcquireInfo acquire = {XR_TYPE_SWAPCHAIN_IMAGE_ACQUIRE_INFO, nullptr};
  PENUMBRA_TRY(xr_try(xrAcquireSwapchainImage(chain.handle, &acquire, &index), "an image"));
  if (index >= chain.images.size())
    return fail(ErrorCode::kUnavailable, "headset", "the OpenXR runtime gives an unknown image");
  constexpr XrDuration kPatience_ns = 200'000'000;
  const XrSwapchainImageWaitInfo wait = {XR_TYPE_SWAPCHAIN_IMAGE_WAIT_INFO, nullptr, kPatience_ns};
  const XrResult waited = xrWaitSwapchainImage(chain.handle, &wait);
  if (waited == XR_TIMEOUT_EXPIRED)
    return fail(ErrorCode::kUnavailable, "headset", "the OpenXR runtime does not give images back");
  PENUMBRA_TRY(xr_try(waited, "an image"));
  return index;
}

Result<void> HeadSession::release_image(std::size_t view) {
  const XrSwapchainImageReleaseInfo info = {XR_TYPE_SWAPCHAIN_IMAGE_RELEASE_INFO, nullptr};
  return xr_try(xrReleaseSwapchainImage(swapchains_[view].handle, &info), "an image");
}

// ---- Poses. ----

Result<std::optional<EyeViews>> HeadSession::eyes_in(XrSpace base, XrTime time) const {
  const XrViewLocateInfo info = {XR_TYPE_VIEW_LOCATE_INFO, nullptr, views_, time, base};
  XrViewState state{};
  state.type = XR_TYPE_VIEW_STATE;
  EyeViews out{};
  for (XrView& one : out.eyes) one.type = XR_TYPE_VIEW;
  std::uint32_t count = 0;
  const XrResult got = xrLocateViews(
      session_, &info, &state, static_cast<std::uint32_t>(view_count()), &count, out.eyes.data());
  if (got == XR_ERROR_TIME_INVALID) return std::nullopt;
  PENUMBRA_TRY(xr_try(got, "the eyes"));
  constexpr XrViewStateFlags kValid =
      XR_VIEW_STATE_ORIENTATION_VALID_BIT | XR_VIEW_STATE_POSITION_VALID_BIT;
  if ((state.viewStateFlags & kValid) != kValid || count != view_count()) return std::nullopt;
  for (std::size_t i = 0; i < count; ++i)
    if (!is_view(out.eyes[i])) return std::nullopt;
  return out;
}

Result<std::optional<EyeViews>> HeadSession::eyes_in_world(XrTime time) const {
  return eyes_in(world_, time);
}
Result<std::optional<EyeViews>> HeadSession::eyes_in_head(XrTime time) const {
  return eyes_in(view_, time);
}

std::optional<HeadPose> HeadSession::locate(XrSpace space, XrTime time) const {
  XrSpaceLocation location{};
  location.type = XR_TYPE_SPACE_LOCATION;
  if (XR_FAILED(xrLocateSpace(space, world_, time, &location))) return std::nullopt;
  const auto has = [&](XrSpaceLocationFlags flags) {
    return (location.locationFlags & flags) == flags;
  };
  if (!has(XR_SPACE_LOCATION_ORIENTATION_VALID_BIT | XR_SPACE_LOCATION_POSITION_VALID_BIT) ||
      !is_pose(location.pose))
    return std::nullopt;
  return HeadPose{from_xr(location.pose), has(XR_SPACE_LOCATION_POSITION_TRACKED_BIT),
                  has(XR_SPACE_LOCATION_ORIENTATION_TRACKED_BIT)};
}

std::optional<HeadPose> HeadSession::locate_hand(std::size_t hand, XrTime time) const {
  return locate(hands_->grip(hand), time);
}

}  // namespace penumbra::service
