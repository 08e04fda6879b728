#include "motiongen/core/retarget.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "motiongen/core/pose.hpp"
#include "quaternion.hpp"
#include "retarget_checks.hpp"

namespace motiongen {
namespace {

constexpr Quaternion kNoTurn = {1, 0, 0, 0};
constexpr std::size_t kNobody = static_cast<std::size_t>(-1);

Vector plus(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }

Vector vector_of(const float* from) { return {from[0], from[1], from[2]}; }

Result<std::size_t> index_of(const std::vector<std::string>& names, const std::string& name) {
  const auto found = std::find(names.begin(), names.end(), name);
  if (found != names.end()) return static_cast<std::size_t>(found - names.begin());
  std::string known;
  for (const std::string& each : names) known += (known.empty() ? "" : ", ") + each;
  return Status(Code::not_found, "UNKNOWN_JOINT", "no joint is called " + name + "; known are: " + known);
}

Result<std::vector<std::size_t>> indices_of(const std::vector<std::string>& names,
                                            const std::vector<std::string>& wanted) {
  std::vector<std::size_t> found;
  for (const std::string& each : wanted) {
    const auto index = index_of(names, each);
    if (!index) return index.status();
    found.push_back(index.value());
  }
  return found;
}

// The average length of the chains: for each, the bones that lead to all its joints but the first.
Result<float> chain_length(const std::vector<std::string>& names, const std::vector<float>& offsets,
                           const std::vector<std::vector<std::string>>& chains) {
  if (chains.empty()) return invalid("scale", "0 without chains", "a number above 0, or chains of joints of both");
  float length = 0;
  for (const auto& chain : chains) {
    for (std::size_t joint = 1; joint < chain.size(); ++joint) {
      const auto index = index_of(names, chain[joint]);
      if (!index) return index.status();
      const Vector bone = vector_of(&offsets[3 * index.value()]);
      length += std::sqrt(bone.x * bone.x + bone.y * bone.y + bone.z * bone.z);
    }
  }
  return length / static_cast<float>(chains.size());
}

}  // namespace

struct Retargeter::State {
  struct Driven {
    std::size_t ours = kNobody;
    std::size_t ours_too = kNobody;
    float fraction = 0;
    Quaternion axes = kNoTurn;
  };

  Rig rig;
  UserSkeleton skeleton;
  std::vector<Driven> driven;  // one for each joint of the skeleton
  std::vector<std::size_t> middle_theirs;
  std::vector<std::size_t> middle_ours;
  float metres_per_unit = 1;
  float scale = 1;
  float lift_m = 0;
  bool has_before = false;
  // for the present frame
  std::vector<float> our_places;
  std::vector<float> our_rotations;
  std::vector<Quaternion> world;
  std::vector<Vector> places;  // relative to the root, in their units
  std::vector<float> before;

  Quaternion rest(std::size_t joint) const {
    return skeleton.rest_wxyz.empty() ? kNoTurn : load(&skeleton.rest_wxyz[4 * joint]);
  }

  // Finds local rotations and the joints' places relative to the root, from `our_rotations`.
  void pose(Span<float> local_wxyz) {
    for (std::size_t joint = 0; joint < driven.size(); ++joint) {
      const bool is_root = joint == 0;
      const auto parent = static_cast<std::size_t>(is_root ? 0 : skeleton.parents[joint]);
      const Quaternion above = is_root ? kNoTurn : world[parent];
      const Driven& by = driven[joint];
      if (by.ours == kNobody) {
        world[joint] = multiply(above, rest(joint));
      } else {
        Quaternion turn = load(&our_rotations[4 * by.ours]);
        if (by.ours_too != by.ours) turn = slerp(turn, load(&our_rotations[4 * by.ours_too]), by.fraction);
        world[joint] = multiply(turn, by.axes);
      }
      store(multiply(inverse(above), world[joint]), &local_wxyz[4 * joint]);
      const Vector bone = is_root ? Vector{0, 0, 0} : rotate(above, vector_of(&skeleton.offsets[3 * joint]));
      places[joint] = is_root ? bone : plus(places[parent], bone);
    }
  }

  Vector middle(const std::vector<std::size_t>& joints, const float* positions) const {
    Vector sum = {0, 0, 0};
    for (const std::size_t joint : joints) sum = plus(sum, vector_of(positions + 3 * joint));
    const auto count = static_cast<float>(joints.size());
    return {sum.x / count, sum.y / count, sum.z / count};
  }

  Vector middle_of_theirs() const {
    Vector sum = {0, 0, 0};
    for (const std::size_t joint : middle_theirs) sum = plus(sum, places[joint]);
    const auto count = static_cast<float>(middle_theirs.size());
    return {sum.x / count, sum.y / count, sum.z / count};
  }

  Status take_drives(const JointMap& map);
  Status take_scale(const JointMap& map);
  Status take_ground(const JointMap& map);
};

Status Retargeter::State::take_drives(const JointMap& map) {
  driven.resize(skeleton.joint_names.size());
  for (const Drive& drive : map.drives) {
    const auto theirs = index_of(skeleton.joint_names, drive.theirs);
    if (!theirs) return theirs.status();
    const auto ours = index_of(rig.joint_names, drive.ours);
    if (!ours) return ours.status();
    const auto too = drive.ours_too.empty() ? ours : index_of(rig.joint_names, drive.ours_too);
    if (!too) return too.status();
    driven[theirs.value()] = {ours.value(), too.value(), drive.fraction, load(drive.axes_wxyz.data())};
  }
  auto theirs = indices_of(skeleton.joint_names, map.root_theirs);
  if (!theirs) return theirs.status();
  auto ours = indices_of(rig.joint_names, map.root_ours);
  if (!ours) return ours.status();
  middle_theirs = std::move(theirs).value();
  middle_ours = std::move(ours).value();
  if (middle_theirs.empty() || middle_ours.empty()) {
    return invalid("root_theirs, root_ours", "no joint", "one joint or more of both");
  }
  return {};
}

Status Retargeter::State::take_scale(const JointMap& map) {
  metres_per_unit = map.metres_per_unit;
  scale = map.scale;
  if (scale > 0) return {};
  const auto theirs = chain_length(skeleton.joint_names, skeleton.offsets, map.chains_theirs);
  if (!theirs) return theirs.status();
  const auto ours = chain_length(rig.joint_names, rig.offsets_m, map.chains_ours);
  if (!ours) return ours.status();
  scale = ours.value() / (theirs.value() * metres_per_unit);
  const bool has_length = scale > 0 && std::isfinite(scale);
  return has_length ? Status() : invalid("chains", "bones without length", "bones of both that are longer than 0");
}

// Finds the height of their root joints' midpoint above the scaled one of ours.
Status Retargeter::State::take_ground(const JointMap& map) {
  if (!map.on_feet) {
    lift_m = map.ground_theirs * metres_per_unit - map.ground_ours_m / scale;
    return {};
  }
  const auto feet = indices_of(rig.joint_names, map.feet_ours);
  if (!feet) return feet.status();
  // both in our neutral pose
  std::vector<float> row(rig.row_width, 0.0F);
  for (std::size_t joint = 0; joint < rig.num_joints(); ++joint) row[rig.rotation_column + 4 * joint] = 1;
  joint_transforms(rig, row, our_places, our_rotations);
  std::vector<float> local(4 * driven.size());
  pose(local);
  const auto is_foot = [&](std::size_t joint) {
    return std::count(feet.value().begin(), feet.value().end(), driven[joint].ours) != 0;
  };
  // theirs at rest, relative to the root
  std::vector<Quaternion> turned(driven.size(), kNoTurn);
  std::vector<Vector> rest_places(driven.size(), Vector{0, 0, 0});
  float lowest = HUGE_VALF;
  float lowest_foot_at_rest = HUGE_VALF;
  float lowest_foot = HUGE_VALF;
  for (std::size_t joint = 0; joint < driven.size(); ++joint) {
    const auto parent = static_cast<std::size_t>(std::max(skeleton.parents[joint], 0));
    const Quaternion above = joint == 0 ? kNoTurn : turned[parent];
    turned[joint] = multiply(above, rest(joint));
    if (joint > 0) {
      rest_places[joint] = plus(rest_places[parent], rotate(above, vector_of(&skeleton.offsets[3 * joint])));
    }
    lowest = std::min(lowest, rest_places[joint].y);
    if (!is_foot(joint)) continue;
    lowest_foot_at_rest = std::min(lowest_foot_at_rest, rest_places[joint].y);
    lowest_foot = std::min(lowest_foot, places[joint].y);
  }
  if (!std::isfinite(lowest_foot))
    return invalid("feet_ours", "joints that drive none of theirs", "ours that drive feet");
  float our_lowest = HUGE_VALF;
  for (const std::size_t joint : feet.value()) our_lowest = std::min(our_lowest, our_places[3 * joint + 1]);
  const float middle_theirs_m = (lowest_foot_at_rest - lowest - lowest_foot + middle_of_theirs().y) * metres_per_unit;
  const float middle_ours_m = map.ground_ours_m - our_lowest + middle(middle_ours, our_places.data()).y;
  lift_m = middle_theirs_m - middle_ours_m / scale;
  return {};
}

Retargeter::Retargeter(std::unique_ptr<State> state) : state_(std::move(state)) {}
Retargeter::Retargeter(Retargeter&&) noexcept = default;
Retargeter& Retargeter::operator=(Retargeter&&) noexcept = default;
Retargeter::~Retargeter() = default;

float Retargeter::scale() const { return state_->scale; }

Result<Retargeter> Retargeter::make(const Rig& rig, const UserSkeleton& skeleton, const JointMap& map) {
  Status checked = check_skeleton(skeleton);
  if (checked) checked = check_numbers(map);
  if (!checked) return checked;
  auto state = std::make_unique<State>();
  state->rig = rig;
  state->skeleton = skeleton;
  state->our_places.resize(3 * std::size_t{rig.num_joints()});
  state->our_rotations.resize(4 * std::size_t{rig.num_joints()});
  state->world.resize(skeleton.joint_names.size(), kNoTurn);
  state->places.resize(skeleton.joint_names.size(), Vector{0, 0, 0});
  state->before.resize(4 * skeleton.joint_names.size());
  checked = state->take_drives(map);
  if (checked) checked = state->take_scale(map);
  if (checked) checked = state->take_ground(map);
  if (!checked) return checked;
  return Retargeter(std::move(state));
}

void Retargeter::apply(Span<const float> row, Span<float> root, Span<float> rotations_wxyz) {
  State& s = *state_;
  joint_transforms(s.rig, row, s.our_places, s.our_rotations);
  s.pose(rotations_wxyz);
  const Vector ours = s.middle(s.middle_ours, s.our_places.data());
  const Vector theirs = s.middle_of_theirs();
  root[0] = ours.x / s.scale / s.metres_per_unit - theirs.x;
  root[1] = (ours.y / s.scale + s.lift_m) / s.metres_per_unit - theirs.y;
  root[2] = ours.z / s.scale / s.metres_per_unit - theirs.z;
  for (std::size_t at = 0; at < s.before.size(); at += 4) {
    Quaternion turn = load(&rotations_wxyz[at]);
    const bool flip = s.has_before ? dot(turn, load(&s.before[at])) < 0 : turn.w < 0;
    if (flip) turn = {-turn.w, -turn.x, -turn.y, -turn.z};
    store(turn, &rotations_wxyz[at]);
    store(turn, &s.before[at]);
  }
  s.has_before = true;
}

}  // namespace motiongen
