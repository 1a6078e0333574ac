// Writes the assets of gltf_assets.h into a folder, to be looked at: write_assets FOLDER
#include <cstdio>
#include <filesystem>
#include <string>

#include "tests/support/gltf_assets.h"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fputs("usage: write_assets FOLDER\n", stderr);
    return 2;
  }
  std::filesystem::create_directories(argv[1]);
  for (const penumbra::test::NamedAsset& asset : penumbra::test::kGltfAssets)
    asset.make().write_glb(std::filesystem::path(argv[1]) / (std::string(asset.name) + ".glb"));
}
