#include "solve/control_guess.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>

namespace saltus {
namespace {

constexpr double kSameTime = 1e-9;  // of the duration: intervals fill it

// Where intervals begin and end, in units of the whole duration.
std::vector<double> Boundaries(const ControlGuess& guess, size_t intervals) {
  std::vector<double> at(intervals + 1, 0.0);
  for (size_t k = 0; k < intervals; ++k) at[k + 1] = guess.durations.empty() ? k + 1.0 : at[k] + guess.durations[k];
  const double total = at.back();
  for (double& boundary : at) boundary /= total;
  return at;
}

}  // namespace

std::string Validate(const ControlGuess& guess, const Scene& scene) {
  const size_t width = scene.control_width(), found = guess.control.size();
  if (width == 0) return "guess: a control, expected a scene in which something is pushed";
  if (found == 0 || found % width != 0) {
    return "guess: found a control of " + std::to_string(found) + " numbers, expected a positive multiple of " +
           std::to_string(width);
  }
  if (!guess.durations.empty() && guess.durations.size() != found / width) {
    return "guess: found " + std::to_string(guess.durations.size()) + " durations, expected " +
           std::to_string(found / width) + ", one per interval";
  }
  const auto finite = [](double value) { return std::isfinite(value) && std::abs(value) <= kLargestMagnitude; };
  if (!std::all_of(guess.control.begin(), guess.control.end(), finite)) return "guess: expected finite forces";
  const auto length = [&](double value) { return finite(value) && value >= 0; };
  if (!std::all_of(guess.durations.begin(), guess.durations.end(), length)) {
    return "guess: expected durations that are finite and not negative";
  }
  const double sum = DurationOf(guess, scene);
  if (!(sum > 0)) return "guess: durations sum up to 0";
  if (!scene.objective.duration && std::abs(sum - scene.duration) > kSameTime * scene.duration) {
    char text[120];
    std::snprintf(
        text, sizeof text, "guess: durations sum up to %.9g s, expected the scene's, %.9g s", sum, scene.duration);
    return text;
  }
  return "";
}

std::vector<double> LengthsOf(const ControlGuess& guess, const Scene& scene) {
  if (!guess.durations.empty()) return guess.durations;
  const size_t intervals = guess.control.size() / scene.control_width();
  return std::vector<double>(intervals, scene.duration / static_cast<double>(intervals));
}

double DurationOf(const ControlGuess& guess, const Scene& scene) {
  if (guess.durations.empty()) return scene.duration;
  return std::accumulate(guess.durations.begin(), guess.durations.end(), 0.0);
}

std::vector<double> MeanOverSteps(const ControlGuess& guess, int numbers, int steps) {
  const size_t width = numbers, intervals = guess.control.size() / width;
  const std::vector<double> at = Boundaries(guess, intervals);
  std::vector<double> means(width * steps, 0.0);
  const double smallest = 1e-12 / steps;  // overlaps below this are rounding
  size_t first = 0;
  for (int k = 0; k < steps; ++k) {
    const double begin = static_cast<double>(k) / steps, end = static_cast<double>(k + 1) / steps;
    while (first + 1 < intervals && at[first + 1] <= begin + smallest) ++first;
    double covered = 0;
    size_t count = 0, last = first;
    for (size_t i = first; i < intervals && at[i] < end - smallest; ++i) {
      const double overlap = std::min(end, at[i + 1]) - std::max(begin, at[i]);
      if (overlap <= smallest) continue;
      covered += overlap;
      ++count;
      last = i;
      for (size_t j = 0; j < width; ++j) means[width * k + j] += overlap * guess.control[width * i + j];
    }
    for (size_t j = 0; j < width; ++j) {
      double& mean = means[width * k + j];
      mean = count == 1 ? guess.control[width * last + j] : mean / covered;
    }
  }
  return means;
}

}  // namespace saltus
