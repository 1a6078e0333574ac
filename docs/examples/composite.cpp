// Composites a recording or capture folder with a scene, frame by frame. Links penumbra::runtime.
#include <penumbra/capture/recording/recording.h>
#include <penumbra/codec/codec.h>
#include <penumbra/codec/display.h>
#include <penumbra/runtime/pipeline/pipeline.h>

#include <cstdio>

using namespace penumbra;

Result<void> composite(const char* capture, const char* scene_file, const char* picture_file) {
  PENUMBRA_ASSIGN(source, capture::open_capture(capture));
  PENUMBRA_ASSIGN(scene, runtime::read_scene(scene_file));
  PENUMBRA_ASSIGN(pipeline, Pipeline::create(source->cameras(), scene));
  runtime::Composited picture;
  while (true) {
    PENUMBRA_ASSIGN(frame, source->next());
    if (!frame) break;
    if (pipeline.shows_surroundings(frame->camera)) PENUMBRA_TRY(pipeline.add_environment(*frame));
    const auto role = source->cameras()[static_cast<std::size_t>(frame->camera)].role;
    if (!capture::sees_light(role)) PENUMBRA_TRY(pipeline.add_foreground(*frame));
    if (role != capture::Role::kView) continue;
    PENUMBRA_ASSIGN(composited, pipeline.composite(*frame));
    picture = std::move(composited);
  }
  std::printf("%zu distant lights\n", pipeline.light().lights.size());
  return codec::write_frame(picture_file, codec::to_display(picture.pixels));
}

int main(int argc, char** argv) {
  if (argc != 4) return std::fprintf(stderr, "usage: composite CAPTURE SCENE OUT.png\n"), 2;
  const auto done = composite(argv[1], argv[2], argv[3]);
  if (!done)
    std::fprintf(stderr, "%s: %s\n", done.error().where.c_str(), done.error().detail.c_str());
  return done ? 0 : 1;
}
