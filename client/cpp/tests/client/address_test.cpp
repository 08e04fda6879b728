#include "client/address.hpp"

#include <gtest/gtest.h>

#include "motiongen/client/client.hpp"

namespace motiongen {
namespace {

const std::vector<std::string> kLocal = {"localhost:50051", "127.0.0.1:1",      "127.8.9.255:1",
                                         "[::1]:1",         "unix:motion.sock", "unix:/run/motion.sock"};
// Includes addresses that only look like this machine's.
const std::vector<std::string> kFar = {
    "motion.example:50051", "10.0.0.7:1", "127.0.0.1.example:1", "localhost.example:1",
    "128.0.0.1:1",          "127.1:1",    "0127.0.0.1:1",        "127.0.0.1@10.0.0.7:1",
    "127.0.0.256:1",        "[::2]:1",    "ipv4:10.0.0.7:1",     "dns:///motion.example:1",
    "127.0.0.1,10.0.0.7:1"};

TEST(Address, MustBeHostAndPortOrUnixSocket) {
  for (const auto* addresses : {&kLocal, &kFar}) {
    for (const std::string& each : *addresses) EXPECT_TRUE(check_address("address", each)) << each;
  }
  EXPECT_TRUE(check_address("address", "unix:" + std::string(107, 'p')));
  for (const std::string& wrong :
       {std::string(), std::string("nowhere"), std::string(":1"), std::string("host:"), std::string("host:0"),
        std::string("host:65536"), std::string("host:http"), std::string("host:-1"), std::string("host:+1"),
        std::string("unix:"), std::string("unix:/tmp/a b"), std::string("unix:/tmp/%41"), std::string("unix:/a?b"),
        "unix:" + std::string(108, 'p'), std::string("unix-abstract:name"), std::string("::1:50051"),
        std::string("fe80::a:1")}) {
    const Status refused = check_address("address", wrong);
    EXPECT_EQ(refused.code(), Code::invalid_argument) << wrong;
    EXPECT_EQ(refused.message().rfind("address: \"" + wrong + "\" was given; allowed is ", 0), 0U) << refused.message();
  }
}

TEST(Address, LocalAddressesAreRecognised) {
  for (const std::string& each : kLocal) EXPECT_TRUE(is_local(each)) << each;
  for (const std::string& each : kFar) EXPECT_FALSE(is_local(each)) << each;
}

TEST(Address, UnixSocketIsLocalhostForTls) {
  EXPECT_EQ(name_for_tls("unix:motion.sock"), "localhost");
  EXPECT_EQ(name_for_tls("motion.example:50051"), "");
}

// The message with which `connect` refuses these options; empty if it fails for another reason.
std::string refusal(ClientOptions options) {
  options.connect_timeout_s = 0.01;  // no server listens there
  const Status refused = Client::connect(options).status();
  return refused.code() == Code::invalid_argument ? refused.message() : "";
}

TEST(Address, TokenWithoutTlsIsRefusedToARemoteAddress) {
  ClientOptions options;
  options.address = "10.0.0.7:50051";
  options.token = "secret";
  EXPECT_EQ(refusal(options).rfind("tls: a token for \"10.0.0.7:50051\" without TLS was given; allowed is TLS", 0), 0U)
      << refusal(options);
  EXPECT_EQ(refusal(options).find("secret"), std::string::npos);
  options.token.clear();
  options.token_source = [] { return std::string("secret"); };
  EXPECT_NE(refusal(options), "");
  options.address = "localhost:1";
  EXPECT_EQ(refusal(options), "");
  options.other_addresses = {"127.0.0.1:1", "motion.example:50051"};
  EXPECT_NE(refusal(options).find("motion.example:50051"), std::string::npos) << refusal(options);
  options.tls = true;
  EXPECT_EQ(refusal(options), "");
  options.tls = false;
  options.token_source = nullptr;
  EXPECT_EQ(refusal(options), "") << "without a token";
}

TEST(Address, CertificatesMustBePemAndGoWithTls) {
  ClientOptions options;
  options.address = "localhost:1";
  const std::string pem = "-----BEGIN CERTIFICATE-----\n";
  for (std::string ClientOptions::*field : {&ClientOptions::root_certificates_pem,
                                            &ClientOptions::certificate_chain_pem, &ClientOptions::private_key_pem}) {
    ClientOptions each = options;
    each.*field = pem;
    EXPECT_NE(refusal(each).find("_pem: a text without tls was given"), std::string::npos) << refusal(each);
    each.tls = true;
    each.*field = "/etc/ssl/ca.pem";
    EXPECT_NE(refusal(each).find("_pem: a text of 15 bytes that is no PEM was given"), std::string::npos);
  }
  options.tls = true;
  options.certificate_chain_pem = pem;
  EXPECT_NE(refusal(options).find("one of them was given"), std::string::npos) << "its key is missing";
  options.private_key_pem = "-----BEGIN PRIVATE KEY-----\n";
  EXPECT_EQ(refusal(options), "");
}

TEST(Address, OnlyGrpcChannelOptionsAreAcceptedAndNoProxyWithAToken) {
  ClientOptions options;
  options.address = "localhost:1";
  options.channel_options = {{"grpc.max_send_message_length", 1 << 20}, {"grpc.secondary_user_agent", "game"}};
  EXPECT_EQ(refusal(options), "");
  for (const char* name : {"", "keepalive_time_ms", "grpc.primary_user_agent"}) {
    options.channel_options = {{name, 1}};
    EXPECT_EQ(refusal(options).rfind("channel_options: \"" + std::string(name) + "\" was given", 0), 0U)
        << refusal(options);
  }
  options.channel_options = {{"grpc.enable_http_proxy", 1}};
  EXPECT_EQ(refusal(options), "");
  options.token = "secret";
  EXPECT_NE(refusal(options), "") << "a proxy is another machine";
}

}  // namespace
}  // namespace motiongen
