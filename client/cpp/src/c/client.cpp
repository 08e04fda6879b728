// The C interface of a client.
#include <utility>

#include "c/handles.hpp"
#include "c/structs.hpp"

using motiongen::Event;
using motiongen::EventKind;
using motiongen::c::answer;
using motiongen::c::text;

namespace {

std::uint32_t number_of(EventKind kind) {
  switch (kind) {
    case EventKind::opened:
      return MOTIONGEN_EVENT_OPENED;
    case EventKind::edit:
      return MOTIONGEN_EVENT_EDIT;
    case EventKind::service_level:
      return MOTIONGEN_EVENT_SERVICE_LEVEL;
    case EventKind::closed:
      return MOTIONGEN_EVENT_CLOSED;
    case EventKind::connection_lost:
      return MOTIONGEN_EVENT_CONNECTION_LOST;
    case EventKind::connected:
      return MOTIONGEN_EVENT_CONNECTED;
    case EventKind::recovered:
      return MOTIONGEN_EVENT_RECOVERED;
    case EventKind::draining:
      return MOTIONGEN_EVENT_DRAINING;
    case EventKind::reached:
      return MOTIONGEN_EVENT_REACHED;
    case EventKind::durability:
      return MOTIONGEN_EVENT_DURABILITY;
  }
  return 0;
}

void put_reached(const motiongen::Reached& reached, motiongen_event& told) {
  told.has_frame = 1;
  told.frame = reached.frame;
  told.target = reached.target;
  told.met = reached.met ? 1 : 0;
  told.has_position_error = reached.position_error_m ? 1 : 0;
  told.position_error_m = reached.position_error_m.value_or(0);
  told.has_rotation_error = reached.rotation_error_rad ? 1 : 0;
  told.rotation_error_rad = reached.rotation_error_rad.value_or(0);
}

constexpr std::size_t kMostTokenBytes = 16384;  // including the NUL; issuers' tokens have a few thousand bytes

motiongen::Result<std::string> token_of(const motiongen_client_options& given) {
  std::string token(kMostTokenBytes, '\0');
  if (given.token_source(given.token_context, &token[0], static_cast<uint32_t>(token.size())) == 0) {
    return motiongen::Status(motiongen::Code::unavailable, "", "it returned 0");
  }
  const auto end = token.find('\0');
  if (end == std::string::npos) {
    return motiongen::invalid("token_source", "a text without an end", "a token and its NUL in `size` bytes");
  }
  token.resize(end);
  return token;
}

// Without this check, rows of another width would be taken for a different number of rows.
motiongen::Status check_row_floats(const motiongen::Catalog& catalog, const motiongen_session_options& given) {
  const std::string model_id = text(given.model_id);
  for (const motiongen::Model& model : catalog.models) {
    if (!model_id.empty() && model.model_id != model_id) continue;
    for (const motiongen::Rig& rig : catalog.rigs) {
      if (rig.rig_id != model.rig_id || rig.row_width == given.prior_row_floats) continue;
      return motiongen::invalid(
          "prior_row_floats", std::to_string(given.prior_row_floats),
          std::to_string(rig.row_width) + ", as rows of rig " + rig.rig_id + " without outputs have");
    }
    return {};
  }
  return {};  // opening the session will report that there is no such model
}

}  // namespace

uint32_t motiongen_abi_version(void) { return MOTIONGEN_ABI_VERSION; }

motiongen_code motiongen_client_connect(const motiongen_client_options* options, motiongen_client** client,
                                        motiongen_error* error) {
  motiongen_client_options given;
  if (client == nullptr) return motiongen::c::missing("client", error);
  *client = nullptr;
  if (!motiongen::c::read(options, given)) return motiongen::c::missing("options", error);
  motiongen::ClientOptions chosen;
  chosen.address = text(given.address);
  chosen.token = text(given.token);
  if (given.token_source != nullptr) chosen.token_source = [given] { return token_of(given); };
  chosen.tls = given.use_tls != 0;
  chosen.root_certificates_pem = text(given.root_certificates_pem);
  chosen.certificate_chain_pem = text(given.certificate_chain_pem);
  chosen.private_key_pem = text(given.private_key_pem);
  if (given.num_other_addresses > 0 && given.other_addresses == nullptr) {
    return motiongen::c::missing("other_addresses", error);
  }
  for (uint32_t index = 0; index < given.num_other_addresses; ++index) {
    chosen.other_addresses.push_back(text(given.other_addresses[index]));
  }
  if (given.connect_timeout_s != 0) chosen.connect_timeout_s = given.connect_timeout_s;
  chosen.reconnect = given.no_reconnect == 0;
  chosen.agent = "c";
  auto connected = motiongen::Client::connect(chosen);
  if (!connected) return answer(connected.status(), error);
  *client = new motiongen_client{std::move(connected).value()};
  return answer({}, error);
}

void motiongen_client_destroy(motiongen_client* client) { delete client; }

int32_t motiongen_client_is_connected(const motiongen_client* client) {
  return client != nullptr && client->client.is_connected() ? 1 : 0;
}

int32_t motiongen_client_next_event(motiongen_client* client, motiongen_event* event) {
  Event next;
  if (client == nullptr || !motiongen::c::has_size(event) || !client->client.next_event(next)) return 0;
  motiongen_event told;
  std::memset(&told, 0, sizeof told);
  told.kind = number_of(next.kind);
  told.session = next.session;
  told.code = static_cast<motiongen_code>(next.outcome.status.code());
  told.edit = next.edit;
  const bool has_frame = next.kind == EventKind::recovered || next.outcome.effective_frame.has_value();
  told.has_frame = has_frame ? 1 : 0;
  if (has_frame) told.frame = next.outcome.effective_frame.value_or(next.frame);
  if (next.kind == EventKind::reached) put_reached(next.reached, told);
  told.exact = next.exact ? 1 : 0;
  told.is_durable = next.is_durable ? 1 : 0;
  told.tier = next.level.tier;
  told.denoise_steps = next.level.denoise_steps;
  motiongen::c::copy_text(next.outcome.status.reason(), told.reason);
  motiongen::c::copy_text(next.outcome.status.message(), told.message);
  motiongen::c::write(told, event);
  return 1;
}

motiongen_code motiongen_client_open(motiongen_client* client, const motiongen_session_options* options,
                                     motiongen_session** session, motiongen_error* error) {
  motiongen_session_options given;
  if (client == nullptr || session == nullptr) return motiongen::c::missing("client, session", error);
  *session = nullptr;
  if (!motiongen::c::read(options, given)) return motiongen::c::missing("options", error);
  if (given.priority > 4) {
    return answer(motiongen::invalid("priority", std::to_string(given.priority), "1 to 4, or 0 for near"), error);
  }
  motiongen::SessionOptions chosen;
  if (given.priority != 0) chosen.priority = static_cast<motiongen::Priority>(given.priority);
  chosen.prompt = motiongen::Prompt(text(given.prompt));
  chosen.model_id = text(given.model_id);
  if (given.has_seed != 0) chosen.seed = given.seed;
  chosen.lookahead_frames = given.lookahead_frames;
  chosen.denoise_steps = given.denoise_steps;
  chosen.clock = given.manual_clock != 0 ? motiongen::Clock::manual : motiongen::Clock::real_time;
  chosen.start_x_m = given.start_x_m;
  chosen.start_z_m = given.start_z_m;
  if (given.start_heading_rad != 0) chosen.start_heading_rad = given.start_heading_rad;
  if (given.frame_format > MOTIONGEN_FORMAT_QUANTISED) {
    return answer(motiongen::invalid("frame_format", std::to_string(given.frame_format), "1 to 3, or 0 for F32"),
                  error);
  }
  if (given.frame_format != 0) chosen.frame_format = static_cast<motiongen::FrameFormat>(given.frame_format);
  chosen.history_frames = given.history_frames;
  chosen.keep_prompts = given.keep_prompts != 0;
  chosen.prompt.preset_id = text(given.preset_id);
  if (given.has_text_guidance != 0) chosen.text_guidance = given.text_guidance;
  if (given.has_target_guidance != 0) chosen.constraint_guidance = given.target_guidance;
  if (given.num_outputs > 0 && given.outputs == nullptr) return motiongen::c::missing("outputs", error);
  for (uint32_t index = 0; index < given.num_outputs; ++index) chosen.outputs.push_back(text(given.outputs[index]));
  if (given.num_prior_rows > 0) {
    if (given.prior_rows == nullptr) return motiongen::c::missing("prior_rows", error);
    const motiongen::Status fits = check_row_floats(*client->client.catalog(), given);
    if (!fits) return answer(fits, error);
    chosen.prior_rows.assign(given.prior_rows,
                             given.prior_rows + std::size_t{given.num_prior_rows} * given.prior_row_floats);
  }
  auto opened = client->client.open(chosen);
  if (!opened) return answer(opened.status(), error);
  *session = new motiongen_session{std::move(opened).value()};
  return answer({}, error);
}
