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
#include "saltus/simulate/registry.h"
#include "sweep/results.h"
#include "sweep/study.h"

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

// Returns the reason of a point that was stopped after so many seconds.
std::string TimeLimitReason(double seconds) { return "stopped at the time limit of " + Cell(seconds).Exact() + " s"; }

// Results of a point as a document, in which ResultColumn::place finds them.
struct Found {
  PointStatus status = PointStatus::kComputed;
  Json document = Json::object();
};

// A column, and where the document has its value.
struct ResultColumn {
  std::string name;
  Json::json_pointer place;
};

// The columns of a loop with --feedback, and where its document has them.
constexpr std::pair<const char*, const char*> kFeedbackColumns[] = {{"error", "/runs/final_error"},
                                                                    {"error_first_order", "/final_error"},
                                                                    {"loss", "/runs/loss"},
                                                                    {"loss_error", "/runs/loss_error"},
                                                                    {"loss_first_order", "/expected_loss"},
                                                                    {"otherwise", "/runs/otherwise"},
                                                                    {"change_probability", "/change_probability"},
                                                                    {"failed", "/runs/failed"}};

std::vector<ResultColumn> ColumnsOf(const SweepStudy& study) {
  const Request& request = study.request();
  const std::optional<Surrogate>& surrogate = request.options.surrogate;
  const SweepProgram* program = KeptProgram();
  std::vector<ResultColumn> columns;
  const auto add = [&](std::initializer_list<const char*> names) {
    for (const char* name : names) columns.push_back({name, Json::json_pointer() / std::string(name)});
  };
  if (surrogate) add({"surrogate"});
  if (study.any_bias()) add({"biased"});
  if (study.solving()) {
    add({"initial_loss", "loss_before_last", "final_loss", "exact_loss", "iterations", "evaluations", "seconds"});
    for (const DesignParameter& design : request.scene.design) {
      const std::string name = NameOf(design.parameter, request.scene);
      columns.push_back({name, Json::json_pointer("/parameters") / name});
    }
  } else if (program != nullptr) {
    add({"loss", "norm_dinitial", "norm_dcontrol", "norm_dparameters", "relative_error", "events"});
  } else {
    add({"loss", "norm_dposition", "norm_dvelocity", "norm_dcontrol", "relative_error"});
  }
  if (program != nullptr ? program->feedback : request.feedback.has_value()) {
    for (const std::string loop : {"open", "closed"}) {
      for (const auto& [name, place] : kFeedbackColumns) {
        columns.push_back({loop + "_" + name, Json::json_pointer("/feedback/" + loop + place)});
      }
    }
  }
  if (study.solving() && study.generates()) add({"memory_mib"});
  if (study.solving()) add({"termination"});
  if (!study.solving() && surrogate && surrogate->smooths()) add({"norm_standard_error"});
  add({"reason"});
  return columns;
}

// Returns the finite number or the text at a place, or null.
SweepValue ValueAt(const Json& document, const Json::json_pointer& place) {
  const SweepValue value = document.value(place, Json());
  const bool finite = value.is_number() && std::isfinite(value.get<double>());
  return finite || value.is_string() ? value : SweepValue();
}

PointResult ToRow(const SweepStudy& study, int64_t point, Found found) {
  PointResult result{found.status, study.Values(point)};
  if (const std::optional<Surrogate>& surrogate = study.request().options.surrogate) {
    found.document["surrogate"] = SurrogateToString(surrogate->kind);
  }
  found.document["biased"] = study.any_bias() && study.IsBiased(point) ? "yes" : "no";
  for (const ResultColumn& column : ColumnsOf(study)) result.row.push_back(ValueAt(found.document, column.place));
  return result;
}

// Adds the loss before the last one of a run's document.
void AddLossBeforeLast(Json* run) {
  if (!run->contains("losses")) return;
  const Json& losses = run->at("losses");
  (*run)["loss_before_last"] = Json(losses.at(losses.size() > 1 ? losses.size() - 2 : 0));
}

PointStatus StatusOf(Termination termination) {
  if (termination == Termination::kNotApplicable) return PointStatus::kNotApplicable;
  // Only the time limit interrupts a solver here.
  const bool failed = termination == Termination::kFailed || termination == Termination::kInterrupted;
  return failed ? PointStatus::kFailed : PointStatus::kComputed;
}

// `alone`: no other point is computed meanwhile, so that the memory of the process is that of this one.
Found SolvePoint(const Request& request, double seconds, const StopRequest& stop, bool alone) {
  SolverOptions options = request.options;
  options.monitor.stop = stop;
  if (alone) ForgetPeakMemory();
  SolvedRun run{SolveAndSimulate(request.solvers[0],
                                 {request.scene, ContactNamed(request.contacts[0], request.scene), request.precision},
                                 options)};
  AddFeedback(request, /*threads=*/1, &run);  // points are computed in several threads
  const SolveReport& report = run.report;
  Found found{StatusOf(report.termination), SolveToJson(request, {{run}})["runs"][0]};
  AddLossBeforeLast(&found.document);
  if (const double most = PeakMemory(); alone && most >= 0) found.document["memory_mib"] = most;
  const bool stopped = report.termination == Termination::kInterrupted;
  std::string remark = stopped ? TimeLimitReason(seconds) : RemarkOn(run);
  if (remark.empty() && run.feedback) remark = run.feedback->reason;
  if (stopped) found.document["termination"] = TerminationToString(Termination::kFailed);
  found.document["reason"] = remark;
  return found;
}

Found GradientPoint(const Request& request, double seconds, const StopRequest& stop) {
  const Scene& scene = request.scene;
  const std::optional<Surrogate>& surrogate = request.options.surrogate;
  const Contact contact = ContactNamed(request.contacts[0], scene);
  const ModelGradient gradient =
      surrogate ? ComputeSurrogate(contact, scene, request.precision, *surrogate, /*threads=*/1, stop)
                : ComputeGradient(contact, scene, request.precision, stop);
  Found found;
  Json& document = found.document;
  if (!gradient.ok()) {
    const bool stopped = stop && stop();
    const bool failed = stopped || HasFailed(contact.name(), scene) || !IsNotApplicable(gradient, scene);
    found.status = failed ? PointStatus::kFailed : PointStatus::kNotApplicable;
    document["reason"] = stopped ? TimeLimitReason(seconds) : gradient.reason;
    return found;
  }
  std::string remark = ReasonNotComparable(contact, scene);
  if (const auto exact = remark.empty() ? ComputeExactGradient(scene) : std::nullopt) {
    if (const std::string ties = TiesToString(exact->ambiguous); !ties.empty()) {
      remark = "ambiguous: " + ties;
    } else {
      document["relative_error"] = CompareGradients(gradient, *exact).relative;
    }
  }
  document["loss"] = gradient.loss;
  document["norm_dposition"] = Norm(NumbersIn(VectorsToJson(scene, gradient.gradient.initial, 0)));
  document["norm_dvelocity"] = Norm(NumbersIn(VectorsToJson(scene, gradient.gradient.initial, 2)));
  document["norm_dcontrol"] = Norm(gradient.gradient.control);
  if (request.feedback) {
    const FeedbackStudy study = StudyFeedback(
        scene, InitialState(scene), InitialControl(scene, scene.steps), {}, *request.feedback, /*threads=*/1);
    document["feedback"] = FeedbackToJson(study, /*states=*/false);
    if (remark.empty()) remark = study.reason;
  }
  document["norm_standard_error"] = std::hypot(Norm(gradient.initial_error), Norm(gradient.control_error));
  document["reason"] = remark;
  return found;
}

Found ProgramPoint(const SweepStudy& study, int64_t point, double seconds) {
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
    arguments += " --iterations=" + std::to_string(options.limits.iterations);
  }
  Found found{PointStatus::kComputed, RunProgram(arguments, seconds)};
  Json& document = found.document;
  if (!study.solving()) {
    const Json gradient = document.value("gradient", Json::object());
    for (const std::string part : {"initial", "control", "parameters"}) {
      if (gradient.contains(part)) document["norm_d" + part] = Norm(NumbersIn(gradient.at(part)));
    }
    if (!document.contains("loss")) found.status = PointStatus::kFailed;
    if (const Json audit = document.value("/audits/0"_json_pointer, Json()); audit.contains("gradient")) {
      document["relative_error"] =
          RelativeError(NumbersIn(audit.at("gradient")), NumbersIn(audit.at("exact_gradient")));
    }
    document["events"] = document.at("motion").at("events").size();
    document["reason"] = document.value("failed", document.at("motion").value("remark", std::string()));
    return found;
  }
  document = Json(document.at("runs").at(0));
  const std::string termination = document.at("termination");
  if (termination == TerminationToString(Termination::kNotApplicable)) found.status = PointStatus::kNotApplicable;
  if (termination == TerminationToString(Termination::kFailed)) found.status = PointStatus::kFailed;
  AddLossBeforeLast(&document);
  if (document.contains("final_loss")) document["exact_loss"] = Json(document.at("final_loss"));
  document["reason"] = document.value("reason", std::string());
  return found;
}

}  // namespace

std::vector<std::string> ResultColumns(const SweepStudy& study) { return NameList(ColumnsOf(study)); }

PointResult ComputePoint(const SweepStudy& study, int64_t point, double seconds, const StopRequest& stop, bool alone) {
  const Clock::time_point deadline =
      Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(std::min(seconds, 1e9)));
  const StopRequest stop_or_late = [&] { return (seconds > 0 && Clock::now() >= deadline) || (stop && stop()); };
  try {
    if (KeptProgram() != nullptr) return ToRow(study, point, ProgramPoint(study, point, seconds));
    const Request request = study.RequestAt(point);
    if (!study.solving()) return ToRow(study, point, GradientPoint(request, seconds, stop_or_late));
    return ToRow(study, point, SolvePoint(request, seconds, stop_or_late, alone && study.generates()));
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
  return ToRow(
      study,
      point,
      {PointStatus::kFailed, {{"termination", TerminationToString(Termination::kFailed)}, {"reason", reason}}});
}

}  // namespace saltus
