// Meshes as files that a scene can name.
#pragma once

#include <filesystem>
#include <fstream>

#include "prt/prt.h"

namespace penumbra::test {

inline void write_obj(const prt::Mesh& m, const std::filesystem::path& path) {
  std::ofstream out(path);
  for (const auto& p : m.positions) out << "v " << p.x << ' ' << p.y << ' ' << p.z << '\n';
  for (const auto& n : m.normals) out << "vn " << n.x << ' ' << n.y << ' ' << n.z << '\n';
  for (const auto& t : m.triangles) {
    out << 'f';
    for (const auto v : t) out << ' ' << v + 1 << "//" << v + 1;
    out << '\n';
  }
}

}  // namespace penumbra::test
