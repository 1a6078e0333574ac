#include "shadows/silhouette/light_rays.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <glm/gtx/quaternion.hpp>
#include <iterator>

#include "core/conventions.h"
#include "core/threads/background_task.h"
#include "lighting/lights/distant_light.h"

namespace penumbra::shadows {

namespace {
constexpr double kGoldenRatio = .6180339887498949;
}

double largest_angle(const lighting::DistantLight& source) {
  double largest = source.shape.empty() ? source.radius.value() : 0;
  for (const glm::dvec3& d : source.shape)
    largest = std::max(largest, std::acos(std::clamp(glm::dot(d, source.direction), -1., 1.)));
  return largest;
}

double rms_angle(const lighting::DistantLight& source) {
  if (source.shape.empty()) return source.radius.value() / std::sqrt(2.);
  double sum = 0;
  for (const glm::dvec3& d : source.shape)
    sum += std::pow(std::acos(std::clamp(glm::dot(d, source.direction), -1., 1.)), 2);
  return std::sqrt(sum / static_cast<double>(source.shape.size()));
}

bool is_wide(const lighting::DistantLight& source) {
  constexpr double kFrom = .05;  // radians
  return largest_angle(source) >= kFrom;
}

bool penumbra_exceeds_edges(const lighting::DistantLight& source,
                            const SilhouetteMesh& silhouette) {
  constexpr double kEdges = 1.75;
  return rms_angle(source) * silhouette.radius_m() >= kEdges * silhouette.mean_length_m();
}

DirectionCone cone_of(const lighting::DistantLight& source, double more) {
  return {source.direction, std::sin(std::min(largest_angle(source) + more, kPi / 2))};
}

bool may_occlude(const BoundingSphere& one, const BoundingSphere& from,
                 const lighting::DistantLight& source) {
  const glm::dvec3 apart = one.centre - from.centre;
  const double far = glm::length(apart), both = one.radius + from.radius;
  if (far <= both) return true;
  const double aside = std::acos(std::clamp(glm::dot(apart / far, source.direction), -1., 1.));
  return aside < std::asin(both / far) + largest_angle(source);
}

BoundingSphere sphere_of(const Caster& caster) {
  return {caster.world_from_mesh * glm::dvec3(caster.silhouette->bounds().centre()),
          double(caster.silhouette->radius_m())};
}

SilhouetteCache& cache_of(const ShadowCasters& casters) {
  if (casters.cache) return *casters.cache;
  thread_local SilhouetteCache empty;
  empty.clear();
  return empty;
}

void SamplePattern::make(const lighting::DistantLight& source, int samples, int turns) {
  assert(samples >= 1 && samples <= kMaxSamples && turns >= 1);
  samples_ = samples, turns_ = turns;
  repeated_.clear();
  directions_.clear();
  if (samples == 1 && turns == 1)
    directions_.emplace_back(source.direction);
  else if (source.shape.empty())
    spread_over_cap(source);
  else
    spread_over_shape(source);
}

void SamplePattern::keep_before(const prt::Plane& plane) {
  thread_local std::vector<glm::vec3> all, own;  // grow once per thread
  all.clear();
  std::ranges::copy_if(directions_, std::back_inserter(all),
                       [&](const glm::vec3& d) { return !behind(&plane, d); });
  if (all.empty() || all.size() == directions_.size()) return;
  repeated_.assign(directions_.size(), 0);
  const auto samples = static_cast<std::size_t>(samples_);
  for (std::size_t first = 0; first < directions_.size(); first += samples) {
    own.clear();
    const std::span turn = std::span(directions_).subspan(first, samples);
    std::ranges::copy_if(turn, std::back_inserter(own),
                         [&](const glm::vec3& d) { return !behind(&plane, d); });
    for (std::size_t k = 0, next = 0; k < samples; ++k) {
      if (!behind(&plane, turn[k])) continue;
      turn[k] = own.empty() ? all[(first + k) % all.size()] : own[next++ % own.size()];
      repeated_[first + k] = !own.empty();
    }
  }
}

int SamplePattern::count_before(std::size_t point, const glm::vec3& normal) const {
  const std::span<const glm::vec3> turn = at(point);
  const auto first = static_cast<std::size_t>(turn.data() - directions_.data());
  int out = 0;
  for (std::size_t k = 0; k < turn.size(); ++k)
    out += glm::dot(normal, turn[k]) > 0 && (repeated_.empty() || !repeated_[first + k]);
  return out;
}

// A Vogel spiral from the rim inwards, which has as many points in equal areas.
void SamplePattern::spread_over_cap(const lighting::DistantLight& source) {
  const glm::dmat3 frame = glm::mat3_cast(glm::rotation(glm::dvec3(0, 1, 0), source.direction));
  const double height = 2 * std::pow(std::sin(.5 * source.radius.value()), 2);
  for (int turn = 0; turn < turns_; ++turn)
    for (int k = samples_ - 1; k >= 0; --k) {
      const double c = 1 - height * (k + .5) / samples_, s = std::sqrt(1 - c * c);
      // The turns follow the golden ratio, so that neighbours differ most.
      constexpr double kGolden = 2.399963229728653;
      const double a = k * kGolden + 2 * kPi * std::fmod(turn * kGoldenRatio, 1.);
      directions_.emplace_back(frame * glm::dvec3(s * std::cos(a), c, s * std::sin(a)));
    }
}

// One point of each group of neighbours. Where one turn has to do its middle; else from turn to
// turn another one, on by the golden ratio and groups out of step, so that vertices beside each
// other together ask all of the shape. Steps of whole points instead leave a third more error.
void SamplePattern::spread_over_shape(const lighting::DistantLight& source) {
  constexpr double kOutOfStep = .7548776662466927;  // of the plane's golden ratio
  const std::size_t points = source.shape.size(), samples = static_cast<std::size_t>(samples_);
  const auto middle = [&](std::size_t k) {
    const std::size_t first = k * points / samples, last = (k + 1) * points / samples;
    glm::dvec3 sum = source.shape[first];
    for (std::size_t i = first + 1; i < last; ++i) sum += source.shape[i];
    return glm::normalize(sum);
  };
  const auto one_of = [&](std::size_t k, std::size_t turn) {
    const double within = std::fmod(.5 + double(turn) * kGoldenRatio + double(k) * kOutOfStep, 1.);
    const double place = (double(k) + within) / double(samples) * double(points);
    return source.shape[std::min(static_cast<std::size_t>(place), points - 1)];
  };
  for (std::size_t turn = 0; turn < static_cast<std::size_t>(turns_); ++turn)
    for (std::size_t k = 0; k < samples; ++k)
      directions_.emplace_back(turns_ == 1 || samples >= points ? middle(k) : one_of(k, turn));
}

}  // namespace penumbra::shadows
