#ifndef _GNU_SOURCE
#define _GNU_SOURCE  // NOLINT(bugprone-reserved-identifier): syscall() and the coarse clock
#endif
#include "penumbra_client.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/futex.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum {
  kPaths = 2,      // a user's daemon and the system's
  kTries = 16,     // bounds a read, so that what a dead writer left half is told at once
  kSliceMs = 250,  // a wait wakes so often to see whether there is another file
  kMillion = 1000000,
};
static const int64_t kLookEveryNs = 1000000000;

struct penumbra_client {
  char* paths[kPaths];
  int path_count;
  int path;  // index of the one that is mapped, or was looked for last
  const struct penumbra_light_page* page;
  int code;  // why there is no page
  dev_t device;
  ino_t inode;
  int64_t looked_ns;      // when the file was looked at last
  uint32_t seen_light;    // sequence at the last read: anything new needs no look at the file
  uint32_t looked_light;  // sequence when the file was looked at
  int gone;               // the writer, when the file was looked at
};

static int64_t now_ns(clockid_t clock) {
  struct timespec t;
  clock_gettime(clock, &t);
  return (int64_t)t.tv_sec * 1000 * kMillion + t.tv_nsec;
}

// ---- The file. ----

static void unmap(penumbra_client* c) {
  if (c->page) munmap((void*)(uintptr_t)c->page, sizeof *c->page);
  c->page = NULL;
  c->gone = 0;
}

static int check_header(const struct penumbra_light_page* page) {
  if (memcmp(page->magic, PENUMBRA_LIGHT_PAGE_MAGIC, sizeof page->magic) != 0)
    return PENUMBRA_NOT_A_PAGE;
  const uint32_t version = __atomic_load_n(&page->version, __ATOMIC_RELAXED);
  const uint32_t bytes = __atomic_load_n(&page->bytes, __ATOMIC_RELAXED);
  if (version != PENUMBRA_LIGHT_PAGE_VERSION || bytes != sizeof *page)
    return PENUMBRA_OTHER_VERSION;
  return PENUMBRA_OK;
}

// Only a whole, regular file is mapped: reading beyond a file's end would kill the program.
static int map_file(penumbra_client* c, const char* path) {
  // Without O_NONBLOCK a pipe of that name would hold the program up.
  const int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY);
  if (fd < 0) return errno == ENOENT || errno == ENOTDIR ? PENUMBRA_NO_PAGE : PENUMBRA_UNREADABLE;
  struct stat s;
  int code = PENUMBRA_OK;
  const struct penumbra_light_page* page = NULL;
  if (fstat(fd, &s) != 0) {
    code = PENUMBRA_UNREADABLE;
  } else if (!S_ISREG(s.st_mode)) {
    code = PENUMBRA_NOT_A_PAGE;
  } else if (s.st_size < (off_t)sizeof *page) {
    code = PENUMBRA_TOO_SHORT;
  } else {
    void* mapped = mmap(NULL, sizeof *page, PROT_READ, MAP_SHARED, fd, 0);
    if (mapped == MAP_FAILED)
      code = PENUMBRA_UNREADABLE;
    else
      page = mapped;
  }
  const int reason = errno;
  close(fd);
  errno = reason;
  if (!page) return code;
  code = check_header(page);
  if (code != PENUMBRA_OK) {
    munmap((void*)(uintptr_t)page, sizeof *page);
    return code;
  }
  c->page = page;
  c->device = s.st_dev;
  c->inode = s.st_ino;
  return PENUMBRA_OK;
}

// A process that has ended is there until its parent has asked for it.
static int is_zombie(uint32_t pid) {
  char name[32], text[512];
  snprintf(name, sizeof name, "/proc/%u/stat", pid);
  const int fd = open(name, O_RDONLY | O_CLOEXEC);
  if (fd < 0) return 0;
  const ssize_t bytes = read(fd, text, sizeof text - 1);
  close(fd);
  if (bytes <= 0) return 0;
  text[bytes] = 0;
  const char* state = strrchr(text, ')');  // ends the program's name, which may hold any
  return state && state[1] == ' ' && (state[2] == 'Z' || state[2] == 'X');
}

// In a container the writer's number may be unknown though it lives: then new lights tell.
static int is_writer_gone(const struct penumbra_light_page* page) {
  const uint32_t pid = __atomic_load_n(&page->writer_pid, __ATOMIC_RELAXED);
  if (pid == 0 || pid > INT_MAX) return 0;
  return kill((pid_t)pid, 0) != 0 ? errno == ESRCH : is_zombie(pid);
}

static void begin_page(penumbra_client* c, int path) {
  c->path = path;
  c->seen_light = c->looked_light = __atomic_load_n(&c->page->light_sequence, __ATOMIC_RELAXED);
  c->gone = is_writer_gone(c->page);
}

static void find_page(penumbra_client* c) {
  for (int i = 0; i < c->path_count; ++i) {
    c->path = i;
    c->code = map_file(c, c->paths[i]);
    if (c->code == PENUMBRA_OK) begin_page(c, i);
    if (c->code != PENUMBRA_NO_PAGE) return;
  }
  c->path = 0;
}

// The same file, whole and with a header of ours: a daemon that starts again may write into it.
static int is_current(const penumbra_client* c) {
  struct stat s;
  if (stat(c->paths[c->path], &s) != 0) return 1;  // removed by a daemon that ended: keep the light
  return s.st_dev == c->device && s.st_ino == c->inode && s.st_size >= (off_t)sizeof *c->page &&
         check_header(c->page) == PENUMBRA_OK;
}

// Of a user's daemon and the system's one may have ended and the other have started.
static void change_path(penumbra_client* c) {
  for (int i = 0; i < c->path_count; ++i) {
    penumbra_client other = *c;
    other.page = NULL;
    if (i == c->path || map_file(&other, c->paths[i]) != PENUMBRA_OK) continue;
    begin_page(&other, i);
    if (other.gone) {
      unmap(&other);
    } else {
      unmap(c);
      *c = other;
    }
  }
}

// At most once a second, and only where no new light has come since the last read.
static void look(penumbra_client* c) {
  const int64_t now = now_ns(CLOCK_MONOTONIC_COARSE);
  if (now - c->looked_ns < kLookEveryNs) return;
  c->looked_ns = now;
  if (c->page && !is_current(c)) unmap(c);
  if (!c->page) {
    find_page(c);
    return;
  }
  const uint32_t light = __atomic_load_n(&c->page->light_sequence, __ATOMIC_RELAXED);
  c->gone = light == c->looked_light && is_writer_gone(c->page);
  c->looked_light = light;
  if (c->gone) change_path(c);
}

// ---- Reading. ----

// A sequence lock's reader. All loads are atomic, since the writer may write at any time; they
// acquire, so that the second look at the sequence stays behind them without a fence.
static int copy_part(const uint32_t* sequence, const void* from, void* to, size_t bytes) {
  const uint64_t* source = from;
  unsigned char* target = to;
  for (int i = 0; i < kTries; ++i) {
    const uint32_t before = __atomic_load_n(sequence, __ATOMIC_ACQUIRE);
    if (before & 1) continue;
    for (size_t n = 0; n < bytes / sizeof *source; ++n) {
      const uint64_t word = __atomic_load_n(&source[n], __ATOMIC_ACQUIRE);
      memcpy(target + n * sizeof word, &word, sizeof word);
    }
    if (__atomic_load_n(sequence, __ATOMIC_RELAXED) == before) return PENUMBRA_OK;
  }
  return PENUMBRA_BUSY;
}

// What is copied is a whole number of words, or its end would be missing.
_Static_assert(sizeof(struct penumbra_light) % 8 == 0, "light");
_Static_assert(sizeof(struct penumbra_objects) % 8 == 0, "objects");
_Static_assert(sizeof(struct penumbra_cube) % 8 == 0, "cube");

static int is_light(const struct penumbra_light* light) {
  return light->bands <= PENUMBRA_PAGE_BANDS && (light->bands > 0 || !light->valid) &&
         light->light_count <= PENUMBRA_PAGE_LIGHTS;
}

// Looks at the file where nothing new came since the last call.
static int begin_read(penumbra_client* c) {
  if (!c->page) look(c);
  if (!c->page) return c->code;
  const uint32_t light = __atomic_load_n(&c->page->light_sequence, __ATOMIC_RELAXED);
  if (light == c->seen_light) {
    look(c);
    if (!c->page) return c->code;
    if (c->gone) return PENUMBRA_STALE;
  }
  c->seen_light = light;
  c->gone = 0;
  return PENUMBRA_OK;
}

static int read_light(penumbra_client* c, struct penumbra_light* out) {
  const int state = begin_read(c);
  if (state < 0) return state;
  struct penumbra_light copy;
  const int code = copy_part(&c->page->light_sequence, &c->page->light, &copy, sizeof copy);
  if (code != PENUMBRA_OK) return code;
  if (copy.number == 0) return PENUMBRA_NONE_YET;
  if (!is_light(&copy)) return PENUMBRA_DAMAGED;
  *out = copy;
  return state;
}

int penumbra_client_light(penumbra_client* client, struct penumbra_light* out) {
  if (!client || !out) return PENUMBRA_ARGUMENT;
  return read_light(client, out);
}

int penumbra_client_objects(penumbra_client* client, struct penumbra_objects* out) {
  if (!client || !out) return PENUMBRA_ARGUMENT;
  const int state = begin_read(client);
  if (state < 0) return state;
  const struct penumbra_light_page* page = client->page;
  struct penumbra_objects copy;
  const int code = copy_part(&page->objects_sequence, &page->objects, &copy, sizeof copy);
  if (code != PENUMBRA_OK) return code;
  if (copy.number == 0) return PENUMBRA_NONE_YET;
  if (copy.count > PENUMBRA_PAGE_OBJECTS) return PENUMBRA_DAMAGED;
  for (uint32_t i = 0; i < copy.count; ++i) copy.objects[i].name[PENUMBRA_PAGE_NAME - 1] = 0;
  *out = copy;
  return state;
}

int penumbra_client_cube(penumbra_client* client, struct penumbra_cube* out) {
  if (!client || !out) return PENUMBRA_ARGUMENT;
  const int state = begin_read(client);
  if (state < 0) return state;
  const struct penumbra_light_page* page = client->page;
  // Too large for a small stack, and `out` stays as it was until the copy is whole.
  struct penumbra_cube* copy = malloc(sizeof *copy);
  if (!copy) return PENUMBRA_NO_MEMORY;
  int code = copy_part(&page->cube_sequence, &page->cube, copy, sizeof *copy);
  if (code == PENUMBRA_OK && copy->number == 0) code = PENUMBRA_NONE_YET;
  if (code == PENUMBRA_OK && (copy->size != PENUMBRA_PAGE_CUBE || copy->faces != 6))
    code = PENUMBRA_DAMAGED;
  if (code == PENUMBRA_OK) *out = *copy;
  free(copy);
  return code == PENUMBRA_OK ? state : code;
}

// ---- Waiting. ----

static void sleep_until_written(const penumbra_client* c, uint32_t sequence, int64_t wait_ns) {
  const int64_t most = (int64_t)kSliceMs * kMillion;
  if (wait_ns > most) wait_ns = most;
  const struct timespec t = {(time_t)(wait_ns / (1000 * kMillion)),
                             (long)(wait_ns % (1000 * kMillion))};
  // Not private: the writer is another process. The kernel only reads the word.
  if (c->page)
    syscall(SYS_futex, &c->page->light_sequence, FUTEX_WAIT, sequence, &t, NULL, 0);
  else
    nanosleep(&t, NULL);
}

int penumbra_client_wait(penumbra_client* client, uint64_t after_number, int timeout_ms,
                         struct penumbra_light* out) {
  if (!client || !out) return PENUMBRA_ARGUMENT;
  const int64_t end = now_ns(CLOCK_MONOTONIC) + (int64_t)timeout_ms * kMillion;
  for (;;) {
    // Before the light: whatever is written later changes this word and ends the wait.
    const uint32_t sequence =
        client->page ? __atomic_load_n(&client->page->light_sequence, __ATOMIC_ACQUIRE) : 0;
    const struct penumbra_light_page* page = client->page;
    struct penumbra_light light;
    light.number = after_number;
    const int code = read_light(client, &light);
    if (code >= 0 && light.number != after_number) {
      *out = light;
      return code;
    }
    // A daemon that starts leaves a file without its header for a moment.
    const int no_page =
        code == PENUMBRA_NO_PAGE || code == PENUMBRA_TOO_SHORT || code == PENUMBRA_NOT_A_PAGE;
    if (code < 0 && code != PENUMBRA_NONE_YET && code != PENUMBRA_BUSY && !no_page) return code;
    if (client->page != page) continue;  // another file: its sequence is not known
    int64_t left = (int64_t)kSliceMs * kMillion;
    if (timeout_ms >= 0) left = end - now_ns(CLOCK_MONOTONIC);
    if (left <= 0) return no_page ? code : PENUMBRA_TIMEOUT;
    sleep_until_written(client, sequence, left);
  }
}

// ---- Opening. ----

static char* join(const char* folder, const char* name) {
  const size_t bytes = strlen(folder) + strlen(name) + 1;
  char* out = malloc(bytes);
  if (out) snprintf(out, bytes, "%s%s", folder, name);
  return out;
}

static int add_path(penumbra_client* c, const char* folder, const char* name) {
  char* path = join(folder, name);
  if (!path) return PENUMBRA_NO_MEMORY;
  c->paths[c->path_count++] = path;
  return PENUMBRA_OK;
}

static int add_paths(penumbra_client* c, const char* path_or_null) {
  const char* path = path_or_null ? path_or_null : getenv("PENUMBRA_LIGHT");
  if (path && *path) return add_path(c, path, "");
  const char* runtime = getenv("XDG_RUNTIME_DIR");
  if (runtime && *runtime && add_path(c, runtime, "/penumbra/light") != PENUMBRA_OK)
    return PENUMBRA_NO_MEMORY;
  return add_path(c, "/run/penumbra/light", "");
}

int penumbra_client_open(const char* path_or_null, penumbra_client** out) {
  if (!out) return PENUMBRA_ARGUMENT;
  *out = NULL;
  if (path_or_null && !*path_or_null) return PENUMBRA_ARGUMENT;
  penumbra_client* c = calloc(1, sizeof *c);
  if (!c) return PENUMBRA_NO_MEMORY;
  if (add_paths(c, path_or_null) != PENUMBRA_OK) {
    penumbra_client_close(c);
    return PENUMBRA_NO_MEMORY;
  }
  c->looked_ns = now_ns(CLOCK_MONOTONIC_COARSE);
  find_page(c);
  *out = c;
  return c->page ? PENUMBRA_OK : c->code;
}

void penumbra_client_close(penumbra_client* client) {
  if (!client) return;
  unmap(client);
  for (int i = 0; i < client->path_count; ++i) free(client->paths[i]);
  free(client);
}

const char* penumbra_client_path(const penumbra_client* client) {
  return client ? client->paths[client->path] : "";
}
