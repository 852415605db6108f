#include "solve/search/search_queue.h"

#include <algorithm>
#include <iterator>

namespace saltus {
namespace {

constexpr int kStarts = 3;  // motions from which a sequence is tried
constexpr size_t kMostRunnersUp = 12;

}  // namespace

SequenceKey KeyOf(const ContactSequence& sequence) {
  SequenceKey key;
  for (const Candidate& c : sequence) key.push_back({c.a, c.b, c.plane});
  return key;
}

void SearchQueue::Add(const Motion& from, ContactSequence sequence, size_t sharing) {
  const double loss = from->exact.loss;
  const std::size_t motion = sizeof(Trial) + (from->control.size() + from->durations.size()) * sizeof(double);
  const std::size_t bytes = sizeof(Queued) + sequence.size() * sizeof(Candidate) + motion / sharing;
  bytes_ += bytes;
  SearchTask task{.sequence = std::move(sequence), .from = from};
  queue_.emplace(std::pair(loss, number_++), Queued{std::move(task), bytes});
  while (bytes_ > memory_ && queue_.size() > 1) {
    const auto last = std::prev(queue_.end());
    bytes_ -= last->second.bytes;
    queue_.erase(last);
    forgotten_ = true;
  }
}

void SearchQueue::AddSequence(const Motion& from, ContactSequence sequence, size_t sharing) {
  int& starts = starts_[KeyOf(sequence)];
  if (starts >= kStarts) return;
  ++starts;
  Add(from, std::move(sequence), sharing);
}

void SearchQueue::AddMotion(const Trial& trial) {
  if (!trial.exact.only_impacts) return;
  NoteTried(trial.exact.contacts);
  Add(std::make_shared<const Trial>(trial), trial.exact.contacts, 1);
}

SearchTask SearchQueue::TakeFirst() {
  auto node = queue_.extract(queue_.begin());
  bytes_ -= node.mapped().bytes;
  return std::move(node.mapped().task);
}

void RunnersUp::Meet(const Trial& trial) {
  const auto known = std::find_if(motions_.begin(), motions_.end(), [&](const auto& other) {
    return other.second->exact.contacts == trial.exact.contacts;
  });
  if (known != motions_.end()) {
    if (known->first <= trial.exact.loss) return;
    motions_.erase(known);
  }
  motions_.emplace(trial.exact.loss, std::make_shared<const Trial>(trial));
  if (motions_.size() > kMostRunnersUp) motions_.erase(std::prev(motions_.end()));
}

}  // namespace saltus
