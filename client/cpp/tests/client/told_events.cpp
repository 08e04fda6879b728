// Plays one character and tells what happens to it, a line each, until a line comes: told_events HOST:PORT
// Lines that it takes: "prompt TEXT", "waypoint FRAME X Z", "pause", "quit". What it tells:
//   opened | frames FIRST..LAST | edit ID CODE FRAME | lost REASON | connected | recovered FRAME EXACT | closed REASON
#include <cstdio>
#include <iostream>
#include <mutex>
#include <sstream>
#include <string>
#include <vector>

#include "motiongen/client/client.hpp"

using motiongen::Event;
using motiongen::EventKind;

namespace {

void tell(const Event& event) {
  const std::string& reason = event.outcome.status.reason();
  switch (event.kind) {
    case EventKind::opened:
      std::printf("opened\n");
      break;
    case EventKind::edit:
      std::printf("edit %llu %s %lld\n", static_cast<unsigned long long>(event.edit),
                  event.outcome.status.ok() ? "OK" : reason.c_str(),
                  event.outcome.effective_frame ? static_cast<long long>(*event.outcome.effective_frame) : -1LL);
      break;
    case EventKind::connection_lost:
      std::printf("lost %s\n", motiongen::name_of(event.outcome.status.code()));
      break;
    case EventKind::connected:
      std::printf("connected\n");
      break;
    case EventKind::recovered:
      std::printf("recovered %llu %d\n", static_cast<unsigned long long>(event.frame), event.exact ? 1 : 0);
      break;
    case EventKind::closed:
      std::printf("closed %s\n", reason.c_str());
      break;
    case EventKind::draining:
      std::printf("draining\n");
      break;
    default:
      return;
  }
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  motiongen::ClientOptions options;
  options.address = argv[1];
  options.ping_period_s = 0.4;
  options.on_event = tell;
  auto client = motiongen::Client::connect(options);
  if (!client) {
    std::fprintf(stderr, "%s\n", client.status().message().c_str());
    return 1;
  }
  motiongen::SessionOptions character;
  character.prompt = "a person walks forward";
  character.seed = 1;
  auto session = client->open(character);
  if (!session) return 1;
  for (std::string line; std::getline(std::cin, line) && line != "quit";) {
    std::istringstream in(line);
    std::string name;
    in >> name;
    if (name == "prompt") {
      if (!session->set_prompt(line.substr(7))) return 1;
    } else if (name == "waypoint") {
      motiongen::Waypoint waypoint;
      in >> waypoint.frame >> waypoint.x_m >> waypoint.z_m;
      const motiongen::Target target = waypoint;
      if (!session->add_targets({&target, 1})) return 1;
    } else if (name == "pause") {
      if (!session->pause()) return 1;
    } else if (name == "wait") {  // for a frame
      std::uint64_t frame = 0;
      in >> frame;
      const motiongen::Status status = session->wait_frame(frame, 60);
      std::printf("frame %llu %s\n", static_cast<unsigned long long>(frame), status ? "OK" : status.reason().c_str());
      std::fflush(stdout);
    } else if (name == "x") {  // where the hips are at a frame
      std::uint64_t frame = 0;
      in >> frame;
      std::vector<float> row(session->rig().row_width);
      const motiongen::Status status = session->copy_frame(frame, row);
      std::printf("x %llu %.4f %.4f %.4f\n", static_cast<unsigned long long>(frame), static_cast<double>(row[0]),
                  static_cast<double>(row[1]), static_cast<double>(row[2]));
      std::fflush(stdout);
      if (!status) return 1;
    }
  }
  return 0;
}
