// Validation of a load.
#include <string>

#include "client/address.hpp"
#include "client/texts.hpp"
#include "player.hpp"

namespace motiongen::load {
namespace {

std::string find_fault_of_edits(const Load& load) {
  const int edits = load.edit_at_s_size();
  if (load.edit_character_size() != edits || load.edit_rule_size() != edits || load.edit_value_size() != edits) {
    return "its columns of edits have different lengths";
  }
  for (int edit = 0; edit < edits; ++edit) {
    const std::string which = "edit " + std::to_string(edit);
    if (load.edit_character(edit) >= static_cast<std::uint32_t>(load.characters_size())) {
      return which + " is of character " + std::to_string(load.edit_character(edit)) + ", which is not there";
    }
    const auto& character = load.characters(static_cast<int>(load.edit_character(edit)));
    const Group& group = load.groups(static_cast<int>(character.group()));
    if (load.edit_rule(edit) >= static_cast<std::uint32_t>(group.rules_size())) {
      return which + " is by rule " + std::to_string(load.edit_rule(edit)) + ", which its group does not have";
    }
    const Rule& rule = group.rules(static_cast<int>(load.edit_rule(edit)));
    if (rule.kind() == "prompt" && load.edit_value(edit) >= static_cast<std::uint32_t>(group.prompts_size())) {
      return which + " is prompt " + std::to_string(load.edit_value(edit)) + ", which its group does not have";
    }
  }
  return "";
}

}  // namespace

std::string find_fault(const Load& load) {
  if (load.num_processes() == 0 || load.process() >= load.num_processes() || load.num_streams() == 0) {
    return "it is for process " + std::to_string(load.process()) + " of " + std::to_string(load.num_processes()) +
           " with " + std::to_string(load.num_streams()) + " streams";
  }
  if (load.frame_rate() == 0 || load.jitter_s_size() == 0 || load.max_request_bytes() == 0 || !(load.report_hz() > 0) ||
      !(load.end_s() > 0 && load.end_s() < 1e6)) {
    return "frame_rate, jitter_s, max_request_bytes, report_hz and end_s must be above 0, end_s below 1e6";
  }
  const Status token = check_token(load.access().token());
  if (!token) return token.message();
  if (!load.access().tls() && !load.access().token().empty()) {
    const Status plain = check_plain_token({load.address()});
    if (!plain) return plain.message();
  }
  for (const Group& group : load.groups()) {
    for (const Rule& rule : group.rules()) {
      if (rule.kind() != "prompt" && rule.kind() != "constraints" && rule.kind() != "velocity") {
        return "a rule is of kind " + rule.kind() + "; known are prompt, constraints, velocity";
      }
    }
  }
  for (int number = 0; number < load.characters_size(); ++number) {
    const Character& character = load.characters(number);
    if (character.group() >= static_cast<std::uint32_t>(load.groups_size()) ||
        character.prompt() >=
            static_cast<std::uint32_t>(load.groups(static_cast<int>(character.group())).prompts_size())) {
      return "character " + std::to_string(number) + " has a group or a prompt that is not there";
    }
  }
  return find_fault_of_edits(load);
}

}  // namespace motiongen::load
