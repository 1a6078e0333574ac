#include "prt/clip/internal/frame_bake.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/rotation.h"
#include "prt/geometry/ground_grid.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtx/quaternion.hpp>
#include <numeric>

#include "core/half.h"
#include "core/io/hash.h"
#include "core/threads/parallel.h"
#include "prt/bake/bake_rules.h"
#include "prt/rays/ray_pattern.h"

namespace penumbra::prt {

namespace {

constexpr int kMaxFrames = 4096;
constexpr std::uint64_t kBakeVersion = 4;  // changes with what a bake computes
constexpr float kOpenT0 = .28209479f;      // Y_0: of a point that sees all
constexpr std::uint16_t kHidden = 0x7e00;  // a half that is no number

void add_clip(Fnv1a& h, const Clip& clip) {
  const auto add_track = [&](const auto& track) {
    h.add(track.size());
    for (const auto& key : track) h.add(key.seconds).add(key.value);
  };
  h.add(clip.seconds);
  for (const Clip::NodeTracks& t : clip.nodes) {
    h.add(t.node);
    add_track(t.translation);
    add_track(t.rotation);
    add_track(t.scale);
  }
  for (const Clip::MorphTrack& t : clip.morphs) {
    h.add(t.target);
    add_track(t.weight);
  }
}

}  // namespace

std::uint64_t fingerprint(const Character& c, int clip) {
  Fnv1a h;
  h.add(c.positions).add(c.normals).add(c.albedo).add(c.triangles);
  h.add(c.texture_coordinates).add(c.light_coordinates);
  for (const Character::Influence& f : c.influences) h.add(f.bone).add(f.weight);
  for (const Character::Node& n : c.nodes)
    h.add(n.parent).add(n.rest.translation).add(n.rest.rotation).add(n.rest.scale);
  for (const Character::Bone& b : c.bones) h.add(b.node).add(b.bone_from_rest);
  for (const Character::MorphTarget& t : c.morph_targets)
    h.add(t.rest_weight).add(t.first).add(t.positions).add(t.normals);
  add_clip(h, c.clips[static_cast<std::size_t>(clip)]);
  return h.value();
}

bool has_light_coordinates(const Character& c) {
  return light_coordinates_of(c).size() == c.positions.size();
}

Result<FrameBaker> FrameBaker::create(const Character& c, int clip, const SequenceOptions& o) {
  if (clip < 0 || clip >= static_cast<int>(c.clips.size()))
    return fail(ErrorCode::kInvalid, "animation", fmt::format("there is no clip {}", clip));
  if (c.triangles.empty()) return fail(ErrorCode::kInvalid, "character", "has no triangles");
  if (!(o.frames_per_second > 0 && o.frames_per_second <= 1000))
    return fail(ErrorCode::kInvalid, "frames per second", "are not above 0 and at most 1000");
  const double seconds = c.clips[static_cast<std::size_t>(clip)].seconds;
  if (!(seconds * o.frames_per_second <= kMaxFrames))
    return fail(ErrorCode::kInvalid, "animation",
                fmt::format("has {:.1f} s, which at {} frames a second are more than {} frames",
                            seconds, o.frames_per_second, kMaxFrames));
  if (o.bands < 1 || o.bands > kMaxBands)
    return fail(ErrorCode::kInvalid, "bands",
                fmt::format("{} is not within 1..{}", o.bands, kMaxBands));
  if (o.map_width < 0 || o.map_width > 4096 || o.map_height < 0 || o.map_height > 4096 ||
      (o.map_width == 0) != (o.map_height == 0))
    return fail(ErrorCode::kInvalid, "light map", "has sides that are not within 1..4096 texels");
  if (o.map_width > 0 && !has_light_coordinates(c))
    return fail(ErrorCode::kInvalid, "light map",
                "needs texture coordinates, which the asset does not have");
  if (o.rays < 64 || o.rays % 64 != 0 || o.ground_rays < 64 || o.ground_rays % 64 != 0)
    return fail(ErrorCode::kInvalid, "rays", "are not a positive multiple of 64");
  if (o.bounces < 0 || o.bounces > kMaxBounces)
    return fail(ErrorCode::kInvalid, "bounces",
                fmt::format("{} is not within 0..{}", o.bounces, kMaxBounces));
  const auto is_albedo = [](const Rgb& a) {
    return a.r >= 0 && a.r <= 1 && a.g >= 0 && a.g <= 1 && a.b >= 0 && a.b <= 1;
  };
  if (!is_albedo(o.ground_albedo) || !std::ranges::all_of(c.albedo, is_albedo))
    return fail(ErrorCode::kInvalid, "albedo", "is not within 0..1");
  if (o.ground_size && (*o.ground_size < 2 || *o.ground_size > 4096))
    return fail(ErrorCode::kInvalid, "receiver", "has a size that is not within 2..4096");
  if (!(o.error > 0 && o.error < 1))
    return fail(ErrorCode::kInvalid, "error", "is not above 0 and below 1");
  if (!(o.interpolation_error >= 0 && o.interpolation_error < 1))
    return fail(ErrorCode::kInvalid, "interpolation error", "is not at least 0 and below 1");
  return FrameBaker(c, clip, o);
}

FrameBaker::FrameBaker(const Character& character, int clip, const SequenceOptions& options)
    : character_(character),
      clip_(clip),
      options_(options),
      layout_(lay_out(character, options.map_width, options.map_height)),
      seams_(character, layout_),
      frames_(std::max(
          1, static_cast<int>(std::lround(character.clips[static_cast<std::size_t>(clip)].seconds *
                                          options.frames_per_second)))),
      reflected_bands_(options.bounces == 0 ? 1 : reflected_bands(options.bands)) {
  if (options.ground_size) find_receiver();
  link_points();
}

bool FrameBaker::moves() const {
  return character_.clips[static_cast<std::size_t>(clip_)].seconds > 0;
}

double FrameBaker::seconds_at(int position) const {
  return character_.clips[static_cast<std::size_t>(clip_)].seconds * position / positions();
}

// One grid for all frames, on the plane y = 0 of the character's frame.
void FrameBaker::find_receiver() {
  Mesh all, mesh;
  for (int p = 0; p < positions(); p += kMaxParts) {
    deform(character_,
           sample(character_, character_.clips[static_cast<std::size_t>(clip_)], seconds_at(p)),
           mesh);
    const Bounds b = bounds_of(mesh);
    all.positions.insert(all.positions.end(), {b.low, b.high});
  }
  receiver_ = Receiver{fit_ground_grid(all, 0, *options_.ground_size), options_.ground_albedo};
}

int FrameBaker::channels() const {
  const bool all_grey =
      std::ranges::all_of(character_.albedo, is_grey) && (!receiver_ || is_grey(receiver_->albedo));
  return options_.bounces > 0 && !all_grey ? 3 : 1;
}

JournalKey FrameBaker::key() const {
  const SequenceOptions& o = options_;
  Fnv1a h;
  h.add(kBakeVersion).add(fingerprint(character_, clip_)).add(character_.frame);
  h.add(o.frames_per_second);
  for (const int n : {o.bands, o.bounces, o.rays, o.ground_rays, o.map_width, o.map_height,
                      o.ground_size.value_or(0), int{o.denoise}})
    h.add(n);
  h.add(o.ground_albedo);
  return {h.value(), static_cast<std::uint32_t>(positions()), offset(kStreams)};
}

Transfer FrameBaker::shape(Stream stream) const {
  const bool ground = stream == kGround || stream == kGroundReflected;
  const bool reflected = stream == kSurfaceReflected || stream == kGroundReflected;
  const auto side = static_cast<std::size_t>(receiver_ ? receiver_->grid.size : 0);
  return {reflected ? reflected_bands_ : options_.bands, channels(),
          ground ? side * side : layout_.points()};
}

std::size_t FrameBaker::offset(Stream stream) const {
  std::size_t sum = 0;
  for (int s = 0; s < stream; ++s) sum += shape(static_cast<Stream>(s)).values.size();
  return sum;
}

// Vertices along edges; texels beside each other that lie beside each other on the surface too.
void FrameBaker::link_points() {
  std::vector<std::array<std::uint32_t, 2>> pairs;
  for (const auto& t : character_.triangles)
    for (std::size_t k = 0; k < 3; ++k) pairs.push_back({t[k], t[(k + 1) % 3]});
  Mesh rest;
  deform(character_, rest_pose(character_), rest);
  const Bounds bounds = bounds_of(rest);
  add_texels(character_, layout_, rest);
  // Texels of one chart are about so far apart.
  const float spacing = 3 * glm::length(bounds.high - bounds.low) /
                        std::sqrt(static_cast<float>(layout_.texels.size()) + 1);
  std::vector<std::uint32_t> at(
      static_cast<std::size_t>(layout_.width) * static_cast<std::size_t>(layout_.height),
      SurfaceLayout::kNone);
  const auto slot = [&](int x, int y) {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(layout_.width) +
           static_cast<std::size_t>(x);
  };
  for (std::size_t i = 0; i < layout_.texels.size(); ++i) {
    const SurfaceLayout::Texel& texel = layout_.texels[i];
    const auto point = static_cast<std::uint32_t>(layout_.vertices + i);
    at[slot(texel.x, texel.y)] = point;
    for (const auto& [dx, dy] : {std::pair{1, 0}, {0, 1}}) {
      if (texel.x < dx || texel.y < dy) continue;
      const std::uint32_t other = at[slot(texel.x - dx, texel.y - dy)];
      if (other == SurfaceLayout::kNone ||
          glm::distance(rest.positions[point], rest.positions[other]) > spacing ||
          glm::dot(rest.normals[point], rest.normals[other]) < .5f)
        continue;
      pairs.push_back({point, other});
    }
  }
  const std::size_t half = pairs.size();
  for (std::size_t i = 0; i < half; ++i) pairs.push_back({pairs[i][1], pairs[i][0]});
  std::ranges::sort(pairs);
  const auto same = std::ranges::unique(pairs);
  pairs.erase(same.begin(), same.end());
  link_begin_.assign(layout_.points() + 1, 0);
  for (const auto& [a, b] : pairs) {
    ++link_begin_[a + 1];
    links_.push_back(b);
  }
  std::partial_sum(link_begin_.begin(), link_begin_.end(), link_begin_.begin());
}

namespace {

std::vector<float> floats_of(const Transfer& t) {
  std::vector<float> out(t.values.size());
  std::ranges::transform(t.values, out.begin(), float_from_half);
  return out;
}

}  // namespace

// What lies within another part is never seen, and what it would see there means nothing.
void FrameBaker::mark_hidden(const BakeReport& report, Transfer& transfer) const {
  for (std::size_t p = 0; p < layout_.points(); ++p)
    if (report.quality[p].behind > kHiddenFraction)
      for (std::size_t k = p; k < transfer.values.size(); k += transfer.stride)
        transfer.values[k] = kHidden;
}

// Lookups beside a point that is hidden for a while still touch it: it goes straight from what it
// was before to what it will be, and if it never shows it continues what is around it.
void FrameBaker::complete_hidden(std::span<Transfer> frames, const KeyFrames& keys) const {
  for (Transfer& t : frames) t.values.make_own();
  parallel_for(std::size_t{0}, layout_.points(), 64, [&](const auto& range) {
    for (std::size_t p = range.begin(); p < range.end(); ++p) complete_in_time(p, frames, keys);
  });
  std::vector<std::uint32_t> left;
  for (std::uint32_t p = 0; p < layout_.points(); ++p)
    if (frames[0].values[p] == kHidden) left.push_back(p);
  while (!left.empty()) {
    std::vector<std::uint32_t> still;
    // a point and one that it takes after
    std::vector<std::pair<std::uint32_t, std::uint32_t>> known;
    for (const std::uint32_t p : left) {
      const auto from = std::ranges::find_if(
          links_.begin() + link_begin_[p], links_.begin() + link_begin_[p + 1], [&](auto q) {
            return frames[0].values[q] != kHidden && layout_.bone[q] == layout_.bone[p];
          });
      if (from == links_.begin() + link_begin_[p + 1]) {
        still.push_back(p);
      } else {
        known.emplace_back(p, *from);
      }
    }
    for (Transfer& t : frames) {
      for (std::size_t k = 0; k < t.values.size(); k += t.stride) {
        for (const auto& [p, q] : known) t.values[k + p] = t.values[k + q];
        if (known.empty())
          for (const std::uint32_t p : still) t.values[k + p] = 0;
      }
    }
    if (known.empty()) return;
    left = std::move(still);
  }
}

void FrameBaker::complete_in_time(std::size_t p, std::span<Transfer> frames,
                                  const KeyFrames& keys) const {
  const std::size_t count = frames.size();
  const auto hidden = [&](std::size_t f) { return frames[f % count].values[p] == kHidden; };
  const auto parts = [&](std::size_t from, std::size_t to) {
    float sum = 0;
    for (std::size_t f = from; f < to; ++f) sum += static_cast<float>(keys.width(f % count));
    return sum;
  };
  std::size_t first = 0;
  while (first < count && hidden(first)) ++first;
  if (first == count) return;
  for (std::size_t f = first; f < first + count;) {
    std::size_t next = f + 1;
    while (hidden(next)) ++next;
    for (std::size_t between = f + 1; between < next; ++between) {
      const float fraction = parts(f, between) / parts(f, next);
      for (std::size_t k = p; k < frames[0].values.size(); k += frames[0].stride)
        frames[between % count].values[k] =
            half_from_float(std::lerp(float_from_half(frames[f % count].values[k]),
                                      float_from_half(frames[next % count].values[k]), fraction));
    }
    f = next;
  }
}

// A joint bilateral step on what is blocked (the open part is exact). Neighbours count as far as
// their t_0 differs by no more than their noise explains, so where there is none nothing changes.
// Texels alone: vertices lie too far apart to tell noise from form (64 rays a point: texels' error
// falls by a fifth, that of vertices by a twentieth or grows).
// source: a-trous weights of Dammertz et al. 2010 with the variance of Schied et al. 2017
void FrameBaker::denoise(const BakeReport& report, const Mesh& mesh, Transfer& transfer) const {
  constexpr float kSigmas = .7f, kNormalPower = 256;
  const int count = coefficient_count(transfer.bands);
  const std::vector<float> before = floats_of(transfer);
  transfer.values.make_own();
  std::vector<float> open(layout_.points() * static_cast<std::size_t>(count));
  parallel_for(std::size_t{0}, layout_.points(), 256, [&](const auto& range) {
    double basis[kMaxCoefficients];
    for (std::size_t p = range.begin(); p < range.end(); ++p) {
      lighting::evaluate_basis(transfer.bands, glm::normalize(glm::dvec3(mesh.normals[p])), basis);
      for (int l = 0; l < transfer.bands; ++l)
        for (int m = -l; m <= l; ++m)
          open[p * static_cast<std::size_t>(count) + static_cast<std::size_t>(sh_index(l, m))] =
              static_cast<float>(lighting::cosine_coefficient(l) / kPi * basis[sh_index(l, m)]);
    }
  });
  parallel_for(layout_.vertices, layout_.points(), 256, [&](const auto& range) {
    std::vector<float> weights;
    for (std::size_t p = range.begin(); p < range.end(); ++p) {
      const auto variance_of = [&](std::size_t q) {
        const float s = report.quality[q].standard_error * kOpenT0;
        return s * s;
      };
      const float own = variance_of(p);
      if (!(own > 0)) continue;
      weights.clear();
      float all = 1;
      for (std::uint32_t i = link_begin_[p]; i < link_begin_[p + 1]; ++i) {
        const std::uint32_t q = links_[i];
        const float difference = before[p] - before[q];
        const float cosine = std::max(0.f, glm::dot(mesh.normals[p], mesh.normals[q]));
        weights.push_back(
            std::exp(-difference * difference / (2 * kSigmas * kSigmas * (own + variance_of(q)))) *
            std::pow(cosine, kNormalPower));
        all += weights.back();
      }
      for (std::size_t k = 0; k < before.size(); k += transfer.stride) {
        const std::size_t n = k / transfer.stride % static_cast<std::size_t>(count);
        const auto blocked = [&](std::size_t q) {
          return open[q * static_cast<std::size_t>(count) + n] - before[k + q];
        };
        float sum = blocked(p);
        for (std::size_t i = 0; i < weights.size(); ++i)
          sum += weights[i] * blocked(links_[link_begin_[p] + i]);
        transfer.values[k + p] =
            half_from_float(open[p * static_cast<std::size_t>(count) + n] - sum / all);
      }
    }
  });
}

// Before the materials' frames, which may differ across a seam. Points within others would pull it
// dark.
void FrameBaker::equalise_seams(const BakeReport& report, Transfer& transfer,
                                Transfer& reflected) const {
  if (seams_.empty()) return;
  std::vector<char> hidden(layout_.points());
  for (std::size_t p = 0; p < hidden.size(); ++p)
    hidden[p] = report.quality[p].behind > kHiddenFraction;
  std::vector<float> values = floats_of(transfer);
  const std::vector<float> more = floats_of(reflected);
  values.insert(values.end(), more.begin(), more.end());
  seams_.equalise(hidden, transfer.stride, values);
  const std::span<const float> done(values);
  std::ranges::transform(done.first(transfer.values.size()), transfer.values.begin(),
                         half_from_float);
  std::ranges::transform(done.subspan(transfer.values.size()), reflected.values.begin(),
                         half_from_float);
}

namespace {

// Into the frame of each point's bone.
void to_materials(const SurfaceLayout& layout, const std::vector<glm::mat3>& turns,
                  Transfer& transfer) {
  std::vector<lighting::ShRotation> rotations;
  for (const glm::mat3& turn : turns)
    rotations.emplace_back(glm::dmat3(glm::transpose(turn)), transfer.bands);
  transfer.values.make_own();
  parallel_for(std::size_t{0}, layout.points(), 256, [&](const auto& range) {
    TransferSh t(transfer.bands);
    for (std::size_t p = range.begin(); p < range.end(); ++p) {
      for (int c = 0; c < transfer.channels; ++c)
        for (int n = 0; n < t.size(); ++n) t[n][c] = transfer.value(c, n, p);
      const TransferSh turned = rotations[layout.bone[p]] * t;
      for (int c = 0; c < transfer.channels; ++c)
        for (int n = 0; n < t.size(); ++n) transfer.set(c, n, p, turned[n][c]);
    }
  });
}

}  // namespace

// The patterns at rest turned with the bones, and by no more than needed onto normals that skins or
// morphs turn further.
std::vector<glm::mat3> FrameBaker::ray_frames(const Mesh& mesh,
                                              const std::vector<glm::mat3>& bones) const {
  Mesh rest{character_.positions, character_.normals, character_.albedo, {}};
  add_texels(character_, layout_, rest);
  std::vector<glm::mat3> out;
  for (std::size_t p = 0; p < layout_.points(); ++p) {
    const glm::mat3& turn = bones[layout_.bone[p]];
    const glm::vec3 at_rest = glm::normalize(rest.normals[p]),
                    now = glm::normalize(glm::transpose(turn) * mesh.normals[p]);
    out.push_back(turn * glm::mat3_cast(glm::rotation(at_rest, now)) * frame_around(at_rest));
  }
  return out;
}

Result<FrameRecord> FrameBaker::bake(int position,
                                     const std::function<void(double)>& progress) const {
  const CharacterPose pose =
      sample(character_, character_.clips[static_cast<std::size_t>(clip_)], seconds_at(position));
  Mesh mesh;
  deform(character_, pose, mesh);
  add_texels(character_, layout_, mesh);
  const std::vector<glm::mat3> bones = bone_turns(character_, pose);
  const std::vector<glm::mat3> frames = ray_frames(mesh, bones);
  BakeOptions o;
  o.bands = options_.bands;
  o.bounces = options_.bounces;
  o.reflected_bands = reflected_bands_;
  o.rays = options_.rays;
  o.ground_rays = options_.ground_rays;
  o.receiver = receiver_;
  o.ray_frames = frames;
  o.progress = progress;
  PENUMBRA_ASSIGN(baked, prt::bake(std::move(mesh), o));
  // In one frame, where neighbours on different bones can be compared.
  if (options_.denoise && !layout_.texels.empty())
    denoise(baked.report, baked.mesh, baked.transfer);
  equalise_seams(baked.report, baked.transfer, baked.reflected);
  for (Transfer* t : {&baked.transfer, &baked.reflected}) {
    to_materials(layout_, bones, *t);
    mark_hidden(baked.report, *t);
  }
  FrameRecord out;
  out.frame = static_cast<std::uint32_t>(position);
  out.rays = baked.report.rays;
  out.seconds = baked.report.seconds;
  for (std::size_t p = 0; p < layout_.points(); ++p) {
    if (baked.report.quality[p].behind > kHiddenFraction) continue;
    ++out.seen;
    out.mean += baked.transfer.value(0, 0, p);
    out.error_variance += std::pow(double(baked.report.quality[p].standard_error) * kOpenT0, 2);
  }
  for (const Transfer* t :
       {&baked.transfer, &baked.reflected, &baked.ground_deficit, &baked.ground_reflected})
    out.values.insert(out.values.end(), t->values.begin(), t->values.end());
  out.values.resize(offset(kStreams));
  return out;
}

}  // namespace penumbra::prt
