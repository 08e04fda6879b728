#include "client/reached.hpp"

#include <algorithm>
#include <utility>

namespace motiongen {
namespace {

std::uint32_t target_of(const Reached& each) { return each.target; }
std::uint32_t target_of(const Placement& each) { return each.target; }
std::uint32_t target_of(const std::pair<std::uint32_t, Status>& each) { return each.first; }

template <class Each>
void keep(Each each, std::size_t most, std::deque<Each>& in) {
  in.push_back(std::move(each));
  if (in.size() > most) in.pop_front();
}

// The newest entry of a target, if any.
template <class Each>
std::optional<Each> newest(const std::deque<Each>& in, std::uint32_t target) {
  const auto found =
      std::find_if(in.rbegin(), in.rend(), [target](const Each& each) { return target_of(each) == target; });
  return found == in.rend() ? std::nullopt : std::optional<Each>(*found);
}

template <class Each>
void erase(std::deque<Each>& in, std::uint32_t target) {
  const auto is_its = [target](const Each& each) { return target_of(each) == target; };
  in.erase(std::remove_if(in.begin(), in.end(), is_its), in.end());
}

}  // namespace

bool ReachedBook::note(const Reached& told, bool is_former) {
  const std::pair<std::uint32_t, std::uint64_t> news(told.target, told.frame);
  if (std::find(heard_.begin(), heard_.end(), news) != heard_.end()) return false;
  keep(news, kKept, heard_);
  if (is_former) return true;
  const auto replaced = forgotten_.find(told.target);
  if (replaced != forgotten_.end()) {
    replaced->second.told = told;  // of the old target: a server reports the new one only after its answer
  } else {
    keep(told, kKept, told_);
  }
  return true;
}

void ReachedBook::note(const Placement& placed) {
  const auto replaced = forgotten_.find(placed.target);
  if (replaced != forgotten_.end()) {
    replaced->second.placed = placed;  // of the old target: the one that replaces it may not have a placement
  } else {
    keep(placed, kKept, placements_);
  }
}

void ReachedBook::refuse(std::uint32_t target, const Status& why) {
  if (!find(target)) keep({target, why}, kKept, refused_);
}

void ReachedBook::forget(std::uint32_t target) {
  Forgotten& kept = forgotten_[target];
  if (auto told = find(target)) kept.told = told;
  if (auto placed = find_placement(target)) kept.placed = placed;
  if (auto why = find_refusal(target)) kept.refused = why;
  erase(told_, target);
  erase(placements_, target);
  erase(refused_, target);
}

void ReachedBook::begin_replay() { is_replay_ = true; }

void ReachedBook::end_replay() {
  is_replay_ = false;
  took_over_.clear();
}

void ReachedBook::take_over(std::uint32_t target, std::uint64_t effective_frame) {
  if (is_replay_ && forgotten_.count(target) != 0) took_over_[target] = effective_frame;
}

std::optional<std::uint64_t> ReachedBook::took_over_from(std::uint32_t target) const {
  const auto found = took_over_.find(target);
  return found == took_over_.end() ? std::nullopt : std::optional<std::uint64_t>(found->second);
}

void ReachedBook::settle(std::uint32_t target, bool was_taken, bool is_last) {
  const auto kept = forgotten_.find(target);
  if (kept == forgotten_.end()) return;
  const Forgotten before = std::exchange(kept->second, {});
  if (is_last) forgotten_.erase(kept);
  if (was_taken) return;
  if (before.told && !find(target)) keep(*before.told, kKept, told_);
  if (before.placed && !find_placement(target)) keep(*before.placed, kKept, placements_);
  if (before.refused) refuse(target, *before.refused);
}

std::optional<Reached> ReachedBook::find(std::uint32_t target) const { return newest(told_, target); }

std::optional<Placement> ReachedBook::find_placement(std::uint32_t target) const { return newest(placements_, target); }

std::optional<Status> ReachedBook::find_refusal(std::uint32_t target) const {
  const auto found = newest(refused_, target);
  return found ? std::optional<Status>(found->second) : std::nullopt;
}

}  // namespace motiongen
