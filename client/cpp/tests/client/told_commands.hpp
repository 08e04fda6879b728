// What `told_events` is told: a line is a command, and some of its words are NAME=VALUE.
#pragma once

#include <string>

#include "motiongen/client/session.hpp"

namespace told {

// Do what a line says. False for one that nobody knows, or that the library refuses at once, which it prints.
bool obey(const std::string& line, motiongen::Session& session);

}  // namespace told
