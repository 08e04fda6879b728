// Ground: adapts motion, which is generated on a level floor at height 0, to slopes and steps before it is shown.
//
// Only hips and legs change; a row's outputs stay those of the level floor. A standing foot rests on the ground below
// ankle and toes; on the edge of a step it stands level on the upper side; in the air it moves from where it stood to
// where it will stand. Gives the same numbers as the Python client's.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>

#include "motiongen/core/export.hpp"
#include "motiongen/core/rig.hpp"
#include "motiongen/core/span.hpp"
#include "motiongen/core/status.hpp"
#include "motiongen/core/timeline.hpp"

namespace motiongen {

// Returns the ground's height in metres at world x, z. It is called some 60 times a frame and must not throw.
using Heights = std::function<double(double x_m, double z_m)>;

// Adapts a motion as a whole.
class MOTIONGEN_API Ground {
 public:
  // INVALID_ARGUMENT without a callback, or for a rig whose feet have no thigh and shin as parents; NOT_FOUND for a rig
  // without feet.
  static Result<Ground> make(const Rig& rig, Heights heights);

  Ground(Ground&&) noexcept;
  Ground& operator=(Ground&&) noexcept;
  ~Ground();

  // Adapt all frames of a motion in place. rows: whole rows of rig.row_width floats. INVALID_ARGUMENT for anything
  // else, or if the position of a foot or a height is not finite; rows are then unchanged. Allocates memory only if
  // there are more frames than ever before.
  [[nodiscard]] Status apply(Span<float> rows);

  const Rig& rig() const;

 private:
  struct State;
  explicit Ground(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

// Adapts what one timeline plays, at frames or at any moment between two, using the frames held before and after it.
//
// Where a step ends is known as far as frames are held. If a replan moves that place while the foot is in the air, what
// is shown blends to the new path within a fifth of a second. After its first use a follower allocates no memory.
class MOTIONGEN_API GroundFollower {
 public:
  static constexpr std::uint64_t kAroundFrames = 24;  // used before and after each frame: more than a step takes

  explicit GroundFollower(Ground ground);
  GroundFollower(GroundFollower&&) noexcept;
  GroundFollower& operator=(GroundFollower&&) noexcept;
  ~GroundFollower();

  // Adapt in place the row that the timeline's `sample`, or `row` of the playhead, has just given. The timeline must
  // have started and must keep kAroundFrames behind its playhead. INVALID_ARGUMENT as `Ground::apply`.
  [[nodiscard]] Status apply(const Timeline& timeline, Span<float> row);

  const Rig& rig() const;
  // The same ground for motions as a whole.
  Ground& ground();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace motiongen
