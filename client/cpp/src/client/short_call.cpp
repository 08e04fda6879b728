// Short calls beside the stream.
#include <chrono>

#include "client/core.hpp"
#include "client/timeouts.hpp"

namespace motiongen {

ShortCall::ShortCall(ClientCore& core, double timeout_s) : core_(core) {
  const auto metadata = core.metadata_.make(core.route_.key());
  made = metadata.status();
  if (metadata) {
    for (const auto& [key, text] : metadata.value()) context.AddMetadata(key, text);
  }
  const auto timeout = std::chrono::duration<double>(bounded_s(timeout_s));
  context.set_deadline(std::chrono::system_clock::now() +
                       std::chrono::duration_cast<std::chrono::system_clock::duration>(timeout));
  const std::lock_guard<std::mutex> lock(core.mutex_);
  core.short_calls_.insert(&context);
  if (core.closing_) context.TryCancel();
}

ShortCall::~ShortCall() {
  const std::lock_guard<std::mutex> lock(core_.mutex_);
  core_.short_calls_.erase(&context);
}

}  // namespace motiongen
