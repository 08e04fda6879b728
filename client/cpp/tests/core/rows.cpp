#include "core/rows.hpp"

#include <utility>

namespace motiongen::testing {

Rig chain_rig() {
  Rig rig;
  rig.rig_id = "chain";
  rig.joint_names = {"Hips", "Spine", "Head"};
  rig.parents = {-1, 0, 1};
  rig.offsets_m = {0, 0, 0, 0, 1, 0, 0, 1, 0};
  rig.frame_rate_hz = 20;
  rig.blocks = {{"root_translation_m", 3}, {"unknown", 2}, {"joint_rotation_quat_wxyz", 12}, {"foot_contact", 4}};
  static_cast<void>(rig.check());
  return rig;
}

std::vector<float> chain_row(const Rig& rig, float x) {
  std::vector<float> row(rig.row_width, 0.0F);
  row[rig.root_column] = x;
  for (std::uint32_t joint = 0; joint < rig.num_joints(); ++joint) row[rig.rotation_column + 4 * joint] = 1;
  return row;
}

std::vector<float> numbered_rows(std::uint32_t plan, std::uint64_t first_frame, std::uint32_t num_frames,
                                 std::uint32_t width) {
  std::vector<float> rows;
  for (std::uint64_t frame = first_frame; frame < first_frame + num_frames; ++frame) {
    rows.insert(rows.end(), width, static_cast<float>(plan * 1000 + frame));
  }
  return rows;
}

Timeline small_timeline(std::uint32_t keep_frames) {
  TimelineOptions options;
  options.row_width = 2;
  options.keep_frames = keep_frames;
  return std::move(Timeline::make(options)).value();
}

Status add(Timeline& timeline, std::uint32_t plan, std::uint64_t first_frame, std::uint32_t num_frames,
           std::uint64_t committed_to) {
  const std::vector<float> rows = numbered_rows(plan, first_frame, num_frames, timeline.row_width());
  RowSpan source(rows);
  return timeline.add_chunk({plan, first_frame, num_frames, committed_to}, source);
}

}  // namespace motiongen::testing
