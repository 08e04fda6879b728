// The commands of `told_events`: one for each line; some of its words are NAME=VALUE.
#pragma once

#include <string>

#include "motiongen/client/session.hpp"

namespace told {

// Execute a line. False if the command is unknown, or refused by the library at once; the refusal is printed.
bool obey(const std::string& line, motiongen::Session& session);

}  // namespace told
