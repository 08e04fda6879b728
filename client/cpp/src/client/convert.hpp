// Conversions between the contract's messages and this library's types. Pure; only this knows both.
#pragma once

#include <memory>
#include <string>

#include "motiongen/client/clip.hpp"
#include "motiongen/client/types.hpp"
#include "motiongen/v1/service.pb.h"

namespace motiongen::convert {

// ---- to the server. Frames are those of the timeline; the book shifts them

bool all_finite(Span<const float> values);
// INVALID_ARGUMENT for a number that is not finite, a list of the wrong length or a text that is not UTF-8.
Status check(const Target& target);
// INVALID_ARGUMENT if none or more than one of text, preset and vector is given, a text is not UTF-8, or a number is
// not finite.
Status check(const Prompt& prompt);
// The same for all prompts, targets, numbers and other texts of a session's options, but not its rows.
Status check(const SessionOptions& options);
// INVALID_ARGUMENT for a number that is not finite.
Status check(const OptionsChange& change);
// INVALID_ARGUMENT for a message bigger than the server accepts. what: its name, for people.
Status check_size(const char* what, const google::protobuf::MessageLite& message, const Limits& limits);
// INVALID_ARGUMENT unless `rows` is one whole row or several, of finite numbers.
Status check_rows(Span<const float> rows, std::uint32_t row_width);
v1::Constraint constraint(std::uint32_t id, const Target& target);
// end_frame 0: until another prompt takes over.
v1::PromptSpan span(std::uint32_t id, const Prompt& prompt, std::uint64_t start_frame, std::uint64_t end_frame);
// Without prompts, constraints and prior frames.
v1::OpenSession open_session(const SessionOptions& options);
// rows: whole rows of the rig; their outputs are not sent.
void set_rows(Span<const float> rows, const Rig& rig, v1::FrameChunk* frames);
v1::SetOptions set_options(const OptionsChange& change);

// ---- from the server. Of each text, and of all warnings together, only so much is kept; it says if there was more

// A violation if an answer has more placements than any request can ask for.
Status check_placements(int count);
// A violation if a rig contradicts itself.
Result<std::shared_ptr<const Catalog>> catalog(const v1::GetCatalogResponse& message);
// The model with an id, or the default model for an empty id, and its rig. nullptr if there is none.
const Model* find_model(const Catalog& catalog, const std::string& model_id);
const Rig* find_rig(const Catalog& catalog, const std::string& model_id);
// The rig of a session's frames, with the outputs it asked for. A violation if the server's do not match.
Result<Rig> session_rig(const Catalog& catalog, const v1::SessionOpened& message,
                        const std::vector<std::string>& outputs);
Opened opened(const v1::SessionOpened& message);
Reached reached(const v1::ConstraintReached& message);
Residual residual(const v1::ConstraintResidual& message);
std::vector<OtherServer> other_servers(const google::protobuf::RepeatedPtrField<v1::OtherServer>& messages);
Outcome outcome(const v1::EditOutcome& message);
// Why the server ended a session.
Status closed(const v1::SessionClosed& message);
double seconds(const google::protobuf::Duration& duration);
void set_seconds(double seconds, google::protobuf::Duration* duration);

}  // namespace motiongen::convert
