// The prompts of a session's book: which are in force until when, and which of them a session opened anew gets.
#include <algorithm>
#include <iterator>
#include <optional>
#include <utility>
#include <vector>

#include "client/book.hpp"
#include "client/frame_shift.hpp"

namespace motiongen {
namespace {

// What is left of a span once another takes its place at `frame`; nothing if it would not begin before that. A span
// that had been cut short for one that now never begins, at `never_begins`, lasts until `frame` instead.
std::optional<v1::PromptSpan> until(std::uint64_t frame, const v1::PromptSpan& span,
                                    std::optional<std::uint64_t> never_begins) {
  const bool was_cut_for_that = never_begins && span.end_frame() == *never_begins;
  const std::uint64_t own_end = span.end_frame() != 0 && !was_cut_for_that ? span.end_frame() : frame;
  const std::uint64_t end = std::min<std::uint64_t>(own_end, frame);
  if (span.start_frame() >= end) return std::nullopt;
  v1::PromptSpan left = span;
  left.set_end_frame(end);
  return left;
}

// Keeps only the last span of each id, without those that a later one replaces.
void keep_last_of_each(std::vector<v1::PromptSpan>& spans) {
  std::vector<v1::PromptSpan> last;
  for (auto span = spans.begin(); span != spans.end(); ++span) {
    const auto is_another = [&span](const v1::PromptSpan& each) { return each.prompt_id() == span->prompt_id(); };
    if (std::none_of(std::next(span), spans.end(), is_another)) last.push_back(*span);
  }
  spans = std::move(last);
}

}  // namespace

bool SessionBook::is_being_changed(std::uint32_t prompt_id) const {
  return std::any_of(pending_.begin(), pending_.end(), [prompt_id](const Pending& each) {
    const auto& edit = each.event.edit_prompts();
    const auto has_id = [prompt_id](const v1::PromptSpan& span) { return span.prompt_id() == prompt_id; };
    return std::count(edit.remove().begin(), edit.remove().end(), prompt_id) != 0 ||
           std::any_of(edit.upsert().begin(), edit.upsert().end(), has_id);
  });
}

std::vector<std::uint32_t> SessionBook::begun_prompts(std::uint64_t playhead, bool spare_last) const {
  std::vector<std::pair<std::uint64_t, std::uint32_t>> begun;
  for (const v1::PromptSpan& span : prompts_) {
    const bool goes_by_itself = span.prompt_id() == kPresentPrompt || span.end_frame() != 0;
    if (goes_by_itself || span.start_frame() > playhead || is_being_changed(span.prompt_id())) continue;
    begun.emplace_back(span.start_frame(), span.prompt_id());
  }
  std::sort(begun.begin(), begun.end());
  if (spare_last && !begun.empty()) begun.pop_back();
  std::vector<std::uint32_t> ids;
  for (const auto& each : begun) ids.push_back(each.second);
  return ids;
}

std::vector<v1::PromptSpan> SessionBook::prompts_from(std::uint64_t base, std::size_t most) const {
  std::vector<v1::PromptSpan> held = prompts_;
  const auto later = std::stable_partition(held.begin(), held.end(),
                                           [base](const v1::PromptSpan& each) { return each.start_frame() <= base; });
  // they all begin at the same frame now: the one that is in force must come last
  std::stable_sort(held.begin(), later,
                   [](const v1::PromptSpan& a, const v1::PromptSpan& b) { return a.start_frame() < b.start_frame(); });
  std::vector<v1::PromptSpan> spans;
  for (v1::PromptSpan& span : held) {
    if (shift(span, base)) spans.push_back(std::move(span));
  }
  if (spans.size() > most) keep_last_of_each(spans);
  return spans;
}

void SessionBook::accept_prompts(const v1::EditPrompts& edit, const Taken& taken) {
  const auto is_gone = [&](const v1::PromptSpan& each) {
    const bool has_ended = each.end_frame() != 0 && each.end_frame() <= taken.playhead;
    return has_ended || std::count(edit.remove().begin(), edit.remove().end(), each.prompt_id()) != 0;
  };
  prompts_.erase(std::remove_if(prompts_.begin(), prompts_.end(), is_gone), prompts_.end());
  for (const v1::PromptSpan& each : edit.upsert()) {
    v1::PromptSpan span = each;
    span.set_start_frame(std::max<std::uint64_t>(span.start_frame(), taken.effective_frame));
    put_prompt(std::move(span), taken.playhead);
  }
}

// A span with the same id that has begun goes on until the new one starts, as it does at the server.
void SessionBook::put_prompt(v1::PromptSpan span, std::uint64_t playhead) {
  const auto is_its = [&span](const v1::PromptSpan& each) { return each.prompt_id() == span.prompt_id(); };
  const auto newest = std::find_if(prompts_.rbegin(), prompts_.rend(), is_its);
  std::optional<std::uint64_t> never_begins;
  if (newest != prompts_.rend() && newest->start_frame() > playhead) {
    never_begins = newest->start_frame();
    prompts_.erase(std::prev(newest.base()));
  }
  std::vector<v1::PromptSpan> held;
  for (const v1::PromptSpan& each : prompts_) {
    auto left = is_its(each) ? until(span.start_frame(), each, never_begins) : each;
    if (left) held.push_back(std::move(*left));
  }
  held.push_back(std::move(span));
  prompts_ = std::move(held);
}

}  // namespace motiongen
