// Calls beside the stream that last a moment.
#include <chrono>

#include "client/core.hpp"
#include "client/timeouts.hpp"

namespace motiongen {

ShortCall::ShortCall(ClientCore& core, double timeout_s) : core_(core) {
  const auto timeout = std::chrono::duration<double>(bounded_s(timeout_s));
  context.set_deadline(std::chrono::system_clock::now() +
                       std::chrono::duration_cast<std::chrono::system_clock::duration>(timeout));
  if (!core.options_.token.empty()) context.AddMetadata("authorization", "Bearer " + core.options_.token);
  context.AddMetadata("x-motiongen-key", core.route_.key());
  const std::lock_guard<std::mutex> lock(core.mutex_);
  core.short_calls_.insert(&context);
  if (core.closing_) context.TryCancel();
}

ShortCall::~ShortCall() {
  const std::lock_guard<std::mutex> lock(core_.mutex_);
  core_.short_calls_.erase(&context);
}

}  // namespace motiongen
