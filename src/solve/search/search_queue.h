// What a search over collision sequences keeps for later: sequences to be solved along, best first, and the best
// motions that are no optima.
#pragma once

#include <array>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "solve/search/search_solve.h"

namespace saltus {

// A sequence as something to be compared.
using SequenceKey = std::vector<std::array<int, 3>>;
SequenceKey KeyOf(const ContactSequence& sequence);

using Motion = std::shared_ptr<const Trial>;

class SearchQueue {
 public:
  // `memory`, bytes: of what does not fit the last is forgotten.
  explicit SearchQueue(std::size_t memory) : memory_(memory) {}

  // Along a sequence, from a motion that so many others of the queue share; by its loss, then in order. Not if the
  // sequence has been tried from enough motions.
  void AddSequence(const Motion& from, ContactSequence sequence, size_t sharing = 1);
  // Along its own sequence, whatever that has been tried from. Not if it has more than impacts.
  void AddMotion(const Trial& trial);
  // Counts a motion from which a sequence is tried without the queue.
  void NoteTried(const ContactSequence& sequence) { ++starts_[KeyOf(sequence)]; }

  bool empty() const { return queue_.empty(); }
  double first_loss() const { return queue_.begin()->first.first; }
  SearchTask TakeFirst();
  bool has_forgotten() const { return forgotten_; }

 private:
  struct Queued {
    SearchTask task;
    std::size_t bytes = 0;
  };
  void Add(const Motion& from, ContactSequence sequence, size_t sharing);

  std::size_t memory_, bytes_ = 0;
  bool forgotten_ = false;
  int number_ = 0;
  std::map<std::pair<double, int>, Queued> queue_;
  std::map<SequenceKey, int> starts_;  // motions from which a sequence is, or is to be, tried
};

// The best motions that are no optima, one of each sequence.
class RunnersUp {
 public:
  void Meet(const Trial& trial);
  const std::multimap<double, Motion>& by_loss() const { return motions_; }

 private:
  std::multimap<double, Motion> motions_;
};

}  // namespace saltus
