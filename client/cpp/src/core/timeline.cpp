// The timeline's part that takes what arrives from the server and holds it.
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <iterator>
#include <utility>

#include "timeline_state.hpp"

namespace motiongen {
namespace {

constexpr std::uint32_t kMostReserved = 1 << 20;
constexpr std::ptrdiff_t kMostCutsAhead = 64;                     // cuts whose frames are still to come
constexpr std::size_t kMostReservedBytes = std::size_t{1} << 26;  // more is allocated as frames arrive

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "rows are copied from the wire as they are, and the wire is little endian"
#endif

std::string number(std::uint64_t value) { return std::to_string(value); }

}  // namespace

void RowSpan::take(std::size_t count, void* to) {
  if (to != nullptr) std::memcpy(to, reinterpret_cast<const char*>(numbers_.data()) + taken_, count);
  taken_ += count;
}

Timeline::Timeline(std::unique_ptr<State> state) : state_(std::move(state)) {}
Timeline::Timeline(Timeline&&) noexcept = default;
Timeline& Timeline::operator=(Timeline&&) noexcept = default;
Timeline::~Timeline() = default;

Result<Timeline> Timeline::make(const TimelineOptions& options) {
  if (!(options.frame_rate_hz > 0) || !std::isfinite(options.frame_rate_hz)) {
    return invalid("frame_rate_hz", std::to_string(options.frame_rate_hz), "a finite number above 0");
  }
  if (options.row_width == 0) return invalid("row_width", "0", "a whole number of 1 or more");
  if (options.reserve_frames > kMostReserved ||
      (options.keep_frames > TimelineOptions::kMostKept && options.keep_frames != TimelineOptions::kKeepAll)) {
    return invalid("keep_frames, reserve_frames", number(options.keep_frames) + ", " + number(options.reserve_frames),
                   "up to " + number(kMostReserved) + " frames, or kKeepAll");
  }
  if (options.start_frame > kLastFrame) {
    return invalid("start_frame", number(options.start_frame), "at most " + number(kLastFrame));
  }
  const std::size_t kept = options.keep_frames == TimelineOptions::kKeepAll ? 0 : options.keep_frames;
  const std::size_t most = kMostReservedBytes / (options.row_width * sizeof(float));
  auto state = std::make_unique<State>(options, std::min(kept + options.reserve_frames, most) + 1);
  state->playhead = state->committed_to = state->first_kept = state->received_to = options.start_frame;
  return Timeline(std::move(state));
}

Status Timeline::announce_plan(std::uint32_t plan, std::uint64_t valid_from, bool is_cut) {
  State& s = *state_;
  if (plan <= s.plan) {
    return violation("plan " + number(plan) + " was announced after plan " + number(s.plan) + "; plans must rise");
  }
  if (valid_from < s.committed_to) {
    return violation("plan " + number(plan) + " replaces frames from " + number(valid_from) + ", but frames below " +
                     number(s.committed_to) + " are committed");
  }
  if (valid_from > kLastFrame) {
    return violation("plan " + number(plan) + " begins at frame " + number(valid_from) +
                     "; frames are numbered up to " + number(kLastFrame));
  }
  const std::uint64_t first_replaceable = s.started ? std::max(valid_from, s.playhead + 1) : valid_from;
  const auto replaced = std::lower_bound(s.cuts.begin(), s.cuts.end(), first_replaceable);
  if (is_cut && replaced - std::upper_bound(s.cuts.begin(), replaced, s.received_to) >= kMostCutsAhead) {
    return violation("more than " + std::to_string(kMostCutsAhead) + " cuts were announced before their frames");
  }
  s.plan = plan;
  s.cuts.erase(replaced, s.cuts.end());
  // the newest cut behind the frames kept stays: `sample` may not have been called since
  const auto kept = std::upper_bound(s.cuts.begin(), s.cuts.end(), s.first_kept);
  if (kept != s.cuts.begin()) s.cuts.erase(s.cuts.begin(), std::prev(kept));
  if (first_replaceable > valid_from) s.passed = {valid_from, first_replaceable};
  if (is_cut) s.cuts.push_back(first_replaceable);
  if (valid_from > s.received_to) return {};  // frames before it that are still to come will carry this plan's number
  s.received_to = valid_from;
  if (valid_from < first_replaceable) ++s.late_plans;
  if (s.buffered_to() > first_replaceable) {
    s.rows.drop_back(s.buffered_to() - first_replaceable);
    s.replaced_from = std::min(s.replaced_from, first_replaceable);
  }
  return {};
}

Status Timeline::add_chunk(const ChunkHeader& header, RowSource& rows) {
  State& s = *state_;
  if (header.plan != s.plan) {
    return violation("a chunk of plan " + number(header.plan) + " arrived, but the latest plan is " + number(s.plan));
  }
  if (header.plan == 0) return violation("a chunk arrived before any plan was announced");  // numbered from 1
  if (header.first_frame != s.received_to) {
    return violation("a chunk begins at frame " + number(header.first_frame) + "; the next frame is " +
                     number(s.received_to));
  }
  const std::size_t row_bytes = s.options.row_width * sizeof(float);
  if (header.num_frames < 1 || rows.num_bytes() != header.num_frames * row_bytes) {
    return violation("a chunk of " + number(header.num_frames) + " frames has " + number(rows.num_bytes()) +
                     " bytes, not the " + number(header.num_frames * row_bytes) + " of its rig");
  }
  if (header.committed_to < s.committed_to) {
    return violation("committed_to fell from " + number(s.committed_to) + " to " + number(header.committed_to));
  }
  const std::uint64_t end = header.first_frame + header.num_frames;
  if (end > kLastFrame || header.committed_to > kLastFrame) {
    return violation("a chunk has frames up to " + number(end) + ", committed up to " + number(header.committed_to) +
                     "; frames are numbered up to " + number(kLastFrame));
  }
  const std::uint64_t ahead = end > s.playhead ? end - s.playhead : 0;
  if (ahead > kMostAheadBytes / row_bytes) {
    return violation("frame " + number(end - 1) + " came while " + number(s.playhead) + " is played; at most " +
                     number(kMostAheadBytes / row_bytes) + " frames are held ahead");
  }
  s.committed_to = header.committed_to;
  const std::uint64_t shown = std::min<std::uint64_t>(s.buffered_to() - header.first_frame, header.num_frames);
  if (shown > 0) rows.take(shown * row_bytes, nullptr);
  for (std::uint64_t row = shown; row < header.num_frames; ++row) rows.take(row_bytes, s.rows.push());
  s.received_to = end;
  return {};
}

std::uint64_t Timeline::note_cut(std::uint64_t frame) {
  State& s = *state_;
  const bool was_shown = s.passed.first <= frame && frame < s.passed.end;
  const std::uint64_t shows_at = was_shown ? s.passed.end : frame;
  const auto place = std::lower_bound(s.cuts.begin(), s.cuts.end(), shows_at);
  if (place == s.cuts.end() || *place != shows_at) s.cuts.insert(place, shows_at);
  return shows_at;
}

void Timeline::continue_with_new_plans() {
  State& s = *state_;
  s.plan = 0;
  s.received_to = s.buffered_to();
  s.committed_to = s.received_to;  // all frames held will be shown: the new session begins after them
}

Result<Span<const float>> Timeline::row(std::uint64_t frame) const {
  const State& s = *state_;
  if (frame < s.first_kept || frame >= s.buffered_to()) {
    return Status(Code::out_of_range, "FRAME_NOT_HELD",
                  "frame: " + number(frame) + " was given; held are frames from " + number(s.first_kept) +
                      " up to, not with, " + number(s.buffered_to()));
  }
  return s.row(frame);
}

bool Timeline::is_cut(std::uint64_t frame) const { return state_->is_cut(frame); }

std::optional<std::uint64_t> Timeline::cut_before(std::uint64_t frame) const {
  const auto& cuts = state_->cuts;
  const auto after = std::lower_bound(cuts.begin(), cuts.end(), frame);
  if (after == cuts.begin()) return std::nullopt;
  return *std::prev(after);
}

bool Timeline::started() const { return state_->started; }
std::uint64_t Timeline::playhead() const { return state_->playhead; }
float Timeline::share() const {
  const bool may_mix = state_->buffered_to() > state_->playhead + 1 && !state_->is_cut(state_->playhead + 1);
  return may_mix ? state_->blend : 0;
}
std::uint64_t Timeline::buffered_to() const { return state_->buffered_to(); }
std::uint64_t Timeline::received_to() const { return state_->received_to; }
std::uint64_t Timeline::first_kept() const { return state_->first_kept; }
std::uint64_t Timeline::committed_to() const { return state_->committed_to; }
std::uint32_t Timeline::plan() const { return state_->plan; }
std::uint32_t Timeline::underruns() const { return state_->underruns; }
std::uint32_t Timeline::late_plans() const { return state_->late_plans; }
bool Timeline::playing() const { return state_->playing; }
std::uint32_t Timeline::row_width() const { return state_->options.row_width; }
double Timeline::frame_rate_hz() const { return state_->options.frame_rate_hz; }

}  // namespace motiongen
