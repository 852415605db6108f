#include "programs/audit.h"

#include <gflags/gflags.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <iostream>
#include <memory>
#include <new>
#include <optional>

#include "base/interrupt.h"
#include "programs/parallel.h"
#include "saltus/simulate/registry.h"

DEFINE_double(attribution_seconds, 0,
              "time limit, s, for tracing the error of a wrong gradient to contacts, for each model; 0 is no limit");
DEFINE_double(audit_seconds, 0,
              "time, s, within which the audit of each --simulate is planned, from the time that its first gradient "
              "takes; 0 is no limit");
DEFINE_bool(
    width_sweep, false,
    "also compare the gradient with differences of the loss of every width (always done where no exact gradient "
    "exists)");
DEFINE_bool(fail_on_wrong, false,
            "end with exit code 1 if a gradient is wrong or has the wrong sign (audits of hybrid systems always do)");

namespace saltus {
namespace {

// Runs the audits of models, or of black boxes, as jobs, and adds those that were begun to the report. `audit` makes
// the i-th with options that report what it is at; whatever it uses it must own.
void AddAudits(const std::vector<std::string>& names, bool black_boxes, int threads, const AuditOptions& options,
               Progress* progress, const std::function<ModelAudit(int i, const AuditOptions& options)>& audit,
               AuditReport* report) {
  // Returns the audit of a model without a gradient, with the reason.
  const auto without_gradient = [names, black_boxes](std::size_t i, const std::string& reason) {
    ModelAudit none;
    none.gradient.contact = names[i];
    none.gradient.reason = reason;
    none.interrupted = reason == kStopped;
    if (black_boxes) none.black_box.emplace();
    return none;
  };
  const auto audits = ComputeAll<ModelAudit>(
      names, threads, progress, [options, audit, without_gradient](int i, const SayNote& say, const auto&) {
        AuditOptions own = options;
        own.status = say;
        try {
          return audit(i, own);
        } catch (const std::bad_alloc&) {
          HoldMemoryBackAgain();
          return without_gradient(i, kMemoryRanOut);
        }
      });
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (audits.started[i]) report->models.push_back(audits.results[i].value_or(without_gradient(i, kStopped)));
  }
}

// The exact gradient, as a job like the others: it may take long too.
std::optional<ModelGradient> FindReference(const Request& request, Progress* progress) {
  using Reference = std::optional<ModelGradient>;
  const auto found =
      ComputeAll<Reference>({"exact gradient"}, 1, progress, [scene = request.scene](int, const SayNote&, const auto&) {
        return ComputeExactGradient(scene, IsStopRequested);
      });
  return found.results[0].value_or(std::nullopt);
}

}  // namespace

AuditReport RunAudit(const Request& request, bool needs_reference, const std::vector<SimulatorCommand>& simulators) {
  AuditOptions options;
  options.width_sweep = FLAGS_width_sweep;
  if (!(FLAGS_attribution_seconds >= 0)) throw InputError("--attribution_seconds: expected seconds, or 0 for no limit");
  options.attribution_seconds = FLAGS_attribution_seconds;
  if (!(FLAGS_audit_seconds >= 0)) throw InputError("--audit_seconds: expected seconds, or 0 for no limit");
  options.surrogate = request.options.surrogate;
  if (options.surrogate && FLAGS_width_sweep) {
    throw InputError("--width_sweep is of the models' own gradients; expected no --surrogate with it");
  }
  // The last models at work share the threads of those that are done.
  const auto at_work = std::make_shared<std::atomic<int>>(static_cast<int>(request.contacts.size()));
  options.threads_now = [at_work, threads = request.threads] {
    return std::max(1, threads / std::max(1, at_work->load()));
  };
  options.stop = IsStopRequested;
  Progress progress(
      request.progress, stderr, "audit " + request.scene.name, 1 + request.contacts.size() + simulators.size());
  AuditReport report;
  report.reference = FindReference(request, &progress);
  if (needs_reference && !report.reference && !InterruptGuard::Interrupted()) {
    throw InputError("--given: the scene has no exact gradient to compare with");
  }
  AddAudits(
      request.contacts,
      /*black_boxes=*/false,
      request.threads,
      options,
      &progress,
      [request, reference = report.reference, at_work](int i, const AuditOptions& own) {
        const std::shared_ptr<void> done(nullptr, [at_work](void*) { --*at_work; });
        return AuditModel(request.contacts[i], request.scene, request.precision, reference, own);
      },
      &report);
  // One after the other, each with copies on all threads.
  std::vector<std::string> names;
  for (const SimulatorCommand& simulator : simulators) names.push_back(simulator.name);
  AddAudits(
      names,
      /*black_boxes=*/true,
      1,
      options,
      &progress,
      [request, simulators, reference = report.reference](int i, const AuditOptions& own) {
        return AuditBlackBox(
            OpenSimulator(simulators[i], request.threads), request.scene, reference, own, {FLAGS_audit_seconds});
      },
      &report);
  return report;
}

void PrintAuditTable(const Request& request, const AuditReport& report) {
  std::cout << AuditText(request.scene, report, request.options.surrogate, LayoutOfStandardOutput()) << std::flush;
}

int AuditExitCode(const Request& request, const AuditReport& report, std::size_t simulators) {
  const std::size_t asked = request.contacts.size() + simulators;
  bool failed = report.models.size() < asked;
  std::vector<std::string> without, wrong;
  for (const ModelAudit& audit : report.models) {
    failed = failed || audit.interrupted;
    if (FLAGS_fail_on_wrong && IsWrong(audit.verdict))
      wrong.push_back(audit.gradient.contact + ": " + audit.VerdictReason());
    if (audit.gradient.ok()) continue;
    const bool not_applicable = IsNotApplicable(audit, request.scene);
    if (not_applicable && asked == 1) {
      std::cerr << "error: " << audit.gradient.contact << ": " << audit.gradient.reason << std::endl;
      return kWrongInput;
    }
    failed = failed || !not_applicable;
    if (!not_applicable) without.push_back(audit.gradient.contact + ": " + audit.gradient.reason);
  }
  if (!without.empty()) {
    std::cerr << "no gradient of " << without.size() << " of " << asked << " (" << FirstOf(without) << ")" << std::endl;
  }
  if (!wrong.empty()) {
    std::cerr << "wrong gradients of " << wrong.size() << " of " << asked << " (" << FirstOf(wrong) << ")" << std::endl;
  }
  return failed || !wrong.empty() ? kAnswerFailed : kDone;
}

}  // namespace saltus
