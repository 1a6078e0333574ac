// The OpenXR layer between Debian's loader and the fake runtime, with light from the test's page.
#include <dlfcn.h>
#include <gtest/gtest.h>
#include <openxr/openxr.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "service/client/penumbra_convert.h"
#include "service/openxr/light_estimation.h"
#include "tests/support/fake_openxr_runtime.h"
#include "tests/support/light_page_writer.h"
#include "tests/support/temp_folder.h"

namespace penumbra::service {
namespace {

using test::LightPageWriter;
using test::TempFolder;

constexpr const char* kLight = XR_ANDROID_LIGHT_ESTIMATION_EXTENSION_NAME;
constexpr const char* kCube = XR_ANDROID_LIGHT_ESTIMATION_CUBEMAP_EXTENSION_NAME;
using Three = std::array<float, 3>;

// 120 degrees about (1, 1, 1): x of the local space is the stage's y, its y is z, its z is x.
constexpr const char* kCyclicTurn = "0.5 0.5 0.5 0.5";
Three local_from_stage(const Three& v) {
  return {v[1], v[2], v[0]};
}

FakeOpenXrState& runtime_state() {
  static void* const library = ::dlopen(PENUMBRA_FAKE_OPENXR_RUNTIME, RTLD_NOW);
  static auto* const function =
      reinterpret_cast<FakeOpenXrStateFunction*>(::dlsym(library, kFakeOpenXrStateFunction));
  return *function();
}

double sh_radiance(const float sh[9][3], std::size_t c, const Three& d) {
  const double x = d[0], y = d[1], z = d[2];
  const std::array<double, 9> basis = {.28209479,
                                       .48860251 * y,
                                       .48860251 * z,
                                       .48860251 * x,
                                       1.0925484 * x * y,
                                       1.0925484 * y * z,
                                       .31539157 * (3 * z * z - 1),
                                       1.0925484 * x * z,
                                       .54627422 * (x * x - y * y)};
  double sum = 0;
  for (std::size_t n = 0; n < 9; ++n) sum += sh[n][c] * basis[n];
  return sum;
}

std::vector<Three> directions() {
  std::mt19937 random(20261127);
  std::normal_distribution<float> normal;
  std::vector<Three> out(50);
  for (Three& d : out) {
    d = {normal(random), normal(random), normal(random)};
    const float length = std::hypot(d[0], d[1], d[2]);
    for (float& c : d) c /= length;
  }
  return out;
}

// One light of 2, 1, .5 towards (.6, .8, 0), and two weaker ones, small enough to be points.
penumbra_light three_lights() {
  penumbra_light light{};
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  light.number = 1;
  light.published_ns = LightPageWriter::monotonic_ns();
  light.capture_time_ns = 5'000'000;
  light.valid = 1, light.bands = 5, light.light_count = 3;
  for (std::size_t n = 0; n < 25; ++n)
    for (std::size_t c = 0; c < 3; ++c) light.residual[n][c] = normal(random);
  const Three towards[3] = {{0, 0, 1}, {.6f, .8f, 0}, {0, -1, 0}};
  const Three power[3] = {{.1f, .1f, .1f}, {2, 1, .5f}, {.2f, .3f, .1f}};
  for (std::uint32_t i = 0; i < 3; ++i) {
    auto& one = light.lights[i];
    one.solid_angle_sr = .001f;
    one.id = i;
    for (std::size_t c = 0; c < 3; ++c) {
      one.direction[c] = towards[i][c];
      one.radiance[c] = power[i][c] * 1000;
    }
  }
  std::memcpy(light.coefficients, light.residual, sizeof light.residual);
  for (int i = 0; i < 3; ++i) {
    const auto [x, y, z] = towards[i];
    const float basis[9] = {.28209479f,
                            .48860251f * y,
                            .48860251f * z,
                            .48860251f * x,
                            1.0925484f * x * y,
                            1.0925484f * y * z,
                            .31539157f * (3 * z * z - 1),
                            1.0925484f * x * z,
                            .54627422f * (x * x - y * y)};
    for (std::size_t n = 0; n < 9; ++n)
      for (std::size_t c = 0; c < 3; ++c) light.coefficients[n][c] += basis[n] * power[i][c];
  }
  return light;
}

// All that an application can chain, Godot's two structs of one type among it.
struct Estimate {
  XrSphericalHarmonicsANDROID total{XR_TYPE_SPHERICAL_HARMONICS_ANDROID,
                                    nullptr,
                                    XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID,
                                    XR_SPHERICAL_HARMONICS_KIND_TOTAL_ANDROID,
                                    {}};
  XrSphericalHarmonicsANDROID ambient{XR_TYPE_SPHERICAL_HARMONICS_ANDROID,
                                      &total,
                                      XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID,
                                      XR_SPHERICAL_HARMONICS_KIND_AMBIENT_ANDROID,
                                      {}};
  XrAmbientLightANDROID mean{
      XR_TYPE_AMBIENT_LIGHT_ANDROID, &ambient, XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID, {}, {}};
  XrDirectionalLightANDROID main{
      XR_TYPE_DIRECTIONAL_LIGHT_ANDROID, &mean, XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID, {}, {}};
  XrLightEstimateANDROID all{XR_TYPE_LIGHT_ESTIMATE_ANDROID, &main,
                             XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID, 0};

  Estimate() = default;
  Estimate(const Estimate&) = delete;
  Estimate& operator=(const Estimate&) = delete;

  void expect(XrLightEstimateStateANDROID state) const {
    EXPECT_EQ(all.state, state);
    EXPECT_EQ(main.state, state);
    EXPECT_EQ(mean.state, state);
    EXPECT_EQ(ambient.state, state);
    EXPECT_EQ(total.state, state);
  }
  [[nodiscard]] Three direction() const {
    return {main.direction.x, main.direction.y, main.direction.z};
  }
};

struct CubeBuffers {
  std::array<std::vector<std::uint8_t>, 6> faces;
  XrCubemapLightingDataANDROID data{};

  explicit CubeBuffers(std::size_t bytes) {
    data.type = XR_TYPE_CUBEMAP_LIGHTING_DATA_ANDROID;
    data.imageBufferSize = static_cast<std::uint32_t>(bytes);
    for (auto& face : faces) face.resize(bytes);
    data.imageBufferRight = faces[0].data(), data.imageBufferLeft = faces[1].data();
    data.imageBufferTop = faces[2].data(), data.imageBufferBottom = faces[3].data();
    data.imageBufferFront = faces[4].data(), data.imageBufferBack = faces[5].data();
  }
  [[nodiscard]] Three rgb32f(std::size_t face, std::size_t texel) const {
    Three out{};
    std::memcpy(out.data(), faces[face].data() + 12 * texel, sizeof out);
    return out;
  }
};

class OpenXrLayer : public testing::Test {
 protected:
  OpenXrLayer() {
    std::ifstream in(PENUMBRA_SOURCE_DIR "/service/openxr/XrApiLayer_penumbra_light.json.in");
    std::stringstream text;
    text << in.rdbuf();
    std::string manifest = text.str();
    const std::string mark = "@PENUMBRA_LAYER_PATH@";
    manifest.replace(manifest.find(mark), mark.size(), PENUMBRA_LAYER_LIBRARY);
    std::filesystem::create_directory(folder_.path() / "layers");
    std::ofstream(folder_.path() / "layers/light.json") << manifest;
    std::ofstream(folder_.path() / "runtime.json")
        << R"({"file_format_version": "1.0.0", "runtime": {"library_path": ")"
        << PENUMBRA_FAKE_OPENXR_RUNTIME << R"("}})";
    set("XR_RUNTIME_JSON", (folder_.path() / "runtime.json").string());
    set("XR_API_LAYER_PATH", (folder_.path() / "layers").string());
    set("XR_ENABLE_API_LAYERS", "XR_APILAYER_PENUMBRA_light");
    set("PENUMBRA_LIGHT", page_.string());
  }
  ~OpenXrLayer() override {
    if (session_) xrDestroySession(session_);
    if (instance_) xrDestroyInstance(instance_);
    for (const std::string& name : variables_) ::unsetenv(name.c_str());
  }

  void set(const char* name, const std::string& value) {
    variables_.emplace_back(name);
    ::setenv(name, value.c_str(), 1);
  }

  XrResult make_instance(const std::vector<const char*>& extensions, const char* engine = "") {
    XrInstanceCreateInfo info{XR_TYPE_INSTANCE_CREATE_INFO, nullptr, 0, {}, 0, nullptr, 0, nullptr};
    std::snprintf(info.applicationInfo.applicationName, XR_MAX_APPLICATION_NAME_SIZE, "test");
    std::snprintf(info.applicationInfo.engineName, XR_MAX_ENGINE_NAME_SIZE, "%s", engine);
    info.applicationInfo.apiVersion = XR_CURRENT_API_VERSION;
    info.enabledExtensionCount = static_cast<std::uint32_t>(extensions.size());
    info.enabledExtensionNames = extensions.data();
    return xrCreateInstance(&info, &instance_);
  }

  // An instance, a session and its local space.
  void start(const std::vector<const char*>& extensions, const char* engine = "") {
    ASSERT_EQ(make_instance(extensions, engine), XR_SUCCESS);
    const XrSystemGetInfo get = {XR_TYPE_SYSTEM_GET_INFO, nullptr,
                                 XR_FORM_FACTOR_HEAD_MOUNTED_DISPLAY};
    ASSERT_EQ(xrGetSystem(instance_, &get, &system_), XR_SUCCESS);
    const XrSessionCreateInfo info = {XR_TYPE_SESSION_CREATE_INFO, nullptr, 0, system_};
    ASSERT_EQ(xrCreateSession(instance_, &info, &session_), XR_SUCCESS);
    const XrReferenceSpaceCreateInfo space = {XR_TYPE_REFERENCE_SPACE_CREATE_INFO,
                                              nullptr,
                                              XR_REFERENCE_SPACE_TYPE_LOCAL,
                                              {{0, 0, 0, 1}, {0, 0, 0}}};
    ASSERT_EQ(xrCreateReferenceSpace(session_, &space, &local_), XR_SUCCESS);
  }

  template <class Function>
  Function function(const char* name) {
    PFN_xrVoidFunction out = nullptr;
    xrGetInstanceProcAddr(instance_, name, &out);
    return reinterpret_cast<Function>(out);
  }

  XrResult make_estimator(void* next = nullptr) {
    XrLightEstimatorCreateInfoANDROID info = {XR_TYPE_LIGHT_ESTIMATOR_CREATE_INFO_ANDROID, next};
    return function<PFN_xrCreateLightEstimatorANDROID>("xrCreateLightEstimatorANDROID")(
        session_, &info, &estimator_);
  }
  XrResult destroy_estimator() {
    return function<PFN_xrDestroyLightEstimatorANDROID>("xrDestroyLightEstimatorANDROID")(
        estimator_);
  }
  XrResult get(XrLightEstimateANDROID& out, XrTime time = kNow) {
    const XrLightEstimateGetInfoANDROID info = {XR_TYPE_LIGHT_ESTIMATE_GET_INFO_ANDROID, nullptr,
                                                local_, time};
    return function<PFN_xrGetLightEstimateANDROID>("xrGetLightEstimateANDROID")(estimator_, &info,
                                                                                &out);
  }

  static constexpr XrTime kNow = 2'000'000'000'000;
  TempFolder folder_;
  std::filesystem::path page_ = folder_.path() / "light";
  std::vector<std::string> variables_;
  XrInstance instance_ = XR_NULL_HANDLE;
  XrSystemId system_ = XR_NULL_SYSTEM_ID;
  XrSession session_ = XR_NULL_HANDLE;
  XrSpace local_ = XR_NULL_HANDLE;
  XrLightEstimatorANDROID estimator_ = XR_NULL_HANDLE;
};

TEST_F(OpenXrLayer, ItsExtensionsAreEnumerated) {
  std::uint32_t count = 0;
  ASSERT_EQ(xrEnumerateInstanceExtensionProperties(nullptr, 0, &count, nullptr), XR_SUCCESS);
  std::vector<XrExtensionProperties> all(count, {XR_TYPE_EXTENSION_PROPERTIES, nullptr, {}, 0});
  ASSERT_EQ(xrEnumerateInstanceExtensionProperties(nullptr, count, &count, all.data()), XR_SUCCESS);
  int found = 0;
  for (const auto& one : all)
    found += one.extensionName == std::string(kLight) || one.extensionName == std::string(kCube);
  EXPECT_EQ(found, 2);
}

TEST_F(OpenXrLayer, TheRuntimeHearsNothingOfThem) {
  start({kLight, kCube, "XR_MND_headless"});
  const std::string heard = runtime_state().extensions;
  EXPECT_NE(heard.find("XR_MND_headless "), std::string::npos) << heard;
  EXPECT_EQ(heard.find("light_estimation"), std::string::npos) << heard;

  XrSystemCubemapLightEstimationPropertiesANDROID cube = {
      XR_TYPE_SYSTEM_CUBEMAP_LIGHT_ESTIMATION_PROPERTIES_ANDROID, nullptr, XR_FALSE};
  XrSystemHandTrackingPropertiesEXT others = {XR_TYPE_SYSTEM_HAND_TRACKING_PROPERTIES_EXT, &cube,
                                              XR_FALSE};
  XrSystemLightEstimationPropertiesANDROID light = {
      XR_TYPE_SYSTEM_LIGHT_ESTIMATION_PROPERTIES_ANDROID, &others, XR_FALSE};
  XrSystemProperties properties{};
  properties.type = XR_TYPE_SYSTEM_PROPERTIES, properties.next = &light;
  ASSERT_EQ(xrGetSystemProperties(instance_, system_, &properties), XR_SUCCESS);
  EXPECT_EQ(runtime_state().structs_of_properties, 1) << "the one that is not the layer's";
  EXPECT_EQ(light.supportsLightEstimation, static_cast<XrBool32>(XR_TRUE));
  EXPECT_EQ(cube.supportsCubemapLightEstimation, static_cast<XrBool32>(XR_TRUE));
  EXPECT_STREQ(properties.systemName, "fake headset");
  EXPECT_EQ(properties.next, &light);
  EXPECT_EQ(light.next, &others);
  EXPECT_EQ(others.next, &cube);
  EXPECT_EQ(cube.next, nullptr);
}

TEST_F(OpenXrLayer, AnApplicationThatDoesNotAskIsLeftAlone) {
  start({"XR_MND_headless"});
  EXPECT_STREQ(runtime_state().extensions, "XR_MND_headless ");
  EXPECT_EQ(function<PFN_xrGetLightEstimateANDROID>("xrGetLightEstimateANDROID"), nullptr);
  XrSystemLightEstimationPropertiesANDROID light = {
      XR_TYPE_SYSTEM_LIGHT_ESTIMATION_PROPERTIES_ANDROID, nullptr, XR_FALSE};
  XrSystemProperties properties{};
  properties.type = XR_TYPE_SYSTEM_PROPERTIES, properties.next = &light;
  ASSERT_EQ(xrGetSystemProperties(instance_, system_, &properties), XR_SUCCESS);
  EXPECT_EQ(runtime_state().structs_of_properties, 1);
  EXPECT_EQ(light.supportsLightEstimation, static_cast<XrBool32>(XR_FALSE));
  EXPECT_EQ(runtime_state().spaces, 1) << "its own";
}

TEST_F(OpenXrLayer, AnEstimatorLivesAndEndsWithItsHandle) {
  start({kLight});
  ASSERT_EQ(make_estimator(), XR_SUCCESS);
  EXPECT_EQ(runtime_state().spaces, 2) << "the application's and the layer's";
  EXPECT_EQ(destroy_estimator(), XR_SUCCESS);
  EXPECT_EQ(runtime_state().spaces, 1);
  EXPECT_EQ(destroy_estimator(), XR_ERROR_HANDLE_INVALID);
  Estimate estimate;
  EXPECT_EQ(get(estimate.all), XR_ERROR_HANDLE_INVALID);
  for (int i = 0; i < 16; ++i) ASSERT_EQ(make_estimator(), XR_SUCCESS);
  EXPECT_EQ(make_estimator(), XR_ERROR_LIMIT_REACHED);
  EXPECT_EQ(runtime_state().spaces, 17);
  EXPECT_EQ(xrDestroySession(session_), XR_SUCCESS);
  session_ = XR_NULL_HANDLE;
  EXPECT_EQ(destroy_estimator(), XR_ERROR_HANDLE_INVALID) << "it went with its session";
}

TEST_F(OpenXrLayer, InstancesFollowEachOther) {
  LightPageWriter page(page_);
  page.write(three_lights());
  for (int i = 0; i < 3; ++i) {
    start({kLight});
    ASSERT_EQ(make_estimator(), XR_SUCCESS);
    Estimate estimate;
    ASSERT_EQ(get(estimate.all), XR_SUCCESS);
    estimate.expect(XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID);
    ASSERT_EQ(xrDestroyInstance(instance_), XR_SUCCESS);
    instance_ = XR_NULL_HANDLE, session_ = XR_NULL_HANDLE;
  }
  EXPECT_EQ(runtime_state().instances, 0);
}

TEST_F(OpenXrLayer, WithoutAPageNothingIsValid) {
  start({kLight, kCube});
  ASSERT_EQ(make_estimator(), XR_SUCCESS);
  Estimate estimate;
  estimate.all.state = estimate.main.state = XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID;
  estimate.total.state = XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID;
  EXPECT_EQ(get(estimate.all), XR_SUCCESS);
  estimate.expect(XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID);
}

TEST_F(OpenXrLayer, ALightThatIsNotValidIsNotGivenOut) {
  LightPageWriter page(page_);
  penumbra_light light = three_lights();
  light.valid = 0;
  page.write(light);
  start({kLight});
  ASSERT_EQ(make_estimator(), XR_SUCCESS);
  Estimate estimate;
  EXPECT_EQ(get(estimate.all), XR_SUCCESS);
  estimate.expect(XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID);
}

TEST_F(OpenXrLayer, GivesTheLightOfThePageInTheApplicationsSpace) {
  set("PENUMBRA_FAKE_XR_LOCAL", kCyclicTurn);
  LightPageWriter page(page_);
  const penumbra_light light = three_lights();
  page.write(light);
  start({kLight});
  ASSERT_EQ(make_estimator(), XR_SUCCESS);
  Estimate estimate;
  ASSERT_EQ(get(estimate.all), XR_SUCCESS);
  estimate.expect(XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID);

  const Three towards = local_from_stage({.6f, .8f, 0});
  const Three power = {2, 1, .5f};
  for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(estimate.direction()[i], towards[i], 1e-6);
  EXPECT_NEAR(estimate.main.intensity.x, power[0], 1e-5);
  EXPECT_NEAR(estimate.main.intensity.y, power[1], 1e-5);
  EXPECT_NEAR(estimate.main.intensity.z, power[2], 1e-5);
  for (const Three& d : directions())
    for (std::size_t c = 0; c < 3; ++c)
      EXPECT_NEAR(sh_radiance(estimate.total.coefficients, c, local_from_stage(d)),
                  sh_radiance(light.coefficients, c, d), 1e-5);
  // The ambient part is the whole without the main light, which is a point.
  const float rows[9] = {
      .28209479f, .48860251f * .8f, 0, .48860251f * .6f,          1.0925484f * .48f,
      0,          -.31539157f,      0, .54627422f * (.36f - .64f)};
  float ambient[9][3];
  for (std::size_t n = 0; n < 9; ++n)
    for (std::size_t c = 0; c < 3; ++c)
      ambient[n][c] = light.coefficients[n][c] - rows[n] * power[c];
  for (const Three& d : directions())
    EXPECT_NEAR(sh_radiance(estimate.ambient.coefficients, 1, local_from_stage(d)),
                sh_radiance(ambient, 1, d), 1e-5);
  EXPECT_NEAR(estimate.mean.intensity.y, .28209479f * ambient[0][1], 1e-5);
  EXPECT_EQ(estimate.mean.colorCorrection.y, 1);
}

TEST_F(OpenXrLayer, GodotGetsItsMirroredSigns) {
  LightPageWriter page(page_);
  const penumbra_light light = three_lights();
  page.write(light);
  start({kLight}, "Godot Engine");
  ASSERT_EQ(make_estimator(), XR_SUCCESS);
  Estimate estimate;
  ASSERT_EQ(get(estimate.all), XR_SUCCESS);
  estimate.expect(XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID);
  for (const Three& d : directions())
    EXPECT_NEAR(sh_radiance(estimate.total.coefficients, 0, {d[0], d[1], -d[2]}),
                sh_radiance(light.coefficients, 0, d), 1e-5);
  EXPECT_NEAR(estimate.main.direction.x, .6f, 1e-6) << "its direction is not mirrored";
}

TEST_F(OpenXrLayer, TheEnvironmentGoesBeforeTheEngine) {
  LightPageWriter page(page_);
  penumbra_light light = three_lights();
  page.write(light);
  set("PENUMBRA_XR_CONVENTION", "webxr");
  set("PENUMBRA_XR_LIGHT_DIRECTION", "along");
  set("PENUMBRA_XR_YAW_DEGREES", "90");  // Penumbra's x is the stage's -z
  start({kLight}, "Godot Engine");
  ASSERT_EQ(make_estimator(), XR_SUCCESS);
  Estimate estimate;
  ASSERT_EQ(get(estimate.all), XR_SUCCESS);
  const Three along = {0, -.8f, .6f};
  for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(estimate.direction()[i], along[i], 1e-6);
  for (const Three& d : directions())
    EXPECT_NEAR(sh_radiance(estimate.total.coefficients, 0, {d[2], d[1], -d[0]}),
                sh_radiance(light.coefficients, 0, d), 1e-5);
}

TEST_F(OpenXrLayer, ThereIsAMainLightEvenInARoomWithoutOne) {
  LightPageWriter page(page_);
  penumbra_light light = three_lights();
  light.light_count = 0;
  std::memset(light.coefficients, 0, sizeof light.coefficients);
  for (std::size_t c = 0; c < 3; ++c) light.coefficients[0][c] = 3, light.coefficients[3][c] = -1;
  std::memcpy(light.residual, light.coefficients, sizeof light.residual);
  page.write(light);
  start({kLight});
  ASSERT_EQ(make_estimator(), XR_SUCCESS);
  Estimate estimate;
  ASSERT_EQ(get(estimate.all), XR_SUCCESS);
  estimate.expect(XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID);
  EXPECT_EQ(estimate.main.intensity.x, 0);
  EXPECT_NEAR(estimate.main.direction.x, -1, 1e-6) << "where most light comes from";
  EXPECT_EQ(std::memcmp(estimate.total.coefficients, estimate.ambient.coefficients,
                        sizeof estimate.total.coefficients),
            0);
}

TEST_F(OpenXrLayer, TimesAreOnTheRuntimesClock) {
  LightPageWriter page(page_);
  penumbra_light light = three_lights();
  page.write(light);
  start({kLight});
  ASSERT_EQ(make_estimator(), XR_SUCCESS);
  Estimate estimate;
  ASSERT_EQ(get(estimate.all), XR_SUCCESS);
  EXPECT_EQ(estimate.all.lastUpdatedTime, light.published_ns + FakeOpenXrState::kTimeAhead_ns);
}

TEST_F(OpenXrLayer, WithoutTheRuntimesClockTimesStillGoOnByLight) {
  set("PENUMBRA_FAKE_XR_REFUSE", "clock stage");
  LightPageWriter page(page_);
  penumbra_light light = three_lights();
  page.write(light);
  start({kLight});
  EXPECT_STREQ(runtime_state().extensions, "");
  ASSERT_EQ(make_estimator(), XR_SUCCESS) << "in the local space";
  Estimate estimate;
  ASSERT_EQ(get(estimate.all), XR_SUCCESS);
  const XrTime first = estimate.all.lastUpdatedTime;
  EXPECT_LE(first, kNow);
  EXPECT_GT(first, kNow - 60'000'000'000);
  ASSERT_EQ(get(estimate.all, kNow + 11'000'000), XR_SUCCESS);
  EXPECT_EQ(estimate.all.lastUpdatedTime, first) << "the same light";
  light.number = 2;
  page.write(light);
  ASSERT_EQ(get(estimate.all, kNow), XR_SUCCESS);
  EXPECT_GT(estimate.all.lastUpdatedTime, first);
}

TEST_F(OpenXrLayer, WrongCallsGetTheErrorsOfTheExtension) {
  LightPageWriter page(page_);
  page.write(three_lights());
  start({kLight});
  const auto create = function<PFN_xrCreateLightEstimatorANDROID>("xrCreateLightEstimatorANDROID");
  XrLightEstimatorCreateInfoANDROID info = {XR_TYPE_SESSION_CREATE_INFO, nullptr};
  EXPECT_EQ(create(session_, &info, &estimator_), XR_ERROR_VALIDATION_FAILURE);
  info.type = XR_TYPE_LIGHT_ESTIMATOR_CREATE_INFO_ANDROID;
  EXPECT_EQ(create(session_, nullptr, &estimator_), XR_ERROR_VALIDATION_FAILURE);
  EXPECT_EQ(create(reinterpret_cast<XrSession>(1), &info, &estimator_), XR_ERROR_HANDLE_INVALID);
  ASSERT_EQ(make_estimator(), XR_SUCCESS);
  Estimate estimate;
  EXPECT_EQ(get(estimate.all, 0), XR_ERROR_TIME_INVALID);
  estimate.all.type = XR_TYPE_SPACE_LOCATION;
  EXPECT_EQ(get(estimate.all), XR_ERROR_VALIDATION_FAILURE);
  EXPECT_EQ(function<PFN_xrVoidFunction>("xrEnumerateCubemapLightingResolutionsANDROID"), nullptr)
      << "of an extension that is not enabled";
}

TEST_F(OpenXrLayer, WithoutTrackingNothingIsValid) {
  set("PENUMBRA_FAKE_XR_REFUSE", "tracking");
  LightPageWriter page(page_);
  page.write(three_lights());
  start({kLight});
  ASSERT_EQ(make_estimator(), XR_SUCCESS);
  Estimate estimate;
  EXPECT_EQ(get(estimate.all), XR_SUCCESS);
  estimate.expect(XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID);
}

TEST_F(OpenXrLayer, CubemapSizesAndFormatsAreEnumerated) {
  start({kLight, kCube});
  const auto sizes = function<PFN_xrEnumerateCubemapLightingResolutionsANDROID>(
      "xrEnumerateCubemapLightingResolutionsANDROID");
  const auto formats = function<PFN_xrEnumerateCubemapLightingColorFormatsANDROID>(
      "xrEnumerateCubemapLightingColorFormatsANDROID");
  std::uint32_t count = 0;
  ASSERT_EQ(sizes(instance_, system_, 0, &count, nullptr), XR_SUCCESS);
  std::vector<std::uint32_t> got(count);
  EXPECT_EQ(sizes(instance_, system_, count - 1, &count, got.data()), XR_ERROR_SIZE_INSUFFICIENT);
  ASSERT_EQ(sizes(instance_, system_, count, &count, got.data()), XR_SUCCESS);
  EXPECT_EQ(got, (std::vector<std::uint32_t>{16, 32, 64, 128, 256}));
  EXPECT_EQ(sizes(instance_, 99, 0, &count, nullptr), XR_ERROR_SYSTEM_INVALID);
  ASSERT_EQ(formats(instance_, system_, 0, &count, nullptr), XR_SUCCESS);
  EXPECT_EQ(count, 3u);

  XrCubemapLightEstimatorCreateInfoANDROID cube = {
      XR_TYPE_CUBEMAP_LIGHT_ESTIMATOR_CREATE_INFO_ANDROID, nullptr, 48,
      XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R16G16B16A16_SFLOAT_ANDROID, XR_TRUE};
  EXPECT_EQ(make_estimator(&cube), XR_ERROR_FEATURE_UNSUPPORTED);
  cube.cubemapResolution = 32;
  cube.colorFormat = static_cast<XrCubemapLightingColorFormatANDROID>(4);
  EXPECT_EQ(make_estimator(&cube), XR_ERROR_FEATURE_UNSUPPORTED);
}

// Each face of the page has a red of its number and a green that grows along its columns.
std::unique_ptr<penumbra_cube> numbered_faces() {
  constexpr std::array<std::uint16_t, 7> halves = {0,      0x3c00, 0x4000, 0x4200,
                                                   0x4400, 0x4500, 0x4600};  // 0 to 6
  auto cube = std::make_unique<penumbra_cube>();
  cube->number = 1, cube->size = 64, cube->faces = 6, cube->capture_time_ns = 2'000'000;
  for (std::size_t f = 0; f < 6; ++f)
    for (auto& row : cube->texels[f])
      for (std::size_t i = 0; i < 64; ++i)
        row[i][0] = halves[f + 1], row[i][1] = halves[i < 32 ? 0 : 1], row[i][3] = 0x3c00;
  return cube;
}

TEST_F(OpenXrLayer, TheCubemapStandsOnTheApplicationsAxes) {
  set("PENUMBRA_FAKE_XR_LOCAL", kCyclicTurn);
  LightPageWriter page(page_);
  page.write(three_lights());
  page.write(*numbered_faces());
  start({kLight, kCube});
  XrCubemapLightEstimatorCreateInfoANDROID cube = {
      XR_TYPE_CUBEMAP_LIGHT_ESTIMATOR_CREATE_INFO_ANDROID, nullptr, 32,
      XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R32G32B32_SFLOAT_ANDROID, XR_TRUE};
  ASSERT_EQ(make_estimator(&cube), XR_SUCCESS);
  CubeBuffers buffers(32 * 32 * 12);
  Estimate estimate;
  estimate.total.next = &buffers.data;
  ASSERT_EQ(get(estimate.all), XR_SUCCESS);
  ASSERT_EQ(buffers.data.state, XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID);
  EXPECT_EQ(buffers.data.rotation.w, 1);
  EXPECT_EQ(buffers.data.centerExposureTime, estimate.all.lastUpdatedTime - 3'000'000);
  // Local x, y, z are the stage's y, z, x: the page's faces 3 4 5 6 1 2, with front before back.
  const std::array<float, 6> faces = {3, 4, 5, 6, 2, 1};
  for (std::size_t f = 0; f < 6; ++f)
    EXPECT_NEAR(buffers.rgb32f(f, 16 * 32 + 16)[0], faces[f], 1e-5) << f;

  // A buffer that is too small leaves the rest valid.
  --buffers.data.imageBufferSize;
  ASSERT_EQ(get(estimate.all), XR_SUCCESS);
  EXPECT_EQ(buffers.data.state, XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID);
  estimate.expect(XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID);
}

TEST_F(OpenXrLayer, ACubemapThatIsNotReprojectedTellsItsRotation) {
  set("PENUMBRA_FAKE_XR_LOCAL", kCyclicTurn);
  LightPageWriter page(page_);
  page.write(three_lights());
  page.write(*numbered_faces());
  start({kLight, kCube});
  for (const auto& [size, format, bytes] :
       {std::tuple{64u, XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R16G16B16A16_SFLOAT_ANDROID, 8u},
        std::tuple{256u, XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R32G32B32A32_SFLOAT_ANDROID, 16u}}) {
    XrCubemapLightEstimatorCreateInfoANDROID cube = {
        XR_TYPE_CUBEMAP_LIGHT_ESTIMATOR_CREATE_INFO_ANDROID, nullptr, size, format, XR_FALSE};
    ASSERT_EQ(make_estimator(&cube), XR_SUCCESS);
    CubeBuffers buffers(std::size_t{size} * size * bytes);
    Estimate estimate;
    estimate.total.next = &buffers.data;
    ASSERT_EQ(get(estimate.all), XR_SUCCESS);
    ASSERT_EQ(buffers.data.state, XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID);
    // The cube's y, turned, is where the stage's y is in the local space: x.
    const XrQuaternionf q = buffers.data.rotation;
    EXPECT_NEAR(2 * (q.x * q.y - q.z * q.w), 1, 1e-6);
    const auto page_cube = numbered_faces();
    if (size == 64) {
      EXPECT_EQ(std::memcmp(buffers.faces[0].data(), page_cube->texels[0], 64 * 64 * 8), 0);
      EXPECT_EQ(std::memcmp(buffers.faces[4].data(), page_cube->texels[5], 64 * 64 * 8), 0);
      EXPECT_EQ(std::memcmp(buffers.faces[5].data(), page_cube->texels[4], 64 * 64 * 8), 0);
    } else {
      std::array<float, 4> left{}, right{};
      std::memcpy(left.data(), buffers.faces[2].data() + 16 * 128 * 256, sizeof left);
      std::memcpy(right.data(), buffers.faces[2].data() + 16 * (128 * 256 + 255), sizeof right);
      EXPECT_EQ(left, (std::array<float, 4>{3, 0, 0, 1}));
      EXPECT_EQ(right, (std::array<float, 4>{3, 1, 0, 1}));
    }
  }
}

TEST_F(OpenXrLayer, ARuntimeThatRefusesIsHeard) {
  set("PENUMBRA_FAKE_XR_REFUSE", "instance");
  EXPECT_EQ(make_instance({kLight}), XR_ERROR_RUNTIME_FAILURE);
  instance_ = XR_NULL_HANDLE;
}

}  // namespace
}  // namespace penumbra::service
