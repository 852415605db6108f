// Small functions of numbers, texts and of rollouts that several parts of the audit need.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <span>
#include <string>
#include <vector>

#include "saltus/simulate/simulator.h"

namespace saltus {

// As printf does.
inline std::string FormatNumbers(const char* format, double a, double b = 0, double c = 0) {
  char text[240];
  std::snprintf(text, sizeof text, format, a, b, c);
  return text;
}

// The Euclidean norm.
inline double Norm(const std::vector<double>& entries) {
  double sum = 0;
  for (double entry : entries) sum += entry * entry;
  return std::sqrt(sum);
}

// The largest magnitude; 0 of none.
inline double Largest(const std::vector<double>& entries) {
  double largest = 0;
  for (double entry : entries) largest = std::max(largest, std::abs(entry));
  return largest;
}

// The middle value; the upper one of two. Precondition: not empty.
inline double Median(std::vector<double> values) {
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// The largest speed of a disc in the simulator's last rollout, m/s.
inline double LargestSpeed(const Simulator& simulator) {
  double largest = 0;
  std::vector<double> x(simulator.state_size());
  for (int k = 0; k <= simulator.num_steps(); ++k) {
    simulator.GetState(k, x);
    for (int i = 0; i < simulator.num_bodies(); ++i) {
      const double* v = &x[i * simulator.body_size() + 2];
      largest = std::max(largest, std::hypot(v[0], v[1]));
    }
  }
  return largest;
}

// p of y ~ x^p, by least squares of the logarithms.
inline double PowerOf(std::span<const double> x, std::span<const double> y) {
  double sum_x = 0, sum_y = 0, sum_xx = 0, sum_xy = 0;
  const double n = static_cast<double>(x.size());
  for (size_t i = 0; i < x.size(); ++i) {
    const double log_x = std::log(x[i]), log_y = std::log(y[i]);
    sum_x += log_x;
    sum_y += log_y;
    sum_xx += log_x * log_x;
    sum_xy += log_x * log_y;
  }
  return (n * sum_xy - sum_x * sum_y) / (n * sum_xx - sum_x * sum_x);
}

}  // namespace saltus
