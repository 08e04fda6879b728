#include "client/frame_shift.hpp"

#include <algorithm>
#include <cstddef>

namespace motiongen {
namespace {

constexpr std::uint64_t kNever = std::uint64_t{1} << 53;  // no session reaches this frame: a Seek to it is refused

// Make all count from `base` and remove those that have passed. Returns whether any has.
template <class Each>
bool shift_all(google::protobuf::RepeatedPtrField<Each>& all, std::uint64_t base) {
  const auto has_passed = [base](Each& each) { return !shift(each, base); };
  const auto end = std::remove_if(all.begin(), all.end(), has_passed);
  const bool any = end != all.end();
  all.erase(end, all.end());
  return any;
}

}  // namespace

bool shift(v1::PromptSpan& span, std::uint64_t base) {
  if (span.end_frame() != 0 && span.end_frame() <= base) return false;
  if (span.end_frame() != 0) span.set_end_frame(span.end_frame() - base);
  span.set_start_frame(span.start_frame() <= base ? 0 : span.start_frame() - base);
  return true;
}

bool shift(v1::Constraint& constraint, std::uint64_t base) {
  if (constraint.at_any_frame() || constraint.frames_from_effect() || constraint.has_root_path()) return true;
  if (constraint.has_last_frame()) {
    if (constraint.last_frame() < base) return false;
    constraint.set_last_frame(constraint.last_frame() - base);
    constraint.set_frame(constraint.frame() <= base ? 0 : constraint.frame() - base);
    return true;
  }
  if (constraint.frame() >= base) {
    constraint.set_frame(constraint.frame() - base);
    return true;
  }
  if (!constraint.has_root_trajectory()) return false;
  auto* way = constraint.mutable_root_trajectory();
  const auto passed = base - constraint.frame();
  if (2 * passed >= static_cast<std::uint64_t>(way->positions_size())) return false;
  const auto count = static_cast<std::ptrdiff_t>(passed);
  way->mutable_positions()->erase(way->positions().begin(), way->positions().begin() + 2 * count);
  if (way->headings_size() > 0) {
    way->mutable_headings()->erase(way->headings().begin(), way->headings().begin() + count);
  }
  constraint.set_frame(0);
  return true;
}

std::optional<v1::SessionEvent> shifted(v1::SessionEvent event, std::uint64_t base) {
  if (base == 0) return event;
  if (event.has_edit_prompts()) {
    auto& edit = *event.mutable_edit_prompts();
    const bool has_passed = shift_all(*edit.mutable_upsert(), base);
    if (has_passed && edit.upsert().empty()) return std::nullopt;
  }
  if (event.has_edit_constraints()) {
    auto& edit = *event.mutable_edit_constraints();
    const bool has_passed = shift_all(*edit.mutable_upsert(), base);
    if (has_passed && edit.upsert().empty() && edit.remove().empty() && !edit.clear()) return std::nullopt;
  }
  if (event.has_seek() && event.seek().frame() != 0) {
    const std::uint64_t frame = event.seek().frame();
    event.mutable_seek()->set_frame(frame > base ? frame - base : kNever);
  }
  return event;
}

std::vector<std::uint32_t> targets_of(const v1::SessionEvent& event) {
  std::vector<std::uint32_t> ids;
  for (const v1::Constraint& each : event.edit_constraints().upsert()) ids.push_back(each.constraint_id());
  return ids;
}

std::vector<std::uint32_t> passed_targets_of(const v1::SessionEvent& event, std::uint64_t base) {
  std::vector<std::uint32_t> ids;
  for (v1::Constraint each : event.edit_constraints().upsert()) {
    if (!shift(each, base)) ids.push_back(each.constraint_id());
  }
  return ids;
}

}  // namespace motiongen
