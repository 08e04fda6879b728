#include "client/texts.hpp"

#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "client/convert.hpp"

namespace motiongen {
namespace {

constexpr char kLatin1[] = "caf\xE9";

TEST(Texts, OnlyValidUtf8IsAccepted) {
  for (const std::string text : {"", "walk", "caf\xC3\xA9", "\xE2\x82\xAC", "\xED\x9F\xBF", "\xEE\x80\x80",
                                 "\xF0\x9F\x95\xBA dances", "\xF4\x8F\xBF\xBF"}) {
    EXPECT_TRUE(check_utf8("text", text)) << text;
  }
  EXPECT_TRUE(check_utf8("text", std::string("a\0b", 3)));
  const std::vector<std::pair<std::string, std::string>> wrong = {
      {kLatin1, "0xe9 at position 3 of 4"},
      {"\x80", "0x80 at position 0"},              // a continuation byte
      {"ab\xC3", "0xc3 at position 2"},            // cut off
      {"\xC0\xAF", "0xc0 at position 0"},          // overlong, as are the next two
      {"\xE0\x9F\xBF", "0xe0 at position 0"},      //
      {"\xF0\x8F\xBF\xBF", "0xf0 at position 0"},  //
      {"\xED\xA0\x80", "0xed at position 0"},      // half of a UTF-16 surrogate pair
      {"\xF4\x90\x80\x80", "0xf4 at position 0"},  // above U+10FFFF
      {"\xE2\x82 ", "0xe2 at position 0"},
      {"\xF0\x9F\x95", "0xf0 at position 0"},
      {"\xFF", "0xff at position 0"},
  };
  for (const auto& [text, told] : wrong) {
    const Status refused = check_utf8("text", text);
    EXPECT_EQ(refused.code(), Code::invalid_argument) << told;
    EXPECT_NE(refused.message().find("text: the byte " + told), std::string::npos) << refused.message();
  }
}

TEST(Texts, TokenThatNoHeaderMayHaveIsRefusedWithoutPrintingIt) {
  EXPECT_TRUE(check_token(""));
  EXPECT_TRUE(check_token("mg_!~"));
  for (const std::string token : {"abc\n", "abc\r\n", "a bc", "abc\x7F", "caf\xC3\xA9", "\tabc"}) {
    const Status refused = check_token(token);
    EXPECT_EQ(refused.code(), Code::invalid_argument);
    EXPECT_EQ(refused.message().find("abc"), std::string::npos) << "it is secret";
  }
  EXPECT_NE(check_token("abc\n").message().find("0x0a at position 3 of 4"), std::string::npos);
}

TEST(Texts, AreCutBetweenCharacters) {
  EXPECT_EQ(first_bytes("abc", 3), "abc");
  EXPECT_EQ(first_bytes("abc", 2), "ab");
  EXPECT_EQ(first_bytes("ab\xC3\xA9", 3), "ab");
  EXPECT_EQ(first_bytes("a\xF0\x9F\x95\xBA", 4), "a");
}

// Whether the status is a refusal that names the field.
bool names(const Status& refused, const std::string& field) {
  return refused.code() == Code::invalid_argument && refused.message().rfind(field + ": ", 0) == 0;
}

TEST(Texts, TextOfASessionThatIsNotUtf8IsRefusedByItsField) {
  const auto opened_with = [](auto change) {
    SessionOptions options;
    change(options);
    return convert::check(options);
  };
  EXPECT_TRUE(opened_with([](SessionOptions&) {}));
  EXPECT_TRUE(names(opened_with([](auto& options) { options.model_id = kLatin1; }), "model_id"));
  EXPECT_TRUE(names(opened_with([](auto& options) { options.rig_id = kLatin1; }), "rig_id"));
  EXPECT_TRUE(names(opened_with([](auto& options) { options.outputs = {"a", kLatin1}; }), "outputs"));
  EXPECT_TRUE(names(opened_with([](auto& options) { options.prompt = kLatin1; }), "Prompt::text"));
  EXPECT_TRUE(names(opened_with([](auto& options) {
                      options.later_prompts = {{40, Prompt(kLatin1)}};
                    }),
                    "Prompt::text"));
  EXPECT_TRUE(names(opened_with([](auto& options) { options.prompt = Prompt::preset(kLatin1); }), "Prompt::preset_id"));
  Prompt vector;
  vector.embedding = {1};
  vector.text_encoder = kLatin1;
  EXPECT_TRUE(names(convert::check(vector), "Prompt::text_encoder"));
  FootContact foot;
  foot.limb = kLatin1;
  EXPECT_TRUE(names(convert::check(Target(foot)), "FootContact::limb"));
  EXPECT_TRUE(names(opened_with([&foot](auto& options) { options.targets = {foot}; }), "FootContact::limb"));
}

}  // namespace
}  // namespace motiongen
