// Connects and disconnects COUNT times: connects HOST:PORT COUNT. Every other time with a character.
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#include "motiongen/client/client.hpp"

namespace {

// The resident memory of this process in kilobytes.
long resident_kb() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("VmRSS:", 0) == 0) return std::atol(line.c_str() + 6);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const int count = std::atoi(argv[2]);
  long settled_kb = 0;
  for (int number = 0; number < count; ++number) {
    motiongen::ClientOptions options;
    options.address = argv[1];
    options.connect_timeout_s = 30;
    auto client = motiongen::Client::connect(options);
    if (!client) {
      std::fprintf(stderr, "connect %d: %s\n", number, client.status().message().c_str());
      return 1;
    }
    if (number % 2 == 0) {
      motiongen::SessionOptions character;
      character.prompt = "a person walks forward";
      auto session = client->open(character);
      if (!session) return 1;
      if (number % 4 == 0 && !session->wait_open(30)) return 1;
    }
    if (number == count / 5) settled_kb = resident_kb();
  }
  std::printf("%ld %ld\n", settled_kb, resident_kb());
  return 0;
}
