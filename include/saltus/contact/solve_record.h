// A record of the results of iterations in a step, so that its derivatives need no iterations.
#pragma once

#include <cstddef>
#include <source_location>
#include <span>
#include <vector>

namespace saltus {

// The vectors that a step finds by iteration, in the order in which the step asks for them. A derivative depends only
// on the point at which an iteration ends (implicit function theorem), so a step that is repeated with Jets recalls the
// values that were found before.
//
// Each vector is stored with the place in the source that asked for it. A repeated step that takes another branch asks
// from another place: it then recalls nothing, and what follows in the record is replaced.
class SolveRecord {
 public:
  void Clear() { Assign({}); }
  void Assign(std::span<const double> numbers) {
    numbers_.assign(numbers.begin(), numbers.end());
    next_ = 0;
  }
  // Returns to the beginning, before the step is repeated.
  void Rewind() { next_ = 0; }
  // Returns, for each vector in turn, its length, a number of its place, and its entries.
  std::span<const double> numbers() const { return numbers_; }

  bool AtEnd() const { return next_ == numbers_.size(); }
  // Returns whether there is a next vector and it was asked for at `place`.
  bool Has(const std::source_location& place) const { return !AtEnd() && numbers_[next_ + 1] == Number(place); }
  // Returns the next vector, valid until the next call of Append(). Precondition: not at the end.
  std::span<const double> Next() {
    const auto size = static_cast<std::size_t>(numbers_[next_]);
    const std::span<const double> vector = numbers().subspan(next_ + 2, size);
    next_ += 2 + size;
    return vector;
  }
  // Replaces all vectors that have not been recalled by one vector.
  void Append(const std::source_location& place, std::span<const double> vector) {
    numbers_.resize(next_);
    numbers_.push_back(static_cast<double>(vector.size()));
    numbers_.push_back(Number(place));
    numbers_.insert(numbers_.end(), vector.begin(), vector.end());
    next_ = numbers_.size();
  }

 private:
  static double Number(const std::source_location& place) { return 1024.0 * place.line() + place.column(); }

  std::vector<double> numbers_;
  std::size_t next_ = 0;
};

}  // namespace saltus
