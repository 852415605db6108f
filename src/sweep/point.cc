#include "sweep/point.h"

#include <chrono>
#include <cmath>
#include <fstream>
#include <new>

#include "base/statistics.h"
#include "base/table.h"
#include "programs/audit.h"
#include "programs/feedback_study.h"
#include "programs/simulators.h"
#include "programs/solve.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "sweep/options.h"

namespace saltus {
namespace {

using Clock = std::chrono::steady_clock;

// The most memory that this process has had at once from here on. Where the system does not allow it, the peak stays
// that since the process began. Linux, proc(5): 5 in clear_refs resets the peak, VmHWM in status is it.
void ForgetPeakMemory() { std::ofstream("/proc/self/clear_refs") << "5"; }

// In MiB, resident; negative where the system does not tell.
double PeakMemory() {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    double kib = 0;
    if (word == "VmHWM:" && status >> kib) return kib / 1024;
  }
  return -1;
}

// Appends values, with null in place of numbers that are not finite.
void Append(std::initializer_list<SweepValue> values, SweepRow* row) {
  for (const SweepValue& value : values) {
    const bool finite = !value.is_number_float() || std::isfinite(value.get<double>());
    row->push_back(finite ? value : SweepValue());
  }
}

PointResult StartRow(const SweepStudy& study, int64_t point) {
  PointResult result{PointStatus::kComputed, study.Values(point)};
  if (const std::optional<Surrogate>& surrogate = study.request().options.surrogate) {
    Append({std::string(SurrogateToString(surrogate->kind))}, &result.row);
  }
  if (study.any_bias()) Append({std::string(study.IsBiased(point) ? "yes" : "no")}, &result.row);
  return result;
}

// The number or text under a key, or null.
SweepValue ValueOf(const Json& json, const char* key) {
  const auto found = json.find(key);
  return found != json.end() && (found->is_number() || found->is_string()) ? SweepValue(*found) : SweepValue();
}

// The columns of a loop with --feedback, and where its document has them.
struct FeedbackColumn {
  const char* name;
  bool of_runs;
  const char* key;
};
constexpr FeedbackColumn kFeedbackColumns[] = {{"error", true, "final_error"},
                                               {"error_first_order", false, "final_error"},
                                               {"loss", true, "loss"},
                                               {"loss_error", true, "loss_error"},
                                               {"loss_first_order", false, "expected_loss"},
                                               {"otherwise", true, "otherwise"},
                                               {"change_probability", false, "change_probability"},
                                               {"failed", true, "failed"}};

// The cells of a document's "feedback"; empty ones of an empty document.
void AppendFeedback(const Json& feedback, SweepRow* row) {
  const Json none = Json::object();
  const auto part = [&](const Json& json, const char* key) -> const Json& {
    const auto found = json.find(key);
    return found == json.end() ? none : *found;
  };
  for (const char* loop : {"open", "closed"}) {
    const Json& of_loop = part(feedback, loop);
    for (const FeedbackColumn& column : kFeedbackColumns) {
      Append({ValueOf(column.of_runs ? part(of_loop, "runs") : of_loop, column.key)}, row);
    }
  }
}

// Appends the feedback study of a solution, in one thread: points are computed in several threads. A reason why there
// is none is added to an empty remark.
void AppendFeedback(const Request& request, const Scene& scene, const std::vector<double>& initial,
                    const std::vector<double>& control, const std::vector<double>& durations, SweepRow* row,
                    std::string* remark) {
  if (!request.feedback) return;
  const FeedbackStudy study = StudyFeedback(scene, initial, control, durations, *request.feedback, /*threads=*/1);
  if (remark->empty()) *remark = study.reason;
  AppendFeedback(FeedbackToJson(study, /*states=*/false), row);
}

bool HasStandardError(const std::optional<Surrogate>& surrogate) { return surrogate && surrogate->smooths(); }

PointStatus StatusOf(Termination termination) {
  if (termination == Termination::kNotApplicable) return PointStatus::kNotApplicable;
  // Only the time limit interrupts a solver here.
  const bool failed = termination == Termination::kFailed || termination == Termination::kInterrupted;
  return failed ? PointStatus::kFailed : PointStatus::kComputed;
}

// The most memory that a solver took is measured of control problems that are solved alone.
enum class Memory { kNone, kMeasured, kUnknown };

PointResult SolvePoint(const Request& request, double seconds, const StopRequest& stop, Memory memory,
                       PointResult result) {
  SolverOptions options = request.options;
  options.stop = stop;
  if (memory == Memory::kMeasured) ForgetPeakMemory();
  SolvedRun run;
  run.report = Solve(request.solvers[0],
                     {request.scene, ContactNamed(request.contacts[0], request.scene), request.precision},
                     options);
  const SolveReport& report = run.report;
  result.status = StatusOf(report.termination);
  std::string no_feedback;
  const std::vector<double>& losses = report.losses;
  if (losses.empty()) {
    result.row.resize(result.row.size() + 7 + request.scene.design.size());
    if (request.feedback) AppendFeedback(Json::object(), &result.row);
  } else {
    const Scene scene = WithDesign(request.scene, report.parameters);
    run.exact = SimulateExactly(scene, report.initial_state, report.control, report.durations);
    Append({report.initial_loss,
            losses.size() > 1 ? losses[losses.size() - 2] : losses[0],
            report.final_loss,
            run.exact.ok ? SweepValue(run.exact.loss) : SweepValue(),
            int64_t{report.iterations},
            int64_t{report.evaluations},
            report.seconds},
           &result.row);
    std::vector<double> parameters = report.parameters;
    parameters.resize(request.scene.design.size(), std::nan(""));
    for (const double value : parameters) Append({value}, &result.row);
    AppendFeedback(request, scene, report.initial_state, report.control, report.durations, &result.row, &no_feedback);
  }
  if (memory != Memory::kNone) {
    const double most = memory == Memory::kMeasured ? PeakMemory() : -1;
    Append({most >= 0 ? SweepValue(most) : SweepValue()}, &result.row);
  }
  const bool stopped = report.termination == Termination::kInterrupted;
  const Termination termination = stopped ? Termination::kFailed : report.termination;
  const std::string remark = stopped ? TimeLimitReason(seconds) : RemarkOn(run);
  Append({std::string(TerminationToString(termination)), remark.empty() ? no_feedback : remark}, &result.row);
  return result;
}

// The numbers of nested lists.
std::vector<double> NumbersIn(const Json& json) {
  std::vector<double> numbers;
  if (json.is_number()) return {json.get<double>()};
  for (const Json& item : json) {
    const std::vector<double> more = NumbersIn(item);
    numbers.insert(numbers.end(), more.begin(), more.end());
  }
  return numbers;
}

PointResult GradientPoint(const Request& request, double seconds, const StopRequest& stop, PointResult result) {
  const std::optional<Surrogate>& surrogate = request.options.surrogate;
  const Contact contact = ContactNamed(request.contacts[0], request.scene);
  const ModelGradient gradient =
      surrogate ? ComputeSurrogate(contact, request.scene, request.precision, *surrogate, /*threads=*/1, stop)
                : ComputeGradient(contact, request.scene, request.precision, stop);
  if (!gradient.ok()) {
    const bool stopped = stop && stop();
    const bool failed =
        stopped || HasFailed(contact.name(), request.scene) || !IsNotApplicable(gradient, request.scene);
    result.status = failed ? PointStatus::kFailed : PointStatus::kNotApplicable;
    result.row.resize(result.row.size() + 5);
    if (request.feedback) AppendFeedback(Json::object(), &result.row);
    if (HasStandardError(surrogate)) result.row.emplace_back();
    Append({stopped ? TimeLimitReason(seconds) : gradient.reason}, &result.row);
    return result;
  }
  SweepValue error;
  std::string remark = WhyNotComparable(contact, request.scene);
  if (const auto exact = remark.empty() ? ExactGradientOf(request.scene) : std::nullopt) {
    if (const std::string ties = TiesToString(exact->ambiguous); !ties.empty()) {
      remark = "ambiguous: " + ties;
    } else {
      error = CompareGradients(gradient, *exact).relative;
    }
  }
  Append({gradient.loss,
          Norm(NumbersIn(VectorsToJson(request.scene, gradient.gradient.initial, 0))),
          Norm(NumbersIn(VectorsToJson(request.scene, gradient.gradient.initial, 2))),
          Norm(gradient.gradient.control),
          error},
         &result.row);
  AppendFeedback(request,
                 request.scene,
                 InitialState(request.scene),
                 InitialControl(request.scene, request.scene.steps),
                 {},
                 &result.row,
                 &remark);
  if (HasStandardError(surrogate)) {
    const double norm = std::hypot(Norm(gradient.initial_error), Norm(gradient.control_error));
    Append({norm}, &result.row);
  }
  Append({remark}, &result.row);
  return result;
}

// |gradient - exact| / |exact| of an audit, over all that it has.
SweepValue ErrorOfAudit(const Json& audit) {
  if (!audit.contains("gradient")) return {};
  const std::vector<double> found = NumbersIn(audit.at("gradient")), exact = NumbersIn(audit.at("exact_gradient"));
  std::vector<double> difference = found;
  for (size_t i = 0; i < std::min(found.size(), exact.size()); ++i) difference[i] -= exact[i];
  return Norm(difference) / Norm(exact);
}

PointResult ProgramPoint(const SweepStudy& study, int64_t point, double seconds, PointResult result) {
  const SweepRow values = study.Values(point);
  std::string arguments, set;
  const auto quoted = [](const std::string& text) { return "'" + text + "'"; };
  for (size_t i = 0; i < values.size(); ++i) {
    const std::string& option = study.options()[i];
    const std::string value = CellOf(values[i]).Exact();
    const bool flag = option == "solver" || option == "steps" || option == "iterations" || option == "learning_rate" ||
                      option.starts_with("feedback_");
    (flag ? arguments : set) += flag ? " --" + option + "=" + value : (set.empty() ? "" : ",") + option + "=" + value;
  }
  const SolverOptions& options = study.request().options;
  if (!set.empty()) arguments += " --set=" + quoted(set);
  if (!study.solving()) arguments += " --solver=none";
  if (arguments.find("--iterations=") == std::string::npos) {
    arguments += " --iterations=" + std::to_string(options.iterations);
  }
  const Json document = RunProgram(arguments, seconds);
  if (!study.solving()) {
    const Json& motion = document.at("motion");
    const Json gradient = document.value("gradient", Json::object());
    const auto norm = [&](const char* key) {
      return gradient.contains(key) ? SweepValue(Norm(NumbersIn(gradient.at(key)))) : SweepValue();
    };
    if (!document.contains("loss")) result.status = PointStatus::kFailed;
    const SweepValue reason = document.contains("failed") ? ValueOf(document, "failed") : ValueOf(motion, "remark");
    Append({ValueOf(document, "loss"),
            norm("initial"),
            norm("control"),
            norm("parameters"),
            document.contains("audits") ? ErrorOfAudit(document.at("audits").at(0)) : SweepValue(),
            static_cast<int64_t>(motion.at("events").size())},
           &result.row);
    if (KeptProgram()->feedback) AppendFeedback(document.value("feedback", Json::object()), &result.row);
    Append({reason.is_null() ? SweepValue("") : reason}, &result.row);
    return result;
  }
  const Json& run = document.at("runs").at(0);
  const std::vector<double> losses = run.contains("losses") ? NumbersIn(run.at("losses")) : std::vector<double>();
  const std::string termination = run.at("termination");
  if (termination == TerminationToString(Termination::kNotApplicable)) result.status = PointStatus::kNotApplicable;
  if (termination == TerminationToString(Termination::kFailed)) result.status = PointStatus::kFailed;
  Append({ValueOf(run, "initial_loss"),
          losses.empty() ? SweepValue() : SweepValue(losses.size() > 1 ? losses[losses.size() - 2] : losses[0]),
          ValueOf(run, "final_loss"),
          ValueOf(run, "final_loss"),
          ValueOf(run, "iterations"),
          ValueOf(run, "evaluations"),
          ValueOf(run, "seconds")},
         &result.row);
  if (KeptProgram()->feedback) AppendFeedback(run.value("feedback", Json::object()), &result.row);
  Append({termination, run.value("reason", std::string())}, &result.row);
  return result;
}

}  // namespace

std::vector<std::string> ResultColumns(const SweepStudy& study) {
  const std::optional<Surrogate>& surrogate = study.request().options.surrogate;
  std::vector<std::string> columns;
  if (surrogate) columns.push_back("surrogate");
  if (study.any_bias()) columns.push_back("biased");
  const auto add = [&](std::initializer_list<const char*> names) {
    columns.insert(columns.end(), names.begin(), names.end());
  };
  const auto add_feedback = [&] {
    if (KeptProgram() != nullptr ? !KeptProgram()->feedback : !study.request().feedback) return;
    for (const std::string loop : {"open_", "closed_"}) {
      for (const FeedbackColumn& column : kFeedbackColumns) columns.push_back(loop + column.name);
    }
  };
  if (study.solving()) {
    add({"initial_loss", "loss_before_last", "final_loss", "exact_loss", "iterations", "evaluations", "seconds"});
    const Scene& scene = study.request().scene;
    for (const DesignParameter& design : scene.design) columns.push_back(NameOf(design.parameter, scene));
    add_feedback();
    if (study.generates()) add({"memory_mib"});
    add({"termination", "reason"});
    return columns;
  }
  if (KeptProgram() != nullptr) {
    add({"loss", "norm_dinitial", "norm_dcontrol", "norm_dparameters", "relative_error", "events"});
    add_feedback();
    add({"reason"});
    return columns;
  }
  add({"loss", "norm_dposition", "norm_dvelocity", "norm_dcontrol", "relative_error"});
  add_feedback();
  if (HasStandardError(surrogate)) add({"norm_standard_error"});
  add({"reason"});
  return columns;
}

std::string TimeLimitReason(double seconds) { return "stopped at the time limit of " + Cell(seconds).Exact() + " s"; }

PointResult ComputePoint(const SweepStudy& study, int64_t point, double seconds, const StopRequest& stop, bool alone) {
  const Clock::time_point deadline =
      Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(std::min(seconds, 1e9)));
  const StopRequest stop_or_late = [&] { return (seconds > 0 && Clock::now() >= deadline) || (stop && stop()); };
  try {
    if (KeptProgram() != nullptr) return ProgramPoint(study, point, seconds, StartRow(study, point));
    const Request request = study.At(point);
    PointResult result = StartRow(study, point);
    if (!study.solving()) return GradientPoint(request, seconds, stop_or_late, std::move(result));
    const Memory memory = !study.generates() ? Memory::kNone : alone ? Memory::kMeasured : Memory::kUnknown;
    return SolvePoint(request, seconds, stop_or_late, memory, std::move(result));
  } catch (const InputError& error) {
    return FailedPoint(study, point, error.what());
  } catch (const Json::exception& error) {
    return FailedPoint(study, point, std::string("the program's document: ") + error.what());
  } catch (const std::bad_alloc&) {
    HoldMemoryBackAgain();
    return FailedPoint(study, point, kMemoryRanOut);
  }
}

PointResult FailedPoint(const SweepStudy& study, int64_t point, const std::string& reason) {
  PointResult result = StartRow(study, point);
  result.status = PointStatus::kFailed;
  result.row.resize(study.columns().size());
  if (study.solving()) result.row[result.row.size() - 2] = std::string(TerminationToString(Termination::kFailed));
  result.row.back() = reason;
  return result;
}

}  // namespace saltus
