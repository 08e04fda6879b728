// Numbers that are not finite are refused by the call that they were given to, before a server hears of it.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "scripted_server.hpp"

namespace motiongen {
namespace {

constexpr double kLimitS = 60;
constexpr float kWrong[] = {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
                            -std::numeric_limits<float>::infinity()};

// Whether the status is a refusal that names the field.
bool names(const Status& refused, const std::string& field) {
  return refused.code() == Code::invalid_argument && refused.message().rfind(field + ": ", 0) == 0;
}

TEST(WrongNumbers, SessionAndClipOptionsThatAreNotFiniteAreRefused) {
  ScriptedServer server;
  server.add_to_catalog = [](v1::GetCatalogResponse& catalog) {
    catalog.mutable_limits()->set_max_clip_frames(10);
    catalog.mutable_limits()->set_max_clip_samples(1);
  };
  auto client = Client::connect(server.options());
  ASSERT_TRUE(client) << client.status().message();
  const auto refuse = [&client](const char* field, const auto& set) {
    for (const float wrong : kWrong) {
      SessionOptions options;
      set(options, wrong);
      EXPECT_TRUE(names(client->open(options).status(), field)) << field;
      ClipOptions clip;
      clip.num_frames = 1;
      set(clip, wrong);
      EXPECT_TRUE(names(client->generate_clip(clip).status(), field)) << field;
    }
  };
  refuse("start_x_m", [](auto& options, float wrong) { options.start_x_m = wrong; });
  refuse("start_z_m", [](auto& options, float wrong) { options.start_z_m = wrong; });
  refuse("start_heading_rad", [](auto& options, float wrong) { options.start_heading_rad = wrong; });
  refuse("text_guidance", [](auto& options, float wrong) { options.text_guidance = wrong; });
  refuse("constraint_guidance", [](auto& options, float wrong) { options.constraint_guidance = wrong; });
  refuse("Prompt::embedding", [](auto& options, float wrong) { options.prompt.embedding = {0, wrong}; });
}

TEST(WrongNumbers, EditsAndRowsThatAreNotFiniteAreRefused) {
  ScriptedServer server;
  server.hear = [](const v1::SessionEvent& event, ScriptedServer::Stream& stream) {
    if (event.has_open()) stream.Write(ScriptedServer::opened(event));
  };
  auto client = Client::connect(server.options());
  ASSERT_TRUE(client) << client.status().message();
  auto session = client->open({});
  ASSERT_TRUE(session && session->wait_open(kLimitS));
  for (const float wrong : kWrong) {
    OptionsChange change;
    change.guidance.emplace(wrong, 1.0F);
    EXPECT_TRUE(names(session->set_options(change).status(), "guidance, of text"));
    change.guidance.emplace(std::nullopt, wrong);
    EXPECT_TRUE(names(session->set_options(change).status(), "guidance, of targets"));
    std::vector<float> rows(session->rig().row_width);
    rows.back() = wrong;
    EXPECT_TRUE(names(session->cut_to(rows).status(), "rows"));
    SessionOptions options;
    options.prior_rows = rows;
    EXPECT_TRUE(names(client->open(options).status(), "rows"));
  }
}

}  // namespace
}  // namespace motiongen
