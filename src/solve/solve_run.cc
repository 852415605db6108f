#include "solve/solve_run.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/number_text.h"
#include "saltus/control/objective.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/events.h"
#include "saltus/simulate/registry.h"
#include "solve/control_guess.h"

namespace saltus {
namespace {

SingleShooting MakeShooting(const Contact& contact, const SolveRequest& request) {
  const Precision precision = request.precision;
  return SingleShooting(MakeSimulator(contact, request.scene, precision),
                        SingleShooting::Variables::kOptimized,
                        [contact, precision](const Scene& scene) {
                          const bool takes = ReasonNotApplicable(contact, scene).empty();
                          return takes ? MakeSimulator(contact, scene, precision) : nullptr;
                        });
}

// The decision variables of a control that is given.
std::vector<double> DecisionsOf(const ControlGuess& guess, const SingleShooting& shooting) {
  const Scene& scene = shooting.scene();
  std::vector<double> z = MeanOverSteps(guess, scene.control_width(), shooting.simulator().num_steps());
  if (shooting.has_duration()) {
    const FreeDuration& free = *scene.objective.duration;
    z.push_back(std::clamp(DurationOf(guess, scene), free.min, free.max));
  }
  const std::vector<double> design = shooting.ParametersAt(shooting.initial_guess());
  z.insert(z.end(), design.begin(), design.end());
  return z;
}

void AddReason(const std::string& why, std::string* words) {
  if (!why.empty() && words->find(why) == std::string::npos) *words += (words->empty() ? "" : ": ") + why;
}

bool GradientVanished(std::span<const ceres::IterationSummary> iterations) {
  double largest = 0;
  for (const ceres::IterationSummary& iteration : iterations) largest = std::max(largest, iteration.gradient_max_norm);
  return iterations.back().gradient_max_norm <= std::max(kGradientTolerance, kGradientReduction * largest);
}

Termination Judge(const CeresOutcome& outcome) {
  if (outcome.iterations.empty()) {
    return outcome.type == ceres::CONVERGENCE ? Termination::kConverged : Termination::kFailed;
  }
  if (outcome.type == ceres::USER_SUCCESS) return Termination::kInterrupted;
  if (outcome.type == ceres::FAILURE && !outcome.failure_is_stall) return Termination::kFailed;
  if (GradientVanished(outcome.iterations)) return Termination::kConverged;
  return outcome.type == ceres::NO_CONVERGENCE ? Termination::kIterationLimit : Termination::kNoProgress;
}

// Describes how a solve ended. Reports of Ceres are not used, as they refer to its internal thresholds.
std::string Describe(Termination termination, const CeresOutcome& outcome) {
  switch (termination) {
    case Termination::kConverged:
      return "the gradient has vanished";
    case Termination::kIterationLimit:
      return "the gradient has not vanished within the iterations allowed";
    case Termination::kNoProgress:
      return outcome.type == ceres::FAILURE ? "no descent was found, though the gradient has not vanished"
                                            : "steps no longer lower the loss, though the gradient has not vanished";
    case Termination::kFailed:
      return "no step was found that has a finite loss and derivatives";
    case Termination::kInterrupted:
    case Termination::kNotApplicable:
      return "";
  }
  return "";
}

}  // namespace

std::string Validate(const SolverOptions& options) {
  if (options.limits.iterations < 0) {
    return "iterations: found " + std::to_string(options.limits.iterations) + ", expected 0 or more";
  }
  if (!(options.descent.learning_rate > 0) || !std::isfinite(options.descent.learning_rate)) {
    return "learning_rate: found " + ToText(options.descent.learning_rate) + ", expected a finite number > 0";
  }
  if (options.threads < 0) return "threads: found " + std::to_string(options.threads) + ", expected 0 or more";
  return Validate(options.sequences.limits);
}

void SetSolution(const ShootingFunction& shooting, std::span<const double> z, Solution* solution) {
  solution->initial_state = shooting.InitialStateAt(z);
  solution->control = shooting.ControlAt(z);
  solution->durations = shooting.DurationsAt(z);
  solution->parameters = shooting.ParametersAt(z);
}

ShootingRun::ShootingRun(std::string_view solver, const SolverOptions& options)
    : options_(options), start_(std::chrono::steady_clock::now()) {
  report_.solver = solver;
}

void ShootingRun::RecordEstimate(std::vector<double> standard_error) {
  ++num_estimates_;
  report_.history.standard_error = std::move(standard_error);
}

bool ShootingRun::Record(double loss, std::span<const double> z) {
  report_.history.losses.push_back(loss);
  if (options_.keep_iterates) report_.history.iterates.emplace_back(z.begin(), z.end());
  if (function().stopped()) return false;
  return !options_.monitor.callback || options_.monitor.callback(num_recorded() - 1, loss);
}

SolveReport ShootingRun::Finish(std::span<const double> z, Termination termination, std::string reason,
                                std::optional<double> final_loss) {
  const ShootingFunction& shooting = function();
  // An algorithm that is stopped in the middle of an iteration sees evaluations that fail.
  if (shooting.stopped() && termination != Termination::kConverged) {
    termination = Termination::kInterrupted;
    reason.clear();
  }
  const std::string why = termination == Termination::kFailed ? shooting.FailureReason() : "";
  if (const std::string remark = RemarkOn(z, termination); !remark.empty()) {
    reason += (reason.empty() ? "" : ": ") + remark;
  }
  report_.termination = termination;
  report_.reason = std::move(reason);
  AddReason(why, &report_.reason);
  if (!report_.history.losses.empty()) {
    report_.guess.loss = report_.history.losses.front();
    report_.solution.loss = final_loss.value_or(report_.history.losses.back());
    report_.work.iterations = num_recorded() - 1;
  }
  report_.work.evaluations = shooting.num_adjoints() + num_estimates_;
  SetSolution(shooting, z, &report_.solution);
  report_.work.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  return std::move(report_);
}

SolveRun::SolveRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options)
    : ShootingRun(solver, options),
      shooting_(MakeShooting(ApplySurrogate(options.surrogate, request.contact), request)) {
  shooting_.set_memory_limit(options.limits.memory);
  shooting_.set_stop([this] {
    const auto& most = options_.limits.impacts;
    if (most && shooting_.simulator().touches().size() > static_cast<size_t>(*most)) return true;
    return options_.monitor.stop && options_.monitor.stop();
  });
  guess_ = options.guess ? DecisionsOf(*options.guess, shooting_) : shooting_.initial_guess();
  report_.contact = request.contact.name();
  report_.surrogate = options.surrogate;
}

std::string SolveRun::RemarkOn(std::span<const double> z, Termination termination) {
  const Scene scene = shooting_.scene();  // an evaluation may go on to another
  double loss = 0;
  if (termination != Termination::kConverged || scene.pockets.empty() || !shooting_.Evaluate(z, &loss, nullptr)) {
    return "";
  }
  std::string in_pockets;
  for (const Event& event : EventsOf(shooting_.simulator())) {
    const bool counts = event.mode == ContactMode::kPocketed &&
                        std::any_of(scene.objective.terminal.begin(),
                                    scene.objective.terminal.end(),
                                    [&](const TerminalTerm& term) { return scene.bodies[term.body].name == event.a; });
    const std::string lies = event.a + " lies in the pocket " + event.b;
    if (!counts || in_pockets.find(lies) != std::string::npos) continue;
    in_pockets += (in_pockets.empty() ? "" : ", ") + lies;
  }
  return in_pockets.empty() ? "" : in_pockets + ", where the loss has no slope";
}

std::string UnsupportedByShooting(const SolveRequest& request, const BoundsKept& bounds) {
  const Scene& scene = request.scene;
  if (std::string reason = ReasonNothingToOptimize(scene); !reason.empty()) return reason;
  const auto refuse = [](const std::string& what, const std::string& why) {
    return "the scene has " + what + ", " + why + "; ceres_phases takes them";
  };
  if (const std::string found = ConstraintsOf(scene.objective); !found.empty()) {
    return refuse(found, "which take multipliers");
  }
  if (!scene.no_contact.empty()) return refuse("pairs that must not touch", "which take multipliers");
  if (!(scene.control.max.empty() && scene.control.max_torque.empty()) && !bounds.components) {
    return refuse("bounds on the control", "which its steps would leave");
  }
  if (!scene.control.max_norm.empty() && !bounds.norm) {
    return refuse("bounds on the control's norm", "which its steps would leave");
  }
  if (!scene.design.empty()) {
    const std::string design = "optimize: found " + NameOf(scene.design.front().parameter, scene);
    if (request.precision != Precision::kDouble) return design + ", whose derivatives are taken in double precision";
    for (const DesignParameter& one : scene.design) {
      if ((!one.min && !one.max) || bounds.components) continue;
      return "optimize: found bounds on " + NameOf(one.parameter, scene) + ", which its steps would leave";
    }
    const bool path = !scene.objective.running.empty() || !scene.objective.via.empty();
    if (path && !FindContactModel(request.contact)->event_driven) {
      return design + " beside path costs, which have derivatives by parameters under the contact model event only";
    }
  }
  if (!scene.objective.duration) return "";
  if (scene.optimize != Optimize::kControl) return "the scene has a free duration, and no control is optimized";
  const ModelTraits* model = FindContactModel(request.contact);
  if (model == nullptr || !model->event_driven || request.precision != Precision::kDouble) {
    return "the scene has a free duration: only steps of the contact model event in double precision have a derivative "
           "by their length";
  }
  return "";
}

std::string ReasonNothingToOptimize(const Scene& scene) {
  if (!scene.design.empty()) return "";
  const bool nothing = scene.optimize == Optimize::kNone ||
                       (scene.optimize == Optimize::kControl ? scene.control.bodies.empty() : scene.free.empty());
  return nothing ? "the scene leaves nothing to optimize: give optimize, with a control or with bodies that are free"
                 : "";
}

bool RecordIteration::Record(const ceres::IterationSummary& summary) {
  if (summary.iteration == 0 || summary.step_is_successful) last_ = loss_(summary.cost);
  iterate_ = *z_;
  return run_->Record(last_, *z_);
}

ceres::CallbackReturnType RecordIteration::operator()(const ceres::IterationSummary& summary) {
  return Record(summary) ? ceres::SOLVER_CONTINUE : ceres::SOLVER_TERMINATE_SUCCESSFULLY;
}

End RecordEnd(ShootingRun* run, RecordIteration* record, std::span<const double> z, const CeresOutcome& outcome) {
  const Termination termination = Judge(outcome);
  if (termination != Termination::kInterrupted) {
    for (size_t i = run->num_recorded(); i < outcome.iterations.size(); ++i) record->Record(outcome.iterations[i]);
  }
  std::string words = Describe(termination, outcome);
  if (termination == Termination::kFailed) AddReason(run->function().FailureReason(), &words);
  // Where the gradient vanishes at the initial guess, the line search solver reports no iteration at all.
  double loss = 0;
  if (run->num_recorded() == 0 && run->function().Evaluate(z, &loss, nullptr)) run->Record(loss, z);
  return {termination, std::move(words)};
}

SolveReport Conclude(ShootingRun* run, RecordIteration* record, std::span<const double> z,
                     const CeresOutcome& outcome) {
  auto [termination, words] = RecordEnd(run, record, z, outcome);
  return run->Finish(z, termination, std::move(words));
}

namespace {

bool IsDeniedBy(const std::optional<Certificate>& certificate) {
  return certificate && (certificate->verdict == Certificate::Verdict::kNotStationary || certificate->IsSaddle());
}

}  // namespace

void JudgeByCertificate(SolveReport* report) {
  if (report->termination != Termination::kConverged || !IsDeniedBy(report->certificate)) return;
  report->termination = Termination::kNoProgress;
  report->reason += (report->reason.empty() ? "" : "; ") + report->certificate->reason;
}

void ForgetCertificate(SolveReport* report) {
  if (report->termination == Termination::kNoProgress && IsDeniedBy(report->certificate)) {
    report->termination = Termination::kConverged;
    std::string& reason = report->reason;
    const std::string denial = (reason == report->certificate->reason ? "" : "; ") + report->certificate->reason;
    if (const size_t at = reason.rfind(denial); at != std::string::npos) reason.erase(at, denial.size());
  }
  report->certificate.reset();
}

}  // namespace saltus
