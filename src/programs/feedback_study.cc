#include "programs/feedback_study.h"

#include <gflags/gflags.h>

#include <cmath>
#include <iostream>

#include "feedback/noisy_states.h"
#include "saltus/simulate/registry.h"

DEFINE_bool(feedback, false,
            "compute a regulator along each solution and how errors grow with and without it, and simulate noisy runs");
DEFINE_string(feedback_weights, "state=10,control=0.001,final=10",
              "weights of the regulator: of the state and the control over time, and of the final state");
DEFINE_string(feedback_noise, "state=0.001",
              "standard deviations of errors. Initial state: position, velocity, angle, angular_velocity, or 'state' "
              "for all; each step: force, torque, and process_position, measured_position, ... (a hybrid system has "
              "its states and controls in their place)");
DEFINE_double(feedback_scale, 1, "factor on all standard deviations of --feedback_noise");
DEFINE_string(feedback_plant, "event", "contact model under which the noisy runs are simulated");
DEFINE_int32(feedback_samples, 1000, "number of noisy runs in open loop, and in closed loop");
DEFINE_uint64(feedback_seed, 1, "seed of the noisy runs");

namespace saltus {
namespace {

constexpr const char* kNumberFlags[] = {
    "feedback_weights", "feedback_noise", "feedback_scale", "feedback_plant", "feedback_samples", "feedback_seed"};

}  // namespace

std::optional<FeedbackOptions> FeedbackFromFlags(const std::vector<std::string>& states,
                                                 const std::vector<std::string>& controls) {
  if (!FLAGS_feedback) {
    RefuseFlags(kNumberFlags, " needs --feedback");
    return std::nullopt;
  }
  FeedbackOptions options;
  std::vector<std::string> names;
  for (const std::string prefix : kDeviationPrefixes) {
    names.push_back(prefix + kAllStates);
    for (const std::string& state : states) names.push_back(prefix + state);
    if (prefix.empty()) names.insert(names.end(), controls.begin(), controls.end());
  }
  options.deviations = ReadAssignments("feedback_noise", FLAGS_feedback_noise, names);
  for (const auto& [name, deviation] : options.deviations) {
    if (deviation < 0) throw InputError("--feedback_noise: " + name + " must not be negative");
  }
  for (const auto& [name, weight] :
       ReadAssignments("feedback_weights", FLAGS_feedback_weights, {"state", "control", "final"})) {
    if (weight < 0 || (name == "control" && weight == 0)) {
      throw InputError("--feedback_weights: " + name +
                       (name == "control" ? " must be positive" : " must not be negative"));
    }
    (name == "state" ? options.state : name == "control" ? options.control : options.final) = weight;
  }
  options.scale = FLAGS_feedback_scale;
  if (!(options.scale >= 0) || std::isinf(options.scale)) throw InputError("--feedback_scale must be a number >= 0");
  for (const auto& [name, deviation] : options.deviations) {
    if (std::isfinite(std::pow(options.scale * deviation, 2))) continue;
    throw InputError("--feedback_noise: the variance of " + name + " is too large for a number of double precision");
  }
  options.samples = FLAGS_feedback_samples;
  if (options.samples < 0) throw InputError("--feedback_samples must not be negative");
  options.seed = FLAGS_feedback_seed;
  options.plant = FLAGS_feedback_plant;
  if (const std::string wrong = Validate(Contact(options.plant)); !wrong.empty()) {
    throw InputError("--feedback_plant=" + options.plant + ": " + wrong);
  }
  return options;
}

std::optional<FeedbackOptions> SceneFeedbackFromFlags() {
  return FeedbackFromFlags({"position", "velocity", "angle", "angular_velocity"}, {"force", "torque"});
}

namespace {

Json LoopToJson(const FeedbackStudy& study, const FeedbackStudy::Loop& loop, bool states) {
  const Covariance& covariance = loop.covariance;
  Json item = {{"final_error", FinalError(covariance)},
               {"covariance", covariance.nodes.back()},
               {"event_deviations", covariance.event_times},
               {"change_probability", covariance.change_probability},
               {"risks", Json::array()}};
  if (loop.expected_loss) item["expected_loss"] = *loop.expected_loss;
  for (const SequenceRisk& risk : covariance.risks) {
    item["risks"].push_back({{"what", risk.description}, {"time", risk.time}, {"probability", risk.probability}});
  }
  if (const std::string warning = covariance.Warning(); !warning.empty()) item["warning"] = warning;
  if (states) item["covariances"] = covariance.nodes;
  if (!loop.runs) return item;
  const MonteCarlo& runs = *loop.runs;
  Json of_runs = {{"samples", study.samples}, {"failed", runs.failed}, {"otherwise", runs.off_plan}};
  if (runs.counted > 1) {
    of_runs["final_error"] = FinalError(study, runs);
    of_runs["covariance"] = runs.covariance;
    if (study.loss) {
      of_runs["loss"] = runs.loss;
      of_runs["loss_error"] = runs.loss_error;
    }
  }
  item["runs"] = std::move(of_runs);
  return item;
}

}  // namespace

Json FeedbackToJson(const FeedbackStudy& study, bool states) {
  if (!study.reason.empty()) return {{"failed", study.reason}};
  Json item = {{"times", study.times}};
  if (!study.remark.empty()) item["remark"] = study.remark;
  if (study.loss) item["loss"] = *study.loss;
  if (!study.plant.empty()) item["plant"] = study.plant;
  if (study.closed) item["gains"] = study.gains;
  if (study.closed && states) item["cost_to_go"] = study.cost_to_go;
  item["open"] = LoopToJson(study, study.open, states);
  if (study.closed) item["closed"] = LoopToJson(study, *study.closed, states);
  return item;
}

namespace {

// Returns the caption of the table, a sentence without its full stop.
std::string FeedbackCaption(const NamedStudies& studies) {
  int samples = 0;
  for (const auto& [name, study] : studies) samples = study.value("/open/runs/samples"_json_pointer, samples);
  return "errors of the final state (root mean square), expected loss with its standard error, and the share of runs "
         "whose events are not as "
         "planned, of " +
         std::to_string(samples) + " noisy runs in each loop and to first order";
}

std::vector<std::string> FeedbackWarnings(const NamedStudies& studies) {
  std::vector<std::string> lines;
  for (const auto& [name, study] : studies) {
    for (const std::string loop : {"open", "closed"}) {
      const std::string warning = study.value(Json::json_pointer("/" + loop + "/warning"), "");
      if (!warning.empty()) lines.push_back(name + ", " + loop + " loop: " + warning);
    }
  }
  return lines;
}

// Returns one row for each loop of each study.
Table FeedbackTable(const NamedStudies& studies) {
  Json rows = Json::array();
  for (const auto& [name, study] : studies) {
    if (study.contains("failed")) rows.push_back({{"run", name}, {"remark", study["failed"]}});
    for (const std::string loop : {"open", "closed"}) {
      if (!study.contains(loop)) continue;
      Json& row = rows.emplace_back(study[loop]);
      std::string remark = study.value("remark", "");
      if (row.contains("runs")) {
        const Json& runs = row["runs"];
        const int failed = runs["failed"];
        if (failed > 0) remark += (remark.empty() ? "" : "; ") + std::to_string(failed) + " runs have failed";
        row["share_otherwise"] = runs["otherwise"].get<double>() / runs["samples"].get<double>();
      }
      row.update({{"run", name}, {"loop", loop}, {"remark", remark}});
    }
  }
  return TableOf(rows,
                 "",
                 "run; loop; final error=runs/final_error:4; first order=final_error:4; expected loss=runs/loss:8; "
                 "±=runs/loss_error:2; first order=expected_loss:8; other events=share_otherwise:3; "
                 "first order=change_probability:3; remark",
                 2);
}

}  // namespace

void PrintFeedback(const std::string& name, const NamedStudies& studies) {
  PrintTableIfAny(name + FeedbackCaption(studies), FeedbackTable(studies));
  const size_t width = LayoutOfStandardOutput().width;
  for (const std::string& line : FeedbackWarnings(studies)) std::cout << Paragraph(line, width) << std::endl;
}

void AddFeedbackSection(const NamedStudies& studies, Page* page) {
  page->AddHeading("Feedback");
  page->AddTable(FeedbackTable(studies), "The " + FeedbackCaption(studies) + ".");
  if (const std::vector<std::string> warnings = FeedbackWarnings(studies); !warnings.empty()) page->AddList(warnings);
}

int FeedbackExitCode(const NamedStudies& studies) {
  for (const auto& [name, study] : studies) {
    if (study.value("failed", "") != kNoRegulator) continue;
    std::cerr << "error: --feedback_weights: " << name << ": " << kNoRegulator << std::endl;
    return kWrongInput;
  }
  return kDone;
}

}  // namespace saltus
