#include "client/route.hpp"

#include <gtest/gtest.h>

namespace motiongen {
namespace {

constexpr char kKey[] = "0123456789abcdef";

using Servers = std::vector<OtherServer>;

TEST(Route, NextAddressesAreTriedInTurnWithTheSameKey) {
  Route route({"own:1", "b:1", "c:1"}, "");
  const std::string key = route.key();
  EXPECT_EQ(key.size(), 16U);
  EXPECT_NE(Route({"own:1"}, "").key(), key);
  EXPECT_EQ(route.server(), 0U);
  for (const std::size_t next : {1U, 2U, 0U}) {
    route.next();
    EXPECT_EQ(route.server(), next);
    EXPECT_EQ(route.key(), key);
  }
}

TEST(Route, NamedServersAreTriedInOrderAndThenItsOwnAddresses) {
  Route route({"own:1", "b:1", "c:1", "d:1"}, "");
  EXPECT_TRUE(route.follow(Servers{{"stranger:1", ""}, {"c:1", kKey}, {"own:1", ""}, {"b:1", ""}}));
  EXPECT_EQ(route.server(), 2U);
  EXPECT_NE(route.key(), kKey) << "an allowed address is used without the key";
  for (const std::size_t next : {0U, 1U, 2U, 3U, 0U}) {
    route.pass_over(false);
    EXPECT_EQ(route.server(), next);
  }
}

TEST(Route, KeyIsUsedAtTheFirstAddressIfTheNamedAddressIsNotAllowed) {
  Route route({"own:1", "b:1"}, "");
  route.next();
  EXPECT_TRUE(route.follow(Servers{{"stranger:1", kKey}, {"", "second"}}));
  EXPECT_EQ(route.server(), 0U);
  EXPECT_EQ(route.key(), kKey);
  route.pass_over(true);
  EXPECT_EQ(route.server(), 0U);
  EXPECT_EQ(route.key(), "second");
}

TEST(Route, NamesOfAnEarlierGoodbyeAreForgotten) {
  Route route({"own:1", "b:1", "c:1"}, "");
  EXPECT_TRUE(route.follow(Servers{{"c:1", ""}, {"c:1", ""}}));
  EXPECT_FALSE(route.follow({}));
  EXPECT_EQ(route.server(), 2U) << "it stays with the server that was named";
  route.pass_over(false);
  EXPECT_EQ(route.server(), 0U);
}

TEST(Route, NewKeyIsDrawnWhenAServerIsStarting) {
  Route route({"own:1", "b:1"}, "");
  const std::string key = route.key();
  route.pass_over(true);
  EXPECT_EQ(route.server(), 1U);
  EXPECT_NE(route.key(), key);
  EXPECT_EQ(route.key().size(), 16U);
}

TEST(Route, KeyOfTheApplicationIsNeverChanged) {
  Route route({"own:1", "b:1"}, "player-7");
  EXPECT_FALSE(route.follow(Servers{{"stranger:1", kKey}}));
  EXPECT_EQ(route.server(), 0U);
  EXPECT_TRUE(route.follow(Servers{{"b:1", kKey}}));
  EXPECT_EQ(route.server(), 1U);
  route.pass_over(true);
  EXPECT_EQ(route.server(), 0U);
  EXPECT_FALSE(route.go_to(Servers{{"", kKey}, {"stranger:1", kKey}})) << "a full server does not change it either";
  EXPECT_TRUE(route.go_to(Servers{{"", kKey}, {"b:1", kKey}}));
  EXPECT_EQ(route.server(), 1U);
  EXPECT_EQ(route.key(), "player-7");
}

TEST(Route, GoesToTheFirstAllowedServerWithRoom) {
  Route route({"own:1", "b:1"}, "");
  EXPECT_FALSE(route.go_to(Servers{{"stranger:1", ""}}));
  EXPECT_TRUE(route.go_to(Servers{{"stranger:1", ""}, {"b:1", ""}, {"", kKey}}));
  EXPECT_EQ(route.server(), 1U);
  EXPECT_TRUE(route.go_to(Servers{{"", kKey}}));
  EXPECT_EQ(route.server(), 0U);
  EXPECT_EQ(route.key(), kKey);
}

TEST(Route, KeysThatMetadataCannotCarryAreIgnored) {
  Route route({"own:1"}, "");
  const std::string key = route.key();
  const Servers servers{
      {"", "a b"}, {"", "line\nbreak"}, {"", "\xc3\xa9"}, {"", std::string("a\0b", 3)}, {"", std::string(257, 'a')}};
  EXPECT_FALSE(route.follow(servers));
  EXPECT_FALSE(route.go_to(servers));
  EXPECT_EQ(route.key(), key);
  EXPECT_TRUE(Route::is_key("Player-7.a_b"));
}

}  // namespace
}  // namespace motiongen
