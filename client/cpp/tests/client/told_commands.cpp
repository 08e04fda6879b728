#include "told_commands.hpp"

#include <cstdio>
#include <cstdlib>
#include <map>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace told {
namespace {

using motiongen::EditId;
using motiongen::Result;
using motiongen::Session;
using motiongen::Status;
using motiongen::Target;

// The words of a line: the plain ones in order, and the named ones.
struct Words {
  std::vector<std::string> plain;
  std::map<std::string, std::string> named;

  explicit Words(const std::string& line) {
    std::istringstream in(line);
    for (std::string word; in >> word;) {
      const auto equals = word.find('=');
      if (equals == std::string::npos) {
        plain.push_back(word);
      } else {
        named[word.substr(0, equals)] = word.substr(equals + 1);
      }
    }
  }

  bool has(const std::string& name) const { return named.count(name) != 0; }
  double number(std::size_t place) const {
    return place < plain.size() ? std::strtod(plain[place].c_str(), nullptr) : 0;
  }
  float real(const std::string& name) const {
    const auto found = named.find(name);
    return found == named.end() ? 0 : std::strtof(found->second.c_str(), nullptr);
  }
  std::uint64_t whole(const std::string& name) const {
    const auto found = named.find(name);
    return found == named.end() ? 0 : std::strtoull(found->second.c_str(), nullptr, 10);
  }
  std::optional<float> optional(const std::string& name) const {
    return has(name) ? std::optional<float>(real(name)) : std::nullopt;
  }
  std::vector<float> reals(const std::string& name) const {
    std::vector<float> values;
    if (!has(name)) return values;
    std::istringstream in(named.at(name));
    for (std::string each; std::getline(in, each, ',');) values.push_back(std::strtof(each.c_str(), nullptr));
    return values;
  }
};

motiongen::TargetForm form_of(const Words& words) {
  const std::string& form = words.plain[1];
  const std::uint64_t frame = words.whole("frame");
  const std::vector<float> positions = words.reals("positions");
  std::vector<std::uint32_t> joints;
  for (const float joint : words.reals("joints")) joints.push_back(static_cast<std::uint32_t>(joint));
  if (form == "trajectory") return motiongen::RootTrajectory{frame, positions, words.reals("headings"), {}};
  if (form == "keyframe") return motiongen::Keyframe{frame, positions, {}};
  if (form == "joints") return motiongen::JointTargets{frame, joints, positions, words.reals("rotations"), {}};
  if (form == "heading") return motiongen::HeadingTarget{frame, words.real("heading"), {}};
  if (form == "rotations") return motiongen::JointRotations{frame, joints, words.reals("rotations"), {}};
  if (form == "path") return motiongen::RootPath{positions, words.optional("speed"), words.optional("smoothing"), {}};
  if (form == "foot") {
    const std::string limb = words.has("limb") ? words.named.at("limb") : "";
    return motiongen::FootContact{frame, limb, words.real("x"), words.real("z"), words.optional("heading"), {}};
  }
  return motiongen::Waypoint{frame, words.real("x"), words.real("z"), words.optional("heading"), {}};
}

Target target_of(const Words& words) {
  Target target = form_of(words);
  std::visit([&](auto& form) { form.tolerance = {words.optional("metres"), words.optional("radians")}; }, target.form);
  if (words.has("last")) target.last_frame = words.whole("last");
  target.at_any_frame = words.has("any");
  target.frames_from_effect = words.has("effect");
  target.relative_to_character = words.has("relative");
  target.weight = words.optional("weight");
  return target;
}

motiongen::OptionsChange change_of(const Words& words) {
  motiongen::OptionsChange change;
  if (words.has("priority")) change.priority = static_cast<motiongen::Priority>(words.whole("priority"));
  if (words.has("steps")) change.denoise_steps = static_cast<std::uint32_t>(words.whole("steps"));
  if (words.has("lookahead")) change.lookahead_frames = static_cast<std::uint32_t>(words.whole("lookahead"));
  if (words.has("history")) change.history_frames = static_cast<std::uint32_t>(words.whole("history"));
  if (words.has("guidance")) change.guidance.emplace(words.optional("guidance"), std::nullopt);
  return change;
}

// The rest of a line after its first words.
std::string rest(const std::string& line, std::size_t words) {
  std::istringstream in(line);
  std::string text;
  for (std::size_t word = 0; word < words; ++word) in >> text;
  std::getline(in >> std::ws, text);
  return text;
}

void say(const char* what, std::uint64_t frame, const Status& status) {
  std::printf("%s %llu %s\n", what, static_cast<unsigned long long>(frame), status ? "OK" : status.reason().c_str());
}

void say_held(const Session& session) {
  std::vector<float> row(session.rig().row_width);
  const std::uint64_t end = session.buffered_to();
  std::uint64_t first = session.playhead();
  while (first > 0 && session.copy_frame(first - 1, row)) --first;
  std::printf("held %llu", static_cast<unsigned long long>(first));
  for (std::uint64_t frame = first; frame < end && session.copy_frame(frame, row); ++frame) {
    std::printf(" %.4f", static_cast<double>(row[2]));
  }
  std::printf("\n");
}

void say_row(const Session& session, std::uint64_t frame, std::size_t width) {
  std::vector<float> row(session.rig().row_width);
  const Status status = session.copy_frame(frame, row);
  std::printf("%s %llu", width == 3 ? "x" : "row", static_cast<unsigned long long>(frame));
  for (std::size_t column = 0; status && column < std::min<std::size_t>(width, row.size()); ++column) {
    std::printf(" %.4f", static_cast<double>(row[column]));
  }
  std::printf("%s\n", status ? "" : (" " + status.reason()).c_str());
}

// The commands that read what has arrived.
bool look(const std::string& name, const Words& words, Session& session) {
  const auto frame = static_cast<std::uint64_t>(words.number(1));
  if (name == "wait") {
    say("frame", frame, session.wait_frame(frame, 60));
  } else if (name == "to") {
    say("at", frame, session.advance_to(frame));
  } else if (name == "x") {
    say_row(session, frame, 3);
  } else if (name == "row") {
    say_row(session, frame, session.rig().row_width);
  } else if (name == "held") {
    say_held(session);
  } else if (name == "stats") {
    const motiongen::SessionStats stats = session.stats();
    std::printf("stats %u %u %u %u\n", stats.plans, stats.underruns, stats.late_plans, stats.recoveries);
  } else {
    return false;
  }
  return true;
}

std::optional<Result<EditId>> tell(const std::string& name, const Words& words, const std::string& line,
                                   Session& session) {
  const auto id = static_cast<std::uint32_t>(words.number(1));
  const auto first = static_cast<float>(words.number(1));
  const auto second = static_cast<float>(words.number(2));
  if (name == "prompt") return session.set_prompt(rest(line, 1));
  if (name == "preset") return session.set_prompt(motiongen::Prompt::preset(words.plain.at(1)));
  if (name == "schedule") {  // FROM TO TEXT
    const auto to = static_cast<std::uint64_t>(words.number(2));
    return session.schedule_prompt(rest(line, 3), static_cast<std::uint64_t>(words.number(1)), to);
  }
  if (name == "replace_prompt") {  // ID FROM TO TEXT
    const auto from = static_cast<std::uint64_t>(words.number(2));
    return session.replace_prompt(id, rest(line, 4), from, static_cast<std::uint64_t>(words.number(3)));
  }
  if (name == "remove_prompt") return session.remove_prompt(id);
  if (name == "waypoint") {  // FRAME X Z
    const auto frame = static_cast<std::uint64_t>(words.number(1));
    const Target target = motiongen::Waypoint{frame, second, static_cast<float>(words.number(3)), {}, {}};
    return session.add_targets({&target, 1});
  }
  if (name == "target") {
    const Target target = target_of(words);
    return session.add_targets({&target, 1});
  }
  if (name == "replace_target")
    return session.replace_target(static_cast<std::uint32_t>(words.whole("id")), target_of(words));
  if (name == "remove_target") return session.remove_targets({&id, 1});
  if (name == "clear_targets") return session.set_targets({});
  if (name == "go") return session.go_to(first, second, words.optional("heading"), words.has("relative"));
  if (name == "velocity") {
    const double seconds = words.has("seconds") ? static_cast<double>(words.real("seconds")) : 1;
    return session.set_velocity(first, second, seconds, words.optional("heading"), words.has("keep_prompt"));
  }
  if (name == "teleport") return session.teleport(first, second, words.real("heading"));
  if (name == "seek") return session.seek(static_cast<std::uint64_t>(words.number(1)));
  if (name == "options") return session.set_options(change_of(words));
  if (name == "pause") return session.pause();
  if (name == "resume") return session.resume();
  return std::nullopt;
}

}  // namespace

bool obey(const std::string& line, Session& session) {
  const Words words(line);
  if (words.plain.empty()) return false;
  const std::string& name = words.plain[0];
  if (name == "close") return session.close().ok();
  const auto sent = tell(name, words, line, session);
  const bool known = sent || look(name, words, session);
  if (sent && !*sent) std::printf("refused %s\n", sent->status().message().c_str());
  std::fflush(stdout);
  return known;
}

}  // namespace told
