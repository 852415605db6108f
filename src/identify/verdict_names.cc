// Verdicts and the like, in words.
#include "saltus/identify/identify.h"

namespace saltus {

const char* DeterminationToString(Determination determination) {
  switch (determination) {
    case Determination::kDetermined:
      return "determined";
    case Determination::kCombined:
      return "only in combination";
    case Determination::kUndetermined:
      break;
  }
  return "not determined";
}

const char* FitVerdictToString(FitVerdict verdict) {
  switch (verdict) {
    case FitVerdict::kFits:
      return "fits";
    case FitVerdict::kNotDetermined:
      return "not determined";
    case FitVerdict::kContradicted:
      return "contradicted";
    case FitVerdict::kFailed:
      return "failed";
    case FitVerdict::kNotConverged:
      return "not converged";
    case FitVerdict::kInterrupted:
      return "interrupted";
    case FitVerdict::kNotApplicable:
      break;
  }
  return "not applicable";
}

}  // namespace saltus
