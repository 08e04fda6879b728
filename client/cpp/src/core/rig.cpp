#include "motiongen/core/rig.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace motiongen {
namespace {

constexpr std::uint32_t kWidestRow = 1 << 14;  // with kMostJoints and all outputs a row has 7246

// The column at which a block begins; a violation if it is missing or has another width.
Result<std::uint32_t> find_column(const Rig& rig, const char* name, std::uint32_t width) {
  std::uint32_t column = 0;
  for (const Block& block : rig.blocks) {
    if (block.name == name) {
      if (block.width == width) return column;
      return violation("rig " + rig.rig_id + ": block " + name + " has width " + std::to_string(block.width) +
                       ", not " + std::to_string(width));
    }
    column += block.width;
  }
  return violation("rig " + rig.rig_id + " has no block " + name);
}

}  // namespace

Status Rig::check() {
  const std::string rig = "rig " + rig_id + ": ";
  const std::size_t joints = joint_names.size();
  if (joints == 0 || joints > Rig::kMostJoints) return violation(rig + std::to_string(joints) + " joints");
  if (parents.size() != joints || offsets_m.size() != 3 * joints) {
    return violation(rig + std::to_string(joints) + " joints, but " + std::to_string(parents.size()) + " parents and " +
                     std::to_string(offsets_m.size()) + " offset numbers");
  }
  const auto is_finite = [](float number) { return std::isfinite(number); };
  if (!std::all_of(offsets_m.begin(), offsets_m.end(), is_finite)) return violation(rig + "an offset is not finite");
  for (std::size_t index = 0; index < joints; ++index) {
    const std::int64_t parent = parents[index];
    if (parent < -1 || parent >= static_cast<std::int64_t>(index) || (parent < 0) != (index == 0)) {
      return violation(rig + "its parents are no tree, parents first");
    }
  }
  const auto is_joint = [joints](std::uint32_t index) { return index < joints; };
  const auto has_joints = [&](const std::vector<std::uint32_t>& all) {
    return std::all_of(all.begin(), all.end(), is_joint);
  };
  if ((!hip_joints.empty() && hip_joints.size() != 2) || !has_joints(hip_joints)) {
    return violation(rig + "its hips are not two of its " + std::to_string(joints) + " joints");
  }
  for (const Limb& limb : limbs) {
    if (!has_joints(limb.joints)) return violation(rig + "limb " + limb.name + " is not of its joints");
  }
  if (frame_rate_hz < 1) return violation(rig + "a frame rate of 0");
  row_width = 0;
  for (const auto* part : {&blocks, &outputs}) {
    for (const Block& block : *part) {
      if (block.width > kWidestRow - row_width) return violation(rig + "a row wider than this library takes");
      row_width += block.width;
    }
    if (part == &blocks) own_width = row_width;
  }
  const auto wide = static_cast<std::uint32_t>(joints);
  const std::pair<const char*, std::uint32_t> known[] = {{"joint_positions_m", 3 * wide},
                                                         {"joint_global_rotation_quat_wxyz", 4 * wide},
                                                         {"joint_velocities_mps", 3 * wide},
                                                         {"g1_qpos", 36},
                                                         {"g1_qvel", 35}};
  for (const Block& output : outputs) {
    for (const auto& [name, width] : known) {
      if (output.name != name || output.width == width) continue;
      return violation(rig + "output " + name + " has width " + std::to_string(output.width) + ", not " +
                       std::to_string(width));
    }
  }
  const auto root = find_column(*this, "root_translation_m", 3);
  if (!root) return root.status();
  const auto rotation = find_column(*this, "joint_rotation_quat_wxyz", 4 * wide);
  if (!rotation) return rotation.status();
  const auto contact = find_column(*this, "foot_contact", 4);
  if (!contact) return contact.status();
  root_column = root.value();
  rotation_column = rotation.value();
  contact_column = contact.value();
  return {};
}

Result<std::uint32_t> Rig::column(const std::string& name) const {
  std::uint32_t at = 0;
  std::string known;
  for (const auto* part : {&blocks, &outputs}) {
    for (const Block& block : *part) {
      if (block.name == name) return at;
      at += block.width;
      known += (known.empty() ? "" : ", ") + block.name;
    }
  }
  return Status(Code::not_found, "UNKNOWN_BLOCK", "no block is called " + name + "; known are: " + known);
}

Result<std::uint32_t> Rig::joint(const std::string& name) const {
  const auto found = std::find(joint_names.begin(), joint_names.end(), name);
  if (found != joint_names.end()) return static_cast<std::uint32_t>(found - joint_names.begin());
  std::string known;
  for (const std::string& each : joint_names) known += (known.empty() ? "" : ", ") + each;
  return Status(Code::not_found, "UNKNOWN_JOINT", "no joint is called " + name + "; known are: " + known);
}

}  // namespace motiongen
