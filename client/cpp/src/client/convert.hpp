// Between the contract's messages and this library's types. Pure; the one place that knows both.
#pragma once

#include <memory>
#include <string>

#include "motiongen/client/clip.hpp"
#include "motiongen/client/types.hpp"
#include "motiongen/v1/service.pb.h"

namespace motiongen::convert {

// ---- to the server. Frames are those of the timeline; the book shifts them

// INVALID_ARGUMENT for a number that is not finite or a list of the wrong length.
Status check(const Target& target);
v1::Constraint constraint(std::uint32_t id, const Target& target);
// end_frame 0: until another takes over.
v1::PromptSpan span(std::uint32_t id, const Prompt& prompt, std::uint64_t start_frame, std::uint64_t end_frame);
// Without prompts and constraints.
v1::OpenSession open_session(const SessionOptions& options);

// ---- from the server

// A violation when a rig contradicts itself.
Result<std::shared_ptr<const Catalog>> catalog(const v1::GetCatalogResponse& message);
Opened opened(const v1::SessionOpened& message);
Reached reached(const v1::ConstraintReached& message);
Residual residual(const v1::ConstraintResidual& message);
Outcome outcome(const v1::EditOutcome& message);
// Why the server ended a session.
Status closed(const v1::SessionClosed& message);
double seconds(const google::protobuf::Duration& duration);
void set_seconds(double seconds, google::protobuf::Duration* duration);

}  // namespace motiongen::convert
