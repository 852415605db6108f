// What the iterations of a step have found, so that its derivatives need none.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace saltus {

// Vectors that a step finds by iteration, in the order in which it needs them. A derivative depends only on where an
// iteration ends (implicit function theorem), so a step that is taken again with Jets recalls what was found in values.
class SolveRecord {
 public:
  void Clear() { Assign({}); }
  void Assign(std::span<const double> numbers) {
    numbers_.assign(numbers.begin(), numbers.end());
    next_ = 0;
  }
  // To be called before the step is taken again.
  void Rewind() { next_ = 0; }
  std::span<const double> numbers() const { return numbers_; }

  bool AtEnd() const { return next_ == numbers_.size(); }
  // The next vector, until the next call of Append(). Precondition: not at the end.
  std::span<const double> Next() {
    const auto size = static_cast<std::size_t>(numbers_[next_]);
    const std::span<const double> vector = numbers().subspan(next_ + 1, size);
    next_ += 1 + size;
    return vector;
  }
  // Precondition: at the end.
  void Append(std::span<const double> vector) {
    numbers_.push_back(static_cast<double>(vector.size()));
    numbers_.insert(numbers_.end(), vector.begin(), vector.end());
    next_ = numbers_.size();
  }

 private:
  std::vector<double> numbers_;  // each vector after its length
  std::size_t next_ = 0;
};

}  // namespace saltus
