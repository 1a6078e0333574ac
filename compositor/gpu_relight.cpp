#include "compositor/internal/gpu_relight.h"

#include <fmt/format.h>

#include <algorithm>

namespace penumbra::compositor {

namespace {

// Two values a word, so two points an invocation; sixteen invocations take a block of kLanes points.
constexpr std::uint32_t kBlocksInGroup = 4, kWordsInBlock = 16;
static_assert(prt::TransferSequence::kLanes == 2 * kWordsInBlock);

constexpr const char* kRelight = R"(#version 310 es
layout(local_size_x = 64) in;
struct Term { uint offset; float r, g, b; };
layout(std430, binding = 0) readonly buffer Values { uint values[]; };
layout(std430, binding = 1) readonly buffer Terms { Term terms[]; };
layout(std430, binding = 2) readonly buffer Blocks { uvec4 blocks[]; };
layout(std430, binding = 3) writeonly buffer Sums { vec4 sums[]; };
void main() {
  uvec4 block = blocks[gl_WorkGroupID.x * 4u + gl_LocalInvocationID.x / 16u];
  uint word = block.z + gl_LocalInvocationID.x % 16u;
  vec3 first = vec3(0), second = vec3(0);
  for (uint k = block.x; k < block.y; ++k) {
    Term t = terms[k];
    int both = int(values[t.offset / 2u + word]);
    vec3 colour = vec3(t.r, t.g, t.b);
    first += float(bitfieldExtract(both, 0, 16)) * colour;
    second += float(bitfieldExtract(both, 16, 16)) * colour;
  }
  sums[2u * gl_GlobalInvocationID.x] = vec4(first, 0);
  sums[2u * gl_GlobalInvocationID.x + 1u] = vec4(second, 0);
}
)";

void fill(GLuint buffer, const void* data, std::size_t bytes, GLenum usage) {
  glBindBuffer(GL_SHADER_STORAGE_BUFFER, buffer);
  glBufferData(GL_SHADER_STORAGE_BUFFER, static_cast<GLsizeiptr>(bytes), data, usage);
}

// Of others: they are theirs to tell.
void forget_errors() {
  while (glGetError() != GL_NO_ERROR) {
  }
}

}  // namespace

Result<GpuRelight> GpuRelight::create(const prt::TransferSequence& sequence) {
  GLint largest = 0;
  glGetIntegerv(GL_MAX_SHADER_STORAGE_BLOCK_SIZE, &largest);
  const std::size_t bytes = sequence.values().size_bytes();
  if (bytes > static_cast<std::size_t>(std::max(largest, 0)))
    return fail(ErrorCode::kUnavailable, "GL",
                fmt::format("a clip of {} MB is more than its buffers of {} MB", bytes >> 20,
                            largest >> 20));
  auto program = make_compute_program(kRelight);
  if (!program) return std::unexpected(program.error());
  constexpr std::size_t kMaxPoints = 65535 / 2 * kBlocksInGroup * prt::TransferSequence::kLanes;
  if (sequence.points() > kMaxPoints)
    return fail(ErrorCode::kUnavailable, "GL", "a clip has more points than one dispatch takes");
  forget_errors();
  GpuRelight out(sequence, std::move(*program));
  fill(out.values_.get(), sequence.values().data(), bytes, GL_STATIC_DRAW);
  if (glGetError() != GL_NO_ERROR)
    return fail(ErrorCode::kUnavailable, "GL", "a clip does not fit into the device's memory");
  return out;
}

Result<void> GpuRelight::relight(double frame, const RadianceSh& light,
                                 std::span<const glm::mat3> turns, std::span<float> out) {
  sequence_->plan(frame, light, turns, plan_);
  todo_.clear();
  for (const prt::RelightPlan::RelightPart& part : plan_.parts)
    for (std::uint32_t i = 0; i < part.point_count; i += prt::TransferSequence::kLanes)
      todo_.push_back({part.first_term, part.first_term + part.term_count, i / 2, 0});
  todo_.resize((todo_.size() + kBlocksInGroup - 1) / kBlocksInGroup * kBlocksInGroup);
  if (plan_.terms.empty()) return std::ranges::fill(out, 0.f), Result<void>{};
  forget_errors();
  const std::size_t sums = todo_.size() * prt::TransferSequence::kLanes;
  fill(terms_.get(), plan_.terms.data(), plan_.terms.size() * sizeof(prt::RelightPlan::Term),
       GL_STREAM_DRAW);
  fill(blocks_.get(), todo_.data(), todo_.size() * sizeof(GpuBlock), GL_STREAM_DRAW);
  fill(sums_.get(), nullptr, sums * 4 * sizeof(float), GL_STREAM_READ);
  const GLuint buffers[] = {values_.get(), terms_.get(), blocks_.get(), sums_.get()};
  for (GLuint i = 0; i < 4; ++i) glBindBufferBase(GL_SHADER_STORAGE_BUFFER, i, buffers[i]);
  glUseProgram(program_.get());
  glDispatchCompute(static_cast<GLuint>(todo_.size() / kBlocksInGroup), 1, 1);
  glMemoryBarrier(GL_BUFFER_UPDATE_BARRIER_BIT);
  const auto* lit = static_cast<const float*>(
      glMapBufferRange(GL_SHADER_STORAGE_BUFFER, 0,
                       static_cast<GLsizeiptr>(sums * 4 * sizeof(float)), GL_MAP_READ_BIT));
  if (!lit) return fail(ErrorCode::kUnavailable, "GL", "relit transfer can't be read back");
  const std::span<const std::uint32_t> order = sequence_->order();
  const std::size_t stride = sequence_->stride();
  for (const prt::RelightPlan::RelightPart& part : plan_.parts) {
    for (std::uint32_t i = 0; i < part.point_count; ++i)
      for (std::size_t c = 0; c < 3; ++c)
        out[c * stride + order[part.first_point + i]] = lit[4 * i + c];
    lit += 4 * ((part.point_count + prt::TransferSequence::kLanes - 1) /
                prt::TransferSequence::kLanes * prt::TransferSequence::kLanes);
  }
  glUnmapBuffer(GL_SHADER_STORAGE_BUFFER);
  if (const GLenum error = glGetError(); error != GL_NO_ERROR)
    return fail(ErrorCode::kUnavailable, "GL",
                fmt::format("error 0x{:04x} while relighting", error));
  return {};
}

}  // namespace penumbra::compositor
