#include "prt/clip/live_bake.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtx/quaternion.hpp>
#include <numeric>

#include "core/threads/parallel.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/rotation.h"
#include "prt/bake/bake.h"
#include "prt/bake/bake_rules.h"
#include "prt/clip/light_map.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"
#include "prt/rays/ray_pattern.h"
#include "prt/rays/rays.h"
#include "prt/transfer/transfer.h"

namespace penumbra::prt {

namespace {

constexpr int kLanes = RayScene::kPacket;
constexpr std::size_t kChunk = 32;  // points a task takes at once
// After vertices went so far (RMS, radii) an estimate counts 1/e: the material's own transfer, and
// what the floor sees of feet that step over it.
constexpr double kMemory = .1, kGroundMemory = .02;
constexpr float kMaxVisits = RayPatterns::kVariants;  // then rays repeat: 1024 a point
constexpr float kFirstGuess = 1e-3f;  // what a hidden point's counts until the point is seen

}  // namespace

struct LiveBake::Impl {
  Impl(const Character& c, const LiveBakeOptions& o, RayScene s, const Mesh& form);

  // What a visit finds at a point in the bake frame: light that is blocked, then by channel light
  // that comes instead.
  struct VisitResult {
    std::vector<float> sums;
    float behind;
  };
  // Where rays of a point go.
  struct Aim {
    glm::vec3 origin;
    glm::mat3 frame;
    float cos_half;  // of a cone; 0: the whole hemisphere, by the cosine
    RayPatterns::Turn turn;
  };

  bool on_ground(std::size_t p) const { return p >= vertices; }
  double memory(std::size_t p) const { return on_ground(p) ? kGroundMemory : kMemory; }
  std::size_t planes() const { return 1 + static_cast<std::size_t>(channels); }
  std::size_t size() const { return vertices + texels; }
  const glm::vec3& normal(std::size_t p) const { return on_ground(p) ? kUp : mesh.normals[p]; }
  void move_to(const CharacterPose& pose);
  Aim aim(std::size_t p) const;
  void trace(std::size_t p, VisitResult& found) const;
  void gather(const RayScene::RayPacket& packet, int lane, float weight, const glm::vec3& origin,
              bool ground_point, VisitResult& found) const;
  void gather_ground(const glm::vec3& at, float weight, float* sum) const;
  void remember(std::size_t p, const VisitResult& found);
  void refresh();
  void write(BakedObject& out) const;
  // planes() functions of `coefficients` each.
  void turn(const lighting::ShRotation& by, const float* in, float* out) const;
  const float* transfer_at(std::size_t p, int channel) const {
    return &now[(p * static_cast<std::size_t>(channels) + static_cast<std::size_t>(channel)) *
                coefficients];
  }

  static constexpr glm::vec3 kUp{0, 1, 0};
  const Character& character;
  LiveBakeOptions options;
  RayScene scene;
  RayPatterns patterns{kRays};
  int traced_bands, channels = 1;
  std::size_t coefficients, vertices, texels = 0;
  std::vector<std::uint16_t> bone;  // by vertex
  std::vector<float> open_ground;   // transfer of the receiver where nothing stands

  Mesh mesh, other;  // at the pose, and room for the next
  std::vector<glm::mat3> turns;
  std::vector<lighting::ShRotation> to_bake, to_material;  // by bone
  glm::vec3 centre{};
  float radius = 1;
  double travelled = 0;  // radii that the vertices went, RMS

  std::vector<float> sums;         // [point][plane][n], of all that counts, in the material's frame
  std::vector<float> counts;       // by point: visits that count
  std::vector<double> visited_at;  // by point: `travelled` then
  std::vector<std::uint32_t> visits;
  std::vector<float> now,
      reflected;  // [point][channel][n], bake frame: transfer, and its reflected part
  std::size_t next = 0, step = 1;  // points take turns by this step
};

LiveBake::Impl::Impl(const Character& c, const LiveBakeOptions& o, RayScene s, const Mesh& form)
    : character(c),
      options(o),
      scene(std::move(s)),
      traced_bands(std::max(o.bands, reflected_bands(o.bands))),
      coefficients(static_cast<std::size_t>(coefficient_count(traced_bands))),
      vertices(c.positions.size()),
      bone(lay_out(c, 0, 0).bone),
      mesh(form) {
  if (!std::ranges::all_of(c.albedo, is_grey) || (o.receiver && !is_grey(o.receiver->albedo)))
    channels = 3;
  if (o.receiver) texels = static_cast<std::size_t>(o.receiver->grid.size * o.receiver->grid.size);
  double up[kMaxCoefficients];
  lighting::evaluate_basis(traced_bands, glm::dvec3(kUp), up);
  for (int l = 0; l < traced_bands; ++l)
    for (int m = -l; m <= l; ++m)
      open_ground.push_back(
          static_cast<float>(lighting::cosine_coefficient(l) / kPi * up[sh_index(l, m)]));
  sums.resize(size() * planes() * coefficients);
  counts.resize(size());
  visited_at.resize(size());
  visits.resize(size());
  now.resize(size() * static_cast<std::size_t>(channels) * coefficients);
  reflected.resize(now.size());
  // Steps by the golden ratio: whatever is left over is spread over the whole surface.
  step = std::max<std::size_t>(1, static_cast<std::size_t>(.6180339887 * double(size())));
  while (std::gcd(step, size()) != 1) ++step;
}

void LiveBake::Impl::move_to(const CharacterPose& pose) {
  deform(character, pose, other);
  double square = 0;
  for (std::size_t i = 0; i < vertices; ++i) {
    const glm::vec3 way = other.positions[i] - mesh.positions[i];
    square += double(glm::dot(way, way));
  }
  // One such pose would stay in every estimate for good.
  if (!std::isfinite(square)) return to_bake.empty() ? move_to(rest_pose(character)) : void();
  std::swap(mesh, other);
  turns = bone_turns(character, pose);
  to_bake.clear();
  to_material.clear();
  for (const glm::mat3& t : turns) {
    to_bake.emplace_back(glm::dmat3(t), traced_bands);
    to_material.emplace_back(glm::dmat3(glm::transpose(t)), traced_bands);
  }
  scene.update_vertices(mesh);
  centre = bounds_of(mesh).centre();
  radius = std::max(radius_around(mesh, centre), 1e-30f);
  travelled += std::sqrt(square / static_cast<double>(vertices)) / double(radius);
}

LiveBake::Impl::Aim LiveBake::Impl::aim(std::size_t p) const {
  RayPatterns::Turn turn = RayPatterns::turn_of(p);
  turn.variant = static_cast<int>((static_cast<std::uint32_t>(turn.variant) + visits[p]) %
                                  RayPatterns::kVariants);
  if (!on_ground(p)) {
    // As in clips: patterns lie fixed in the material.
    const glm::mat3& of_bone = turns[bone[p]];
    const glm::vec3 at_rest = glm::normalize(character.normals[p]),
                    here = glm::normalize(glm::transpose(of_bone) * mesh.normals[p]);
    return {mesh.positions[p] + kRayNear * radius * mesh.normals[p],
            of_bone * glm::mat3_cast(glm::rotation(at_rest, here)) * frame_around(at_rest), 0,
            turn};
  }
  const GroundGrid& grid = options.receiver->grid;
  const std::size_t t = p - vertices;
  const auto side = static_cast<std::size_t>(grid.size);
  const glm::vec2 at = grid.position({(static_cast<float>(t % side) + .5f) / float(grid.size),
                                      (static_cast<float>(t / side) + .5f) / float(grid.size)});
  const glm::vec3 origin(at.x, grid.height + kRayNear * radius, at.y);
  const float distance = glm::distance(origin, centre) / radius;
  if (distance <= kConeFrom) return {origin, frame_around(kUp), 0, turn};
  return {origin, frame_around(glm::normalize(centre - origin)),
          std::sqrt(1 - 1 / (distance * distance)), turn};
}

// The receiver's transfer where a ray ended on it.
void LiveBake::Impl::gather_ground(const glm::vec3& at, float weight, float* sum) const {
  const Receiver& r = *options.receiver;
  const int size = r.grid.size;
  const glm::vec2 uv = r.grid.uv({at.x, at.z});
  const bool near = uv.x >= 0 && uv.x < 1 && uv.y >= 0 && uv.y < 1;  // NaN is not
  const auto texel = [&](float v) {
    return static_cast<std::size_t>(
        std::min(static_cast<int>(v * static_cast<float>(size)), size - 1));
  };
  for (int c = 0; c < channels; ++c, sum += coefficients) {
    const float k = weight * r.albedo[c];
    const float* const t =
        near ? transfer_at(vertices + texel(uv.y) * static_cast<std::size_t>(size) + texel(uv.x), c)
             : open_ground.data();
    for (std::size_t n = 0; n < coefficients; ++n) sum[n] += k * t[n];
  }
}

// What arrives along a blocked ray from where it ended.
void LiveBake::Impl::gather(const RayScene::RayPacket& packet, int lane, float weight,
                            const glm::vec3& origin, bool ground_point, VisitResult& found) const {
  float* const sum = &found.sums[coefficients];
  if (packet.triangle[lane] == RayScene::kMiss) {
    if (ground_point) return;
    const float way = std::max(0.f, (options.receiver->grid.height - origin.y) / packet.y[lane]);
    return gather_ground(origin + way * glm::vec3(packet.x[lane], 0, packet.z[lane]), weight, sum);
  }
  if (!packet.front[lane]) {
    found.behind += weight;
    return;
  }
  const auto& t = mesh.triangles[packet.triangle[lane]];
  const float u = packet.u[lane], v = packet.v[lane], w = 1 - u - v;
  for (int c = 0; c < channels; ++c) {
    const float k =
        weight * (w * mesh.albedo[t[0]][c] + u * mesh.albedo[t[1]][c] + v * mesh.albedo[t[2]][c]);
    const float *a = transfer_at(t[0], c), *b = transfer_at(t[1], c), *d = transfer_at(t[2], c);
    float* const out = sum + static_cast<std::size_t>(c) * coefficients;
    for (std::size_t n = 0; n < coefficients; ++n) out[n] += k * (w * a[n] + u * b[n] + v * d[n]);
  }
}

void LiveBake::Impl::trace(std::size_t p, VisitResult& found) const {
  const Aim a = aim(p);
  const bool ground_point = on_ground(p), plane_blocks = options.receiver && !ground_point;
  const float each = (a.cos_half > 0 ? 2 * (1 - a.cos_half) : 1) / static_cast<float>(kRays);
  found.sums.assign(planes() * coefficients, 0.f);
  found.behind = 0;
  RayScene::RayPacket packet;
  alignas(64) float basis[kMaxCoefficients * kLanes];
  for (int block = 0; block < kRays / kLanes; ++block) {
    if (a.cos_half > 0)
      patterns.cone_block(a.turn, block, a.frame, a.cos_half, packet);
    else
      patterns.cosine_block(a.turn, block, a.frame, packet);
    scene.intersect(a.origin, kRayNear * radius, packet);
    std::uint32_t blocked = 0;
    for (int i = 0; i < kLanes; ++i)
      if (packet.triangle[i] != RayScene::kMiss || (plane_blocks && packet.y[i] < 0))
        blocked |= 1u << i;
    if (blocked == 0) continue;
    lighting::evaluate_basis_block(traced_bands, packet.x, packet.y, packet.z, basis);
    for (; blocked; blocked &= blocked - 1) {
      const int i = std::countr_zero(blocked);
      const float weight = a.cos_half > 0 ? each * std::max(0.f, packet.y[i]) : each;
      for (std::size_t n = 0; n < coefficients; ++n)
        found.sums[n] += weight * basis[n * kLanes + static_cast<std::size_t>(i)];
      gather(packet, i, weight, a.origin, ground_point, found);
    }
  }
}

void LiveBake::Impl::turn(const lighting::ShRotation& by, const float* in, float* out) const {
  for (std::size_t first = 0; first < planes(); first += 3) {
    const std::size_t count = std::min<std::size_t>(3, planes() - first);
    TransferSh t(traced_bands);
    for (std::size_t k = 0; k < count; ++k)
      for (int n = 0; n < t.size(); ++n)
        t[n][static_cast<int>(k)] = in[(first + k) * coefficients + static_cast<std::size_t>(n)];
    t = by * t;
    for (std::size_t k = 0; k < count; ++k)
      for (int n = 0; n < t.size(); ++n)
        out[(first + k) * coefficients + static_cast<std::size_t>(n)] = t[n][static_cast<int>(k)];
  }
}

void LiveBake::Impl::remember(std::size_t p, const VisitResult& found) {
  // What lies within another part keeps what it had, as in clips.
  const bool hidden = found.behind > kHiddenFraction;
  if (hidden && counts[p] > 0) return;
  const float before = counts[p];
  // Older visits count less, the first not at all in the end: they gathered from estimates that
  // lacked further bounces.
  const float aged = before > .5f ? std::min(1 - .5f / before, 1 - 1 / kMaxVisits) : 0;
  const auto keep = aged * static_cast<float>(std::exp((visited_at[p] - travelled) / memory(p)));
  visited_at[p] = travelled;
  ++visits[p];
  const float weight = hidden ? kFirstGuess : 1;
  std::array<float, 4 * kMaxCoefficients> turned;
  if (on_ground(p))
    std::ranges::copy(found.sums, turned.begin());
  else
    turn(to_material[bone[p]], found.sums.data(), turned.data());
  float* const sum = &sums[p * planes() * coefficients];
  for (std::size_t k = 0; k < planes() * coefficients; ++k)
    sum[k] = keep * sum[k] + weight * turned[k];
  counts[p] = keep * counts[p] + weight;
}

// The estimate in the bake frame: what is open is known in closed form.
void LiveBake::Impl::refresh() {
  parallel_for(std::size_t{0}, size(), kChunk, [&](const auto& range) {
    std::array<float, 4 * kMaxCoefficients> turned;
    double basis[kMaxCoefficients];
    for (std::size_t p = range.begin(); p < range.end(); ++p) {
      const float* const sum = &sums[p * planes() * coefficients];
      if (on_ground(p))
        std::copy_n(sum, planes() * coefficients, turned.begin());
      else
        turn(to_bake[bone[p]], sum, turned.data());
      const float each = counts[p] > 0 ? 1 / counts[p] : 0;
      lighting::evaluate_basis(traced_bands, glm::normalize(glm::dvec3(normal(p))), basis);
      const auto channel_count = static_cast<std::size_t>(channels);
      for (std::size_t c = 0; c < channel_count; ++c)
        for (int l = 0; l < traced_bands; ++l) {
          const auto open = static_cast<float>(lighting::cosine_coefficient(l) / kPi);
          for (int m = -l; m <= l; ++m) {
            const auto n = static_cast<std::size_t>(sh_index(l, m));
            const std::size_t at = (p * channel_count + c) * coefficients + n;
            reflected[at] = each * turned[(1 + c) * coefficients + n];
            now[at] = open * static_cast<float>(basis[n]) - each * turned[n] + reflected[at];
          }
        }
    }
  });
}

void LiveBake::Impl::write(BakedObject& out) const {
  const auto shaped = [&](Transfer& t, int bands, std::size_t points) {
    if (t.bands != bands || t.channels != channels || t.points != points)
      t = Transfer(bands, channels, points);
    t.values.make_own();  // before threads write into it
  };
  shaped(out.transfer, options.bands, vertices);
  shaped(out.reflected, traced_bands, vertices);
  shaped(out.ground_deficit, options.bands, texels);
  shaped(out.ground_reflected, traced_bands, texels);
  parallel_for(std::size_t{0}, size(), kChunk, [&](const auto& range) {
    for (std::size_t p = range.begin(); p < range.end(); ++p)
      for (int c = 0; c < channels; ++c) {
        const float* const t = transfer_at(p, c);
        const float* const r = &reflected[static_cast<std::size_t>(t - now.data())];
        const std::size_t texel = p - vertices;
        for (int n = 0; n < coefficient_count(options.bands); ++n)
          on_ground(p)
              ? out.ground_deficit.set(c, n, texel, open_ground[static_cast<std::size_t>(n)] - t[n])
              : out.transfer.set(c, n, p, t[n]);
        for (int n = 0; n < coefficient_count(traced_bands); ++n)
          on_ground(p) ? out.ground_reflected.set(c, n, texel, r[n])
                       : out.reflected.set(c, n, p, r[n]);
      }
  });
}

Result<LiveBake> LiveBake::create(const Character& character, const LiveBakeOptions& options) {
  if (options.bands < 1 || options.bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "bands",
                fmt::format("{} is not within 1..{}", options.bands, kMaxBands));
  if (options.receiver && (options.receiver->grid.size < 2 || options.receiver->grid.size > 4096 ||
                           !(options.receiver->grid.half_extent > 0)))
    return fail(ErrorCode::kInvalid, "receiver",
                "has a size that is not within 2..4096, or an extent that is not positive");
  Mesh form;
  deform(character, rest_pose(character), form);
  PENUMBRA_ASSIGN(scene, RayScene::build(form));
  return LiveBake(std::make_unique<Impl>(character, options, std::move(scene), form));
}

LiveBake::LiveBake(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
LiveBake::~LiveBake() = default;
LiveBake::LiveBake(LiveBake&&) noexcept = default;

std::size_t LiveBake::points() const {
  return impl_->size();
}

LiveBake::Cost LiveBake::update(const CharacterPose& pose, std::size_t visits, BakedObject& out) {
  using Clock = std::chrono::steady_clock;
  const auto seconds_since = [](Clock::time_point begin) {
    return std::chrono::duration<double>(Clock::now() - begin).count();
  };
  const auto begin = Clock::now();
  Cost cost;
  Impl& s = *impl_;
  s.move_to(pose);
  // In rounds, so that no point is visited by two threads and light goes on from one to the next.
  for (std::size_t left = visits; left > 0;) {
    const auto round_begin = Clock::now();
    const std::size_t round = std::min(left, s.size());
    parallel_for(std::size_t{0}, round, kChunk, [&](const auto& range) {
      thread_local Impl::VisitResult found;  // grows once per thread
      for (std::size_t i = range.begin(); i < range.end(); ++i) {
        const std::size_t p = (s.next + i) % s.size() * s.step % s.size();
        s.trace(p, found);
        s.remember(p, found);
      }
    });
    s.next = (s.next + round) % s.size();
    left -= round;
    if (left > 0) s.refresh();
    cost.rays_s += seconds_since(round_begin);
  }
  s.refresh();
  out.mesh = s.mesh;
  out.receiver = s.options.receiver;
  s.write(out);
  cost.fixed_s = seconds_since(begin) - cost.rays_s;
  return cost;
}

}  // namespace penumbra::prt
