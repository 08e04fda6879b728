// One sample of a clip, assembled part by part.
#pragma once

#include <optional>

#include "motiongen/client/clip.hpp"
#include "motiongen/core/frame_format.hpp"
#include "motiongen/v1/service.pb.h"

namespace motiongen {

struct ClipSample {
  Clip clip;
  std::optional<FrameDecoder> decoder;  // holds a reference to the rig in `clip`
  bool is_whole = false;

  // A violation if a part is out of order or more arrives than was asked for.
  Status take(const v1::GenerateClipResponse& part, const Catalog& catalog, const ClipOptions& options);

 private:
  Status take_opened(const v1::SessionOpened& message, const Catalog& catalog, const ClipOptions& options);
  Status take_chunk(const v1::FrameChunk& chunk, const ClipOptions& options);
  Status take_summary(const v1::ClipSummary& summary, const ClipOptions& options);
};

}  // namespace motiongen
