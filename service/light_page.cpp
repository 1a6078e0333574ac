#include "service/light_page.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/futex.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <limits>
#include <utility>
#include <vector>

#include "core/conventions.h"
#include "core/half.h"
#include "lighting/estimate.h"
#include "service/client/penumbra_light_page.h"

namespace penumbra::service {

namespace fs = std::filesystem;

namespace {

std::int64_t monotonic_ns() {
  std::timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

// Odd while it lives; then even, and whoever waits wakes.
class Writing {
 public:
  explicit Writing(std::uint32_t& sequence) : sequence_(sequence) {
    number_ = std::atomic_ref(sequence_).load(std::memory_order_relaxed) | 1;
    std::atomic_ref(sequence_).store(number_, std::memory_order_relaxed);
    std::atomic_thread_fence(std::memory_order_release);
  }
  ~Writing() {
    std::atomic_ref(sequence_).store(number_ + 1, std::memory_order_release);
    ::syscall(SYS_futex, &sequence_, FUTEX_WAKE, std::numeric_limits<int>::max(), nullptr, nullptr,
              0);
  }
  Writing(const Writing&) = delete;
  Writing& operator=(const Writing&) = delete;

 private:
  std::uint32_t& sequence_;
  std::uint32_t number_;
};

void put(const RadianceSh& sh, float (&out)[PENUMBRA_PAGE_COEFFICIENTS][3]) {
  std::memset(out, 0, sizeof out);
  for (std::size_t n = 0; n < sh.terms().size(); ++n)
    for (int c = 0; c < 3; ++c) out[n][c] = sh.terms()[n][c];
}

penumbra_distant_light on_page(const lighting::DistantLight& d) {
  penumbra_distant_light out{};
  out.id = static_cast<std::uint32_t>(d.id);
  for (int c = 0; c < 3; ++c) {
    out.direction[c] = static_cast<float>(d.direction[c]);
    out.radiance[c] = d.radiance[c];
  }
  out.radius_rad = static_cast<float>(d.radius.value());
  out.solid_angle_sr = static_cast<float>(d.solid_angle_sr());
  out.clipped = d.clipped;
  out.lower_bound = d.is_lower_bound();
  return out;
}

}  // namespace

LightPage::LightPage(fs::path path, int file, penumbra_light_page* page)
    : path_(std::move(path)), file_(file), page_(page) {}

LightPage::~LightPage() {
  // The name goes first: whoever opens it then finds the next service's.
  std::error_code ignored;
  fs::remove(path_, ignored);
  ::munmap(page_, sizeof *page_);
  ::close(file_);
}

Result<std::unique_ptr<LightPage>> LightPage::create(const fs::path& path) {
  const auto refused = [&](ErrorCode code, const std::string& reason) {
    return fail(code, path.string(), reason);
  };
  std::error_code error;
  if (path.has_parent_path()) fs::create_directories(path.parent_path(), error);
  if (error) return refused(ErrorCode::kUnwritable, error.message());
  const int file = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0644);
  if (file < 0) return refused(ErrorCode::kUnwritable, std::strerror(errno));
  const auto closed = [&](ErrorCode code, const std::string& reason) {
    ::close(file);
    return refused(code, reason);
  };
  if (::flock(file, LOCK_EX | LOCK_NB) != 0)
    return closed(ErrorCode::kUnavailable, "is written by another service");
  // Never shorter than it was: who has it mapped goes on reading.
  if (::posix_fallocate(file, 0, sizeof(penumbra_light_page)) != 0)
    return closed(ErrorCode::kUnwritable, "cannot be given its size: is the disk full?");
  void* const mapped =
      ::mmap(nullptr, sizeof(penumbra_light_page), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  if (mapped == MAP_FAILED) return closed(ErrorCode::kUnwritable, std::strerror(errno));
  auto* const page = static_cast<penumbra_light_page*>(mapped);
  {
    const Writing light(page->light_sequence), objects(page->objects_sequence),
        cube(page->cube_sequence);
    page->light = {};
    page->objects = {};
    page->cube = {};
    page->version = PENUMBRA_LIGHT_PAGE_VERSION;
    page->bytes = sizeof *page;
    page->writer_pid = static_cast<std::uint32_t>(::getpid());
  }
  std::memcpy(page->magic, PENUMBRA_LIGHT_PAGE_MAGIC, sizeof page->magic);
  return std::unique_ptr<LightPage>(new LightPage(path, file, page));
}

void LightPage::write(const lighting::LightEstimate& light) {
  const std::scoped_lock lock(mutex_);
  penumbra_light out = page_->light;
  ++out.number;
  out.capture_time_ns = light.time.value;
  out.published_ns = monotonic_ns();
  out.valid = light.valid;
  out.lower_bound = std::ranges::any_of(light.lights, &lighting::DistantLight::is_lower_bound);
  out.within_budget = light.plan && light.plan->within_budget;
  out.bands = static_cast<std::uint32_t>(light.light.bands());
  out.light_count =
      static_cast<std::uint32_t>(std::min<std::size_t>(light.lights.size(), PENUMBRA_PAGE_LIGHTS));
  out.coverage = static_cast<float>(light.coverage);
  out.clipped_fraction = static_cast<float>(light.clipped_fraction);
  out.predicted_shadow_error = light.plan && !light.plan->lower_bound
                                   ? static_cast<float>(light.plan->error)
                                   : std::numeric_limits<float>::quiet_NaN();
  for (int c = 0; c < 3; ++c) out.mean_radiance[c] = light.mean_radiance[c];
  put(lighting::whole_light(light), out.coefficients);
  put(light.light, out.residual);
  for (std::size_t i = 0; i < out.light_count; ++i) out.lights[i] = on_page(light.lights[i]);
  const Writing writing(page_->light_sequence);
  page_->light = out;
}

void LightPage::write(std::span<const runtime::ObjectState> objects, TimestampNs time) {
  const std::scoped_lock lock(mutex_);
  penumbra_objects out{};
  out.number = page_->objects.number + 1;
  out.capture_time_ns = time.value;
  for (const runtime::ObjectState& o : objects) {
    if (out.count == PENUMBRA_PAGE_OBJECTS) break;
    penumbra_object& to = out.objects[out.count++];
    o.name.copy(to.name, sizeof to.name - 1);
    const glm::dquat& q = o.world_from_bake.rotation;
    const double rotation[] = {q.w, q.x, q.y, q.z};
    for (int c = 0; c < 3; ++c)
      to.position_m[c] = static_cast<float>(o.world_from_bake.translation[c]);
    std::ranges::transform(rotation, to.rotation_wxyz,
                           [](double v) { return static_cast<float>(v); });
    to.visible = o.visible;
  }
  const Writing writing(page_->objects_sequence);
  page_->objects = out;
}

void LightPage::write(const Environment& environment) {
  constexpr std::int64_t kBetween_ns = 100'000'000;
  const std::int64_t now = monotonic_ns();
  if (now - cube_written_ns_ < kBetween_ns || environment.radiance.empty()) return;
  const std::scoped_lock lock(mutex_);
  if (!cube_of_map_ || !cube_of_map_->fits(environment.radiance))
    cube_of_map_.emplace(environment.radiance.width(), environment.radiance.height(),
                         PENUMBRA_PAGE_CUBE);
  const std::vector<Rgb> cube = cube_of_map_->apply(environment.radiance);
  cube_written_ns_ = now;
  const Writing writing(page_->cube_sequence);
  penumbra_cube& out = page_->cube;
  ++out.number;
  out.capture_time_ns = environment.time.value;
  out.size = PENUMBRA_PAGE_CUBE;
  out.faces = 6;
  std::uint16_t* to = &out.texels[0][0][0][0];
  const std::uint16_t one = half_from_float(1);
  for (const Rgb& c : cube) {
    for (int i = 0; i < 3; ++i) *to++ = half_from_float(std::min(c[i], 65504.f));
    *to++ = one;
  }
}

}  // namespace penumbra::service
