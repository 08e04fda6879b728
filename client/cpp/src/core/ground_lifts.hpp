// By how much the feet and hips of motion on a level floor must be lifted at each frame to fit uneven ground.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

namespace motiongen {

// Works on one number for each of consecutive frames. Allocates memory only if there are more frames than ever before.
class GroundLifts {
 public:
  using Numbers = std::vector<double>;
  using Flags = std::vector<char>;

  // The ground's height under a point of a foot while it stands, 0 elsewhere. A foot on the edge of a step stands on
  // the upper side throughout.
  void standing(const Numbers& heights, const Flags& planted, Numbers& lift);

  // Adds to the result of `standing` the lift of a foot in the air, from where it stood to where it will stand.
  // heights: the ground under it; clearance: its height above the level floor; it is lifted more where it would go
  // through the ground. Before its first stand it has that stand's lift; after the last it moves to the ground below
  // it.
  void swinging(const Numbers& heights, const Flags& planted, const Numbers& clearance, Numbers& lift);

  // Smooths values without lowering any: the mean of the maxima within `reach` frames to each side.
  void cover(Numbers& values, std::size_t reach);

  // The mean within `reach` frames to each side; the ends are repeated.
  void average(Numbers& values, std::size_t reach);

 private:
  // The intervals, first and one past the last, in which the flags are set.
  void find_stands(const Flags& planted);
  void swing(const Numbers& heights, const Numbers& clearance, std::size_t begin, std::size_t end, Numbers& lift);

  std::vector<std::pair<std::size_t, std::size_t>> stands_;
  Numbers missing_;
  Numbers values_;
};

}  // namespace motiongen
