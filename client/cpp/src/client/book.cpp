#include "client/book.hpp"

#include <algorithm>
#include <iterator>

#include "client/frame_shift.hpp"
#include "client/placing.hpp"

namespace motiongen {
namespace {

// Of a target whose frames are known, and which applies to all of them.
std::uint64_t num_frames_of(const v1::Constraint& constraint) {
  const int frames = constraint.has_root_trajectory() ? constraint.root_trajectory().positions_size() / 2 : 1;
  return static_cast<std::uint64_t>(std::max(frames, 1));
}

// The frame of a target's result; nothing if it may be one of several.
std::optional<std::uint64_t> only_result_of(const v1::Constraint& constraint) {
  const bool is_of_any = constraint.has_last_frame() || constraint.at_any_frame();
  if (is_of_any || constraint.frames_from_effect() || constraint.has_root_path()) return std::nullopt;
  return constraint.frame() + num_frames_of(constraint) - 1;
}

}  // namespace

EditId SessionBook::add(v1::SessionEvent& event) {
  event.set_event_seq(take_seq());
  pending_.push_back({next_edit_, event, BacklogShare(backlog_, event.SpaceUsedLong()), 0});
  return next_edit_++;
}

std::optional<EditId> SessionBook::overtake(const v1::SessionEvent& event, std::uint64_t said_to) {
  if (pending_.empty() || !event.has_set_velocity()) return std::nullopt;
  Pending& newest = pending_.back();
  const bool is_unsaid = newest.event.event_seq() > said_to;
  if (!is_unsaid || !newest.event.has_set_velocity() || newest.edit + 1 != next_edit_) return std::nullopt;
  *newest.event.mutable_set_velocity() = event.set_velocity();
  ++newest.num_overtaken;
  newest.edit = next_edit_;
  return next_edit_++;
}

v1::OpenSession SessionBook::reopening(std::uint64_t base, std::uint32_t num_prior, std::string prior,
                                       std::size_t most_prompts) const {
  v1::OpenSession message = open_;
  if (!opened_) return message;
  message.clear_prompts();
  message.clear_constraints();
  for (v1::PromptSpan& span : prompts_from(base, most_prompts)) *message.add_prompts() = std::move(span);
  for (const v1::Constraint& each : constraints_) {
    auto rest = left(each, base);
    if (rest) *message.add_constraints() = std::move(*rest);
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

std::vector<v1::SessionEvent> SessionBook::repetitions(std::uint64_t base, std::uint64_t first_seq,
                                                       std::size_t most) const {
  std::vector<v1::SessionEvent> events;
  for (const Pending& each : pending_) {
    if (each.event.event_seq() < first_seq) continue;
    if (events.size() == most) break;
    auto said = shifted(each.event, base);
    if (said) events.push_back(std::move(*said));
  }
  return events;
}

void SessionBook::drop_from(std::uint64_t event_seq) {
  while (!pending_.empty() && pending_.back().event.event_seq() >= event_seq) pending_.pop_back();
  next_seq_ = event_seq;
}

std::vector<v1::SessionEvent> SessionBook::unanswered(std::uint64_t base) {
  while (!pending_.empty() && pending_.front().edit == 0) pending_.pop_front();  // what an earlier reopening added
  const auto put_first = [this](v1::SessionEvent event) {
    event.set_session(session_);
    pending_.push_front({0, std::move(event), {}, 0});
  };
  if (paused_) {
    v1::SessionEvent pause;
    pause.mutable_set_play_state()->set_state(v1::PLAY_STATE_PAUSED);
    put_first(pause);
  }
  if (velocity_ && velocity_->frame > base) {
    v1::SessionEvent event = velocity_->event;
    auto* velocity = event.mutable_set_velocity();
    const std::uint64_t frames = std::min<std::uint64_t>(velocity->hold_frames(), velocity_->frame - base);
    velocity->set_hold_frames(static_cast<std::uint32_t>(frames));
    put_first(std::move(event));
  }
  if (cut_ && cut_->frame >= base) put_first(cut_->event);
  std::vector<v1::SessionEvent> events;
  for (Pending& each : pending_) {
    each.event.set_event_seq(take_seq());
    auto said = shifted(each.event, base);
    if (said) events.push_back(std::move(*said));
  }
  return events;
}

std::vector<SessionBook::Passed> SessionBook::take_passed(std::uint64_t base) {
  std::vector<Passed> found;
  std::deque<Pending> kept;
  for (Pending& each : pending_) {
    Passed passed{each.edit, passed_targets_of(each.event, base), !shifted(each.event, base)};
    if (!passed.is_all) kept.push_back(std::move(each));
    if (passed.is_all || !passed.targets.empty()) found.push_back(std::move(passed));
  }
  pending_ = std::move(kept);
  return found;
}

std::optional<EditId> SessionBook::answer(std::uint64_t event_seq, const std::optional<Taken>& taken) {
  const auto found = std::find_if(pending_.begin(), pending_.end(),
                                  [event_seq](const Pending& each) { return each.event.event_seq() == event_seq; });
  if (found == pending_.end()) return std::nullopt;
  const EditId edit = found->edit;
  if (taken) accept(found->event, *taken);
  pending_.erase(found);
  return edit;
}

std::vector<std::uint32_t> SessionBook::targets_of(std::uint64_t event_seq) const {
  for (const Pending& each : pending_) {
    if (each.event.event_seq() == event_seq) return motiongen::targets_of(each.event);
  }
  return {};
}

EditId SessionBook::num_overtaken(std::uint64_t event_seq) const {
  const auto has_number = [event_seq](const Pending& each) { return each.event.event_seq() == event_seq; };
  const auto found = std::find_if(pending_.begin(), pending_.end(), has_number);
  return found == pending_.end() ? 0 : found->num_overtaken;
}

bool SessionBook::is_cut(std::uint64_t event_seq) const {
  return std::any_of(pending_.begin(), pending_.end(), [event_seq](const Pending& each) {
    return each.event.event_seq() == event_seq && each.event.has_seek();
  });
}

bool SessionBook::is_being_set(std::uint32_t target) const {
  const auto has_id = [target](const v1::Constraint& each) { return each.constraint_id() == target; };
  return std::any_of(pending_.begin(), pending_.end(), [&has_id](const Pending& each) {
    const auto& upsert = each.event.edit_constraints().upsert();
    return std::any_of(upsert.begin(), upsert.end(), has_id);
  });
}

bool SessionBook::is_unanswered(EditId edit) const {
  return std::any_of(pending_.begin(), pending_.end(), [edit](const Pending& each) {
    return each.edit - each.num_overtaken <= edit && edit <= each.edit;
  });
}

bool SessionBook::expects(std::uint32_t target) const {
  const auto has_id = [target](const v1::Constraint& each) { return each.constraint_id() == target; };
  return is_being_set(target) || std::any_of(constraints_.begin(), constraints_.end(), has_id);
}

bool SessionBook::excludes(std::uint32_t target, std::uint64_t frame,
                           std::optional<std::uint64_t> took_over_from) const {
  const auto has_id = [target](const v1::Constraint& each) { return each.constraint_id() == target; };
  const auto found = std::find_if(constraints_.begin(), constraints_.end(), has_id);
  if (found != constraints_.end() && begins_after(*found, frame)) return true;
  if (!took_over_from) return false;
  const auto reported_at = found == constraints_.end() ? std::nullopt : only_result_of(*found);
  return reported_at ? frame != *reported_at : frame < *took_over_from;
}

// Whether a target asks for nothing at a frame, or before it.
bool SessionBook::begins_after(const v1::Constraint& constraint, std::uint64_t frame) const {
  const auto placement = placements_.find(constraint.constraint_id());
  if (placement != placements_.end()) return frame < placement->second.first_frame;
  if (constraint.at_any_frame() || constraint.frames_from_effect() || constraint.has_root_path()) return false;
  return frame < constraint.frame();
}

std::vector<std::uint32_t> SessionBook::passed_at(std::uint64_t frame) const {
  std::vector<std::uint32_t> ids;
  for (const v1::Constraint& each : constraints_) {
    if (!left(each, frame)) ids.push_back(each.constraint_id());
  }
  return ids;
}

void SessionBook::reopened(std::uint64_t base, const std::vector<Placement>& placements) {
  // the new session has only the rest of a partly walked path, and its placement refers to that rest
  for (v1::Constraint& each : constraints_) {
    if (!each.has_root_path()) continue;
    auto rest = left(each, base);
    if (rest) each = std::move(*rest);
  }
  place(placements);
}

void SessionBook::opened(const std::vector<Placement>& placements) {
  if (opened_) return;
  opened_ = true;
  prompts_.assign(open_.prompts().begin(), open_.prompts().end());
  constraints_.assign(open_.constraints().begin(), open_.constraints().end());
  place(placements);
}

void SessionBook::forget_before(std::uint64_t frame) {
  const auto over = [&](const v1::Constraint& each) { return is_over(each, frame); };
  constraints_.erase(std::remove_if(constraints_.begin(), constraints_.end(), over), constraints_.end());
  for (auto entry = placements_.begin(); entry != placements_.end();) {
    const auto has_id = [&](const v1::Constraint& each) { return each.constraint_id() == entry->first; };
    const bool is_used = std::any_of(constraints_.begin(), constraints_.end(), has_id);
    entry = is_used ? std::next(entry) : placements_.erase(entry);
  }
}

void SessionBook::end_target(std::uint32_t target) {
  const auto has_id = [target](const v1::Constraint& each) { return each.constraint_id() == target; };
  constraints_.erase(std::remove_if(constraints_.begin(), constraints_.end(), has_id), constraints_.end());
  placements_.erase(target);
}

bool SessionBook::is_over(const v1::Constraint& constraint, std::uint64_t frame) const {
  const auto placement = placements_.find(constraint.constraint_id());
  if (placement != placements_.end()) return placement->second.last_frame < frame;
  if (constraint.at_any_frame() || constraint.frames_from_effect() || constraint.has_root_path()) return false;
  if (constraint.has_last_frame()) return constraint.last_frame() < frame;
  return constraint.frame() + num_frames_of(constraint) <= frame;
}

std::optional<v1::Constraint> SessionBook::left(const v1::Constraint& constraint, std::uint64_t frame) const {
  if (is_over(constraint, frame)) return std::nullopt;
  const auto placement = placements_.find(constraint.constraint_id());
  if (placement != placements_.end() && constraint.has_root_path()) {
    return path_left(constraint, placement->second, frame);
  }
  v1::Constraint rest = constraint;
  if (!shift(rest, frame)) return std::nullopt;
  return rest;
}

void SessionBook::place(const std::vector<Placement>& placements) {
  for (const Placement& each : placements) {
    for (v1::Constraint& constraint : constraints_) {
      if (constraint.constraint_id() != each.target) continue;
      constraint = placed(constraint, each);
      placements_[each.target] = each;
    }
  }
}

void SessionBook::accept(const v1::SessionEvent& event, const Taken& taken) {
  if (event.has_edit_prompts()) {
    accept_prompts(event.edit_prompts(), taken);
  } else if (event.has_edit_constraints()) {
    const auto& edit = event.edit_constraints();
    const auto is_gone = [&edit](const v1::Constraint& each) {
      const auto has_id = [&each](const v1::Constraint& other) {
        return other.constraint_id() == each.constraint_id();
      };
      return edit.clear() || std::count(edit.remove().begin(), edit.remove().end(), each.constraint_id()) != 0 ||
             std::any_of(edit.upsert().begin(), edit.upsert().end(), has_id);
    };
    constraints_.erase(std::remove_if(constraints_.begin(), constraints_.end(), is_gone), constraints_.end());
    for (const auto& each : edit.upsert()) placements_.erase(each.constraint_id());
    constraints_.insert(constraints_.end(), edit.upsert().begin(), edit.upsert().end());
    place(taken.placements);
  } else if (event.has_set_velocity()) {
    velocity_ = Held{event, taken.effective_frame + event.set_velocity().hold_frames()};
  } else if (event.has_seek()) {
    cut_ = Held{event, taken.effective_frame};
  } else if (event.has_set_options()) {
    accept_options(event.set_options());
  } else if (event.has_set_play_state()) {
    paused_ = event.set_play_state().state() == v1::PLAY_STATE_PAUSED;
  }
}

void SessionBook::accept_options(const v1::SetOptions& options) {
  if (options.has_priority()) open_.set_priority(options.priority());
  if (options.has_lookahead_frames()) open_.set_lookahead_frames(options.lookahead_frames());
  if (options.has_denoise_steps()) open_.set_denoise_steps(options.denoise_steps());
  if (options.has_history_frames()) open_.set_history_frames(options.history_frames());
  if (options.has_guidance()) *open_.mutable_guidance() = options.guidance();
}

}  // namespace motiongen
