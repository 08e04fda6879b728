#include "client/book.hpp"

#include <algorithm>
#include <iterator>

namespace motiongen {
namespace {

std::uint64_t last_frame(const v1::Constraint& constraint) {
  const int frames = constraint.has_root_trajectory() ? constraint.root_trajectory().positions_size() / 2 : 1;
  return constraint.frame() + static_cast<std::uint64_t>(std::max(frames, 1)) - 1;
}

// A span counted from `base`; false where it is over by then. A start that has passed is "as soon as possible".
bool shift(v1::PromptSpan& span, std::uint64_t base) {
  if (span.end_frame() != 0 && span.end_frame() <= base) return false;
  if (span.end_frame() != 0) span.set_end_frame(span.end_frame() - base);
  span.set_start_frame(span.start_frame() <= base ? 0 : span.start_frame() - base);
  return true;
}

// A constraint counted from `base`, a path without the part that has passed; false where all of it has.
bool shift(v1::Constraint& constraint, std::uint64_t base) {
  if (last_frame(constraint) < base) return false;
  if (constraint.frame() >= base) {
    constraint.set_frame(constraint.frame() - base);
    return true;
  }
  const int passed = static_cast<int>(base - constraint.frame());
  auto* path = constraint.mutable_root_trajectory();
  path->mutable_positions()->erase(path->positions().begin(), path->positions().begin() + 2 * passed);
  if (path->headings_size() > 0) {
    path->mutable_headings()->erase(path->headings().begin(), path->headings().begin() + passed);
  }
  constraint.set_frame(0);
  return true;
}

}  // namespace

std::vector<std::uint32_t> SessionBook::begun_prompts(std::uint64_t playhead, bool spare_last) const {
  std::vector<std::pair<std::uint64_t, std::uint32_t>> begun;
  for (const auto& [id, span] : prompts_) {
    if (id != kPresentPrompt && span.start_frame() <= playhead) begun.emplace_back(span.start_frame(), id);
  }
  std::sort(begun.begin(), begun.end());
  if (spare_last && !begun.empty()) begun.pop_back();
  std::vector<std::uint32_t> ids;
  for (const auto& each : begun) ids.push_back(each.second);
  return ids;
}

EditId SessionBook::add(v1::SessionEvent& event) {
  event.set_event_seq(take_seq());
  pending_.push_back({next_edit_, event});
  return next_edit_++;
}

v1::OpenSession SessionBook::reopening(std::uint64_t base, std::uint32_t num_prior, std::string prior) const {
  v1::OpenSession message = open_;
  if (!opened_) return message;
  message.clear_prompts();
  message.clear_constraints();
  for (const auto& entry : prompts_) {
    v1::PromptSpan span = entry.second;
    if (shift(span, base)) *message.add_prompts() = std::move(span);
  }
  for (const auto& entry : constraints_) {
    v1::Constraint constraint = entry.second;
    if (shift(constraint, base)) *message.add_constraints() = std::move(constraint);
  }
  if (num_prior > 0) {
    message.clear_start_pose();
    auto* frames = message.mutable_prior_frames();
    frames->set_frame_count(num_prior);
    frames->set_scalar_type(v1::SCALAR_TYPE_F32_LE);
    frames->set_data(std::move(prior));
  }
  return message;
}

std::vector<v1::SessionEvent> SessionBook::repetitions(std::uint64_t base) const {
  std::vector<v1::SessionEvent> events;
  for (const Pending& each : pending_) events.push_back(shifted(each.event, base));
  return events;
}

std::vector<v1::SessionEvent> SessionBook::unanswered(std::uint64_t base) {
  std::vector<v1::SessionEvent> events;
  if (!pending_.empty() && pending_.front().edit == 0) pending_.pop_front();  // the pause of the time before
  if (paused_) {
    v1::SessionEvent pause;
    pause.set_session(session_);
    pause.mutable_set_play_state()->set_state(v1::PLAY_STATE_PAUSED);
    pending_.push_front({0, pause});
  }
  for (Pending& each : pending_) {
    each.event.set_event_seq(take_seq());
    events.push_back(shifted(each.event, base));
  }
  return events;
}

v1::SessionEvent SessionBook::shifted(v1::SessionEvent event, std::uint64_t base) {
  if (base == 0) return event;
  // What has passed is left in at frame 0 or 1: the server refuses it by its own rule, and the edit gets its answer.
  if (event.has_edit_prompts()) {
    for (auto& span : *event.mutable_edit_prompts()->mutable_upsert()) {
      if (!shift(span, base)) {
        span.set_start_frame(0);
        span.set_end_frame(1);
      }
    }
  }
  if (event.has_edit_constraints()) {
    for (auto& constraint : *event.mutable_edit_constraints()->mutable_upsert()) {
      if (!shift(constraint, base)) constraint.set_frame(0);
    }
  }
  return event;
}

std::optional<EditId> SessionBook::answer(std::uint64_t event_seq, bool accepted) {
  const auto found = std::find_if(pending_.begin(), pending_.end(),
                                  [event_seq](const Pending& each) { return each.event.event_seq() == event_seq; });
  if (found == pending_.end()) return std::nullopt;
  const EditId edit = found->edit;
  if (accepted) accept(found->event);
  pending_.erase(found);
  return edit;
}

void SessionBook::opened() {
  if (opened_) return;
  opened_ = true;
  for (const auto& span : open_.prompts()) prompts_[span.prompt_id()] = span;
  for (const auto& constraint : open_.constraints()) constraints_[constraint.constraint_id()] = constraint;
}

void SessionBook::forget_before(std::uint64_t frame) {
  for (auto entry = constraints_.begin(); entry != constraints_.end();) {
    entry = last_frame(entry->second) < frame ? constraints_.erase(entry) : std::next(entry);
  }
}

void SessionBook::accept(const v1::SessionEvent& event) {
  if (event.has_edit_prompts()) {
    for (const std::uint32_t id : event.edit_prompts().remove()) prompts_.erase(id);
    for (const auto& span : event.edit_prompts().upsert()) prompts_[span.prompt_id()] = span;
  } else if (event.has_edit_constraints()) {
    if (event.edit_constraints().clear()) constraints_.clear();
    for (const std::uint32_t id : event.edit_constraints().remove()) constraints_.erase(id);
    for (const auto& each : event.edit_constraints().upsert()) constraints_[each.constraint_id()] = each;
  } else if (event.has_set_play_state()) {
    paused_ = event.set_play_state().state() == v1::PLAY_STATE_PAUSED;
  }
}

}  // namespace motiongen
