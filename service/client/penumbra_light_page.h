// The shared-memory page with Penumbra's newest light, as the daemon writes and clients map it.
// threads: plain data; the sequences say how it is read while it is written
#ifndef PENUMBRA_LIGHT_PAGE_H
#define PENUMBRA_LIGHT_PAGE_H

#include <stdint.h>

// Little-endian, natural alignment. A change of this file changes PENUMBRA_LIGHT_PAGE_VERSION.
//
// World      right-handed, metres, y up, -z forward; directions are unit vectors towards the light.
// Radiance   linear Rec.709 RGB, relative units.
// SH         real, orthonormal, without Condon-Shortley phase, index l*l+l+m, on world x, y, z with
//            z as the pole: Y_1,-1..1 = .488603 (y, z, x). B bands are B*B coefficients.
//
// Sequences  each of the three parts has one. It is odd while its part is written. The one writer
//            makes it odd, writes, makes it even and wakes all who wait on it (FUTEX_WAKE). A
//            store-release alone does not keep the part's own stores behind the odd number: the
//            writer needs a release fence there, or release stores of the words. Readers read the
//            sequence, copy, and read it again; light_sequence is also the word to wait on.
// Writer     holds flock(LOCK_EX) on the file and never makes it shorter. It writes `magic` last
//            when the page is new.

#ifdef __cplusplus
#define PENUMBRA_PAGE_ASSERT(condition, text) static_assert(condition, text)
#define PENUMBRA_PAGE_ALIGN alignas(64)
#else
#define PENUMBRA_PAGE_ASSERT(condition, text) _Static_assert(condition, text)
#define PENUMBRA_PAGE_ALIGN _Alignas(64)
#endif

#define PENUMBRA_LIGHT_PAGE_MAGIC "PNBRLGHT"  // eight characters, without the final zero
#define PENUMBRA_LIGHT_PAGE_VERSION 1u
#define PENUMBRA_PAGE_BANDS 9
#define PENUMBRA_PAGE_COEFFICIENTS 81
#define PENUMBRA_PAGE_LIGHTS 64
#define PENUMBRA_PAGE_OBJECTS 64
#define PENUMBRA_PAGE_NAME 64
#define PENUMBRA_PAGE_CUBE 64

struct penumbra_distant_light {
  uint32_t id;  // stays the same while the light is followed; 0xffffffff: no camera sees it
  float direction[3];
  float radius_rad;
  float solid_angle_sr;
  float radiance[3];     // mean, above the residual; times solid_angle_sr it is the irradiance
  uint32_t clipped;      // 1: saturated in every exposure
  uint32_t lower_bound;  // 1: it sends at least this radiance, or this is a guessed share
};

struct penumbra_light {
  uint64_t number;          // counts lights from 1; 0: none yet
  int64_t capture_time_ns;  // on the clock of the frames
  int64_t published_ns;     // CLOCK_MONOTONIC of this machine
  uint32_t valid;           // 0: the light is not to be used
  uint32_t lower_bound;     // 1: some light is a lower bound
  uint32_t within_budget;   // 1: the predicted error keeps to the budget
  uint32_t bands;           // 1 to 9
  uint32_t light_count;     // 0 to 64
  uint32_t reserved;
  float coverage;                // 0 to 1, part of the sphere that the cameras show
  float clipped_fraction;        // 0 to 1, part of the sphere that is saturated
  float predicted_shadow_error;  // relative RMS; NaN: unknown
  float mean_radiance[3];
  float coefficients[PENUMBRA_PAGE_COEFFICIENTS][3];  // the whole light; bands*bands are used
  float residual[PENUMBRA_PAGE_COEFFICIENTS][3];      // without the lights below
  struct penumbra_distant_light lights[PENUMBRA_PAGE_LIGHTS];  // most irradiance first
};

struct penumbra_object {
  char name[PENUMBRA_PAGE_NAME];  // UTF-8, ends with a zero
  float position_m[3];
  float rotation_wxyz[4];  // world_from_object
  uint32_t visible;
};

struct penumbra_objects {
  uint64_t number;          // counts pictures from 1; 0: none yet
  int64_t capture_time_ns;  // of the frame that they were drawn in
  uint32_t count;           // 0 to 64
  struct penumbra_object objects[PENUMBRA_PAGE_OBJECTS];
  uint32_t reserved;
};

// Faces in the order +x, -x, +y, -y, +z, -z, with the axes of OpenGL's cube maps. Column i and row
// j have s = (i + .5)/64, t = (j + .5)/64; with S = 2s - 1 and T = 2t - 1 they look along
//   +x ( 1, -T, -S)   +y (S,  1,  T)   +z ( S, -T,  1)
//   -x (-1, -T,  S)   -y (S, -1, -T)   -z (-S, -T, -1)
struct penumbra_cube {
  uint64_t number;  // counts cubes from 1; 0: none yet
  int64_t capture_time_ns;
  uint32_t size;                                                  // 64, edge in texels
  uint32_t faces;                                                 // 6
  uint16_t texels[6][PENUMBRA_PAGE_CUBE][PENUMBRA_PAGE_CUBE][4];  // RGBA16F, alpha 1
};

struct penumbra_light_page {
  char magic[8];
  uint32_t version;  // PENUMBRA_LIGHT_PAGE_VERSION
  uint32_t bytes;    // size of this struct
  uint32_t light_sequence;
  uint32_t objects_sequence;
  uint32_t cube_sequence;
  uint32_t writer_pid;
  PENUMBRA_PAGE_ALIGN struct penumbra_light light;
  PENUMBRA_PAGE_ALIGN struct penumbra_objects objects;
  PENUMBRA_PAGE_ALIGN struct penumbra_cube cube;
};

#include <stddef.h>

PENUMBRA_PAGE_ASSERT(sizeof(struct penumbra_distant_light) == 44, "distant light");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_light, coverage) == 48, "numbers of the light");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_light, coefficients) == 72, "coefficients");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_light, residual) == 1044, "residual");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_light, lights) == 2016, "lights");
PENUMBRA_PAGE_ASSERT(sizeof(struct penumbra_light) == 4832, "light");
PENUMBRA_PAGE_ASSERT(sizeof(struct penumbra_object) == 96, "object");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_objects, objects) == 20, "objects");
PENUMBRA_PAGE_ASSERT(sizeof(struct penumbra_objects) == 6168, "all objects");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_cube, texels) == 24, "texels");
PENUMBRA_PAGE_ASSERT(sizeof(struct penumbra_cube) == 196632, "cube");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_light_page, light_sequence) == 16, "sequences");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_light_page, writer_pid) == 28, "writer");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_light_page, light) == 64, "place of the light");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_light_page, objects) == 4928, "place of the objects");
PENUMBRA_PAGE_ASSERT(offsetof(struct penumbra_light_page, cube) == 11136, "place of the cube");
PENUMBRA_PAGE_ASSERT(sizeof(struct penumbra_light_page) == 207808, "page");

#undef PENUMBRA_PAGE_ASSERT
#undef PENUMBRA_PAGE_ALIGN

#endif
