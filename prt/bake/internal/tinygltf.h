// tinygltf under a name of its own.
// threads: reentrant
//
// Assimp brings Debian's libdraco into every program, and libdraco exports an older tinygltf whose
// types have another layout: which of the two a program would call depends on the order of its
// libraries. So tinygltf_library.cpp compiles the header's code for this room alone. Pictures are
// left alone: gltf::read_materials decodes them.
#pragma once

#define tinygltf penumbra_tinygltf
#define TINYGLTF_NO_STB_IMAGE
#define TINYGLTF_NO_STB_IMAGE_WRITE
#define TINYGLTF_NO_EXTERNAL_IMAGE
#define TINYGLTF_NO_INCLUDE_JSON
#include <nlohmann/json.hpp>

#include <tiny_gltf.h>
