// The record of the contacts of a rollout, so that derivatives need not simulate again: the touches, the states in
// which they began, and the solutions that iterations have found.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "saltus/contact/step_input.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

// The records of islands (SolveRecord) by step and pairs. Once the largest rollout has been seen, nothing allocates.
class SolvedSteps {
 public:
  void Clear() {
    islands_.clear();
    numbers_.clear();
  }

  // Adds the record of an island all of whose `num_pairs` pairs touched. Precondition: steps come in ascending order.
  void Add(int step, const Candidate& first_pair, std::size_t num_pairs, std::span<const double> numbers) {
    islands_.push_back({step, first_pair, num_pairs, numbers_.size(), numbers.size()});
    numbers_.insert(numbers_.end(), numbers.begin(), numbers.end());
  }
  void AddAll(const SolvedSteps& more) {
    for (const Island& island : more.islands_) {
      Add(island.step, island.first_pair, island.num_pairs, more.NumbersOf(island));
    }
  }

  // Returns the record of an island, empty if there is none.
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

// The touches of a rollout, all of them; and from some touch on, for the sake of memory, the states of their discs
// before the step, and what was found in it.
template <typename State>
class RolloutRecord {
 public:
  void Clear() {
    touches_.clear();
    ForgetStates(0);
  }
  // Discards the states; from here on, states are kept from touch `first` on.
  void ForgetStates(int first) {
    states_.clear();
    solved_.Clear();
    first_with_states_ = first;
  }
  void AddTouches(int k, std::span<const Touch> touches) {
    for (const Touch& touch : touches) touches_.push_back({k, touch});
  }
  // Adds the states of the next touches, those in the step from x.
  void AddStates(std::span<const Touch> touches, std::span<const State> x, const SolvedSteps& solved) {
    for (const Touch& touch : touches) {
      const Candidate& c = touch.candidate;
      states_.push_back({x[c.a], c.plane ? x[c.a] : x[c.b]});
    }
    solved_.AddAll(solved);
  }

  int size() const { return static_cast<int>(touches_.size()); }
  const std::vector<StepTouch>& touches() const { return touches_; }
  // Returns the first of the touches before `end` that is in step k or later.
  int First(int k, int end) const {
    while (end > 0 && touches_[end - 1].step >= k) --end;
    return end;
  }
  int first_with_states() const { return first_with_states_; }
  // Returns the states of disc a and, if there is one, disc b of a touch.
  const std::array<State, 2>& StatesOf(int touch) const { return states_[touch - first_with_states_]; }
  const SolvedSteps& solved() const { return solved_; }
  std::size_t bytes_of_states() const { return states_.size() * sizeof(states_[0]) + solved_.bytes(); }

 private:
  std::vector<StepTouch> touches_;
  std::vector<std::array<State, 2>> states_;
  SolvedSteps solved_;
  int first_with_states_ = 0;
};

}  // namespace saltus
