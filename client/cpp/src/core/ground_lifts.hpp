// How far feet and hips of motion on a level floor are lifted for ground of other heights, frame by frame.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

namespace motiongen {

// Numbers of consecutive frames. Asks for memory only for more frames than before.
class GroundLifts {
 public:
  using Numbers = std::vector<double>;
  using Flags = std::vector<char>;

  // The ground's height under a point of a foot while it stands, 0 elsewhere. A foot that stands on the edge of a step
  // stands on the upper side all the while.
  void standing(const Numbers& heights, const Flags& planted, Numbers& lift);

  // What `standing` gave, with what a foot in the air is lifted by: from where it stood to where it will stand.
  // heights, clearance: of the ground under it, and how far it is above the level floor: it is lifted more where it
  // would go through the ground. Before the first and after the last stand it goes from or to the ground below it.
  void swinging(const Numbers& heights, const Flags& planted, const Numbers& clearance, Numbers& lift);

  // Smooth, and nowhere below what they were: the mean of the greatest within `reach` frames to each side.
  void cover(Numbers& values, std::size_t reach);

  // The mean within `reach` frames to each side; the ends go on as they are.
  void average(Numbers& values, std::size_t reach);

 private:
  // The stretches, first and one past the last, in which the flags hold.
  void find_stands(const Flags& planted);
  void swing(const Numbers& heights, const Numbers& clearance, std::size_t begin, std::size_t end, Numbers& lift);

  std::vector<std::pair<std::size_t, std::size_t>> stands_;
  Numbers missing_;
  Numbers values_;
};

}  // namespace motiongen
