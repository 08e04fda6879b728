#include "client/call_metadata.hpp"

#include <gtest/gtest.h>

#include <stdexcept>

namespace motiongen {
namespace {

using Token = Result<std::string>;

Result<Metadata> made_with(const std::function<Token()>& source) {
  ClientOptions options;
  options.token_source = source;
  return CallMetadata(options).make("key");
}

TEST(CallMetadata, HasTokenRoutingKeyAndTheApplicationsMetadata) {
  ClientOptions options;
  options.metadata = {{"x-route", "blue"}};
  EXPECT_EQ(CallMetadata(options).make("").value(), (Metadata{{"x-route", "blue"}}));
  options.token = "secret";
  EXPECT_EQ(CallMetadata(options).make("key").value(),
            (Metadata{{"x-route", "blue"}, {"x-motiongen-key", "key"}, {"authorization", "Bearer secret"}}));
}

TEST(CallMetadata, TokenSourceIsCalledForEveryCall) {
  ClientOptions options;
  int asked = 0;
  options.token_source = [&asked] { return "t" + std::to_string(++asked); };
  CallMetadata metadata(options);
  for (const std::string token : {"Bearer t1", "Bearer t2"}) {
    EXPECT_EQ(metadata.make("").value(), (Metadata{{"authorization", token}}));
  }
}

TEST(CallMetadata, FailureOfTheTokenSourceIsReportedWithItsReason) {
  const auto locked = made_with([]() -> Token { return Status(Code::unauthenticated, "LOCKED", "nobody is here"); });
  EXPECT_EQ(locked.status().code(), Code::unauthenticated);
  EXPECT_EQ(locked.status().reason(), "TOKEN_SOURCE");
  EXPECT_NE(locked.status().message().find("UNAUTHENTICATED LOCKED: nobody is here"), std::string::npos)
      << locked.status().message();
  const auto thrown = made_with([]() -> Token { throw std::runtime_error("the line is down"); });
  EXPECT_EQ(thrown.status().code(), Code::unavailable);
  EXPECT_EQ(thrown.status().reason(), "TOKEN_SOURCE");
  EXPECT_NE(thrown.status().message().find("it threw the line is down"), std::string::npos);
  EXPECT_EQ(made_with([]() -> Token { throw 3; }).status().code(), Code::unavailable);
  EXPECT_EQ(made_with([]() -> Token { return Status(); }).status().code(), Code::unavailable);
}

TEST(CallMetadata, InvalidTokenOfTheSourceIsRefusedWithoutPrintingIt) {
  for (const std::string token : {"", "abc\n", "a bc"}) {
    const auto refused = made_with([&token] { return token; });
    EXPECT_EQ(refused.status().code(), Code::invalid_argument);
    EXPECT_EQ(refused.status().reason(), "TOKEN_SOURCE");
    EXPECT_EQ(refused.status().message().find("abc"), std::string::npos) << "it is secret";
  }
}

TEST(CallMetadata, ReservedAndInvalidKeysAndValuesAreRefused) {
  EXPECT_TRUE(check_metadata({}));
  EXPECT_TRUE(check_metadata({{"x-route", "blue"}, {"a_b.c-9", " ~"}}));
  for (const std::string key : {"", "Upper", "a b", "grpc-timeout", "a-bin", ":path", "te", "host", "content-type",
                                "user-agent", "authorization", "x-motiongen-key"}) {
    const Status refused = check_metadata({{key, "x"}});
    EXPECT_EQ(refused.code(), Code::invalid_argument) << key;
    EXPECT_EQ(refused.message().rfind("metadata: the key \"" + key + "\"", 0), 0U) << refused.message();
  }
  EXPECT_NE(check_metadata({{"authorization", "x"}}).message().find("`token`"), std::string::npos);
  for (const std::string text : {"", "abc\n", "caf\xC3\xA9"}) {
    const Status refused = check_metadata({{"x-route", text}});
    EXPECT_EQ(refused.code(), Code::invalid_argument);
    EXPECT_EQ(refused.message().find("abc"), std::string::npos) << "it may be secret";
    EXPECT_NE(refused.message().find("x-route"), std::string::npos) << refused.message();
  }
}

TEST(CallMetadata, ConnectRefusesInvalidMetadataAndTwoTokens) {
  ClientOptions options;
  options.address = "localhost:1";
  options.metadata = {{"authorization", "Bearer secret"}};
  EXPECT_EQ(Client::connect(options).status().message().rfind("metadata: the key \"authorization\"", 0), 0U);
  options.metadata.clear();
  options.token = "secret";
  options.token_source = [] { return std::string("another"); };
  EXPECT_EQ(Client::connect(options).status().message().rfind("token_source: ", 0), 0U);
  options.token.clear();
  options.token_source = []() -> Token { throw std::runtime_error("the line is down"); };
  const Status refused = Client::connect(options).status();
  EXPECT_EQ(refused.reason(), "TOKEN_SOURCE") << "connect fails at once: " << refused.message();
}

}  // namespace
}  // namespace motiongen
