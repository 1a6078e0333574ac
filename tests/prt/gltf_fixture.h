// What tests of the glTF reader share.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <string_view>
#include <vector>

#include "prt/geometry/gltf/gltf.h"
#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"
#include "tests/support/gltf_maker.h"
#include "tests/support/temp_folder.h"

namespace penumbra::prt {

class GltfFixture : public testing::Test {
 protected:
  static constexpr Rgb kPaper{.7f, .6f, .5f};

  /// Through memory, as the binary form.
  Import read(const test::GltfMaker& maker) const {
    auto out = gltf::import_bytes(maker.glb(), folder_.path() / "asset.glb", kPaper);
    EXPECT_TRUE(out) << (out ? "" : out.error().detail);
    return out ? std::move(*out) : Import{};
  }
  /// The error's reason, which is one line and of this code.
  std::string refused(const test::GltfMaker& maker, ErrorCode code) const {
    return refused(maker.glb(), code);
  }
  std::string refused(std::vector<unsigned char> bytes, ErrorCode code) const {
    const auto path = folder_.path() / "asset.glb";
    const auto out = gltf::import_bytes(std::move(bytes), path, kPaper);
    EXPECT_FALSE(out);
    if (out) return "";
    EXPECT_EQ(out.error().code, code) << out.error().detail;
    EXPECT_EQ(out.error().where, path.string());
    EXPECT_EQ(out.error().detail.find('\n'), std::string::npos);
    return out.error().detail;
  }
  static bool says(const Import& import, std::string_view part) {
    return std::ranges::any_of(import.left_out, [&](const std::string& line) {
      return line.find(part) != std::string::npos;
    });
  }
  static Image<Rgba8> picture(int width, int height, Rgba8 colour) {
    return Image<Rgba8>(width, height, colour);
  }

  test::TempFolder folder_;
};

}  // namespace penumbra::prt
