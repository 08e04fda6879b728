#include "stream.hpp"

#include "client/address.hpp"
#include "client/convert.hpp"
#include "motiongen/core/status.hpp"

namespace motiongen::load {
namespace {

grpc::ChannelArguments channel_arguments(const std::string& address, const Access& access) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);  // a connection for each stream, as separate clients have
  arguments.SetInt(GRPC_ARG_HTTP2_BDP_PROBE, 0);
  arguments.SetInt(GRPC_ARG_HTTP2_STREAM_LOOKAHEAD_BYTES, 1 << 20);
  arguments.SetInt(GRPC_ARG_ENABLE_RETRIES, 0);
  arguments.SetMaxReceiveMessageSize(64 << 20);
  // a proxy set in the environment is another machine, and without TLS the token must stay on this one
  if (!access.tls() && !access.token().empty()) arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
  const std::string name = access.tls() ? name_for_tls(address) : "";
  if (!name.empty()) arguments.SetString(GRPC_ARG_DEFAULT_AUTHORITY, name);
  return arguments;
}

std::shared_ptr<grpc::ChannelCredentials> credentials(const Access& access) {
  if (!access.tls()) return grpc::InsecureChannelCredentials();
  return grpc::SslCredentials({access.root_certificates(), access.private_key(), access.certificate_chain()});
}

// The name of an enum's value without the common prefix; the number, if the value is of a later version.
std::string short_name(const std::string& name, const std::string& prefix, int number) {
  if (name.empty()) return std::to_string(number);
  return name.compare(0, prefix.size(), prefix) == 0 ? name.substr(prefix.size()) : name;
}

}  // namespace

Stream::Stream(Stage& stage, Run& run)
    : stage_(stage), run_(run), outbox_([this](double waited_s) {
        const std::lock_guard<std::mutex> lock(waits_mutex_);
        if (hello_taken_) waits_.record(waited_s);
        hello_taken_ = true;  // the first message, whose wait is that for the connection
      }) {
  outbox_.set_limit(run.load.max_request_bytes());
}

void Stream::start() {
  const Access& access = run_.load.access();
  const std::string& address = run_.load.address();
  channel_ = grpc::CreateCustomChannel(address, credentials(access), channel_arguments(address, access));
  stub_ = std::make_unique<grpc::GenericStub>(channel_);
  v1::StreamMotionRequest hello;
  hello.mutable_hello()->set_client_agent("motiongen-load");
  outbox_.put_alone(hello);
  Metadata metadata;
  if (!access.token().empty()) metadata.emplace_back("authorization", "Bearer " + access.token());
  call_ = Call::start(*stub_, metadata, outbox_, shared_from_this());
}

bool Stream::wait_hello(double timeout_s) {
  std::unique_lock<std::mutex> lock(stage_.mutex);
  greeted_changed_.wait_for(lock, std::chrono::duration<double>(timeout_s), [this] { return greeted_ || lost(); });
  return greeted_;
}

void Stream::begin_end() {
  {
    const std::lock_guard<std::mutex> lock(stage_.mutex);
    ending_ = true;
  }
  call_->finish();
}

// ---- sending

void Stream::put_report(const PlayedCharacter& character, double now_s) {
  entry_.clear();
  character.put_report(now_s, entry_);
  outbox_.put(entry_);
}

void Stream::put_ping() {
  v1::StreamMotionRequest request;
  request.mutable_ping()->set_client_time_ns(static_cast<std::int64_t>(stage_.now_s() * 1e9));
  if (round_trip_s_ > 0) {
    convert::set_seconds(round_trip_s_, request.mutable_ping()->mutable_round_trip());
  }
  outbox_.put_alone(request);
}

void Stream::write_waits(Recorder& to) {
  const std::lock_guard<std::mutex> lock(waits_mutex_);
  to.add_lags(Lag::write, waits_);
}

// ---- receiving

void Stream::on_message(const wire::Piece* pieces, std::size_t size) {
  const double now_s = stage_.now_s();
  bool must_flush = false;
  bool readable = false;
  {
    const std::lock_guard<std::mutex> lock(stage_.mutex);
    run_.recorder.count("messages_received");
    readable = take_message(pieces, size, now_s, must_flush);
    if (!readable) run_.recorder.count("protocol_breaches");
  }
  if (must_flush) flush();
}

bool Stream::take_message(const wire::Piece* pieces, std::size_t size, double now_s, bool& must_flush) {
  wire::Cursor message(pieces, size);
  std::uint32_t field = 0;
  std::uint32_t type = 0;
  std::uint64_t updates = 0;
  while (message.left() > 0) {
    wire::Cursor inner;
    wire::Update update;
    if (!message.read_tag(field, type)) return false;
    if (type != wire::kLength) {
      if (!message.skip_value(type)) return false;
      continue;
    }
    if (!message.read_message(inner)) return false;
    if (field == v1::StreamMotionResponse::kUpdatesFieldNumber) {
      ++updates;
      if (!wire::read_update(inner, update) || !take_update(update, now_s, must_flush)) return false;
    } else if (!wire::gather(inner, scratch_) || !take_stream_event(field, now_s)) {
      return false;
    }
  }
  run_.recorder.count("updates_received", updates);
  return true;
}

bool Stream::take_stream_event(std::uint32_t field, double now_s) {
  if (field == v1::StreamMotionResponse::kHelloFieldNumber) {
    greeted_ = true;
    greeted_changed_.notify_all();
  } else if (field == v1::StreamMotionResponse::kPongFieldNumber) {
    v1::Pong pong;
    if (!pong.ParseFromString(scratch_)) return false;
    round_trip_s_ = now_s - static_cast<double>(pong.client_time_ns()) / 1e9;
    if (run_.measures(now_s)) run_.recorder.record_round_trip(round_trip_s_);
  } else if (field == v1::StreamMotionResponse::kGoodbyeFieldNumber) {
    run_.recorder.count("goodbyes");
  }
  return true;
}

bool Stream::take_update(const wire::Update& update, double now_s, bool& must_flush) {
  const auto found = characters_.find(update.session);
  if (found == characters_.end() || found->second->ended()) return true;  // sent before the server knew of its end
  PlayedCharacter& character = *found->second;
  if (update.kind == wire::Update::Kind::chunk) {
    wire::Chunk chunk;
    if (!wire::read_chunk(update.body, chunk)) return false;
    const bool begins = !character.started();
    character.take_chunk(chunk.header, now_s);
    if (begins && character.started()) {
      put_report(character, now_s);  // the server starts its estimate of the playhead at this report
      must_flush = true;
    }
    return true;
  }
  v1::SessionUpdate message;
  if (!wire::gather(update.all, scratch_) || !message.ParseFromString(scratch_)) return false;
  take(character, message, now_s);
  return true;
}

void Stream::take(PlayedCharacter& character, const v1::SessionUpdate& update, double now_s) {
  Recorder& recorder = run_.recorder;
  if (update.has_plan()) {
    character.take_plan(update.plan(), now_s);
  } else if (update.has_outcome()) {
    take_outcome(character, update.outcome(), now_s);
  } else if (update.has_opened()) {
    recorder.count("sessions_opened");
  } else if (update.has_service_level()) {
    const auto& level = update.service_level();
    recorder.count("service level: " + short_name(v1::ServiceTier_Name(level.tier()), "SERVICE_TIER_", level.tier()) +
                   ", " + std::to_string(level.denoise_steps()) + " steps");
  } else if (update.has_closed()) {
    take_closed(character, update.closed(), now_s);
  }
}

void Stream::take_outcome(PlayedCharacter& character, const v1::EditOutcome& outcome, double now_s) {
  if (outcome.code() != 0) {
    const bool is_open = outcome.event_seq() == 1;
    const bool known = outcome.code() > 0 && outcome.code() <= static_cast<int>(Code::unauthenticated);
    const std::string code = known ? name_of(static_cast<Code>(outcome.code())) : std::to_string(outcome.code());
    run_.recorder.count(std::string("refused ") + (is_open ? "open" : "edit") + ": " +
                        (outcome.reason().empty() ? code : outcome.reason()));
    run_.recorder.add(Figure::refused, character.plan().group(), now_s);
    if (is_open) return character.refused();
  }
  character.take_outcome(outcome, now_s);
}

void Stream::take_closed(PlayedCharacter& character, const v1::SessionClosed& closed, double now_s) {
  run_.recorder.count("frames_late_by_server", closed.late_frames());
  if (closed.reason() == v1::CLOSE_REASON_CLIENT) return;
  run_.recorder.count("sessions_lost: " +
                      short_name(v1::CloseReason_Name(closed.reason()), "CLOSE_REASON_", closed.reason()));
  character.end(now_s, false);
}

void Stream::on_call_ended(const grpc::Status& status, std::shared_ptr<Call> call) {
  const std::lock_guard<std::mutex> lock(stage_.mutex);
  ended_call_ = std::move(call);
  lost_ = status.ok() ? "the server ended the stream"
                      : name_of(static_cast<Code>(status.error_code())) + (", " + status.error_message());
  greeted_changed_.notify_all();
  if (ending_ || !greeted_) return;
  run_.recorder.count("streams_lost");
  run_.recorder.count("stream_lost: " + lost_);
  const double now_s = stage_.now_s();
  for (const auto& entry : characters_) {
    if (!entry.second->is_live()) continue;
    run_.recorder.count("sessions_lost: STREAM_LOST");
    entry.second->end(now_s, false);
  }
}

}  // namespace motiongen::load
