// A crowd on one stream, drawn sixty times a second: crowd [HOST:PORT] [CHARACTERS] [SECONDS]
// Every character gets a new prompt now and then. Prints what matters to a game: frames held, and processor time.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#include "motiongen/client/client.hpp"
#include "processor_time.hpp"

namespace {

constexpr int kFramesPerSecond = 60;
constexpr const char* kPrompts[] = {"a person walks forward", "a person runs forward", "a person stands still",
                                    "a person waves with the right hand"};

}  // namespace

int main(int argc, char** argv) {
  const std::size_t num_characters = argc > 2 ? std::strtoul(argv[2], nullptr, 10) : 500;
  const double seconds = argc > 3 ? std::strtod(argv[3], nullptr) : 10;
  if (num_characters == 0 || !(seconds > 0 && seconds < 1e6)) {
    std::fprintf(stderr, "a crowd is 1 character or more, for more than 0 s\n");
    return 2;
  }
  motiongen::ClientOptions options;
  options.address = argc > 1 ? argv[1] : "localhost:50051";
  auto client = motiongen::Client::connect(options);
  if (!client) {
    std::fprintf(stderr, "%s\n", client.status().message().c_str());
    return 1;
  }
  std::vector<motiongen::Session> crowd;
  for (std::size_t number = 0; number < num_characters; ++number) {
    motiongen::SessionOptions character;
    character.prompt = kPrompts[number % std::size(kPrompts)];
    character.priority = motiongen::Priority::crowd;
    const std::size_t row = number / 25;
    character.start_x_m = 2.0F * static_cast<float>(number % 25);
    character.start_z_m = 2.0F * static_cast<float>(row);
    auto opened = client->open(character);
    if (!opened) {
      std::fprintf(stderr, "%s\n", opened.status().message().c_str());
      return 1;
    }
    crowd.push_back(std::move(opened).value());
    if (number % 50 == 49 && !crowd.back().wait_frame(0, 60))
      break;  // wait for each group of 50, so that opens follow the pace of the server
  }
  for (motiongen::Session& each : crowd) {
    const auto opened = each.wait_open(30);
    if (!opened) {
      std::fprintf(stderr, "%s\n", opened.status().message().c_str());
      return 1;
    }
  }
  std::vector<float> pose(crowd.front().rig().row_width);
  const auto start = std::chrono::steady_clock::now();
  const double cpu_before_s = processor_time_s();
  const std::uint64_t chunks_before = client->stats().chunks;
  const int frames = static_cast<int>(seconds * kFramesPerSecond);
  std::uint64_t poses = 0;
  motiongen::Event event;
  for (int frame = 0; frame < frames; ++frame) {
    for (motiongen::Session& each : crowd) poses += each.sample(pose) ? 1 : 0;
    motiongen::Session& told = crowd[static_cast<std::size_t>(frame) % crowd.size()];
    const auto edit = told.set_prompt(kPrompts[static_cast<std::size_t>(frame / 7) % std::size(kPrompts)]);
    if (!edit) {
      std::fprintf(stderr, "%s\n", edit.status().message().c_str());
      return 1;
    }
    while (client->next_event(event)) {
      if (event.kind == motiongen::EventKind::closed)
        std::fprintf(stderr, "%s\n", event.outcome.status.message().c_str());
    }
    std::this_thread::sleep_until(start + std::chrono::microseconds(1'000'000LL * (frame + 1) / kFramesPerSecond));
  }
  const double used_s = processor_time_s() - cpu_before_s;
  const auto chunks = client->stats().chunks - chunks_before;
  std::uint64_t held = 0;
  for (const motiongen::Session& each : crowd) held += each.stats().underruns;
  std::printf("%zu characters, %.0f s: %llu poses, %llu chunks, %llu frames held\n", crowd.size(), seconds,
              static_cast<unsigned long long>(poses), static_cast<unsigned long long>(chunks),
              static_cast<unsigned long long>(held));
  std::printf("%.3f of a core; %.1f us a character and second; %.1f us a chunk, poses included\n", used_s / seconds,
              1e6 * used_s / seconds / static_cast<double>(crowd.size()),
              chunks == 0 ? 0.0 : 1e6 * used_s / static_cast<double>(chunks));
  return 0;
}
