// Penumbra's newest light, objects and cube map in any program: C11, nothing but libc.
// threads: one client belongs to one thread at a time; different clients are independent
#ifndef PENUMBRA_CLIENT_H
#define PENUMBRA_CLIENT_H

#include <stddef.h>

#include "penumbra_light_page.h"

// Linked into another library, the functions stay inside of it.
#ifdef PENUMBRA_CLIENT_STATIC
#define PENUMBRA_API __attribute__((visibility("hidden")))
#else
#define PENUMBRA_API __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define PENUMBRA_CLIENT_VERSION 1u

/// From 0 up `out` is filled; below 0 it is as it was.
enum penumbra_code {
  PENUMBRA_OK = 0,
  PENUMBRA_STALE = 1,           // filled, but the daemon that wrote it has ended
  PENUMBRA_NONE_YET = -1,       // the daemon has not measured one
  PENUMBRA_BUSY = -2,           // being written; or its writer died while it wrote
  PENUMBRA_TIMEOUT = -3,        // nothing new in time
  PENUMBRA_NO_PAGE = -4,        // there is no file: no daemon has run
  PENUMBRA_UNREADABLE = -5,     // the file cannot be opened or mapped; errno says why
  PENUMBRA_TOO_SHORT = -6,      // the file is shorter than a page
  PENUMBRA_NOT_A_PAGE = -7,     // the file does not begin as a page does
  PENUMBRA_OTHER_VERSION = -8,  // of another version than this library
  PENUMBRA_DAMAGED = -9,        // counts out of range
  PENUMBRA_ARGUMENT = -10,      // of the call
  PENUMBRA_NO_MEMORY = -11
};

typedef struct penumbra_client penumbra_client;

/// path_or_null: the page's file; NULL takes $PENUMBRA_LIGHT, else $XDG_RUNTIME_DIR/penumbra/light
///               where it exists, else /run/penumbra/light
/// out:          a client, also where there is no good page yet: it looks for one again, at most
///               once a second, whenever it is asked. NULL after PENUMBRA_ARGUMENT and _NO_MEMORY.
/// returns PENUMBRA_OK, or why there is no page yet.
PENUMBRA_API int penumbra_client_open(const char* path_or_null, penumbra_client** out);

/// NULL does nothing.
PENUMBRA_API void penumbra_client_close(penumbra_client* client);

/// The newest light. Never waits, and makes no system call while new lights come. When none has
/// come it looks, at most once a second, whether there is another file or the writer is gone.
PENUMBRA_API int penumbra_client_light(penumbra_client* client, struct penumbra_light* out);

/// Waits until there is a light with another number than `after_number` (0: the first one), which
/// after a restart of the daemon may be a lower one.
/// timeout_ms: 0 does not wait, below 0 waits without end
/// returns PENUMBRA_OK, or PENUMBRA_TIMEOUT; where no page came in time, why not; at once, where
/// waiting cannot help: PENUMBRA_OTHER_VERSION, _UNREADABLE, _DAMAGED, _ARGUMENT
PENUMBRA_API int penumbra_client_wait(penumbra_client* client, uint64_t after_number,
                                      int timeout_ms, struct penumbra_light* out);

/// Where the virtual objects stood in the newest composited picture.
PENUMBRA_API int penumbra_client_objects(penumbra_client* client, struct penumbra_objects* out);

/// The surroundings as a cube map: 192 KiB are copied.
PENUMBRA_API int penumbra_client_cube(penumbra_client* client, struct penumbra_cube* out);

/// Time since the light was published, in ns.
PENUMBRA_API int64_t penumbra_light_age_ns(const struct penumbra_light* light);

/// The file that is mapped, or that was looked for last. Valid until the next call.
PENUMBRA_API const char* penumbra_client_path(const penumbra_client* client);

/// One line in English; also for numbers that are no code.
PENUMBRA_API const char* penumbra_error_text(int code);

/// PENUMBRA_CLIENT_VERSION of the library that runs; it changes when the interface does.
PENUMBRA_API uint32_t penumbra_client_version(void);

enum penumbra_struct {
  PENUMBRA_STRUCT_PAGE = 0,
  PENUMBRA_STRUCT_LIGHT = 1,
  PENUMBRA_STRUCT_OBJECTS = 2,
  PENUMBRA_STRUCT_CUBE = 3
};

/// Size of a struct in the library that runs, for bindings of other languages; 0 for no struct.
PENUMBRA_API size_t penumbra_struct_bytes(int which);

#ifdef __cplusplus
}
#endif

#endif
