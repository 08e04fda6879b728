// Measures the cost of a client: client_cost HOST:PORT CHARACTERS SECONDS POSES_HZ. Prints one line of JSON. All
// characters are on one stream; each is drawn POSES_HZ times a second (0: never) and gets a prompt every five seconds.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

#include "motiongen/client/client.hpp"
#include "processor_time.hpp"

namespace {

int failed(const char* what, const motiongen::Status& status) {
  std::fprintf(stderr, "%s: %s\n", (std::string(what) + " " + status.reason()).c_str(), status.message().c_str());
  return 1;
}

constexpr double kEditPeriodS = 5;
constexpr int kTicksPerSecond = 20;  // if nothing is drawn

}  // namespace

int main(int argc, char** argv) {
  if (argc != 5) return 2;
  const std::size_t characters = std::strtoul(argv[2], nullptr, 10);
  const int seconds = std::atoi(argv[3]);
  const int poses_hz = std::atoi(argv[4]);
  motiongen::ClientOptions options;
  options.address = argv[1];
  auto client = motiongen::Client::connect(options);
  if (!client) return failed("connect", client.status());
  std::vector<motiongen::Session> crowd;
  for (std::size_t number = 0; number < characters; ++number) {
    motiongen::SessionOptions character;
    character.prompt = "a person walks";
    character.seed = number;
    auto session = client->open(character);
    if (!session) return failed("open", session.status());
    crowd.push_back(std::move(session).value());
    // Not all at once: with a server that generates frames instantly, more would wait than a stream may have.
    if (number % 50 != 49) continue;
    const motiongen::Status there = crowd.back().wait_frame(0, 60);
    if (!there) return failed("the first frame", there);
  }
  for (motiongen::Session& each : crowd) {
    const motiongen::Status there = each.wait_frame(0, 60);
    if (!there) return failed("the first frame", there);
  }
  std::this_thread::sleep_for(std::chrono::seconds(2));  // until chunks arrive evenly
  std::vector<float> pose(crowd.front().rig().row_width);
  const double cpu_before_s = processor_time_s();
  const motiongen::ClientStats before = client->stats();
  const auto start = std::chrono::steady_clock::now();
  const int ticks_hz = poses_hz > 0 ? poses_hz : kTicksPerSecond;
  const int ticks = seconds * ticks_hz;
  double edits_due = 0;
  std::size_t edits = 0;
  motiongen::Event event;
  for (int tick = 0; tick < ticks; ++tick) {
    if (poses_hz > 0) {
      for (motiongen::Session& each : crowd) static_cast<void>(each.sample(pose));
    }
    edits_due += static_cast<double>(characters) / kEditPeriodS / ticks_hz;
    for (; static_cast<double>(edits) < edits_due; ++edits) {
      const std::string text = "a person does number " + std::string(1 + edits % 50, 'x');
      const auto edit = crowd[edits % characters].set_prompt(text);
      if (!edit) return failed("a prompt", edit.status());
    }
    while (client->next_event(event)) {
    }
    std::this_thread::sleep_until(start + std::chrono::microseconds(1'000'000LL * (tick + 1) / ticks_hz));
  }
  const double wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  const motiongen::ClientStats after = client->stats();
  std::uint64_t held = 0;
  for (const motiongen::Session& each : crowd) held += each.stats().underruns;
  std::printf(
      "{\"cpu_s\": %.6f, \"wall_s\": %.6f, \"chunks\": %llu, \"messages\": %llu, \"edits\": %zu, \"held\": %llu}\n",
      processor_time_s() - cpu_before_s, wall_s, static_cast<unsigned long long>(after.chunks - before.chunks),
      static_cast<unsigned long long>(after.messages - before.messages), edits, static_cast<unsigned long long>(held));
  return 0;
}
