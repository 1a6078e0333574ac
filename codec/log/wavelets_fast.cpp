// source: Taubman et al. 2019, "High Throughput JPEG 2000", and OpenJPH's interface
#include <openjph/ojph_arch.h>
#include <openjph/ojph_codestream.h>
#include <openjph/ojph_file.h>
#include <openjph/ojph_mem.h>
#include <openjph/ojph_params.h>

#include <algorithm>
#include <cstring>
#include <exception>

#include "codec/internal/wavelets.h"

namespace penumbra::codec {

namespace {

constexpr unsigned kLevels = 5, kBlockSide = 64;

void set_up(ojph::codestream& stream, const LightPlanes& planes, double coarseness) {
  ojph::param_siz size = stream.access_siz();
  size.set_image_extent(
      ojph::point(static_cast<unsigned>(planes.width), static_cast<unsigned>(planes.height)));
  size.set_num_components(kPlanes);
  for (unsigned c = 0; c < kPlanes; ++c)
    size.set_component(c, ojph::point(1, 1), kPlaneBits, false);
  ojph::param_cod coding = stream.access_cod();
  coding.set_num_decomposition(kLevels);
  coding.set_block_dims(kBlockSide, kBlockSide);
  coding.set_color_transform(false);
  coding.set_reversible(coarseness == 0);
  if (coarseness > 0) stream.access_qcd().set_irrev_quant(static_cast<float>(coarseness));
  stream.set_planar(false);
}

}  // namespace

Result<std::vector<unsigned char>> encode_fast_wavelets(const LightPlanes& planes,
                                                        double coarseness) {
  try {
    ojph::codestream stream;
    set_up(stream, planes, coarseness);
    ojph::mem_outfile out;
    out.open();
    stream.write_headers(&out);
    ojph::ui32 component = 0;
    const auto width = static_cast<std::size_t>(planes.width);
    ojph::line_buf* line = stream.exchange(nullptr, component);
    for (std::size_t row = 0; row < static_cast<std::size_t>(planes.height); ++row)
      for (int c = 0; c < kPlanes; ++c) {
        std::memcpy(line->i32, planes.codes[component].data() + row * width,
                    width * sizeof(std::int32_t));
        line = stream.exchange(line, component);
      }
    stream.flush();
    std::vector<unsigned char> bytes(out.get_data(), out.get_data() + out.tell());
    stream.close();
    return bytes;
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnwritable, "picture", std::string("OpenJPH: ") + e.what());
  }
}

}  // namespace penumbra::codec
