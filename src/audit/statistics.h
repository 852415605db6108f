// Small statistics of the audit.
#pragma once

#include <algorithm>
#include <vector>

namespace saltus {

// The middle value; the upper one of two. Precondition: not empty.
inline double Median(std::vector<double> values) {
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace saltus
