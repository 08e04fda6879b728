// Plays characters over a connection that is cut again and again, and prints each one's edits and shown frames:
//   cut_lines HOST:PORT CHARACTERS SEED FRAME_COLUMN PROMPT_COLUMN
// Prints "playing", then sets prompts of 1, 2, 3 ... letters one after another until a line of input arrives. Then
// prints lines:
//   session NUMBER RECOVERIES | edit NUMBER LETTERS FRAME PLAYHEAD (the one when its answer arrived) | fault WORDS
//   shown NUMBER FRAME VALUE VALUE (of the two columns)
#include <array>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "motiongen/client/client.hpp"

namespace {

using motiongen::Event;
using motiongen::EventKind;

struct Edit {
  std::uint64_t frame = 0;
  std::uint64_t heard_at = 0;
  bool answered = false;
};

struct Character {
  motiongen::Session session;
  std::vector<Edit> edits;  // edit n is the prompt of n + 1 letters
  std::vector<std::array<float, 2>> shown;
  bool waits = true;  // for the answer to the last edit; else for the next frame
  std::uint64_t edited_at = 0;

  void look(std::size_t frame_column, std::size_t prompt_column) {
    if (!session.is_open()) return;
    std::vector<float> row(session.rig().row_width);
    const auto now = session.frame(row);
    for (; now && shown.size() <= *now; shown.push_back({row[frame_column], row[prompt_column]})) {
      if (!session.copy_frame(shown.size(), row)) std::abort();
    }
  }

  void tell_more(std::minstd_rand& draw) {
    if (!session.is_open()) return;
    const bool may = edits.empty() || (waits ? edits.back().answered : session.playhead() > edited_at);
    if (!may) return;
    if (!session.set_prompt(std::string(edits.size() + 1, 'x'))) return;
    edits.emplace_back();
    edited_at = session.playhead();
    waits = draw() % 10 < 7;
  }

  bool is_done() const {
    std::uint64_t last = 0;
    for (const Edit& each : edits) {
      if (!each.answered) return false;
      last = std::max(last, each.frame);
    }
    return shown.size() > last + 1;
  }
};

void take(const Event& event, std::vector<Character>& characters) {
  if (event.kind == EventKind::closed || (event.kind == EventKind::recovered && !event.exact)) {
    std::printf("fault session %u %s\n", event.session, event.outcome.status.message().c_str());
  }
  if (event.kind != EventKind::edit) return;
  for (Character& each : characters) {
    if (each.session.id() != event.session) continue;
    Edit& edit = each.edits.at(event.edit - 1);
    if (!event.outcome.status || edit.answered) {
      std::printf("fault edit %u %s\n", event.session, event.outcome.status.message().c_str());
    }
    edit.answered = true;
    edit.frame = event.outcome.effective_frame.value_or(0);
    edit.heard_at = each.session.playhead();
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 6) return 2;
  std::minstd_rand draw(static_cast<unsigned>(std::atoi(argv[3])));
  const std::size_t frame_column = std::strtoul(argv[4], nullptr, 10);
  const std::size_t prompt_column = std::strtoul(argv[5], nullptr, 10);
  motiongen::ClientOptions options;
  options.address = argv[1];
  auto client = motiongen::Client::connect(options);
  if (!client) return 1;
  std::vector<Character> characters;
  for (int number = 0; number < std::atoi(argv[2]); ++number) {
    motiongen::SessionOptions character;
    character.prompt = "first";
    character.lookahead_frames = 80;
    character.keep_frames = 4000;
    auto session = client->open(character);
    if (!session) return 1;
    characters.push_back({std::move(session).value(), {}, {}});
  }
  for (Character& each : characters) {
    if (!each.session.wait_frame(0, 60)) return 1;
  }
  std::printf("playing\n");
  std::fflush(stdout);
  std::atomic<bool> is_over{false};
  std::thread reader([&is_over] {
    std::string line;
    std::getline(std::cin, line);
    is_over = true;
  });
  for (bool done = false; !done;) {
    for (Event event; client->next_event(event);) take(event, characters);
    done = is_over;
    for (Character& each : characters) {
      each.look(frame_column, prompt_column);
      if (!is_over) each.tell_more(draw);
      done = done && (each.is_done() || each.session.is_closed());
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(3));
  }
  reader.join();
  for (std::size_t number = 0; number < characters.size(); ++number) {
    const Character& each = characters[number];
    std::printf("session %zu %u\n", number, each.session.stats().recoveries);
    for (std::size_t edit = 0; edit < each.edits.size(); ++edit) {
      std::printf("edit %zu %zu %llu %llu\n", number, edit + 1, static_cast<unsigned long long>(each.edits[edit].frame),
                  static_cast<unsigned long long>(each.edits[edit].heard_at));
    }
    for (std::size_t frame = 0; frame < each.shown.size(); ++frame) {
      std::printf("shown %zu %zu %.0f %.0f\n", number, frame, static_cast<double>(each.shown[frame][0]),
                  static_cast<double>(each.shown[frame][1]));
    }
  }
  return 0;
}
