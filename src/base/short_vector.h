// A vector that stores its first kFew entries within the object, for many short lists.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

namespace saltus {

// The interface is a part of std::vector's. Precondition: T is default-constructible.
template <typename T, int kFew>
class ShortVector {
 public:
  ShortVector() = default;
  ShortVector(std::size_t size, const T& value) {
    for (std::size_t i = 0; i < size; ++i) push_back(value);
  }

  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }
  T* begin() { return many_.empty() ? few_.data() : many_.data(); }
  T* end() { return begin() + size_; }
  const T* begin() const { return many_.empty() ? few_.data() : many_.data(); }
  const T* end() const { return begin() + size_; }
  T& operator[](std::size_t i) { return begin()[i]; }
  const T& operator[](std::size_t i) const { return begin()[i]; }

  void push_back(const T& value) {
    if (size_ < kFew) {
      few_[size_] = value;
    } else {
      if (many_.empty()) many_.assign(few_.begin(), few_.end());
      many_.push_back(value);
    }
    ++size_;
  }

 private:
  std::array<T, kFew> few_;
  std::vector<T> many_;  // all entries, if they are more than a few
  std::size_t size_ = 0;
};

}  // namespace saltus
