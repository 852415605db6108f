// What the iterations of a rollout have found, so that its derivatives need none.
#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <vector>

#include "saltus/contact/contact_model.h"

namespace saltus {

// The records of islands (SolveRecord) by step and pairs. Once the largest rollout has been seen, nothing allocates.
class SolvedSteps {
 public:
  void Clear() {
    islands_.clear();
    numbers_.clear();
  }

  // Of an island of so many pairs, all of which touched. Steps come in order.
  void Add(int step, const Candidate& first_pair, std::size_t num_pairs, std::span<const double> numbers) {
    islands_.push_back({step, first_pair, num_pairs, numbers_.size(), numbers.size()});
    numbers_.insert(numbers_.end(), numbers.begin(), numbers.end());
  }
  void AddAll(const SolvedSteps& more) {
    for (const Island& island : more.islands_) {
      Add(island.step, island.first_pair, island.num_pairs, more.NumbersOf(island));
    }
  }

  // Empty if there is no record.
  std::span<const double> Find(int step, const Candidate& first_pair, std::size_t num_pairs) const {
    const auto before = [](const Island& island, int k) { return island.step < k; };
    auto at = std::lower_bound(islands_.begin(), islands_.end(), step, before);
    for (; at != islands_.end() && at->step == step; ++at) {
      if (at->first_pair == first_pair && at->num_pairs == num_pairs) {
        return NumbersOf(*at);
      }
    }
    return {};
  }

  std::size_t bytes() const { return islands_.size() * sizeof(Island) + numbers_.size() * sizeof(double); }

 private:
  struct Island {
    int step;
    Candidate first_pair;
    std::size_t num_pairs;
    std::size_t begin, size;  // of its numbers
  };
  std::span<const double> NumbersOf(const Island& island) const {
    return std::span<const double>(numbers_).subspan(island.begin, island.size);
  }

  std::vector<Island> islands_;
  std::vector<double> numbers_;
};

}  // namespace saltus
