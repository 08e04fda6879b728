// Consecutive frame rows in a ring buffer: pushed at the back, dropped at both ends, without an allocation for each.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace motiongen {

class RowStore {
 public:
  RowStore(std::size_t row_width, std::size_t capacity) : row_width_(row_width), rows_(capacity * row_width) {
    capacity_ = capacity;
  }

  std::size_t size() const { return size_; }

  // The row at an index counted from the oldest; it must exist.
  const float* row(std::size_t index) const { return rows_.data() + slot(index) * row_width_; }

  // Room for one more row at the back, for the caller to fill. Doubles the ring if it is full.
  float* push() {
    if (size_ == capacity_) grow();
    return rows_.data() + slot(size_++) * row_width_;
  }

  void drop_back(std::size_t count) { size_ -= count; }

  void drop_front(std::size_t count) {
    first_ = slot(count);
    size_ -= count;
  }

 private:
  std::size_t slot(std::size_t index) const {
    const std::size_t at = first_ + index;
    return at < capacity_ ? at : at - capacity_;
  }

  void grow() {
    std::vector<float> larger((capacity_ == 0 ? 1 : 2 * capacity_) * row_width_);
    for (std::size_t index = 0; index < size_; ++index) {
      const float* from = row(index);
      for (std::size_t column = 0; column < row_width_; ++column) larger[index * row_width_ + column] = from[column];
    }
    capacity_ = capacity_ == 0 ? 1 : 2 * capacity_;
    rows_ = std::move(larger);
    first_ = 0;
  }

  std::size_t row_width_;
  std::size_t capacity_ = 0;
  std::size_t first_ = 0;
  std::size_t size_ = 0;
  std::vector<float> rows_;
};

}  // namespace motiongen
