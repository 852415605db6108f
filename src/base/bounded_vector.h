// A vector of up to kMax entries that are stored within the object, so that small, short-lived lists need no heap.
#pragma once

#include <glog/logging.h>

#include <array>
#include <cstddef>

namespace saltus {

// The interface is a part of std::vector's. Preconditions: T is default-constructible; never more than kMax entries.
template <typename T, int kMax>
class BoundedVector {
 public:
  BoundedVector() = default;
  explicit BoundedVector(std::size_t size, const T& value = T()) { resize(size, value); }

  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  T& operator[](std::size_t i) { return entries_[i]; }
  const T& operator[](std::size_t i) const { return entries_[i]; }
  T* begin() { return entries_.data(); }
  T* end() { return begin() + size_; }
  const T* begin() const { return entries_.data(); }
  const T* end() const { return begin() + size_; }
  const T& back() const { return entries_[size_ - 1]; }

  void push_back(const T& value) {
    CHECK_LT(size_, static_cast<std::size_t>(kMax));
    entries_[size_++] = value;
  }
  void resize(std::size_t size, const T& value = T()) {
    CHECK_LE(size, static_cast<std::size_t>(kMax));
    for (; size_ < size; ++size_) entries_[size_] = value;
    size_ = size;
  }

 private:
  std::array<T, kMax> entries_;
  std::size_t size_ = 0;
};

}  // namespace saltus
