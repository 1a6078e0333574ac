// What FFmpeg allocates, freed when it goes out of scope.
// threads: plain values
#pragma once

extern "C" {
#include <libavcodec/avcodec.h>
}

#include <memory>

namespace penumbra::tools {

template <auto Free>
struct Freed {
  template <class T>
  void operator()(T* p) const {
    Free(&p);
  }
};
using Codec = std::unique_ptr<AVCodecContext, Freed<avcodec_free_context>>;
using FramePointer = std::unique_ptr<AVFrame, Freed<av_frame_free>>;
using OwnedPacket = std::unique_ptr<AVPacket, Freed<av_packet_free>>;

}  // namespace penumbra::tools
