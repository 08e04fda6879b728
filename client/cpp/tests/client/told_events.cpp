// Plays one character and prints what happens to it, one line each, until it is told to quit: told_events HOST:PORT
// Its commands are those of told_commands.cpp, and `another`, which opens another character in its place. It prints:
//   opened | edit ID CODE FRAME | placed TARGET FIRST LAST ARRIVAL ANCHOR | reached TARGET MET FRAME METRES RADIANS
//   lost REASON | connected | recovered FRAME EXACT | closed REASON | draining | durability KEPT | refused WORDS
//   frame FRAME CODE | at FRAME CODE | x FRAME X Y Z | row FRAME NUMBERS | stats PLANS UNDERRUNS LATE RECOVERIES
//   held FIRST Z Z ... (the root's z at each frame held) | no_token (the file has none)
// Environment variables: MOTIONGEN_TOKEN, MOTIONGEN_TOKEN_FILE (read for every call), MOTIONGEN_METADATA and
// MOTIONGEN_CHANNEL_OPTIONS (NAME=VALUE, comma-separated; numbers are whole), the files MOTIONGEN_CA,
// MOTIONGEN_CERTIFICATE and MOTIONGEN_KEY, MOTIONGEN_OTHER (more addresses, comma-separated), MOTIONGEN_FORMAT (1 to
// 3), MOTIONGEN_LOOKAHEAD (frames), MOTIONGEN_CLOCK=manual, MOTIONGEN_PING_S (0.4: a server that is silent for a second
// counts as lost).
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "motiongen/client/client.hpp"
#include "told_commands.hpp"

using motiongen::Event;
using motiongen::EventKind;

namespace {

void tell_placements(const std::vector<motiongen::Placement>& placements) {
  for (const motiongen::Placement& each : placements) {
    std::printf("placed %u %llu %llu %llu %llu\n", each.target, static_cast<unsigned long long>(each.first_frame),
                static_cast<unsigned long long>(each.last_frame), static_cast<unsigned long long>(each.arrival_frame),
                static_cast<unsigned long long>(each.anchor_frame));
  }
}

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
      tell_placements(event.outcome.placements);
      break;
    case EventKind::reached:
      std::printf("reached %u %d %llu %.4f %.4f\n", event.reached.target, event.reached.met ? 1 : 0,
                  static_cast<unsigned long long>(event.reached.frame),
                  static_cast<double>(event.reached.position_error_m.value_or(-1)),
                  static_cast<double>(event.reached.rotation_error_rad.value_or(-1)));
      break;
    case EventKind::durability:
      std::printf("durability %d\n", event.is_durable ? 1 : 0);
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

// The file's present token. Throws if it has none, as an application might.
std::string token_of(const std::string& path) {
  std::string token = content_of(path);
  if (!token.empty()) return token;
  std::printf("no_token\n");
  std::fflush(stdout);
  throw std::runtime_error(path + " has no token");
}

std::map<std::string, std::string> pairs_of(const std::string& text) {
  std::map<std::string, std::string> pairs;
  std::istringstream in(text);
  for (std::string each; std::getline(in, each, ',');) {
    const auto equals = each.find('=');
    if (equals != std::string::npos) pairs[each.substr(0, equals)] = each.substr(equals + 1);
  }
  return pairs;
}

void set_line(motiongen::ClientOptions& options) {
  options.token = variable("MOTIONGEN_TOKEN");
  const std::string token_file = variable("MOTIONGEN_TOKEN_FILE");
  if (!token_file.empty()) options.token_source = [token_file] { return token_of(token_file); };
  options.metadata = pairs_of(variable("MOTIONGEN_METADATA"));
  for (const auto& [name, value] : pairs_of(variable("MOTIONGEN_CHANNEL_OPTIONS"))) {
    const bool is_number = value.find_first_not_of("0123456789") == std::string::npos;
    if (is_number) {
      options.channel_options[name] = std::atoi(value.c_str());
    } else {
      options.channel_options[name] = value;
    }
  }
  options.tls = !variable("MOTIONGEN_CA").empty();
  options.root_certificates_pem = content_of(variable("MOTIONGEN_CA"));
  options.certificate_chain_pem = content_of(variable("MOTIONGEN_CERTIFICATE"));
  options.private_key_pem = content_of(variable("MOTIONGEN_KEY"));
  std::istringstream others(variable("MOTIONGEN_OTHER"));
  for (std::string each; std::getline(others, each, ',');) options.other_addresses.push_back(each);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  motiongen::ClientOptions options;
  options.address = argv[1];
  const std::string ping_s = variable("MOTIONGEN_PING_S");
  options.ping_period_s = ping_s.empty() ? 0.4 : std::atof(ping_s.c_str());
  set_line(options);
  options.on_event = tell;
  auto client = motiongen::Client::connect(options);
  if (!client) {
    std::fprintf(stderr, "%s %s\n", client.status().reason().c_str(), client.status().message().c_str());
    return 1;
  }
  motiongen::SessionOptions character;
  character.prompt = "a person walks forward";
  character.seed = 1;
  character.keep_frames = 4000;  // on a busy machine, a test may ask for a frame late
  character.lookahead_frames = static_cast<std::uint32_t>(std::atoi(variable("MOTIONGEN_LOOKAHEAD").c_str()));
  const std::string format = variable("MOTIONGEN_FORMAT");
  if (!format.empty()) character.frame_format = static_cast<motiongen::FrameFormat>(std::atoi(format.c_str()));
  if (variable("MOTIONGEN_CLOCK") == "manual") character.clock = motiongen::Clock::manual;
  auto session = client->open(character);
  if (!session) return 1;
  for (std::string line; std::getline(std::cin, line) && line != "quit";) {
    if (line == "another") {  // replaces the one before, which is closed
      session = client->open(character);
      if (session) continue;
    } else if (told::obey(line, *session)) {
      continue;
    }
    std::fprintf(stderr, "not understood: %s\n", line.c_str());
    return 1;
  }
  return 0;
}
