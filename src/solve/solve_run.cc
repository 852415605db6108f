#include "solve_run.h"

#include "saltus/dynamics/registry.h"

namespace saltus {

SolveRun::SolveRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options)
    : start_(std::chrono::steady_clock::now()),
      options_(options),
      shooting_(MakeSimulator(ContactWith(options.surrogate, request.contact), request.scene, request.precision)) {
  shooting_.set_memory_limit(options.memory_limit);
  shooting_.set_stop(options.stop);
  report_.contact = request.contact.name();
  report_.solver = solver;
  report_.surrogate = options.surrogate;
}

void SolveRun::RecordEstimate(std::vector<double> standard_error) {
  ++num_estimates_;
  report_.standard_error = std::move(standard_error);
}

bool SolveRun::Record(double loss, std::span<const double> z) {
  report_.losses.push_back(loss);
  if (options_.keep_iterates) report_.iterates.emplace_back(z.begin(), z.end());
  if (shooting_.stopped()) return false;
  return !options_.callback || options_.callback(num_recorded() - 1, loss);
}

SolveReport SolveRun::Finish(std::span<const double> z, Termination termination, std::string reason,
                             std::optional<double> final_loss) {
  // Stopped in the middle of an iteration, an algorithm sees evaluations that fail.
  if (shooting_.stopped() && termination != Termination::kConverged) {
    termination = Termination::kInterrupted;
    reason.clear();
  }
  report_.termination = termination;
  report_.reason = std::move(reason);
  const std::string why = termination == Termination::kFailed ? shooting_.simulator().WhyFailed() : "";
  if (!why.empty()) report_.reason += (report_.reason.empty() ? "" : ": ") + why;
  if (!report_.losses.empty()) {
    report_.initial_loss = report_.losses.front();
    report_.final_loss = final_loss.value_or(report_.losses.back());
    report_.iterations = num_recorded() - 1;
  }
  report_.evaluations = shooting_.num_adjoints() + num_estimates_;
  report_.initial_state = shooting_.InitialStateAt(z);
  report_.control = shooting_.ControlAt(z);
  report_.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  return std::move(report_);
}

std::string WhyNothingToOptimize(const Scene& scene) {
  const bool nothing = scene.optimize == Optimize::kNone ||
                       (scene.optimize == Optimize::kControl ? scene.control.bodies.empty() : scene.free.empty());
  return nothing ? "the scene leaves nothing to optimize" : "";
}

}  // namespace saltus
