#include "audit/remarks.h"

#include <algorithm>
#include <cmath>

#include "base/number_text.h"
#include "base/table.h"
#include "saltus/simulate/events.h"

namespace saltus {
namespace {

constexpr double kMostAmplified = 1e6;   // relative changes of the initial state, in the loss
constexpr double kMostOfTolerance = 10;  // integration errors beyond so many tolerances, and beyond
constexpr double kRounding = 1e-7;       // that of motions which no number of steps improves
constexpr double kWorse = 1e-9;          // relative: losses differ by more than rounding

void AddTie(const std::vector<Tie>& ambiguous, const std::optional<LossSpread>& spread, Remarks* remarks) {
  if (!ambiguous.empty()) remarks->push_back({"ambiguous", "ambiguous: " + DescribeTies(ambiguous, spread)});
}

// Adds the text of ExactRun::reason.
void AddFallback(int unresolved_steps, int num_steps, Remarks* remarks) {
  if (unresolved_steps == 0) return;
  remarks->push_back({"fallback", "there is no exact motion: " + DescribeUnresolved(unresolved_steps, num_steps)});
}

// Adds how many digits of the loss the rounding of initial state and control takes, if these are many.
void AddLostDigits(const Scene& scene, const ModelGradient& gradient, Remarks* remarks) {
  const std::vector<double> initial = InitialState(scene);
  double amplified = 0;
  for (std::size_t i = 0; i < initial.size(); ++i) amplified += std::abs(gradient.gradient.initial[i] * initial[i]);
  amplified /= std::max(std::abs(gradient.loss), gradient.loss_scale);
  if (!(amplified > kMostAmplified)) return;
  remarks->push_back({"lost digits",
                      "relative changes of the initial state grow by a factor of " + ToText(amplified, 2) +
                          " in the loss, of which about " + std::to_string(static_cast<int>(std::log10(amplified))) +
                          " digits are therefore lost to rounding"});
}

bool IsLess(double less, double than) { return than - less > kWorse * std::max(std::abs(less), std::abs(than)); }

}  // namespace

Remarks RemarksOn(const ExactRun& exact) {
  Remarks remarks;
  if (!exact.ok && exact.reason != kStopped) {
    remarks.push_back({exact.end.empty() ? "no exact motion" : "fallback", exact.reason});
  }
  AddTie(exact.ambiguous, exact.spread, &remarks);
  return remarks;
}

bool MayHaveRemarks(const Simulator& simulator) {
  return simulator.traits().event_driven && (!simulator.ties().empty() || NumUnresolvedSteps(simulator) > 0);
}

Remarks RemarksOn(const Simulator& simulator, const std::vector<double>& initial, const std::vector<double>& control,
                  const StopRequest& stop) {
  Remarks remarks;
  if (!MayHaveRemarks(simulator)) return remarks;
  AddFallback(NumUnresolvedSteps(simulator), simulator.num_steps(), &remarks);
  if (TiesOf(simulator).empty()) return remarks;
  const ExactRun exact = SimulateExactly(simulator.scene(), initial, control, {}, stop);
  AddTie(exact.ambiguous, exact.spread, &remarks);
  return remarks;
}

Remarks RemarksOn(const Scene& scene, const ModelGradient& gradient) {
  Remarks remarks;
  AddFallback(gradient.unresolved_steps, gradient.num_steps, &remarks);
  AddTie(gradient.ambiguous, gradient.spread, &remarks);
  for (const Event& event : gradient.grazes) {
    remarks.push_back({"derivative",
                       event.a + " grazes " + event.b + " at t = " + ToText(event.time, 6) +
                           ": the derivatives are those of motions that pass by, and not of those that hit"});
  }
  for (const OneSided& entry : gradient.one_sided) {
    const std::string of = std::string(entry.component == 0 ? "x" : "y") + " of the " +
                           QuantityToString(entry.quantity) + " of " + scene.bodies[entry.body].name;
    remarks.push_back({"derivative",
                       entry.side == OneSided::Side::kNone
                           ? "there is no derivative by the " + of
                           : "the derivative by the " + of + " is that of a " +
                                 (entry.side == OneSided::Side::kAbove ? "rise" : "fall") + " only"});
  }
  AddLostDigits(scene, gradient, &remarks);
  return remarks;
}

Remarks RemarksOn(const CheckedRun& run) {
  const SolveReport& report = run.report;
  Remarks remarks;
  if (run.HasSolution()) remarks = RemarksOn(run.exact);
  if (report.history.losses.empty()) return remarks;
  if (EndsWorse(report)) remarks.push_back({"end", "ends worse than it began"});
  if (report.guess.violation > kFeasible && report.solution.violation <= kFeasible) {
    remarks.push_back({"guess", "the initial guess does not meet the constraints"});
  }
  if (report.history.best && IsLess(report.history.best->solution.loss, report.solution.loss)) {
    remarks.push_back({"end",
                       "best " + Cell(report.history.best->solution.loss).Display(10) + " after " +
                           std::to_string(report.history.best->iteration) + " iterations"});
  }
  return remarks;
}

Remarks RemarksOn(const HybridSimulator& simulator, std::optional<double> integration_error, double tolerance) {
  Remarks remarks;
  if (const std::string why = simulator.ReasonNotDifferentiable(); !why.empty()) remarks.push_back({"derivative", why});
  if (integration_error && !(*integration_error <= std::max(kMostOfTolerance * tolerance, kRounding))) {
    remarks.push_back({"integration error",
                       "the relative error of the final state and of the times of events is " +
                           ToText(*integration_error, 2) + ", above the tolerance of " + ToText(tolerance, 2) +
                           ": use more steps of the integration"});
  }
  return remarks;
}

}  // namespace saltus
