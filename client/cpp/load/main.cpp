// motiongen-load: plays thousands of characters in real time on one core. `motiongen bench --program` starts it, draws
// what to play, and makes the report from what this measured; load.proto defines their messages.
#include <google/protobuf/util/json_util.h>

#include <csignal>
#include <cstdio>
#include <iostream>
#include <string>

#include "load.pb.h"
#include "player.hpp"

namespace {

using motiongen::load::Go;
using motiongen::load::Load;
using motiongen::load::Player;
using motiongen::load::Told;

constexpr char kProgram[] = "motiongen-load 0.1.0";

void tell(const Told& told) {
  std::string line;
  google::protobuf::util::JsonPrintOptions options;
  options.always_print_primitive_fields = true;
  options.preserve_proto_field_names = true;
  if (!google::protobuf::util::MessageToJsonString(told, &line, options).ok()) return;
  line += '\n';
  std::fwrite(line.data(), 1, line.size(), stdout);
  std::fflush(stdout);
}

int fail(const std::string& why) {
  Told told;
  told.set_failed(why);
  tell(told);
  return 1;
}

// Read the next line as a message. False if there is none, or it is another message.
template <class Message>
bool read(Message& message) {
  std::string line;
  return static_cast<bool>(std::getline(std::cin, line)) &&
         google::protobuf::util::JsonStringToMessage(line, &message).ok();
}

}  // namespace

int main(int argc, char**) {
  if (argc > 1) {
    std::fprintf(stderr, "motiongen-load takes no arguments: motiongen bench --program PATH starts it\n");
    return 2;
  }
  std::signal(SIGINT, SIG_IGN);  // Ctrl-C goes to all processes; the one that started this decides
  Load load;
  if (!read(load)) return fail("the first line is no load; motiongen bench --program PATH writes one");
  const std::string fault = motiongen::load::find_fault(load);
  if (!fault.empty()) return fail("the load cannot be played: " + fault);
  Player player(load);
  const std::string unreachable = player.connect();
  Told told;
  if (!unreachable.empty()) {
    const int failed = fail(unreachable);
    player.stop();
    return failed;
  }
  told.mutable_ready()->set_program(kProgram);
  tell(told);
  Go go;
  if (!read(go)) {
    const int failed = fail("the second line is no moment to start at");
    player.stop();
    return failed;
  }
  player.play(go.start_at_s(), [&told](const motiongen::load::Progress& progress) {
    *told.mutable_progress() = progress;
    tell(told);
  });
  *told.mutable_book() = player.book();
  tell(told);
  player.stop();  // only now, so that the reader of the book need not wait for a server that does not end its calls
  return 0;
}
