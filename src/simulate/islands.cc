#include "simulate/islands.h"

#include <algorithm>
#include <tuple>

namespace saltus {
namespace {

bool PrecedesInOrder(const Candidate& l, const Candidate& r) {
  return std::tie(l.plane, l.a, l.b) < std::tie(r.plane, r.a, r.b);
}

}  // namespace

int Islands::Root(int i) {
  while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
  return i;
}

void Islands::FindOnly(const Candidate& pair) {
  size_ = 1;
  pairs_.assign(1, pair);
  bodies_.assign(1, pair.a);
  if (!pair.plane) bodies_.push_back(pair.b);
  first_body_ = {0, static_cast<int>(bodies_.size())};
  first_pair_ = {0, 1};
}

void Islands::Find(std::span<const Candidate> pairs, std::span<const char> fixed) {
  if (pairs.size() == 1) return FindOnly(pairs[0]);
  for (size_t i = parent_.size(); i < fixed.size(); ++i) {
    parent_.push_back(static_cast<int>(i));
    island_of_.push_back(-1);
  }
  moving_.clear();
  for (const Candidate& c : pairs) {
    const bool a = !fixed[c.a];
    const bool b = !c.plane && !fixed[c.b];
    if (a) moving_.push_back(c.a);
    if (b) moving_.push_back(c.b);
    if (!a || !b) continue;
    const int root_a = Root(c.a);
    const int root_b = Root(c.b);
    parent_[std::max(root_a, root_b)] = std::min(root_a, root_b);
  }
  std::sort(moving_.begin(), moving_.end());
  moving_.erase(std::unique(moving_.begin(), moving_.end()), moving_.end());

  size_ = 0;
  members_.clear();
  for (int i : moving_) {
    int& island = island_of_[Root(i)];  // the root is the smallest of its island
    if (island < 0) island = size_++;
    members_.push_back({i, island});
  }
  first_pair_.assign(size_ + 1, 0);
  island_of_pair_.clear();
  for (const Candidate& c : pairs) {
    const int island = island_of_[Root(fixed[c.a] ? c.b : c.a)];
    island_of_pair_.push_back(island);
    ++first_pair_[island + 1];
    if (fixed[c.a]) members_.push_back({c.a, island});
    if (!c.plane && fixed[c.b]) members_.push_back({c.b, island});
  }
  if (members_.size() > moving_.size()) {
    std::sort(members_.begin(), members_.end());
    members_.erase(std::unique(members_.begin(), members_.end()), members_.end());
  }
  first_body_.assign(size_ + 1, 0);
  for (const Member& member : members_) ++first_body_[member.island + 1];
  for (int island = 0; island < size_; ++island) {
    first_body_[island + 1] += first_body_[island];
    first_pair_[island + 1] += first_pair_[island];
  }
  // The lists are filled from behind, so that the ends become the beginnings of the next islands.
  bodies_.resize(members_.size());
  for (size_t m = members_.size(); m-- > 0;) bodies_[--first_body_[members_[m].island + 1]] = members_[m].body;
  pairs_.resize(pairs.size());
  for (size_t q = pairs.size(); q-- > 0;) pairs_[--first_pair_[island_of_pair_[q] + 1]] = pairs[q];
  for (int island = 0; island < size_; ++island) {
    first_body_[island] = first_body_[island + 1];
    first_pair_[island] = first_pair_[island + 1];
  }
  first_body_[size_] = static_cast<int>(members_.size());
  first_pair_[size_] = static_cast<int>(pairs.size());
  for (int i : moving_) {
    parent_[i] = i;
    island_of_[i] = -1;
  }
}

void LocalPairs(std::span<const Candidate> pairs, std::span<const int> bodies, std::vector<Candidate>* local) {
  const auto place = [&](int body) {
    return static_cast<int>(std::lower_bound(bodies.begin(), bodies.end(), body) - bodies.begin());
  };
  local->clear();
  for (const Candidate& c : pairs) local->push_back({place(c.a), c.plane ? c.b : place(c.b), c.plane});
  if (local->size() == 1) return;
  std::sort(local->begin(), local->end(), PrecedesInOrder);
  local->erase(std::unique(local->begin(), local->end()), local->end());
}

}  // namespace saltus
