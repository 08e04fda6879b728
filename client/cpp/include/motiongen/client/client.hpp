// The way in: one stream to one server, with any number of sessions on it.
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
  // Of servers that share a store of sessions: tried in turn where the one before does not answer within 5 s or goes
  // away, and where one that has no room names them. The token is sent to no others.
  std::vector<std::string> other_addresses;
  // By which a proxy chooses a server, sent as x-motiongen-key with every call; empty: one is drawn. Letters, digits, -
  // . _
  std::string routing_key;
  bool tls = false;
  std::string root_certificates_pem;  // with tls; empty: the system's
  std::string certificate_chain_pem;  // of this client, where the server asks for one
  std::string private_key_pem;
  // Sent as `authorization: Bearer ...` with every call; empty: none. Printable ASCII without spaces or a line end.
  // Without tls it is sent to this machine only: other addresses are refused beside it.
  std::string token;
  // In its place: asked before every call, so that a token that expires is followed by the next. Returns the token, or
  // why there is none: sessions play what they hold and it is asked again, unless the status is one that trying again
  // cannot mend (README.md), or of `Client::connect`, which ends with it at once. One that throws has said UNAVAILABLE.
  // Called on threads of the library and on those that connect or make clips, one at a time. Meanwhile no call is made,
  // and the client does not end: it is to return soon, and must not use the client.
  std::function<Result<std::string>()> token_source;
  // Sent with every call too, also in plain text. Keys of a-z, 0-9, _ - . that are not gRPC's own (grpc-..., ...-bin)
  // or other options' (authorization, x-motiongen-key); texts of printable ASCII.
  std::map<std::string, std::string> metadata;
  // Of gRPC, by their names (grpc/impl/codegen/grpc_types.h), in place of what the library sets.
  std::map<std::string, std::variant<int, std::string>> channel_options;
  double connect_timeout_s = 10;   // how long `connect` waits for a server that is ready
  double report_hz = 4;            // how often the server hears each playhead, 1 to 5
  double flush_interval_s = 0.02;  // how long the server may gather frames, 0.005 to 0.1
  double ping_period_s = 5;        // a server is given up that says nothing, or answers no ping, for 2.5 as many
  bool reconnect = true;           // after a loss; else sessions end with it
  std::string agent;               // added to the library's name in the server's logs, as far as 100 bytes go
  // Called with each event, one at a time, on a thread of the library; absent: events wait for `next_event`. It may
  // call anything but what waits, and may destroy sessions and the client itself. It must not throw: an exception that
  // leaves it ends the program.
  std::function<void(const Event&)> on_event;
};

struct ClientStats {
  std::uint64_t messages = 0;
  std::uint64_t bytes = 0;  // of messages received
  std::uint64_t chunks = 0;
  std::uint64_t dropped_events = 0;  // 65,536 are kept for `next_event`; of more, the oldest are dropped
  std::uint32_t reconnects = 0;
  double round_trip_s = 0;  // 0: not measured yet
};

class MOTIONGEN_API Client {
 public:
  // Wait for a server, fetch its catalogue and begin the stream.
  static Result<Client> connect(const ClientOptions& options);

  Client(Client&&) noexcept;
  Client& operator=(Client&&) noexcept;
  // Ends its sessions and the stream. No callback runs after it, unless it is called by one.
  ~Client();

  std::shared_ptr<const Catalog> catalog() const;
  bool is_connected() const;
  ClientStats stats() const;

  // Make a character. Returns at once; the event `opened` or `Session::wait_open` tells when it lives.
  Result<Session> open(const SessionOptions& options);

  // Make a clip: one entry a sample. Waits for it, so not inside an event callback. A call of its own beside the
  // stream. CANCELLED where the client is destroyed meanwhile.
  [[nodiscard]] Result<std::vector<Clip>> generate_clip(const ClipOptions& options);

  // The oldest event that was not taken; false when there is none.
  [[nodiscard]] bool next_event(Event& event);

 private:
  explicit Client(std::shared_ptr<ClientCore> core);
  std::shared_ptr<ClientCore> core_;
};

}  // namespace motiongen
