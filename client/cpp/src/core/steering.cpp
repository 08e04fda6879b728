#include "motiongen/core/steering.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>
#include <utility>

namespace motiongen {
namespace {

constexpr std::size_t kMostCorners = 256;  // of one RootPath

// The distance of a point from the line segment between two others.
double off(Span<const float> points, std::size_t first, std::size_t last, std::size_t at) {
  const double along_x = static_cast<double>(points[2 * last]) - static_cast<double>(points[2 * first]);
  const double along_z = static_cast<double>(points[2 * last + 1]) - static_cast<double>(points[2 * first + 1]);
  const double away_x = static_cast<double>(points[2 * at]) - static_cast<double>(points[2 * first]);
  const double away_z = static_cast<double>(points[2 * at + 1]) - static_cast<double>(points[2 * first + 1]);
  const double square = std::max(along_x * along_x + along_z * along_z, 1e-12);
  const double share = std::clamp((away_x * along_x + away_z * along_z) / square, 0.0, 1.0);
  return std::hypot(away_x - share * along_x, away_z - share * along_z);
}

// Keeps both ends, and of every span the point farthest from its line if that is too far.
std::vector<bool> kept(Span<const float> points, double within_m) {
  const std::size_t count = points.size() / 2;
  std::vector<bool> keep(count, false);
  keep.front() = keep.back() = true;
  std::vector<std::pair<std::size_t, std::size_t>> spans = {{0, count - 1}};
  while (!spans.empty()) {
    const auto [first, last] = spans.back();
    spans.pop_back();
    std::size_t farthest = first;
    double most_m = within_m;
    for (std::size_t at = first + 1; at < last; ++at) {
      const double off_m = off(points, first, last, at);
      if (off_m > most_m) {
        most_m = off_m;
        farthest = at;
      }
    }
    if (farthest == first) continue;
    keep[farthest] = true;
    spans.emplace_back(first, farthest);
    spans.emplace_back(farthest, last);
  }
  return keep;
}

}  // namespace

GroundVector camera_relative(float right_m, float forward_m, float camera_heading_rad) {
  const float sine = std::sin(camera_heading_rad);
  const float cosine = std::cos(camera_heading_rad);
  // +X is to the left when looking along +Z
  return {forward_m * sine - right_m * cosine, forward_m * cosine + right_m * sine};
}

Result<GroundVector> stick_velocity(float right, float forward, const StickOptions& options) {
  for (const float each : {right, forward, options.camera_heading_rad, options.speed_mps}) {
    if (!std::isfinite(each)) return invalid("stick", "a number that is not finite", "finite numbers");
  }
  const float dead_zone = options.dead_zone;
  if (!(dead_zone >= 0 && dead_zone < 1)) {
    return invalid("dead_zone", std::to_string(dead_zone), "0 or more, below 1");
  }
  const float push = std::hypot(right, forward);
  if (push <= dead_zone) return GroundVector{};
  const float speed = options.speed_mps * (std::min(push, 1.0F) - dead_zone) / (1 - dead_zone);
  return camera_relative(speed * right / push, speed * forward / push, options.camera_heading_rad);
}

Result<std::vector<float>> drawn_corners(Span<const float> points_m, float within_m) {
  if (points_m.size() < 2 || points_m.size() % 2 != 0) {
    return invalid("points_m", std::to_string(points_m.size()) + " numbers", "x and z of one point or more");
  }
  if (!std::all_of(points_m.begin(), points_m.end(), [](float value) { return std::isfinite(value); })) {
    return invalid("points_m", "a number that is not finite", "finite metres");
  }
  if (!(within_m > 0)) return invalid("within_m", std::to_string(within_m), "metres above 0");
  auto within = static_cast<double>(within_m);
  std::vector<bool> keep = kept(points_m, within);
  while (static_cast<std::size_t>(std::count(keep.begin(), keep.end(), true)) > kMostCorners) {
    within *= 2;
    keep = kept(points_m, within);
  }
  std::vector<float> corners;
  for (std::size_t at = 0; at < keep.size(); ++at) {
    if (keep[at]) corners.insert(corners.end(), {points_m[2 * at], points_m[2 * at + 1]});
  }
  return corners;
}

}  // namespace motiongen
