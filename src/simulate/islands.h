// Groups of discs that are connected by contacts, each of which can be stepped without the others.
#pragma once

#include <span>
#include <vector>

#include "saltus/contact/step_input.h"

namespace saltus {

// Fixed discs and planes connect nothing; a fixed disc belongs to every island that touches it. Finding islands takes
// time in proportion to the pairs, however many discs there are, and no memory once the largest case has been seen.
class Islands {
 public:
  // Overwrites the islands with those that `pairs` connect. `fixed[i]` is true if disc i is fixed.
  void Find(std::span<const Candidate> pairs, std::span<const char> fixed);

  // The number of islands, which are in the order of their first moving disc.
  int size() const { return size_; }
  // The discs of an island, ascending, and its pairs, in the order given.
  std::span<const int> bodies(int island) const { return Slice<int>(bodies_, first_body_, island); }
  std::span<const Candidate> pairs(int island) const { return Slice<Candidate>(pairs_, first_pair_, island); }

 private:
  template <typename T>
  static std::span<const T> Slice(const std::vector<T>& all, const std::vector<int>& first, int island) {
    return std::span<const T>(all).subspan(first[island], first[island + 1] - first[island]);
  }
  int Root(int i);
  void FindOnly(const Candidate& pair);  // by far the most common case

  int size_ = 0;
  std::vector<int> bodies_, first_body_;
  std::vector<Candidate> pairs_;
  std::vector<int> first_pair_;

  // Between two calls every disc is its own parent and belongs to no island.
  std::vector<int> parent_, island_of_;
  std::vector<int> moving_;
  struct Member {
    int body, island;
    auto operator<=>(const Member&) const = default;
  };
  std::vector<Member> members_;
  std::vector<int> island_of_pair_;
};

// Sets `local` to an island's pairs with discs numbered as in `bodies`, each once: discs by index pairs, then planes.
void LocalPairs(std::span<const Candidate> pairs, std::span<const int> bodies, std::vector<Candidate>* local);

}  // namespace saltus
