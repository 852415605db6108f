#include "base/suggestion.h"

#include <algorithm>
#include <numeric>
#include <utility>

namespace saltus {
namespace {

constexpr std::size_t kLongest = 60;  // words compared, bytes

// Number of single-character insertions, deletions and replacements between two words.
std::size_t EditDistance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), 0);
  for (std::size_t i = 0; i < a.size(); ++i) {
    std::size_t diagonal = std::exchange(row[0], i + 1);
    for (std::size_t j = 0; j < b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i] != b[j]);
      diagonal = row[j + 1];
      row[j + 1] = std::min({replaced, row[j] + 1, diagonal + 1});
    }
  }
  return row.back();
}

}  // namespace

std::string Suggestion(std::string_view word, const std::vector<std::string>& words) {
  if (word.size() > kLongest) return "";
  std::size_t least = std::max<std::size_t>(word.size() / 3, 1) + 1;
  std::string nearest;
  for (const std::string& other : words) {
    if (other.size() > kLongest) continue;
    const std::size_t distance = EditDistance(word, other);
    if (distance >= least) continue;
    least = distance;
    nearest = other;
  }
  return nearest.empty() ? "" : "; did you mean " + nearest + "?";
}

}  // namespace saltus
