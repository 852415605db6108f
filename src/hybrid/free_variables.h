// The variables of a hybrid problem as one list.
#pragma once

#include <vector>

#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// A number that a solver may change.
struct FreeVariable {
  enum class Kind { kControl, kInitial, kParameter, kDuration } kind = Kind::kControl;
  int index = 0;            // among the numbers of this kind
  double min = 0, max = 0;  // infinite where there is no bound

  // Returns the variable's number in an input, a gradient or a motion. Precondition: `of` has a duration if this is
  // one.
  template <typename Numbers>
  auto& Access(Numbers& of) const {
    if constexpr (requires { of.duration; }) {
      if (kind == Kind::kDuration) return of.duration;
    }
    return (kind == Kind::kControl ? of.control : kind == Kind::kInitial ? of.initial : of.parameters)[index];
  }
};

// Returns the free variables: of the control, by interval, of the initial state and of the parameters; the duration.
std::vector<FreeVariable> FreeVariables(const HybridFree& free, int num_controls, int num_intervals);

}  // namespace saltus
