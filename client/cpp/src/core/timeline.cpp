#include "motiongen/core/timeline.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

#include "motiongen/core/pose.hpp"
#include "row_store.hpp"

namespace motiongen {
namespace {

// Playback works in multiples of a frame time that no binary fraction holds: a frame due at 0.15 s is due at 0.1499999.
constexpr double kEarlyFrames = 1e-6;
constexpr double kNever = std::numeric_limits<double>::quiet_NaN();
constexpr std::uint32_t kMostReserved = 1 << 20;

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "rows are copied from the wire as they are, and the wire is little endian"
#endif

bool is_set(double moment_s) { return !std::isnan(moment_s); }

std::string number(std::uint64_t value) { return std::to_string(value); }

std::uint64_t count_of(double value) { return value <= 0 ? 0 : static_cast<std::uint64_t>(std::min(value, 1e15)); }

}  // namespace

void RowSpan::take(std::size_t count, void* to) {
  if (to != nullptr) std::memcpy(to, reinterpret_cast<const char*>(numbers_.data()) + taken_, count);
  taken_ += count;
}

struct Timeline::State {
  State(const TimelineOptions& given, std::size_t capacity) : options(given), rows(given.row_width, capacity) {}

  TimelineOptions options;
  RowStore rows;
  std::uint64_t playhead = 0;
  std::uint64_t committed_to = 0;
  std::uint64_t first_kept = 0;
  std::uint64_t received_to = 0;  // where the next chunk must begin; below buffered_to only after a late plan
  std::uint32_t plan = 0;
  std::uint32_t underruns = 0;
  std::uint32_t late_plans = 0;
  bool started = false;
  bool playing = true;
  double due_s = kNever;  // when the frame after the playhead is due; unset: the clock starts anew
  double held_since_s = kNever;
  std::uint64_t held_frames = 0;
  float blend = 0;  // of the frame after the playhead in what `sample` showed last

  std::uint64_t buffered_to() const { return first_kept + rows.size(); }
  double frame_s() const { return 1 / options.frame_rate_hz; }

  void start(std::uint64_t frame) {
    started = true;
    playhead = frame;
    forget();
  }

  FrameRange move(std::uint64_t count) {
    const std::uint64_t first = playhead + 1;
    playhead += count;
    if (count > 0) blend = 0;
    if (is_set(due_s)) due_s += static_cast<double>(count) / options.frame_rate_hz;
    forget();
    return {first, playhead + 1};
  }

  // Raise the count of the present hold.
  void count_held(std::uint64_t frames) {
    if (frames <= held_frames) return;
    underruns += static_cast<std::uint32_t>(frames - held_frames);
    held_frames = frames;
  }

  void forget() {
    if (options.keep_frames == TimelineOptions::kKeepAll || playhead < first_kept + options.keep_frames) return;
    const std::uint64_t surplus = playhead - options.keep_frames - first_kept;
    rows.drop_front(surplus);
    first_kept += surplus;
  }
};

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
      (options.keep_frames > kMostReserved && options.keep_frames != TimelineOptions::kKeepAll)) {
    return invalid("keep_frames, reserve_frames", number(options.keep_frames) + ", " + number(options.reserve_frames),
                   "up to " + number(kMostReserved) + " frames, or kKeepAll");
  }
  const std::size_t kept = options.keep_frames == TimelineOptions::kKeepAll ? 0 : options.keep_frames;
  auto state = std::make_unique<State>(options, kept + options.reserve_frames + 1);
  state->playhead = state->committed_to = state->first_kept = state->received_to = options.start_frame;
  return Timeline(std::move(state));
}

Status Timeline::announce_plan(std::uint32_t plan, std::uint64_t valid_from) {
  State& s = *state_;
  if (plan <= s.plan) {
    return violation("plan " + number(plan) + " was announced after plan " + number(s.plan) + "; plans must rise");
  }
  if (valid_from < s.committed_to) {
    return violation("plan " + number(plan) + " replaces frames from " + number(valid_from) + ", but frames below " +
                     number(s.committed_to) + " are committed");
  }
  s.plan = plan;
  if (valid_from > s.received_to) return {};  // frames before it that are still to come will carry this plan's number
  s.received_to = valid_from;
  // the frame after the playhead counts as shown where it was mixed into the pose
  const std::uint64_t shown_to = s.started ? s.playhead + (s.blend > 0 ? 2 : 1) : valid_from;
  if (valid_from < shown_to) ++s.late_plans;
  const std::uint64_t first_replaceable = std::max(valid_from, shown_to);
  if (s.buffered_to() > first_replaceable) s.rows.drop_back(s.buffered_to() - first_replaceable);
  return {};
}

Status Timeline::add_chunk(const ChunkHeader& header, RowSource& rows) {
  State& s = *state_;
  if (header.plan != s.plan) {
    return violation("a chunk of plan " + number(header.plan) + " arrived, but the latest plan is " + number(s.plan));
  }
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
  s.committed_to = header.committed_to;
  const std::uint64_t shown = std::min<std::uint64_t>(s.buffered_to() - header.first_frame, header.num_frames);
  if (shown > 0) rows.take(shown * row_bytes, nullptr);
  for (std::uint64_t row = shown; row < header.num_frames; ++row) rows.take(row_bytes, s.rows.push());
  s.received_to = header.first_frame + header.num_frames;
  return {};
}

void Timeline::continue_with_new_plans() {
  State& s = *state_;
  s.plan = 0;
  s.received_to = s.buffered_to();
  s.committed_to = s.received_to;  // what is held will be shown: the other session begins after it
}

FrameRange Timeline::advance(double now_s) {
  State& s = *state_;
  if (!s.playing || (!s.started && s.rows.size() == 0)) return {};
  if (!s.started) {
    s.due_s = now_s + s.frame_s();
    s.start(s.playhead);
    return {s.playhead, s.playhead + 1};
  }
  if (!is_set(s.due_s)) s.due_s = now_s + s.frame_s() * (1 - static_cast<double>(s.blend));
  const double rate = s.options.frame_rate_hz;
  const std::uint64_t left = s.buffered_to() - 1 - s.playhead;
  if (is_set(s.held_since_s) && left > 0) {
    s.count_held(count_of(std::ceil((now_s - s.held_since_s) * rate - kEarlyFrames)));
    s.held_since_s = kNever;
    s.due_s = now_s;
  }
  const std::uint64_t due = count_of(std::floor((now_s - s.due_s) * rate + kEarlyFrames) + 1);
  const FrameRange reached = s.move(std::min(due, left));
  if (due > left) {
    if (!is_set(s.held_since_s)) {
      s.held_since_s = s.due_s;
      s.held_frames = 0;
    }
    s.count_held(count_of(std::floor((now_s - s.held_since_s) * rate + kEarlyFrames) + 1));
  }
  return reached;
}

Result<FrameRange> Timeline::advance_to(std::uint64_t frame) {
  State& s = *state_;
  if (frame < s.playhead || frame >= s.buffered_to()) {
    const std::string allowed = s.buffered_to() > s.playhead
                                    ? "from " + number(s.playhead) + " to " + number(s.buffered_to() - 1)
                                    : "none before frames have come";
    return Status(Code::out_of_range, "FRAME_NOT_HELD",
                  "frame: " + number(frame) + " was given; allowed is " + allowed);
  }
  const std::uint64_t before = s.playhead;
  FrameRange reached;
  if (s.started) {
    reached = s.move(frame - s.playhead);
  } else {
    s.start(frame);
    reached = {before, frame + 1};
  }
  s.due_s = s.held_since_s = kNever;
  s.blend = 0;
  return reached;
}

bool Timeline::sample(double now_s, const Rig& rig, Span<float> out) {
  State& s = *state_;
  advance(now_s);
  if (!s.started) return false;
  const bool has_next = s.buffered_to() > s.playhead + 1;
  if (s.playing && has_next && is_set(s.due_s)) {
    const double left_s = s.due_s - now_s;
    s.blend = static_cast<float>(std::clamp(1 - left_s * s.options.frame_rate_hz, 0.0, 1.0));
  }
  const float* shown = s.rows.row(s.playhead - s.first_kept);
  const Span<const float> from(shown, s.options.row_width);
  if (s.blend > 0 && has_next) {
    interpolate(rig, from, {s.rows.row(s.playhead + 1 - s.first_kept), s.options.row_width}, s.blend, out);
  } else {
    std::copy(from.begin(), from.end(), out.begin());
  }
  return true;
}

void Timeline::pause() { state_->playing = false; }

void Timeline::resume() {
  state_->playing = true;
  state_->due_s = state_->held_since_s = kNever;
}

Result<Span<const float>> Timeline::row(std::uint64_t frame) const {
  const State& s = *state_;
  if (frame < s.first_kept || frame >= s.buffered_to()) {
    return Status(Code::out_of_range, "FRAME_NOT_HELD",
                  "frame: " + number(frame) + " was given; held are frames from " + number(s.first_kept) +
                      " up to, not with, " + number(s.buffered_to()));
  }
  return Span<const float>(s.rows.row(frame - s.first_kept), s.options.row_width);
}

bool Timeline::started() const { return state_->started; }
std::uint64_t Timeline::playhead() const { return state_->playhead; }
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
