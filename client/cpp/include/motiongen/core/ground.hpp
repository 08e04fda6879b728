// Ground: motion made on a level floor at height 0, put on slopes and steps before it is shown.
//
// Hips and legs are changed, nothing else; outputs behind a row stay those of the level floor. A foot that stands is on
// the ground below ankle and toes; on the edge of a step it stands level on the upper side; in the air it goes from
// where it stood to where it will stand. The same as the Python client's, number for number.
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

// The ground's height in metres at world x, z. It is asked some 60 times a frame. It must not throw.
using Heights = std::function<double(double x_m, double z_m)>;

// Motion as a whole.
class MOTIONGEN_API Ground {
 public:
  // INVALID_ARGUMENT without a callback, and for a rig whose feet do not hang on a thigh and a shin; NOT_FOUND for one
  // without feet.
  static Result<Ground> make(const Rig& rig, Heights heights);

  Ground(Ground&&) noexcept;
  Ground& operator=(Ground&&) noexcept;
  ~Ground();

  // All frames of a motion, in place: whole rows of rig.row_width floats. INVALID_ARGUMENT where they are not, or where
  // a place of a foot or a height is not finite; then nothing has changed. Asks for memory only for more frames than
  // before.
  [[nodiscard]] Status apply(Span<float> rows);

  const Rig& rig() const;

 private:
  struct State;
  explicit Ground(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

// What one timeline plays, frame after frame or at any moment between two, from what is held before and after.
//
// A step is known by where it ends, as far as that is held. Where a replan moves that while the foot is in the air,
// what is shown goes over to the new way within a fifth of a second. Once it has followed, it asks for no memory.
class MOTIONGEN_API GroundFollower {
 public:
  static constexpr std::uint64_t kAroundFrames = 24;  // looked at before and after one: more than a step takes

  explicit GroundFollower(Ground ground);
  GroundFollower(GroundFollower&&) noexcept;
  GroundFollower& operator=(GroundFollower&&) noexcept;
  ~GroundFollower();

  // Put the row that `sample`, or `row` of the playhead, has just given on the ground, in place. The timeline has
  // started, and keeps kAroundFrames behind its playhead. INVALID_ARGUMENT as `Ground::apply`.
  [[nodiscard]] Status apply(const Timeline& timeline, Span<float> row);

  const Rig& rig() const;
  // For motion as a whole on the same ground.
  Ground& ground();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace motiongen
