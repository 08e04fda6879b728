// A client's sessions, and what arrives for them.
#include "client/core.hpp"

#include <algorithm>
#include <chrono>

#include "client/convert.hpp"

namespace motiongen {

double now_s() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

ClientCore::ClientCore(ClientOptions options, double ask_timeout_s)
    : options_(std::move(options)),
      ask_timeout_s_(ask_timeout_s),
      metadata_(options_),
      events_(options_.on_event),
      route_(addresses_of(options_), options_.routing_key) {}

std::shared_ptr<const Catalog> ClientCore::catalog() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return catalog_;
}

ClientStats ClientCore::stats() const {
  ClientStats stats;
  stats.messages = num_messages_;
  stats.bytes = num_bytes_;
  stats.chunks = num_chunks_;
  stats.dropped_events = events_.num_dropped();
  stats.reconnects = num_reconnects_;
  stats.round_trip_s = round_trip_s_;
  return stats;
}

std::vector<std::shared_ptr<SessionState>> ClientCore::sessions() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  std::vector<std::shared_ptr<SessionState>> found;
  found.reserve(sessions_.size());
  for (const auto& entry : sessions_) found.push_back(entry.second);
  return found;
}

Result<v1::OpenSession> ClientCore::opening_of(const SessionOptions& options) const {
  v1::OpenSession open = convert::open_session(options);
  std::uint32_t id = SessionBook::kPresentPrompt;
  if (!options.prompt.empty()) *open.add_prompts() = convert::span(id, options.prompt, 0, 0);
  for (const auto& [frame, prompt] : options.later_prompts) *open.add_prompts() = convert::span(++id, prompt, frame, 0);
  if (options.prior_rows.empty()) return open;
  if (open.has_start_pose()) {
    return invalid("start_x_m, start_z_m, start_heading_rad", "a place",
                   "none beside prior_rows, whose last one is where the character starts");
  }
  const auto known = catalog();
  const Rig* rig = convert::find_rig(*known, options.model_id);
  if (rig == nullptr) return invalid("model_id", options.model_id, "a model of the catalogue, beside prior_rows");
  Status checked = convert::check_rows(options.prior_rows, rig->row_width);
  if (!checked) return checked;
  convert::set_rows(options.prior_rows, *rig, open.mutable_prior_frames());
  return open;
}

Result<std::shared_ptr<SessionState>> ClientCore::open(const SessionOptions& options) {
  Status checked = convert::check(options);
  if (!checked) return checked;
  auto opening = opening_of(options);
  if (!opening) return opening.status();
  auto state = std::make_shared<SessionState>(next_session_++, options, std::move(opening).value(), options_.reconnect,
                                              backlog_);
  for (std::size_t prompt = 0; prompt < options.later_prompts.size(); ++prompt) {
    static_cast<void>(state->book.take_prompt_id());
  }
  for (const Target& target : options.targets) {
    state->book.add_opening(convert::constraint(state->book.take_constraint_id(), target));
  }
  Status fits = convert::check_size("the session", state->book.opening(), catalog()->limits);
  if (fits) fits = check_room();
  if (!fits) return fits;
  {
    // checked under the lock that adds the session: whoever closes the client ends the sessions that are there by then
    const std::lock_guard<std::mutex> lock(mutex_);
    if (closing_ || (call_ == nullptr && !is_lost_)) {
      return Status(Code::failed_precondition, "CLIENT_CLOSED", "the client is closed: " + failure_.message());
    }
    sessions_.emplace(state->id, state);
  }
  {
    const std::lock_guard<std::mutex> lock(state->mutex);
    if (connected_ && state->phase == Phase::waiting) state->send_open(outbox_, *catalog(), events_);
  }
  flush();
  return state;
}

Result<EditId> ClientCore::edit(SessionState& state, v1::SessionEvent event) {
  return edit_with(state, [&event] { return std::move(event); });
}

Status ClientCore::check_room() const {
  if (!outbox_.is_full() && !backlog_->is_full()) return {};
  return {Code::resource_exhausted, "OUTBOX_FULL",
          "more than " + std::to_string(Outbox::kMostWaiting) +
              " bytes wait for a server that reads and answers them; tell it less, or again later"};
}

void ClientCore::flush() {
  std::shared_ptr<Call> call;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    call = call_;
  }
  if (call != nullptr) call->send();
}

// ---- from the server

void ClientCore::on_message(const wire::Piece* pieces, std::size_t size) {
  const double now = now_s();
  heard_at_s_ = now;
  ++num_messages_;
  num_bytes_ += size;
  // what concerns the stream must be handled before what concerns its sessions, wherever it is in the message
  if (!take_stream_event({pieces, size})) return;
  wire::Cursor message(pieces, size);
  std::uint32_t field = 0;
  std::uint32_t type = 0;
  bool readable = true;
  while (readable && message.left() > 0) {
    wire::Cursor inner;
    wire::Update update;
    readable = message.read_tag(field, type);
    if (!readable) break;
    if (field != v1::StreamMotionResponse::kUpdatesFieldNumber || type != wire::kLength) {
      readable = message.skip_value(type);
    } else {
      readable = message.read_message(inner) && wire::read_update(inner, update) && take_update(update, now);
    }
  }
  // this update and those after it are lost, and sessions must not go on as if they had never been sent
  if (!readable) drop_call(violation("an update of the server cannot be read"));
  flush();
  events_.dispatch();
}

bool ClientCore::take_stream_event(const wire::Cursor& all) {
  wire::Cursor message = all;
  std::uint32_t field = 0;
  std::uint32_t type = 0;
  bool readable = true;
  while (readable && message.left() > 0) {
    readable = message.read_tag(field, type);
    wire::Cursor inner;
    if (!readable) break;
    if (field < v1::StreamMotionResponse::kHelloFieldNumber || type != wire::kLength) {
      readable = message.skip_value(type);
      continue;
    }
    readable = message.read_message(inner) && wire::gather(inner, scratch_);
    if (!readable) break;
    if (field == v1::StreamMotionResponse::kHelloFieldNumber) {
      v1::ServerHello hello;
      readable = hello.ParseFromString(scratch_);
      if (readable) take_hello(hello);
    } else if (field == v1::StreamMotionResponse::kPongFieldNumber) {
      v1::Pong pong;
      readable = pong.ParseFromString(scratch_);
      if (readable) take_pong(pong.client_time_ns());
    } else if (field == v1::StreamMotionResponse::kGoodbyeFieldNumber) {
      v1::Goodbye goodbye;
      readable = goodbye.ParseFromString(scratch_);
      take_goodbye(goodbye);
    }
  }
  if (!readable) drop_call(violation("a message of the server cannot be read"));
  return readable;
}

void ClientCore::take_hello(const v1::ServerHello& hello) {
  const bool again = ever_connected_.exchange(true);
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    connected_ = true;
    replica_id_ = hello.replica_id();
    changed_.notify_all();
  }
  if (!again) return;
  ++num_reconnects_;
  Event event;
  event.kind = EventKind::connected;
  events_.push(std::move(event));
  open_waiting(now_s());
}

void ClientCore::take_pong(std::int64_t pinged_ns) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (pinged_ns <= ponged_ns_ || pinged_ns > pinged_ns_) return;  // it answers no outstanding ping
  ponged_ns_ = pinged_ns;
  unanswered_since_s_ = 0;
  round_trip_s_ = now_s() - static_cast<double>(pinged_ns) / 1e9;
  backoff_.note_pong();
}

void ClientCore::take_goodbye(const v1::Goodbye& goodbye) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    goodbye_ = goodbye;
  }
  Event event;
  event.kind = EventKind::draining;
  events_.push(std::move(event));
}

void ClientCore::open_waiting(double now) {
  const auto present = catalog();
  for (const auto& state : sessions()) {
    const std::lock_guard<std::mutex> lock(state->mutex);
    if (connected_ && state->phase == Phase::waiting && state->retry_at_s <= now) {
      state->send_open(outbox_, *present, events_);
    }
  }
  forget_closed();
}

bool ClientCore::take_update(const wire::Update& update, double now) {
  std::shared_ptr<SessionState> state;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto found = sessions_.find(update.session);
    if (found == sessions_.end()) return true;  // sent before the server knew that the session had ended here
    state = found->second;
  }
  bool over = false;
  bool readable = true;
  bool is_answer = false;
  v1::SessionUpdate message;
  if (update.kind != wire::Update::Kind::chunk && update.kind != wire::Update::Kind::plan) {
    readable = wire::gather(update.all, scratch_) && message.ParseFromString(scratch_);
    const std::string& reason = message.outcome().reason();
    if (reason == "UNKNOWN_MODEL" || reason == "UNKNOWN_RIG") wants_catalog_ = true;
    // models come and go while the server runs; the session cannot begin without its rig, so fetch that first
    if (message.has_opened() && !knows_rig_of(message.opened()) && is_opening(*state)) {
      static_cast<void>(fetch_catalog(ask_timeout_s_));
    }
  }
  {
    const std::lock_guard<std::mutex> lock(state->mutex);
    if (update.kind == wire::Update::Kind::chunk) {
      wire::Chunk chunk;
      readable = wire::read_chunk(update.body, chunk);
      if (readable) state->take_chunk(chunk, events_, outbox_);
      ++num_chunks_;
    } else if (update.kind == wire::Update::Kind::plan) {
      wire::Plan plan;
      readable = wire::read_plan(update.body, plan);
      if (readable) state->take_plan(plan, events_, outbox_);
    } else {
      if (readable) state->take(message, *catalog(), now, events_, outbox_);
      is_answer = message.has_outcome() || message.has_opened();
    }
    over = state->phase == Phase::closed;
  }
  if (!readable) return false;
  if (is_answer) {
    follow(state);
    const std::lock_guard<std::mutex> lock(state->mutex);
    over = state->phase == Phase::closed;
  }
  if (!over) return true;
  const std::lock_guard<std::mutex> lock(mutex_);
  sessions_.erase(update.session);
  return true;
}

bool ClientCore::is_opening(const SessionState& state) {
  const std::lock_guard<std::mutex> lock(state.mutex);
  return state.phase == Phase::opening;
}

bool ClientCore::knows_rig_of(const v1::SessionOpened& opened) const {
  const auto known = catalog();
  const auto is_its = [&opened](const Rig& each) { return each.rig_id == opened.rig_id(); };
  return std::any_of(known->rigs.begin(), known->rigs.end(), is_its) &&
         convert::find_model(*known, opened.model_id()) != nullptr;
}

void ClientCore::drop_call(const Status& status) {
  std::shared_ptr<Call> call;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    call = call_;
    if (call != nullptr) drop_reason_ = status;  // without a call, it would be taken for the next call's reason
  }
  if (call != nullptr) call->cancel();
}

}  // namespace motiongen
