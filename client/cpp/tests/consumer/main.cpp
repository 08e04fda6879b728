// Uses the core and the client from outside of the tree, without exceptions and without gRPC's headers.
#include <cstdio>
#include <vector>

#include "motiongen/client/client.hpp"
#include "motiongen/core/timeline.hpp"

int main() {
  motiongen::TimelineOptions options;
  options.row_width = 1;
  auto timeline = motiongen::Timeline::make(options);
  const std::vector<float> rows(3, 0.5F);
  motiongen::RowSpan source(rows);
  if (!timeline || !timeline->announce_plan(1, 0) || !timeline->add_chunk({1, 0, 3, 0}, source)) return 1;
  motiongen::ClientOptions server;
  server.address = "nowhere";
  const auto client = motiongen::Client::connect(server);
  std::printf("%llu frames; %s\n", static_cast<unsigned long long>(timeline->buffered_to()),
              motiongen::name_of(client.status().code()));
  return client.status().code() == motiongen::Code::invalid_argument ? 0 : 1;
}
