// The OpenXR extensions for the light of a room, which older openxr.h do not declare.
// threads: plain data
#pragma once

#include <openxr/openxr.h>

// XR_ANDROID_light_estimation, number 701 of the registry, revision 1. The sign of `direction`, the
// units and the normalisation of the harmonics are not part of it.
#ifndef XR_ANDROID_light_estimation
#define XR_ANDROID_light_estimation 1
#define XR_ANDROID_light_estimation_SPEC_VERSION 1
#define XR_ANDROID_LIGHT_ESTIMATION_EXTENSION_NAME "XR_ANDROID_light_estimation"

XR_DEFINE_HANDLE(XrLightEstimatorANDROID)

#define XR_TYPE_LIGHT_ESTIMATOR_CREATE_INFO_ANDROID static_cast<XrStructureType>(1000700000)
#define XR_TYPE_LIGHT_ESTIMATE_GET_INFO_ANDROID static_cast<XrStructureType>(1000700001)
#define XR_TYPE_LIGHT_ESTIMATE_ANDROID static_cast<XrStructureType>(1000700002)
#define XR_TYPE_DIRECTIONAL_LIGHT_ANDROID static_cast<XrStructureType>(1000700003)
#define XR_TYPE_SPHERICAL_HARMONICS_ANDROID static_cast<XrStructureType>(1000700004)
#define XR_TYPE_AMBIENT_LIGHT_ANDROID static_cast<XrStructureType>(1000700005)
#define XR_TYPE_SYSTEM_LIGHT_ESTIMATION_PROPERTIES_ANDROID static_cast<XrStructureType>(1000700006)

// What a struct with another state than valid holds is not defined.
typedef enum XrLightEstimateStateANDROID {
  XR_LIGHT_ESTIMATE_STATE_VALID_ANDROID = 0,
  XR_LIGHT_ESTIMATE_STATE_INVALID_ANDROID = 1,
  XR_LIGHT_ESTIMATE_STATE_MAX_ENUM_ANDROID = 0x7FFFFFFF
} XrLightEstimateStateANDROID;

typedef enum XrSphericalHarmonicsKindANDROID {
  XR_SPHERICAL_HARMONICS_KIND_TOTAL_ANDROID = 0,    // with the main light
  XR_SPHERICAL_HARMONICS_KIND_AMBIENT_ANDROID = 1,  // without it
  XR_SPHERICAL_HARMONICS_KIND_MAX_ENUM_ANDROID = 0x7FFFFFFF
} XrSphericalHarmonicsKindANDROID;

typedef struct XrSystemLightEstimationPropertiesANDROID {  // chained to XrSystemProperties
  XrStructureType type;
  void* XR_MAY_ALIAS next;
  XrBool32 supportsLightEstimation;
} XrSystemLightEstimationPropertiesANDROID;

typedef struct XrLightEstimatorCreateInfoANDROID {
  XrStructureType type;
  void* XR_MAY_ALIAS next;
} XrLightEstimatorCreateInfoANDROID;

typedef struct XrLightEstimateGetInfoANDROID {
  XrStructureType type;
  const void* XR_MAY_ALIAS next;
  XrSpace space;  // directions and harmonics are given in it
  XrTime time;
} XrLightEstimateGetInfoANDROID;

typedef struct XrLightEstimateANDROID {  // the structs below are chained to it
  XrStructureType type;
  void* XR_MAY_ALIAS next;
  XrLightEstimateStateANDROID state;
  XrTime lastUpdatedTime;
} XrLightEstimateANDROID;

typedef struct XrDirectionalLightANDROID {
  XrStructureType type;
  void* XR_MAY_ALIAS next;
  XrLightEstimateStateANDROID state;
  XrVector3f intensity;  // red, green, blue
  XrVector3f direction;
} XrDirectionalLightANDROID;

typedef struct XrSphericalHarmonicsANDROID {
  XrStructureType type;
  void* XR_MAY_ALIAS next;
  XrLightEstimateStateANDROID state;
  XrSphericalHarmonicsKindANDROID kind;  // the application sets it
  float coefficients[9][3];
} XrSphericalHarmonicsANDROID;

typedef struct XrAmbientLightANDROID {
  XrStructureType type;
  void* XR_MAY_ALIAS next;
  XrLightEstimateStateANDROID state;
  XrVector3f intensity;        // red, green, blue
  XrVector3f colorCorrection;  // in gamma space
} XrAmbientLightANDROID;

typedef XrResult(XRAPI_PTR* PFN_xrCreateLightEstimatorANDROID)(
    XrSession session, XrLightEstimatorCreateInfoANDROID* info, XrLightEstimatorANDROID* estimator);
typedef XrResult(XRAPI_PTR* PFN_xrDestroyLightEstimatorANDROID)(XrLightEstimatorANDROID estimator);
typedef XrResult(XRAPI_PTR* PFN_xrGetLightEstimateANDROID)(
    XrLightEstimatorANDROID estimator, const XrLightEstimateGetInfoANDROID* info,
    XrLightEstimateANDROID* estimate);
#endif

// XR_ANDROID_light_estimation_cubemap, number 722, revision 1: the surroundings as six pictures
// with the axes of OpenGL's cube maps. It needs the extension above.
#ifndef XR_ANDROID_light_estimation_cubemap
#define XR_ANDROID_light_estimation_cubemap 1
#define XR_ANDROID_light_estimation_cubemap_SPEC_VERSION 1
#define XR_ANDROID_LIGHT_ESTIMATION_CUBEMAP_EXTENSION_NAME "XR_ANDROID_light_estimation_cubemap"

#define XR_TYPE_SYSTEM_CUBEMAP_LIGHT_ESTIMATION_PROPERTIES_ANDROID \
  static_cast<XrStructureType>(1000721000)
#define XR_TYPE_CUBEMAP_LIGHT_ESTIMATOR_CREATE_INFO_ANDROID static_cast<XrStructureType>(1000721001)
#define XR_TYPE_CUBEMAP_LIGHTING_DATA_ANDROID static_cast<XrStructureType>(1000721002)

typedef enum XrCubemapLightingColorFormatANDROID {
  XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R32G32B32_SFLOAT_ANDROID = 1,
  XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R32G32B32A32_SFLOAT_ANDROID = 2,
  XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R16G16B16A16_SFLOAT_ANDROID = 3,
  XR_CUBEMAP_LIGHTING_COLOR_FORMAT_MAX_ENUM_ANDROID = 0x7FFFFFFF
} XrCubemapLightingColorFormatANDROID;

typedef struct XrSystemCubemapLightEstimationPropertiesANDROID {
  XrStructureType type;
  void* XR_MAY_ALIAS next;
  XrBool32 supportsCubemapLightEstimation;
} XrSystemCubemapLightEstimationPropertiesANDROID;

typedef struct XrCubemapLightEstimatorCreateInfoANDROID {  // chained to the estimator's info
  XrStructureType type;
  const void* XR_MAY_ALIAS next;
  uint32_t cubemapResolution;  // edge in texels; one of those that are enumerated
  XrCubemapLightingColorFormatANDROID colorFormat;
  XrBool32 reproject;  // true: the faces stand on the axes of the application's space
} XrCubemapLightEstimatorCreateInfoANDROID;

typedef struct XrCubemapLightingDataANDROID {  // chained to the estimate
  XrStructureType type;
  void* XR_MAY_ALIAS next;
  XrLightEstimateStateANDROID state;
  uint32_t imageBufferSize;  // bytes of each face, which the application allocates
  uint8_t* imageBufferRight;
  uint8_t* imageBufferLeft;
  uint8_t* imageBufferTop;
  uint8_t* imageBufferBottom;
  uint8_t* imageBufferFront;  // -z
  uint8_t* imageBufferBack;   // +z
  XrQuaternionf rotation;     // of the cube in the application's space
  XrTime centerExposureTime;
} XrCubemapLightingDataANDROID;

typedef XrResult(XRAPI_PTR* PFN_xrEnumerateCubemapLightingResolutionsANDROID)(
    XrInstance instance, XrSystemId system, uint32_t capacity, uint32_t* count,
    uint32_t* resolutions);
typedef XrResult(XRAPI_PTR* PFN_xrEnumerateCubemapLightingColorFormatsANDROID)(
    XrInstance instance, XrSystemId system, uint32_t capacity, uint32_t* count,
    XrCubemapLightingColorFormatANDROID* formats);
#endif
