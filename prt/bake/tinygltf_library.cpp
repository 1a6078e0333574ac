#define TINYGLTF_IMPLEMENTATION
#include "prt/bake/internal/tinygltf.h"
