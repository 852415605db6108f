// One point of a sweep: a row of results, or of the reason why there are none.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "sweep/study.h"

namespace saltus {

// The columns after those of the options. A solve is
//   initial_loss, loss_before_last, final_loss, exact_loss, iterations, evaluations, seconds, termination, reason,
// and of generated scenes memory_mib before the termination, the most that the process had while it solved,
// a gradient (at the initial guess)
//   loss, norm_dposition, norm_dvelocity, norm_dcontrol (of its parts), relative_error (to the exact one), reason,
// where the reason of a row with results names ambiguous ties (a gradient then has no relative_error),
// and before either, of a surrogate: surrogate, and of biased gradients: biased ("yes" or "no"). Before the reason of a
// gradient that was estimated comes norm_standard_error (over the initial state and the control).
// With --feedback, before memory_mib, norm_standard_error, termination or reason, of either loop, "open_" and
// "closed_":
//   error, error_first_order, loss, loss_error, loss_first_order, otherwise, change_probability, failed
// (programs/feedback_study.h: final errors and expected losses of the noisy runs and to first order, runs with other
// events than planned and without a motion). Samples of several seeds are independent.
// The gradient of a program (options.h) is
//   loss, norm_dinitial, norm_dcontrol, norm_dparameters, relative_error (of the first scheme that it audits), events,
//   reason.
std::vector<std::string> ResultColumns(const SweepStudy& study);

// Computes a point, on the thread that calls. It is stopped after `seconds` (0: never) or once `stop` returns true; the
// row then holds what a solver had reached. All but the columns "seconds" and "memory_mib" of a point that is not
// stopped is the same on every call. The latter is empty unless the point is computed `alone`, as the memory of one
// thread is not known.
PointResult ComputePoint(const SweepStudy& study, int64_t point, double seconds, const StopRequest& stop = nullptr,
                         bool alone = true);

// Returns the reason of a point that was stopped after so many seconds.
std::string TimeLimitReason(double seconds);

// The row of a point of which nothing is known but why it failed.
PointResult FailedPoint(const SweepStudy& study, int64_t point, const std::string& reason);

}  // namespace saltus
