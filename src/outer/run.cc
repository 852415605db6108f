#include "saltus/outer/run.h"

#include <chrono>
#include <ostream>
#include <stdexcept>
#include <variant>

#include "audit/audit_text.h"
#include "base/table.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "saltus/outer/audit_gradient.h"
#include "saltus/scene/scene_file.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/solve/hybrid_solver.h"

namespace saltus {

namespace {

constexpr int kDigits = 10;
constexpr const char* kNothingToCertify = "there is no solution to certify";

std::string Number(double value, int digits = kDigits) { return Cell(value).Display(digits); }

SolverOptions OptionsOf(const RunOptions& options) {
  SolverOptions made{.limits = {.iterations = options.iterations}, .monitor = {.callback = options.callback}};
  if (options.seconds > 0) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(options.seconds);
    made.monitor.stop = [end] { return std::chrono::steady_clock::now() >= end; };
  }
  return made;
}

// Where no control is free, the motion is the same on more control intervals: on these many at least, phases between
// events have intervals of their own, and equalities that hold always are looked at often.
constexpr int kLeastIntervals = 64;

HybridProblem AddControlIntervals(HybridProblem problem) {
  HybridInput& guess = problem.guess;
  if (problem.free.control || guess.num_intervals >= kLeastIntervals) return problem;
  const int parts = (kLeastIntervals + guess.num_intervals - 1) / guess.num_intervals;
  const int width = problem.system.num_controls();
  const auto repeat = [&](std::vector<double>* rows, int size) {
    std::vector<double> repeated;
    for (auto row = rows->begin(); row != rows->end(); row += size) {
      for (int part = 0; part < parts; ++part) repeated.insert(repeated.end(), row, row + size);
    }
    *rows = std::move(repeated);
  };
  if (!guess.control.empty()) repeat(&guess.control, width);
  repeat(&guess.lengths, 1);  // only their proportions count
  guess.num_intervals *= parts;
  return problem;
}

// Throws if the solver has refused the problem.
void CheckTaken(const SolveReport& report) {
  if (report.termination == Termination::kNotApplicable) {
    throw std::invalid_argument("Solve: " + report.solver + ": " + report.reason);
  }
}

}  // namespace

double Run::operator[](const std::string& name) const {
  std::vector<std::string> names;
  for (const NamedValue& value : found_) {
    if (value.name == name) return value.value;
    names.push_back(value.name);
  }
  throw std::invalid_argument("Run: found '" + name + "', expected something that was free: " +
                              (names.empty() ? "nothing was" : Joined(names)));
}

Run Solve(const Problem& problem, const RunOptions& options) {
  const HybridProblem parts = AddControlIntervals(problem.parts());
  if (parts.terms.empty()) throw std::invalid_argument("Solve: found a problem without terms, expected a cost");
  SolveReport report = Solve(options.solver, parts, OptionsOf(options));
  CheckTaken(report);
  std::vector<NamedValue> found;
  Certificate certificate;
  if (!report.history.losses.empty()) {
    const HybridInput solution = SolutionOf(parts, report);
    const HybridSystem& system = parts.system;
    for (const int i : parts.free.initial) found.push_back({system.StateName(solution.mode, i), solution.initial[i]});
    for (const int i : parts.free.parameters) found.push_back({system.ParameterName(i), solution.parameters[i]});
    if (parts.free.duration) found.push_back({"duration", solution.duration});
    certificate = report.certificate ? *report.certificate : Certify(parts, solution);
  } else {
    certificate.reason = kNothingToCertify;
  }
  return Run(std::move(report), std::move(certificate), std::move(found));
}

Run Solve(const Scene& scene, const RunOptions& options) {
  SolveReport report = Solve(options.solver, {.scene = scene, .contact = options.contact}, OptionsOf(options));
  CheckTaken(report);
  std::vector<NamedValue> found;
  Certificate certificate;
  if (report.history.losses.empty()) {
    certificate.reason = kNothingToCertify;
  } else {
    for (std::size_t i = 0; i < report.solution.parameters.size(); ++i) {
      found.push_back({NameOf(scene.design[i].parameter, scene), report.solution.parameters[i]});
    }
    double duration = 0;
    for (const double length : report.solution.durations) duration += length;
    if (scene.objective.duration) found.push_back({"duration", duration});
    certificate =
        report.certificate
            ? *report.certificate
            : Certify(scene, report.solution.initial_state, report.solution.control, report.solution.durations);
  }
  return Run(std::move(report), std::move(certificate), std::move(found));
}

std::ostream& operator<<(std::ostream& out, const Run& run) {
  const SolveReport& report = run.report();
  out << report.solver << ": " << TerminationToString(report.termination);
  if (!report.history.losses.empty()) {
    out << ", loss " << Number(report.guess.loss) << " -> " << Number(report.solution.loss) << " in "
        << report.work.iterations << (report.work.iterations == 1 ? " iteration" : " iterations");
  }
  out << '\n';
  if (!report.reason.empty()) out << Paragraph(report.reason, LayoutOfStandardOutput().width, 2);
  for (const NamedValue& value : run.found()) out << "  " << value.name << " = " << Number(value.value) << '\n';
  if (report.solution.violation > kFeasible) {
    out << "  constraints are missed by " << Number(report.solution.violation, 3) << '\n';
  }
  return out;
}

std::ostream& operator<<(std::ostream& out, const Certificate& certificate) {
  const bool applies = certificate.verdict != Certificate::Verdict::kNotApplicable;
  out << "certificate: " << (applies ? VerdictInWords(certificate) : "none") << '\n';
  if (!certificate.reason.empty()) out << Paragraph(certificate.reason, LayoutOfStandardOutput().width, 2);
  if (!applies) return out;
  const auto print = [&](const char* name, std::optional<double> residual) {
    if (residual) out << "  " << name << ' ' << Number(*residual, 2) << '\n';
  };
  print("stationarity", certificate.stationarity);
  print("costate jump", certificate.costate_jump);
  print("Hamiltonian", certificate.hamiltonian);
  print("transversality", certificate.transversality);
  print("final time", certificate.final_time);
  for (const ImpactCertificate& impact : certificate.impacts) {
    out << "  event at " << Number(impact.time) << ": " << impact.a << ", " << impact.b << '\n';
  }
  if (certificate.curvature) {
    out << "  least curvature " << Number(certificate.curvature->smallest, 6) << ", "
        << CurvatureToString(certificate.curvature->kind) << '\n';
  }
  return out;
}

Scene Load(const std::string& path) {
  std::variant<Scene, SceneFileError> loaded = LoadSceneFile(path);
  if (const auto* error = std::get_if<SceneFileError>(&loaded)) throw std::invalid_argument(error->ToString());
  return std::get<Scene>(std::move(loaded));
}

GradientAudit AuditGradient(const Contact& contact, const Scene& scene, const AuditOptions& options) {
  const std::string reason = ReasonNotApplicable(contact, scene);
  if (!reason.empty()) throw std::invalid_argument("AuditGradient: " + contact.name() + ": " + reason);
  GradientAudit audit{.scene = scene, .report = {.reference = ComputeExactGradient(scene, options.stop), .models = {}}};
  audit.report.models.push_back(AuditModel(contact, scene, Precision::kDouble, audit.report.reference, options));
  return audit;
}

std::ostream& operator<<(std::ostream& out, const GradientAudit& audit) {
  return out << AuditText(audit.scene, audit.report, std::nullopt, LayoutOfStandardOutput());
}

}  // namespace saltus
