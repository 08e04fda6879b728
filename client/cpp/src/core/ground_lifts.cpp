#include "ground_lifts.hpp"

#include <algorithm>
#include <cmath>

namespace motiongen {
namespace {

// If the ground under a standing foot rises by more than this from frame to frame, it is a step, not a slope.
constexpr double kStepM = 0.04;
constexpr std::size_t kTaper = 1;
constexpr std::size_t kSwingReach = 2;

// The index of a frame, clamped to the first and the last.
std::size_t within(std::size_t place, std::size_t back, std::size_t ahead, std::size_t count) {
  return std::min(place + ahead < back ? 0 : place + ahead - back, count - 1);
}

}  // namespace

void GroundLifts::find_stands(const Flags& planted) {
  stands_.clear();
  for (std::size_t frame = 0; frame < planted.size(); ++frame) {
    if (planted[frame] == 0) continue;
    if (frame > 0 && planted[frame - 1] != 0) {
      ++stands_.back().second;
    } else {
      stands_.emplace_back(frame, frame + 1);
    }
  }
}

void GroundLifts::standing(const Numbers& heights, const Flags& planted, Numbers& lift) {
  find_stands(planted);
  lift.assign(heights.size(), 0.0);
  for (const auto& [begin, end] : stands_) {
    double rise = 0;
    double highest = heights[begin];
    for (std::size_t frame = begin + 1; frame < end; ++frame) {
      rise = std::max(rise, std::abs(heights[frame] - heights[frame - 1]));
      highest = std::max(highest, heights[frame]);
    }
    for (std::size_t frame = begin; frame < end; ++frame) lift[frame] = rise > kStepM ? highest : heights[frame];
  }
}

void GroundLifts::swinging(const Numbers& heights, const Flags& planted, const Numbers& clearance, Numbers& lift) {
  find_stands(planted);
  std::size_t begin = 0;
  for (const auto& [stand, left] : stands_) {
    if (begin < stand) swing(heights, clearance, begin, stand, lift);
    begin = left;
  }
  if (begin < heights.size()) swing(heights, clearance, begin, heights.size(), lift);
}

void GroundLifts::swing(const Numbers& heights, const Numbers& clearance, std::size_t begin, std::size_t end,
                        Numbers& lift) {
  const std::size_t count = end - begin;
  const bool has_stood = begin > 0;
  const bool will_stand = end < heights.size();
  const double after = will_stand ? lift[end] : heights.back();
  double before = heights.front();
  if (has_stood) {
    before = lift[begin - 1];
  } else if (will_stand) {
    before = after;
  }
  missing_.resize(count);
  for (std::size_t place = 0; place < count; ++place) {
    const double share = static_cast<double>(place + 1) / static_cast<double>(count + 1);
    const std::size_t frame = begin + place;
    lift[frame] = before + (after - before) * share * share * (3 - 2 * share);
    missing_[place] = std::max(heights[frame] - clearance[frame] - lift[frame], 0.0);
  }
  cover(missing_, kSwingReach);
  for (std::size_t place = 0; place < count; ++place) {
    const std::size_t from_stand = has_stood ? place + 1 : count;
    const std::size_t to_stand = will_stand ? count - place : count;
    const double taper = static_cast<double>(std::min(from_stand, to_stand)) / static_cast<double>(kTaper + 1);
    lift[begin + place] += missing_[place] * std::min(taper, 1.0);
  }
}

void GroundLifts::cover(Numbers& values, std::size_t reach) {
  values_.assign(values.begin(), values.end());
  for (std::size_t place = 0; place < values.size(); ++place) {
    for (std::size_t near = 0; near <= 2 * reach; ++near) {
      values[place] = std::max(values[place], values_[within(place, reach, near, values.size())]);
    }
  }
  average(values, reach);
}

void GroundLifts::average(Numbers& values, std::size_t reach) {
  values_.assign(values.begin(), values.end());
  for (std::size_t place = 0; place < values.size(); ++place) {
    double sum = 0;
    for (std::size_t near = 0; near <= 2 * reach; ++near) sum += values_[within(place, reach, near, values.size())];
    values[place] = sum / static_cast<double>(2 * reach + 1);
  }
}

}  // namespace motiongen
