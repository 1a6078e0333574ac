#define _POSIX_C_SOURCE 200809L  // NOLINT(bugprone-reserved-identifier): clock_gettime()
#include <time.h>

#include "penumbra_client.h"

int64_t penumbra_light_age_ns(const struct penumbra_light* light) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec - light->published_ns;
}

const char* penumbra_error_text(int code) {
  switch (code) {
    case PENUMBRA_OK:
      return "ok";
    case PENUMBRA_STALE:
      return "the daemon that wrote this has ended";
    case PENUMBRA_NONE_YET:
      return "nothing is measured yet";
    case PENUMBRA_BUSY:
      return "is being written";
    case PENUMBRA_TIMEOUT:
      return "nothing new came in time";
    case PENUMBRA_NO_PAGE:
      return "there is no such file: no daemon runs";
    case PENUMBRA_UNREADABLE:
      return "cannot be opened or mapped";
    case PENUMBRA_TOO_SHORT:
      return "is shorter than a page of light";
    case PENUMBRA_NOT_A_PAGE:
      return "is no page of light";
    case PENUMBRA_OTHER_VERSION:
      return "is of another version than this library";
    case PENUMBRA_DAMAGED:
      return "is damaged: a count is out of range";
    case PENUMBRA_ARGUMENT:
      return "wrong argument of the call";
    case PENUMBRA_NO_MEMORY:
      return "no memory left";
    default:
      return "unknown code";
  }
}

uint32_t penumbra_client_version(void) {
  return PENUMBRA_CLIENT_VERSION;
}

size_t penumbra_struct_bytes(int which) {
  switch (which) {
    case PENUMBRA_STRUCT_PAGE:
      return sizeof(struct penumbra_light_page);
    case PENUMBRA_STRUCT_LIGHT:
      return sizeof(struct penumbra_light);
    case PENUMBRA_STRUCT_OBJECTS:
      return sizeof(struct penumbra_objects);
    case PENUMBRA_STRUCT_CUBE:
      return sizeof(struct penumbra_cube);
    default:
      return 0;
  }
}
