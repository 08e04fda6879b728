// Compiled with exceptions, unlike the rest of the library: the token source is the application's code.
#include "client/call_metadata.hpp"

#include <algorithm>
#include <exception>

#include "client/route.hpp"
#include "client/texts.hpp"

namespace motiongen {
namespace {

constexpr char kKeyCharacters[] = "0123456789abcdefghijklmnopqrstuvwxyz_.-";
constexpr char kAuthorization[] = "authorization";

bool begins(const std::string& text, const std::string& with) { return text.compare(0, with.size(), with) == 0; }

bool ends(const std::string& text, const std::string& with) {
  return text.size() >= with.size() && text.compare(text.size() - with.size(), with.size(), with) == 0;
}

// Which option a key belongs to; empty: none.
std::string owner_of(const std::string& key) {
  if (key == kAuthorization) return "which `token` and `token_source` set";
  if (key == kRoutingKey) return "which `routing_key` sets";
  const bool is_of_grpc = begins(key, "grpc-") || ends(key, "-bin") || key == "te" || key == "host" ||
                          key == "content-type" || key == "user-agent";
  return is_of_grpc ? "which is gRPC's own" : "";
}

bool is_text(const std::string& text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](char each) {
    const auto byte = static_cast<unsigned char>(each);
    return byte >= 0x20 && byte <= 0x7E;
  });
}

Status no_token(Code code, const std::string& why) {
  return {code, kTokenSource, "token_source gave no token for a call: " + why};
}

}  // namespace

Status check_metadata(const std::map<std::string, std::string>& metadata) {
  for (const auto& [key, text] : metadata) {
    std::string given = "the key \"" + key + "\"";
    if (key.empty() || key.find_first_not_of(kKeyCharacters) != std::string::npos) {
      return invalid("metadata", given, "keys of lower-case letters, digits, _, . and -");
    }
    const std::string owner = owner_of(key);
    if (!owner.empty()) {
      given.append(", ").append(owner).append(",");
      return invalid("metadata", given, "any key of your own");
    }
    if (!is_text(text)) {  // not quoted: it may be secret
      return invalid("metadata", "a text of " + std::to_string(text.size()) + " bytes for " + key,
                     "1 or more characters of printable ASCII (0x20 to 0x7e)");
    }
  }
  return {};
}

Result<Metadata> CallMetadata::make(const std::string& routing_key) {
  Metadata made(options_.metadata.begin(), options_.metadata.end());
  if (!routing_key.empty()) made.emplace_back(kRoutingKey, routing_key);
  const auto token = next_token();
  if (!token) return token.status();
  if (!token.value().empty()) made.emplace_back(kAuthorization, "Bearer " + token.value());
  return made;
}

Result<std::string> CallMetadata::next_token() {
  if (!options_.token_source) return options_.token;
  auto token = ask_source();
  if (!token) {
    const Status& why = token.status();
    if (why.ok()) return no_token(Code::unavailable, "an OK status is no token; return the text, or why there is none");
    const std::string reason = why.reason().empty() ? "" : " " + why.reason();
    return no_token(why.code(), name_of(why.code()) + reason + ": " + why.message());
  }
  if (token.value().empty()) {
    return no_token(Code::invalid_argument, "the text is empty; return a status where there is none at present");
  }
  const Status checked = check_token(token.value());
  return checked ? token : no_token(checked.code(), checked.message());
}

Result<std::string> CallMetadata::ask_source() {
  const std::lock_guard<std::mutex> lock(asking_);
  try {
    return options_.token_source();
  } catch (const std::exception& thrown) {
    return Status(Code::unavailable, "", std::string("it threw ") + thrown.what());
  } catch (...) {
    return Status(Code::unavailable, "", "it threw what is no std::exception");
  }
}

}  // namespace motiongen
