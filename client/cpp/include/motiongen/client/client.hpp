// The entry point of the library: one stream to one server, with any number of sessions on it.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "motiongen/client/clip.hpp"
#include "motiongen/client/session.hpp"
#include "motiongen/client/types.hpp"

namespace motiongen {

struct ClientOptions {
  std::string address;  // host:port, or unix:PATH for a socket of this machine
  // Servers that share a store of sessions with the first. The next one is tried when a server does not answer within 5
  // s or goes away; a server without room may also name one of them. The token is sent to no other servers.
  std::vector<std::string> other_addresses;
  // The key by which a proxy chooses a server, sent as x-motiongen-key with every call; empty: a random one. Letters,
  // digits, - . _
  std::string routing_key;
  bool tls = false;
  std::string root_certificates_pem;  // only with tls, like the next two; empty: the system's
  std::string certificate_chain_pem;  // the client's, if the server requires one
  std::string private_key_pem;
  // Sent as `authorization: Bearer ...` with every call; empty: none. Printable ASCII without spaces. Without tls it is
  // only sent to servers on this machine: a token together with any other address is refused.
  std::string token;
  // In place of `token`: called before every call to the server, so that an expiring token can be renewed. Returns the
  // token, or a status that says why there is none. On such a status `Client::connect` fails at once; afterwards,
  // sessions play what they hold and the function is called again later, unless retrying cannot help with that status
  // (README.md). An exception counts as UNAVAILABLE. Called on threads of the library and on those that connect or make
  // clips, one call at a time. No call is made and the client cannot be destroyed until it returns, so it should return
  // quickly; it must not use the client.
  std::function<Result<std::string>()> token_source;
  // Further metadata of every call, sent even without TLS. Keys consist of a-z, 0-9, _ - . and must not be gRPC's own
  // (grpc-..., ...-bin) or those of other options (authorization, x-motiongen-key); values are printable ASCII.
  std::map<std::string, std::string> metadata;
  // gRPC's channel arguments by name (grpc/impl/codegen/grpc_types.h); they override those that the library sets.
  std::map<std::string, std::variant<int, std::string>> channel_options;
  double connect_timeout_s = 10;   // how long `connect` waits for a server to be ready
  double report_hz = 2;            // how often each playhead is reported to the server, 1 to 5
  double flush_interval_s = 0.02;  // how long the server may collect frames for one message, 0.005 to 0.1
  double ping_period_s = 5;        // a server that sends nothing, or answers no ping, for 2.5 periods counts as lost
  bool reconnect = true;           // after a loss of the stream; false: sessions end with it
  std::string agent;               // follows the library's name in the server's logs; truncated to 100 bytes
  // Called with each event, one at a time, on a thread of the library; absent: events are queued for `next_event`. It
  // may call any function that does not wait, and may destroy sessions and the client itself. It should return soon:
  // until then no frames may be received and no playheads be reported. It must not throw: an escaping exception
  // terminates the program.
  std::function<void(const Event&)> on_event;
};

struct ClientStats {
  std::uint64_t messages = 0;
  std::uint64_t bytes = 0;  // of the messages received
  std::uint64_t chunks = 0;
  // Events wait for `next_event` or for the callback, up to 65,536 of them or 64 MiB. Beyond that the oldest are
  // dropped.
  std::uint64_t dropped_events = 0;
  std::uint32_t reconnects = 0;
  double round_trip_s = 0;  // 0: not yet measured
};

class MOTIONGEN_API Client {
 public:
  // Wait until a server is ready, fetch its catalogue and begin the stream.
  static Result<Client> connect(const ClientOptions& options);

  Client(Client&&) noexcept;
  Client& operator=(Client&&) noexcept;
  // Ends the sessions and the stream. No callback runs after it returns, except the one that called it, if any.
  ~Client();

  std::shared_ptr<const Catalog> catalog() const;
  bool is_connected() const;
  ClientStats stats() const;

  // Open a session. Returns at once; the event `opened` or `Session::wait_open` tells when it has opened.
  Result<Session> open(const SessionOptions& options);

  // Make a clip; one entry for each sample. Blocks, so it cannot be used inside an event callback. It is a call of its
  // own beside the stream. CANCELLED if the client is destroyed meanwhile.
  [[nodiscard]] Result<std::vector<Clip>> generate_clip(const ClipOptions& options);

  // Take the oldest event in the queue; false if there is none.
  [[nodiscard]] bool next_event(Event& event);

 private:
  explicit Client(std::shared_ptr<ClientCore> core);
  std::shared_ptr<ClientCore> core_;
};

}  // namespace motiongen
