// A client with several addresses, or with an outdated catalogue.
#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <string>

#include "client/core.hpp"
#include "motiongen/c/structs.h"
#include "scripted_server.hpp"

namespace motiongen {
namespace {

constexpr double kLimitS = 60;
constexpr double kAskTimeoutOfTestsS = 0.25;  // for a server that answers: if it takes longer, it is asked again

TEST(Connecting, SilentServersDoNotKeepAClientFromTheNextAddress) {
  ScriptedServer frozen;
  ScriptedServer silent;
  ScriptedServer well;
  frozen.is_frozen = true;
  silent.says_hello = false;
  ClientOptions options = frozen.options();
  options.other_addresses = {silent.options().address, well.options().address};
  options.connect_timeout_s = kLimitS;
  const auto core = std::make_shared<ClientCore>(options, kAskTimeoutOfTestsS);
  const Status connected = core->connect();
  ASSERT_TRUE(connected) << connected.message();
  EXPECT_TRUE(core->is_connected());
  EXPECT_GE(well.num_catalogs, 1);
  core->shut_down();
}

TEST(Connecting, ErrorOfAServerThatDoesNotAnswerSaysWhatToCheck) {
  ClientOptions options;
  options.address = "127.0.0.1:1";
  options.connect_timeout_s = 0.2;
  for (const bool tls : {false, true}) {
    options.tls = tls;
    const std::string told = Client::connect(options).status().message();
    EXPECT_NE(told.find("both with TLS, or both without it?"), std::string::npos) << told;
    EXPECT_EQ(told.find("certificate") != std::string::npos, tls) << told;
    EXPECT_LT(told.size(), sizeof(motiongen_error::message)) << "C programs would get only a part of it";
  }
}

TEST(Connecting, ClipCanUseAModelThatWasLoadedSince) {
  ScriptedServer server;
  std::atomic<bool> is_loaded{false};
  server.add_to_catalog = [&](v1::GetCatalogResponse& catalog) {
    catalog.mutable_limits()->set_max_clip_frames(10);
    catalog.mutable_limits()->set_max_clip_samples(1);
    if (!is_loaded) return;
    catalog.add_rigs()->CopyFrom(ScriptedServer::rig());
    catalog.mutable_rigs()->rbegin()->set_rig_id("later");
    catalog.add_models()->set_model_id("later");
    catalog.mutable_models()->rbegin()->set_rig_id("later");
  };
  server.make_clip = [](grpc::ServerWriter<v1::GenerateClipResponse>& parts) {
    v1::GenerateClipResponse part;
    part.mutable_opened()->set_model_id("later");
    part.mutable_opened()->set_rig_id("later");
    parts.Write(part);
    part.mutable_chunk()->set_frame_count(1);
    part.mutable_chunk()->set_scalar_type(v1::SCALAR_TYPE_F32_LE);
    part.mutable_chunk()->set_data(std::string(11 * sizeof(float), '\0'));
    parts.Write(part);
    part.mutable_summary();
    parts.Write(part);
  };
  auto client = Client::connect(server.options());
  ASSERT_TRUE(client) << client.status().message();
  is_loaded = true;
  ClipOptions options;
  options.model_id = "later";
  options.num_frames = 1;
  const auto clips = client->generate_clip(options);
  ASSERT_TRUE(clips) << clips.status().message();
  EXPECT_EQ(clips.value()[0].rig.rig_id, "later");
}

}  // namespace
}  // namespace motiongen
