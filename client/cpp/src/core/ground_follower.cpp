// Puts the frames that a timeline plays on the ground. The change to each frame is kept as a lift and rotations, so
// that a moment between two frames can use a share of both.
#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "motiongen/core/ground.hpp"
#include "quaternion.hpp"

namespace motiongen {
namespace {

constexpr std::uint64_t kRunFrames = 8;
constexpr std::uint64_t kFadeFrames = 4;
constexpr std::size_t kTurned = 6;  // joints changed: both hips, knees and ankles
constexpr Quaternion kNoTurn = {1, 0, 0, 0};

// How the ground changes a frame: the lift of the root, and a rotation of each leg joint.
struct Change {
  float up_m = 0;
  std::array<Quaternion, kTurned> turns = {kNoTurn, kNoTurn, kNoTurn, kNoTurn, kNoTurn, kNoTurn};
};

// A share of one change, followed by another.
Change after(const Change& first, float share, const Change& second) {
  Change both = second;
  both.up_m += share * first.up_m;
  for (std::size_t joint = 0; joint < kTurned; ++joint) {
    both.turns[joint] = multiply(slerp(kNoTurn, first.turns[joint], share), second.turns[joint]);
  }
  return both;
}

// The change that leads from `due` to `shown`.
Change apart(const Change& shown, const Change& due) {
  Change gap;
  gap.up_m = shown.up_m - due.up_m;
  for (std::size_t joint = 0; joint < kTurned; ++joint) {
    gap.turns[joint] = multiply(shown.turns[joint], inverse(due.turns[joint]));
  }
  return gap;
}

Change between(const Change& here, const Change& ahead, float share) {
  Change found;
  found.up_m = here.up_m + share * (ahead.up_m - here.up_m);
  for (std::size_t joint = 0; joint < kTurned; ++joint) {
    found.turns[joint] = slerp(here.turns[joint], ahead.turns[joint], share);
  }
  return found;
}

}  // namespace

struct GroundFollower::State {
  explicit State(Ground given) : ground(std::move(given)) {
    const Rig& rig = ground.rig();
    std::size_t count = 0;
    for (const char* name : {"LeftFoot", "RightFoot"}) {
      const auto limb =
          std::find_if(rig.limbs.begin(), rig.limbs.end(), [name](const Limb& each) { return each.name == name; });
      std::size_t joint = limb->joints[0];  // exists: a Ground's rig has feet
      for (int above = 0; above < 3; ++above) {
        columns[count++] = rig.rotation_column + 4 * joint;
        joint = static_cast<std::size_t>(rig.parents[joint]);
      }
    }
    const std::size_t most = 2 * kAroundFrames + kRunFrames + 1;
    level.reserve(most * rig.row_width);
    raised.reserve(most * rig.row_width);
    run.reserve(kRunFrames + 1);
  }

  Ground ground;
  std::array<std::size_t, kTurned> columns = {};
  std::vector<float> level;   // the rows that the run was made from, from window_first on
  std::vector<float> raised;  // the same rows on the ground
  std::uint64_t window_first = 0;
  std::vector<Change> run;  // from `first` on; one more than is followed, for moments before it
  std::uint64_t first = 0;
  bool has_shown = false;
  std::uint64_t shown_frame = 0;
  Change shown;
  bool has_gap = false;
  std::uint64_t gap_frame = 0;  // the frame at which the change was made
  Change gap;                   // what was shown, relative to what was due

  std::size_t width() const { return ground.rig().row_width; }

  bool is_of_run(const Timeline& timeline, std::uint64_t frame) const {
    if (frame < first || frame >= first + run.size()) return false;
    const auto row = timeline.row(frame);
    const float* known = &level[(frame - window_first) * width()];
    return row && std::equal(row.value().begin(), row.value().end(), known);
  }

  Change change_of(std::uint64_t frame) const {
    const float* from = &level[(frame - window_first) * width()];
    const float* to = &raised[(frame - window_first) * width()];
    Change found;
    const std::size_t height = ground.rig().root_column + 1;
    found.up_m = to[height] - from[height];
    for (std::size_t joint = 0; joint < kTurned; ++joint) {
      found.turns[joint] = multiply(load(to + columns[joint]), inverse(load(from + columns[joint])));
    }
    return found;
  }

  // The frames around one that are continuous with it: none beyond a cut.
  FrameRange window(const Timeline& timeline, std::uint64_t frame) const {
    FrameRange found = {frame, frame + 1};
    const std::uint64_t kept = timeline.first_kept();
    while (found.first > kept && frame - found.first < kAroundFrames && !timeline.is_cut(found.first)) --found.first;
    const std::uint64_t end = std::min(timeline.buffered_to(), frame + kAroundFrames + kRunFrames);
    while (found.end < end && !timeline.is_cut(found.end)) ++found.end;
    return found;
  }

  Status make_run(const Timeline& timeline, std::uint64_t frame) {
    const FrameRange frames = window(timeline, frame);
    level.clear();
    for (std::uint64_t each = frames.first; each < frames.end; ++each) {
      const auto row = timeline.row(each);
      level.insert(level.end(), row.value().begin(), row.value().end());
    }
    raised.assign(level.begin(), level.end());
    window_first = frames.first;
    run.clear();
    Status done = ground.apply(raised);
    if (!done) return done;
    has_gap = has_shown && frame > 0 && shown_frame == frame - 1 && frames.first < frame;
    if (has_gap) gap = apart(shown, change_of(frame - 1));
    gap_frame = frame;
    first = frame;
    const std::uint64_t end = std::min(frames.end, frame + kRunFrames + 1);
    for (std::uint64_t each = frame; each < end; ++each) run.push_back(change_of(each));
    return {};
  }

  // The change due at a frame of the run, with what is left of a gap.
  Change faded(std::uint64_t frame) const {
    const Change& due = run[frame - first];
    if (!has_gap || frame - gap_frame >= kFadeFrames) return due;
    const float left = 1 - static_cast<float>(frame - gap_frame + 1) / static_cast<float>(kFadeFrames + 1);
    return after(gap, left * left * (3 - 2 * left), due);
  }
};

GroundFollower::GroundFollower(Ground ground) : state_(std::make_unique<State>(std::move(ground))) {}
GroundFollower::GroundFollower(GroundFollower&&) noexcept = default;
GroundFollower& GroundFollower::operator=(GroundFollower&&) noexcept = default;
GroundFollower::~GroundFollower() = default;

const Rig& GroundFollower::rig() const { return state_->ground.rig(); }

Ground& GroundFollower::ground() { return state_->ground; }

Status GroundFollower::apply(const Timeline& timeline, Span<float> row) {
  State& s = *state_;
  if (timeline.row_width() != s.width() || row.size() < s.width()) {
    return invalid("row", std::to_string(std::min<std::size_t>(row.size(), timeline.row_width())) + " floats",
                   std::to_string(s.width()) + ", as the rig of the ground has");
  }
  if (!timeline.started()) return {Code::failed_precondition, "NOT_STARTED", "no frame has been shown yet"};
  const std::uint64_t frame = timeline.playhead();
  if (frame >= s.first + kRunFrames || !s.is_of_run(timeline, frame)) {
    Status made = s.make_run(timeline, frame);
    if (!made) return made;
  }
  const Change here = s.faded(frame);
  s.has_shown = true;
  s.shown_frame = frame;
  s.shown = here;
  const float share = timeline.share();
  const bool leads_on = share > 0 && s.is_of_run(timeline, frame + 1);
  const Change change = leads_on ? between(here, s.faded(frame + 1), share) : here;
  row[s.ground.rig().root_column + 1] += change.up_m;
  for (std::size_t joint = 0; joint < kTurned; ++joint) {
    float* at = &row[s.columns[joint]];
    store(multiply(change.turns[joint], load(at)), at);
  }
  return {};
}

}  // namespace motiongen
