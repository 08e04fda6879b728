// One character that walks and then runs, sampled sixty times a second as in a game: one_character [HOST:PORT]
#include <chrono>
#include <cstdio>
#include <thread>
#include <vector>

#include "motiongen/client/client.hpp"
#include "motiongen/core/pose.hpp"

int main(int argc, char** argv) {
  motiongen::ClientOptions options;
  options.address = argc > 1 ? argv[1] : "localhost:50051";
  auto client = motiongen::Client::connect(options);
  if (!client) {
    std::fprintf(stderr, "%s\n", client.status().message().c_str());
    return 1;
  }
  motiongen::SessionOptions character;
  character.prompt = "a person walks forward";
  auto walker = client->open(character);
  if (!walker) {
    std::fprintf(stderr, "%s\n", walker.status().message().c_str());
    return 1;
  }
  const auto opened = walker->wait_open(10);
  if (!opened) {
    std::fprintf(stderr, "%s\n", opened.status().message().c_str());
    return 1;
  }
  const motiongen::Rig& rig = walker->rig();
  std::vector<float> pose(rig.row_width);
  std::vector<float> positions_m(3 * std::size_t{rig.num_joints()});
  const int frames = 4 * 60;
  for (int frame = 0; frame < frames; ++frame) {
    if (frame == frames / 2) {
      const auto edit = walker->set_prompt("a person runs forward");
      if (!edit) std::fprintf(stderr, "%s\n", edit.status().message().c_str());
    }
    if (walker->sample(pose)) {
      motiongen::joint_positions(rig, pose, positions_m);
      if (frame % 15 == 0)
        std::printf("the hips are at %.2f, %.2f, %.2f m\n", positions_m[0], positions_m[1], positions_m[2]);
    }
    std::this_thread::sleep_for(std::chrono::microseconds(16'667));
  }
  const motiongen::SessionStats stats = walker->stats();
  std::printf("%llu frames, %u held\n", static_cast<unsigned long long>(stats.frames), stats.underruns);
  return 0;
}
