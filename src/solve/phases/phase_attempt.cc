#include "solve/phases/phase_attempt.h"

namespace saltus {

std::vector<int> ShareSteps(int steps, const std::vector<double>& ends, const std::vector<bool>& empty) {
  int left = static_cast<int>(std::count(empty.begin(), empty.end(), false));  // phases still to be served
  const int least = steps >= 2 * left ? 2 : 1;
  std::vector<int> share;
  int node = 0;
  for (size_t j = 0; j < ends.size(); ++j) {
    if (empty[j]) {
      share.push_back(0);
      continue;
    }
    --left;
    const int last = steps - least * left;  // leaves enough for those that follow
    const int end = left == 0 ? steps : static_cast<int>(std::floor(steps * (ends[j] / ends.back())));
    share.push_back(std::clamp(end, node + least, last) - node);
    node += share.back();
  }
  return share;
}

}  // namespace saltus
