#include "motiongen/core/ground.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "ground_lifts.hpp"
#include "limb_ik.hpp"

namespace motiongen {
namespace {

constexpr double kSoleM = 0.0152;      // height of a standing foot's lowest joint above the floor
constexpr std::size_t kHipFrames = 5;  // to each side, over which the hips' height is averaged
constexpr double kStretch = 0.995;
constexpr int kRounds = 3;
constexpr const char* kFeet[] = {"LeftFoot", "RightFoot"};

// A leg's joints from hip to toes, and the index of its two numbers in foot_contact.
struct Leg {
  std::size_t hip;
  std::size_t knee;
  std::size_t ankle;
  std::size_t toes;
  std::size_t contact;
  double stands_at;  // the ankle's height above the floor when standing
  double bones_m;    // thigh and shin
};

Place place_of(const float* from) { return {double{from[0]}, double{from[1]}, double{from[2]}}; }

Rotation rotation_of(const float* from) {
  const Rotation turn = {double{from[0]}, double{from[1]}, double{from[2]}, double{from[3]}};
  return normalized(turn, Rotation{1, 0, 0, 0});
}

Result<Leg> leg_of(const Rig& rig, std::size_t foot) {
  const std::string name = kFeet[foot];
  const auto limb =
      std::find_if(rig.limbs.begin(), rig.limbs.end(), [&name](const Limb& each) { return each.name == name; });
  if (limb == rig.limbs.end() || limb->joints.size() < 2) {
    return Status(Code::not_found, "UNKNOWN_LIMB", "rig " + rig.rig_id + " has no " + name + " of an ankle and toes");
  }
  Leg leg = {};
  leg.ankle = limb->joints[0];
  leg.toes = limb->joints[1];
  leg.contact = rig.contact_column + 2 * foot;
  const Status refused =
      invalid("rig", rig.rig_id, "one whose " + name + " hangs on a thigh and a shin, which hang on the root's body");
  if (leg.ankle == 0 || leg.ankle >= rig.num_joints() || leg.toes >= rig.num_joints()) return refused;
  leg.knee = static_cast<std::size_t>(rig.parents[leg.ankle]);
  if (leg.knee == 0) return refused;
  leg.hip = static_cast<std::size_t>(rig.parents[leg.knee]);
  const double thigh = length(place_of(&rig.offsets_m[3 * leg.knee]));
  const double shin = length(place_of(&rig.offsets_m[3 * leg.ankle]));
  const double shorter = std::min(thigh, shin);
  if (leg.hip == 0 || !(shorter > 0 && shorter >= 0.5 * std::max(thigh, shin))) return refused;
  leg.bones_m = thigh + shin;
  leg.stands_at = kSoleM + std::max(-double{rig.offsets_m[3 * leg.toes + 1]}, 0.0);
  return leg;
}

}  // namespace

struct Ground::State {
  using Numbers = GroundLifts::Numbers;

  // One leg's values for each frame.
  struct Step {
    GroundLifts::Flags planted;
    std::vector<Place> goal;  // of the ankle
    std::vector<Place> lies;  // from ankle to toes
  };

  Rig rig;
  Heights heights;
  std::array<Leg, 2> legs;
  std::array<Step, 2> steps;
  // for the present motion
  std::size_t num_frames = 0;
  std::vector<Place> places;        // (T, J)
  std::vector<Rotation> rotations;  // (T, J), in the world
  GroundLifts lifts;
  Numbers below;
  Numbers under;
  Numbers lift;
  Numbers lifted;
  Numbers clearance;
  Numbers toes_clearance;
  Numbers hips;
  Numbers missing;

  const Place& place(std::size_t frame, std::size_t joint) const { return places[frame * rig.num_joints() + joint]; }
  const Rotation& rotation(std::size_t frame, std::size_t joint) const {
    return rotations[frame * rig.num_joints() + joint];
  }

  void pose(Span<const float> rows);
  bool step(std::size_t side, Span<const float> rows);
  void lift_hips();
  void bend(std::size_t side, Span<float> rows) const;
  // Whether a finite height was found. The application is not called for a place that is not finite.
  bool look(const Place& at, double& height) const {
    if (!std::isfinite(at.x) || !std::isfinite(at.y) || !std::isfinite(at.z)) return false;
    height = heights(at.x, at.z);
    return std::isfinite(height);
  }
};

void Ground::State::pose(Span<const float> rows) {
  const std::size_t joints = rig.num_joints();
  num_frames = rows.size() / rig.row_width;
  places.resize(num_frames * joints);
  rotations.resize(num_frames * joints);
  for (std::size_t frame = 0; frame < num_frames; ++frame) {
    const float* row = &rows[frame * rig.row_width];
    Place* at = &places[frame * joints];
    Rotation* turned = &rotations[frame * joints];
    for (std::size_t joint = 0; joint < joints; ++joint) {
      const Rotation local = rotation_of(row + rig.rotation_column + 4 * joint);
      if (joint == 0) {
        turned[0] = local;
        at[0] = place_of(row + rig.root_column);
        continue;
      }
      const auto parent = static_cast<std::size_t>(rig.parents[joint]);
      turned[joint] = multiply(turned[parent], local);
      at[joint] = at[parent] + rotate(turned[parent], place_of(&rig.offsets_m[3 * joint]));
    }
  }
}

// Find where the ankle should be and how the foot lies. False if a place or a height was not finite.
bool Ground::State::step(std::size_t side, Span<const float> rows) {
  const Leg& leg = legs[side];
  Step& made = steps[side];
  for (auto* numbers : {&below, &under, &clearance, &toes_clearance}) numbers->resize(num_frames);
  made.planted.resize(num_frames);
  made.goal.resize(num_frames);
  made.lies.resize(num_frames);
  for (std::size_t frame = 0; frame < num_frames; ++frame) {
    const float* contact = &rows[frame * rig.row_width + leg.contact];
    made.planted[frame] = std::max(contact[0], contact[1]) > 0.5F ? 1 : 0;
    const Place& ankle = place(frame, leg.ankle);
    clearance[frame] = ankle.y - leg.stands_at;
    toes_clearance[frame] = place(frame, leg.toes).y - kSoleM;
    made.lies[frame] = place(frame, leg.toes) - ankle;
    if (!look(ankle, below[frame])) return false;
  }
  lifts.standing(below, made.planted, lift);
  lifts.swinging(below, made.planted, clearance, lift);
  for (int round = 0; round < kRounds; ++round) {  // the toes move over the ground as the foot tilts
    for (std::size_t frame = 0; frame < num_frames; ++frame) {
      if (!look(place(frame, leg.ankle) + made.lies[frame], under[frame])) return false;
    }
    lifts.standing(under, made.planted, lifted);
    lifts.swinging(under, made.planted, toes_clearance, lifted);
    for (std::size_t frame = 0; frame < num_frames; ++frame) {
      const Place& ankle = place(frame, leg.ankle);
      const Place foot = place(frame, leg.toes) - ankle;
      const double long_m = length(foot);
      const double level_m = std::max(std::hypot(foot.x, foot.z), 1e-6);
      const bool is_steep = std::abs(lifted[frame] - lift[frame]) > level_m;
      const double tilt = is_steep ? 0 : lifted[frame] - lift[frame];
      const double drop = std::clamp(foot.y + tilt, -0.95 * long_m, 0.95 * long_m);
      const double flat = std::sqrt(long_m * long_m - drop * drop) / level_m;
      made.lies[frame] = {foot.x * flat, drop, foot.z * flat};
      const double up = is_steep && made.planted[frame] != 0 ? std::max(lift[frame], lifted[frame]) : lift[frame];
      made.goal[frame] = {ankle.x, ankle.y + up, ankle.z};
    }
  }
  return true;
}

// Lift the hips as much as the feet on average, but less where a leg would be too short.
void Ground::State::lift_hips() {
  hips.resize(num_frames);
  missing.assign(num_frames, 0.0);
  for (std::size_t frame = 0; frame < num_frames; ++frame) {
    double sum = 0;
    for (std::size_t side = 0; side < legs.size(); ++side) {
      sum += steps[side].goal[frame].y - place(frame, legs[side].ankle).y;
    }
    hips[frame] = sum / static_cast<double>(legs.size());
  }
  lifts.average(hips, kHipFrames);
  for (std::size_t side = 0; side < legs.size(); ++side) {
    const Leg& leg = legs[side];
    for (std::size_t frame = 0; frame < num_frames; ++frame) {
      const Place& hip = place(frame, leg.hip);
      const Place& goal = steps[side].goal[frame];
      const double longest = std::max(kStretch * leg.bones_m, length(place(frame, leg.ankle) - hip));
      const double aside = std::hypot(goal.x - hip.x, goal.z - hip.z);
      const double highest = goal.y - hip.y + std::sqrt(std::max(longest * longest - aside * aside, 0.0));
      missing[frame] = std::max(missing[frame], hips[frame] - highest);
    }
  }
  lifts.cover(missing, kHipFrames);
  for (std::size_t frame = 0; frame < num_frames; ++frame) hips[frame] -= missing[frame];
}

// Turn a leg so that ankle and foot reach their goal.
void Ground::State::bend(std::size_t side, Span<float> rows) const {
  const Leg& leg = legs[side];
  const std::size_t joints[] = {leg.hip, leg.knee, leg.ankle};
  for (std::size_t frame = 0; frame < num_frames; ++frame) {
    const Place up = {0, hips[frame], 0};
    const Place ahead = rotate(rotation(frame, 0), Place{0, 0, 1});
    const auto [first, second] = two_bone(place(frame, leg.hip) + up, place(frame, leg.knee) + up,
                                          place(frame, leg.ankle) + up, steps[side].goal[frame], ahead);
    const Rotation tilt = rotation_between(place(frame, leg.toes) - place(frame, leg.ankle), steps[side].lies[frame]);
    const Rotation turned[] = {multiply(first, rotation(frame, leg.hip)), multiply(second, rotation(frame, leg.knee)),
                               multiply(tilt, rotation(frame, leg.ankle))};
    Rotation above = rotation(frame, static_cast<std::size_t>(rig.parents[leg.hip]));
    for (std::size_t place = 0; place < 3; ++place) {
      float* to = &rows[frame * rig.row_width + rig.rotation_column + 4 * joints[place]];
      const Rotation before = {double{to[0]}, double{to[1]}, double{to[2]}, double{to[3]}};
      const Rotation now = multiply(inverse(above), turned[place]);
      const double sign = dot(now, before) < 0 ? -1 : 1;
      store({static_cast<float>(sign * now.w), static_cast<float>(sign * now.x), static_cast<float>(sign * now.y),
             static_cast<float>(sign * now.z)},
            to);
      above = turned[place];
    }
  }
}

Ground::Ground(std::unique_ptr<State> state) : state_(std::move(state)) {}
Ground::Ground(Ground&&) noexcept = default;
Ground& Ground::operator=(Ground&&) noexcept = default;
Ground::~Ground() = default;

const Rig& Ground::rig() const { return state_->rig; }

Result<Ground> Ground::make(const Rig& rig, Heights heights) {
  if (!heights) return invalid("heights", "no function", "one that gives the ground's height at x, z");
  auto state = std::make_unique<State>();
  state->rig = rig;
  state->heights = std::move(heights);
  for (std::size_t side = 0; side < state->legs.size(); ++side) {
    const auto leg = leg_of(rig, side);
    if (!leg) return leg.status();
    state->legs[side] = leg.value();
  }
  return Ground(std::move(state));
}

Status Ground::apply(Span<float> rows) {
  State& s = *state_;
  if (rows.size() % s.rig.row_width != 0) {
    return invalid("rows", std::to_string(rows.size()) + " floats", "whole rows of " + std::to_string(s.rig.row_width));
  }
  if (rows.empty()) return {};
  const Span<const float> given(rows.data(), rows.size());
  s.pose(given);
  for (std::size_t side = 0; side < s.legs.size(); ++side) {
    if (!s.step(side, given)) {
      return invalid("rows, heights", "a foot's place or a height that is not finite",
                     "finite rows, and finite metres for every x and z");
    }
  }
  s.lift_hips();
  for (std::size_t frame = 0; frame < s.num_frames; ++frame) {
    rows[frame * s.rig.row_width + s.rig.root_column + 1] += static_cast<float>(s.hips[frame]);
  }
  for (std::size_t side = 0; side < s.legs.size(); ++side) s.bend(side, rows);
  return {};
}

}  // namespace motiongen
