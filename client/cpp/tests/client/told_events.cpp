// Plays one character and tells what happens to it, a line each, until it is told to quit: told_events HOST:PORT
// Lines that it takes: "prompt TEXT", "waypoint FRAME X Z", "velocity X Z", "pause", "wait FRAME", "x FRAME", "held",
// "quit". What it tells:
//   opened | edit ID CODE FRAME | lost REASON | connected | recovered FRAME EXACT | closed REASON | draining
//   frame FRAME CODE | x FRAME X Y Z | held FIRST Z Z ... (where the root is at each frame that is held)
// MOTIONGEN_TOKEN, and the files MOTIONGEN_CA, MOTIONGEN_CERTIFICATE and MOTIONGEN_KEY, are what it connects with.
#include <cstdio>
#include <cstdlib>
#include <fstream>
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

std::string variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? std::string() : std::string(value);
}

std::string content_of(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream content;
  content << file.rdbuf();
  return content.str();
}

void tell_held(const motiongen::Session& session) {
  std::vector<float> row(session.rig().row_width);
  const std::uint64_t end = session.buffered_to();
  std::uint64_t first = session.playhead();
  while (first > 0 && session.copy_frame(first - 1, row)) --first;
  std::printf("held %llu", static_cast<unsigned long long>(first));
  for (std::uint64_t frame = first; frame < end && session.copy_frame(frame, row); ++frame) {
    std::printf(" %.4f", static_cast<double>(row[2]));
  }
  std::printf("\n");
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  motiongen::ClientOptions options;
  options.address = argv[1];
  options.ping_period_s = 0.4;
  options.token = variable("MOTIONGEN_TOKEN");
  options.tls = !variable("MOTIONGEN_CA").empty();
  options.root_certificates_pem = content_of(variable("MOTIONGEN_CA"));
  options.certificate_chain_pem = content_of(variable("MOTIONGEN_CERTIFICATE"));
  options.private_key_pem = content_of(variable("MOTIONGEN_KEY"));
  options.on_event = tell;
  auto client = motiongen::Client::connect(options);
  if (!client) {
    std::fprintf(stderr, "%s %s\n", client.status().reason().c_str(), client.status().message().c_str());
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
    } else if (name == "velocity") {
      float x_mps = 0;
      float z_mps = 0;
      in >> x_mps >> z_mps;
      if (!session->set_velocity(x_mps, z_mps, 1)) return 1;
    } else if (name == "held") {
      tell_held(*session);
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
