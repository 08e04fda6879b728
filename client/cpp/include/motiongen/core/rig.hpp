// Rig: a skeleton and the layout of its frame rows, as the server's catalogue gives them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "motiongen/core/export.hpp"
#include "motiongen/core/span.hpp"
#include "motiongen/core/status.hpp"

namespace motiongen {

// Right-handed, +Y up, +Z forward, metres, radians; quaternions are unit, in the order w, x, y, z.

// A run of numbers in a frame row.
struct Block {
  std::string name;
  std::uint32_t width = 0;
};

// A named end-effector chain, as motion tools use it; `joints` are indices into the rig.
struct Limb {
  std::string name;
  std::vector<std::uint32_t> joints;
};

struct MOTIONGEN_API Rig {
  // Rigs with more are refused: computations on a pose use fixed space for so many and allocate no memory.
  static constexpr std::uint32_t kMostJoints = 512;

  std::string rig_id;
  std::vector<std::string> joint_names;  // J of them; joint 0 is the root
  std::vector<std::int32_t> parents;     // J; -1 for the root, and a parent precedes its children
  std::vector<float> offsets_m;          // (J, 3), from the parent in the neutral pose
  std::uint32_t frame_rate_hz = 0;
  std::vector<Block> blocks;  // of a frame row, in order
  std::vector<std::uint32_t> hip_joints;
  std::vector<Limb> limbs;
  std::vector<Block> outputs;  // those that the session asked for, which follow the blocks

  // Offsets in floats, from the start of a row, of the blocks that this library reads. Set by `check`.
  std::uint32_t own_width = 0;  // without the outputs
  std::uint32_t row_width = 0;
  std::uint32_t root_column = 0;
  std::uint32_t rotation_column = 0;
  std::uint32_t contact_column = 0;

  std::uint32_t num_joints() const { return static_cast<std::uint32_t>(joint_names.size()); }

  // Find the columns. A violation if counts contradict each other, a block is missing, or hips or limbs name joints
  // that the rig does not have.
  [[nodiscard]] Status check();

  // The column at which a block or an output begins; the message of NOT_FOUND lists those that exist.
  [[nodiscard]] Result<std::uint32_t> column(const std::string& name) const;

  // The joint with a name; the message of NOT_FOUND lists the names.
  [[nodiscard]] Result<std::uint32_t> joint(const std::string& name) const;

  // Views of one frame row of `row_width` floats.
  Span<const float> root_translation_m(Span<const float> row) const { return row.subspan(root_column, 3); }
  Span<const float> joint_rotations_wxyz(Span<const float> row) const {
    return row.subspan(rotation_column, 4 * std::size_t{num_joints()});
  }
  // left heel, left toe, right heel, right toe: 1 on the ground, 0 not
  Span<const float> foot_contact(Span<const float> row) const { return row.subspan(contact_column, 4); }
};

}  // namespace motiongen
