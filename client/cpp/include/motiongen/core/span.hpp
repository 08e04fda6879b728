// A view of consecutive values that something else owns, like std::span of C++20.
#pragma once

#include <cstddef>
#include <type_traits>
#include <utility>

namespace motiongen {

// Valid as long as what it was made from. Span<const T> is read-only.
template <class T>
class Span {
 public:
  constexpr Span() = default;
  constexpr Span(T* data, std::size_t size) : data_(data), size_(size) {}

  // From anything with data() and size(): std::vector, std::array, another Span.
  template <class C, class = std::enable_if_t<std::is_convertible_v<decltype(std::declval<C&>().data()), T*> &&
                                              !std::is_same_v<std::decay_t<C>, Span>>>
  constexpr Span(C&& values) : data_(values.data()), size_(values.size()) {}  // NOLINT: converts on purpose

  constexpr T* data() const { return data_; }
  constexpr std::size_t size() const { return size_; }
  constexpr bool empty() const { return size_ == 0; }
  constexpr T* begin() const { return data_; }
  constexpr T* end() const { return data_ + size_; }
  constexpr T& operator[](std::size_t index) const { return data_[index]; }

  // `count` values from `first` on, which must lie within this span.
  constexpr Span subspan(std::size_t first, std::size_t count) const { return {data_ + first, count}; }

 private:
  T* data_ = nullptr;
  std::size_t size_ = 0;
};

}  // namespace motiongen
