// Bakes a mesh: its transfer, as glTF. Links penumbra::prt.
#include <penumbra/prt/prt.h>

#include <cstdio>

int main(int argc, char** argv) {
  using namespace penumbra;
  if (argc != 3) return std::fprintf(stderr, "usage: bake MESH OUT.glb\n"), 2;
  const auto mesh = prt::import_mesh(argv[1], {.7f, .7f, .7f});
  if (!mesh) return std::fprintf(stderr, "%s\n", mesh.error().detail.c_str()), 1;
  prt::BakeOptions options;
  options.rays = 256;  // a vertex
  const auto baked = prt::bake(mesh->mesh, options);
  if (!baked) return std::fprintf(stderr, "%s\n", baked.error().detail.c_str()), 1;
  if (const auto written = prt::write_baked(argv[2], *baked); !written)
    return std::fprintf(stderr, "%s\n", written.error().detail.c_str()), 1;
  std::printf("%zu vertices, %d coefficients each\n", baked->transfer.points,
              baked->transfer.bands * baked->transfer.bands);
}
