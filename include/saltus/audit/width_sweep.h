// Comparison of a model's gradient with differences of its own loss, of every width: an audit without a reference.
//
//   slope(w) = (loss(z + w d) - loss(z - w d)) / (2 w)        d: one entry of initial state or constant force
//
// The grid width of a variable is the change that moves an impact by about one step. Differences of far smaller widths
// leave all impacts in their steps. They approach the derivative of the steps, which automatic differentiation computes
// and a gradient check confirms. Differences of far larger widths move impacts across many steps. They approach the
// derivative of the motion that the steps approximate. If the two plateaus differ, a gradient is wrong although it may
// agree with narrow differences to seven digits.
#pragma once

#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "saltus/audit/refinement.h"

namespace saltus {

struct WidthSweepOptions {
  int refine = 8;      // factor on the scene's steps, which separates the grid width from the scale of the motion
  int per_decade = 6;  // widths per factor of 10
  double smallest = 1e-4, largest = 100;        // widths, in grid widths
  double narrow_from = 1e-4, narrow_to = 1e-2;  // the plateaus, in grid widths
  double wide_from = 5, wide_to = 50;
  double tolerance = 0.05;  // largest difference of the plateaus, relative to the largest entry of the quantity
  int most_states = 0;      // number of states at which speeds are measured for the grid width; 0: all

  // Returns the number of widths of each entry.
  int NumWidths() const { return static_cast<int>(per_decade * std::log10(largest / smallest)) + 1; }
};

enum class WidthFinding {
  kNothing,         // the gradient is that of the motion
  kOnlyOfItsSteps,  // it agrees with narrow differences, not with wide ones
  kOfNeither,       // it agrees with no differences of its loss
  kUndecided,       // wide differences scatter, or discs start too close for them
  kFarther          // wide differences are farther from the exact value than the gradient is
};
const char* WidthFindingToString(WidthFinding finding);

struct WidthSweep {
  Quantity quantity = Quantity::kPosition;
  std::string entry;                           // a name of EntryNames()
  double gradient = 0;                         // derivative by the model, at the refined steps
  double grid_width = 0;                       // m, m/s or N
  std::vector<double> widths, slopes;          // w, in m, m/s or N, rising; and slope(w)
  double narrow = 0, wide = 0;                 // plateaus: medians of the slopes
  double narrow_spread = 0, wide_spread = 0;   // medians of the distance of the slopes to them
  std::optional<double> exact = std::nullopt;  // derivative of the exact motion, if it is known
  WidthFinding finding = WidthFinding::kUndecided;
};

struct WidthSweepStudy {
  std::string reason;              // why there is no study: a rollout that is not finite
  std::vector<WidthSweep> sweeps;  // position and velocity of each disc that moves, constant force on controlled ones
  // kWrong or kWrongSign if the gradient differs from a wide plateau, else kUnknown: kRight needs a reference.
  Verdict verdict = Verdict::kUnknown;

  bool ok() const { return reason.empty(); }
  // Returns the sweep that differs most from the gradient, one by position if any of these does; or null.
  const WidthSweep* Worst() const;
  // Returns the result in one sentence.
  std::string Summary() const;
};

// Adds the exact derivatives to a study. Wide differences that are farther from these than the gradient are not counted
// against it. Precondition: the gradient is that of `scene`.
void CompareWithExact(const Scene& scene, const ModelGradient& exact, WidthSweepStudy* study);

// Sweeps the widths. If the model does not support the scene, `reason` states it. A study that was stopped has no
// meaning.
WidthSweepStudy SweepWidths(const Contact& contact, const Scene& scene, const WidthSweepOptions& options = {},
                            const StopRequest& stop = nullptr);

}  // namespace saltus
