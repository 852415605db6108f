// A model's gradient beside differences of its own loss, of every width: an audit that needs no reference.
//
//   slope(w) = (loss(z + w d) - loss(z - w d)) / (2 w)        d: one entry of initial state or constant force
//
// A simulation in steps gives every variable a scale, the grid width: the change that moves an impact by about a step.
// Differences far narrower keep all impacts in their steps and approach the derivative of the steps, which is what
// automatic differentiation computes and a gradient check confirms. Differences far wider let impacts cross many steps
// and approach the derivative of the motion that the steps stand for. Where the two plateaus differ, a gradient that
// agrees with narrow differences to seven digits is still wrong.
#pragma once

#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "saltus/audit/refinement.h"

namespace saltus {

struct WidthSweepOptions {
  int refine = 8;  // times the scene's steps, so that there is room between grid width and the scale of the motion
  int per_decade = 6;
  double smallest = 1e-4, largest = 100;        // widths, in grid widths
  double narrow_from = 1e-4, narrow_to = 1e-2;  // the plateaus, likewise
  double wide_from = 5, wide_to = 50;
  double tolerance = 0.05;  // by which plateaus may differ, of the largest entry of the quantity
  int most_states = 0;      // of the motion, at which speeds are measured for the grid width; 0: all

  // The number of widths of each entry.
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
  std::string entry;      // as of EntryNames
  double gradient = 0;    // the model's, at the refined steps
  double grid_width = 0;  // m, m/s or N
  std::vector<double> widths, slopes;
  double narrow = 0, wide = 0;                 // plateaus: medians of the slopes
  double narrow_spread = 0, wide_spread = 0;   // medians of the distance to them
  std::optional<double> exact = std::nullopt;  // derivative of the exact motion, if it is known
  WidthFinding finding = WidthFinding::kUndecided;
};

struct WidthSweepStudy {
  std::string reason;              // why there is none: a rollout that is not finite
  std::vector<WidthSweep> sweeps;  // position and velocity of each disc that moves, constant force on controlled ones
  // kWrong or kWrongSign if the gradient misses a wide plateau, else kUnknown: without a reference nothing is right.
  Verdict verdict = Verdict::kUnknown;

  bool ok() const { return reason.empty(); }
  // The sweep that speaks most against the gradient, by position if any of them does; or null.
  const WidthSweep* Worst() const;
  // One sentence for a person.
  std::string Summary() const;
};

// Notes the exact derivatives. Wide differences that are farther from them than the gradient is are no evidence against
// it. Precondition: the gradient is that of `scene`.
void CompareWithExact(const Scene& scene, const ModelGradient& exact, WidthSweepStudy* study);

// Where the model cannot take the scene, that is the reason. A study that was stopped is of no use.
WidthSweepStudy SweepWidths(const Contact& contact, const Scene& scene, const WidthSweepOptions& options = {},
                            const StopRequest& stop = nullptr);

}  // namespace saltus
