#include "character.hpp"

#include <algorithm>
#include <cmath>

namespace motiongen::load {
namespace {

constexpr double kStartGraceS = 1;  // after its intended open; a character that shows nothing by then misses frames

}  // namespace

PlayedCharacter::PlayedCharacter(Run& run, std::uint32_t handle, const Character& plan)
    : run_(run), handle_(handle), plan_(plan), due_from_s_(plan.open_s() + kStartGraceS) {}

// ---- sending

std::uint64_t PlayedCharacter::take_seq(std::optional<double> intended_s) {
  if (intended_s) edits_[next_seq_].intended_s = *intended_s;
  return next_seq_++;
}

std::uint64_t PlayedCharacter::playhead(double now_s) const {
  const double frame = std::min((now_s - epoch_s_) / run_.frame_s(), static_cast<double>(buffered_to_) - 1);
  return static_cast<std::uint64_t>(std::max(frame, 0.0));
}

void PlayedCharacter::put_report(double now_s, std::string& to) const {
  const double past_s = (now_s - epoch_s_) / run_.frame_s() - static_cast<double>(buffered_to_) + 1;
  const auto held_now = static_cast<std::uint32_t>(std::max(past_s, 0.0));  // not counted yet
  wire::put_playhead(handle_, playhead(now_s), buffered_to_, missed_ + held_now, 0, to);
}

// ---- receiving

void PlayedCharacter::take_plan(const v1::PlanNotice& notice, double now_s) {
  plan_number_ = notice.plan();
  run_.recorder.count("plans");
  if (notice.cause() != v1::PLAN_CAUSE_CONTINUE) run_.recorder.count("replans");
  if (notice.valid_from() < buffered_to_) {
    run_.recorder.count("frames_superseded", buffered_to_ - notice.valid_from());
    if (started_) {
      shown_to_ = playhead(now_s) + 1;
      if (notice.valid_from() < shown_to_) run_.recorder.count("shown_frames_replaced");
    }
    buffered_to_ = notice.valid_from();
  }
  for (const std::uint64_t seq : notice.event_seqs()) {
    const auto edit = edits_.find(seq);
    if (edit != edits_.end()) edit->second.first_frame = notice.valid_from();
  }
}

void PlayedCharacter::take_chunk(const ChunkHeader& chunk, double now_s) {
  const std::uint64_t first = chunk.first_frame;
  const std::uint64_t end = first + chunk.num_frames;
  if (chunk.plan != plan_number_ || first != buffered_to_) {
    run_.recorder.count("protocol_breaches");  // a chunk of another plan, or with a gap or overlap
    if (chunk.plan != plan_number_) return;
  }
  run_.recorder.add(Figure::frames, plan_.group(), now_s, chunk.num_frames);
  if (!started_) start(first, now_s);
  const std::uint64_t needed = std::max(first, shown_to_);
  if (needed < end) meet_deadline(needed, now_s);
  buffered_to_ = end;
  committed_to_ = chunk.committed_to;
  if (!edits_.empty()) find_changed(end, now_s);
}

void PlayedCharacter::take_outcome(const v1::EditOutcome& outcome, double now_s) {
  const auto found = edits_.find(outcome.event_seq());
  if (found == edits_.end()) return;
  Edit& edit = found->second;
  record(Latency::answer, edit.intended_s, now_s);
  edit.answered = true;
  if (outcome.code() == 0 && !outcome.has_effective_frame()) {
    run_.recorder.count("edits_that_changed_nothing");
  } else if (outcome.code() == 0 && !edit.changed) {
    if (edit.first_frame) return;
    run_.recorder.count("edits_beyond_the_plan");  // the arrival of their frames says nothing about the server
  }
  edits_.erase(found);
}

// ---- measuring

void PlayedCharacter::look(double now_s) {
  if (showing_.empty()) return;
  const std::uint64_t shown = playhead(now_s);
  const auto has_shown = [&](const Showing& each) {
    const double at_s = std::max(due_s(each.frame), each.arrived_s);
    if (shown < each.frame || at_s > now_s) return false;
    record(Latency::screen, each.intended_s, at_s);
    return true;
  };
  showing_.erase(std::remove_if(showing_.begin(), showing_.end(), has_shown), showing_.end());
}

void PlayedCharacter::end(double now_s, bool as_planned) {
  if (ended_) return;
  ended_ = true;
  if (!open_sent_) return;
  look(now_s);
  const double end_s = as_planned ? now_s : std::min(close_s(), run_.load.end_s());
  count_missed(started_ ? due_s(buffered_to_) : due_from_s_, end_s);
  run_.recorder.add_span(Figure::due, plan_.group(), due_from_s_, end_s, run_.load.frame_rate());
  if (started_) return;
  run_.recorder.count("characters_without_a_frame");
  run_.recorder.record(Latency::open, plan_.group(), end_s - plan_.open_s());  // it waited at least so long
}

void PlayedCharacter::give_up_edits(double now_s) {
  for (const auto& entry : edits_) {
    const Edit& edit = entry.second;
    if (edit.changed || !run_.measures(edit.intended_s)) continue;
    run_.recorder.count("edits_unanswered");
    record(Latency::event, edit.intended_s, now_s);
  }
  edits_.clear();
}

void PlayedCharacter::drop_edits() {
  const auto cut_off =
      std::count_if(edits_.begin(), edits_.end(), [](const auto& entry) { return !entry.second.changed; });
  if (cut_off > 0) run_.recorder.count("edits_cut_off_by_a_close", static_cast<std::uint64_t>(cut_off));
  edits_.clear();
}

// ---- arithmetic

// When the game's loop asks for a frame.
double PlayedCharacter::due_s(std::uint64_t frame) const {
  const auto period = static_cast<std::uint64_t>(run_.load.jitter_s_size());
  const double jitter_s = run_.load.jitter_s(static_cast<int>((handle_ * std::uint64_t{31} + frame) % period));
  return epoch_s_ + static_cast<double>(frame) * run_.frame_s() + jitter_s;
}

void PlayedCharacter::start(std::uint64_t first, double now_s) {
  started_ = true;
  run_.recorder.record(Latency::open, plan_.group(), now_s - plan_.open_s());
  count_missed(due_from_s_, now_s);
  due_from_s_ = std::min(due_from_s_, now_s);
  epoch_s_ = now_s - static_cast<double>(first) * run_.frame_s();
  shown_to_ = first;
}

void PlayedCharacter::meet_deadline(std::uint64_t frame, double now_s) {
  const double at_s = due_s(frame);
  const bool measured = run_.measures(now_s);
  if (measured) {
    run_.recorder.record(Latency::lateness, plan_.group(), std::max(now_s - at_s, 0.0));
    run_.recorder.record(Latency::slack, plan_.group(), std::max(at_s - now_s, 0.0));
  }
  if (now_s <= at_s) return;
  look(now_s);
  if (measured) run_.recorder.count("late_chunks");
  const std::uint32_t held = count_missed(at_s, now_s);
  missed_ += held;
  epoch_s_ += held * run_.frame_s();
}

// Count one underrun: the whole frame times from due_s until now with no new frame to show. Returns their number.
std::uint32_t PlayedCharacter::count_missed(double due_s, double now_s) {
  if (now_s <= due_s) return 0;
  const auto held = static_cast<std::uint32_t>((now_s - due_s) / run_.frame_s()) + 1;
  run_.recorder.add(Figure::underruns, plan_.group(), due_s);
  for (std::uint32_t number = 0; number < held; ++number) {
    run_.recorder.add(Figure::missed, plan_.group(), due_s + number * run_.frame_s());
  }
  return held;
}

void PlayedCharacter::find_changed(std::uint64_t end, double now_s) {
  for (auto each = edits_.begin(); each != edits_.end();) {
    Edit& edit = each->second;
    const bool changes = !edit.changed && edit.first_frame && *edit.first_frame < end;
    if (changes) {
      edit.changed = true;
      record(Latency::event, edit.intended_s, now_s);
      showing_.push_back({edit.intended_s, *edit.first_frame, now_s});
    }
    each = changes && edit.answered ? edits_.erase(each) : std::next(each);
  }
}

void PlayedCharacter::record(Latency what, double intended_s, double now_s) {
  if (run_.measures(intended_s)) run_.recorder.record(what, plan_.group(), now_s - intended_s);
}

}  // namespace motiongen::load
