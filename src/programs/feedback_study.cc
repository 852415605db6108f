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
    for (const char* flag : kNumberFlags) {
      if (IsGiven(flag)) throw InputError("--" + std::string(flag) + " needs --feedback");
    }
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
  if (const std::string wrong = WhatIsWrongWith(Contact(options.plant)); !wrong.empty()) {
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
    item["risks"].push_back({{"what", risk.what}, {"time", risk.time}, {"probability", risk.probability}});
  }
  if (const std::string warning = covariance.Warning(); !warning.empty()) item["warning"] = warning;
  if (states) item["covariances"] = covariance.nodes;
  if (!loop.runs) return item;
  const MonteCarlo& runs = *loop.runs;
  Json of_runs = {{"samples", study.samples}, {"failed", runs.failed}, {"otherwise", runs.otherwise}};
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

Table FeedbackTable(const NamedStudies& studies) {
  Table table(ColumnsOf("run; loop; final error:4; first order:4; expected loss:8; ±:2; first order:8; other events:3; "
                        "first order:3; remark"),
              2);
  for (const auto& [name, study] : studies) {
    if (!study->reason.empty()) {
      std::vector<Cell> row(table.columns().size());
      row[0] = name;
      row.back() = study->reason;
      table.AddRow(std::move(row));
      continue;
    }
    const auto add = [&](const char* what, const FeedbackStudy::Loop& loop) {
      std::string remark = study->remark;
      if (loop.runs && loop.runs->failed > 0) {
        remark += (remark.empty() ? "" : "; ") + std::to_string(loop.runs->failed) + " runs have failed";
      }
      const bool ran = loop.runs && loop.runs->counted > 1, losses = ran && study->loss;
      table.AddRow({name,
                    what,
                    ran ? Cell(FinalError(*study, *loop.runs)) : Cell(),
                    FinalError(loop.covariance),
                    losses ? Cell(loop.runs->loss) : Cell(),
                    losses ? Cell(loop.runs->loss_error) : Cell(),
                    loop.expected_loss ? Cell(*loop.expected_loss) : Cell(),
                    loop.runs ? Cell(static_cast<double>(loop.runs->otherwise) / study->samples) : Cell(),
                    loop.covariance.change_probability,
                    remark});
    };
    add("open", study->open);
    if (study->closed) add("closed", *study->closed);
  }
  return table;
}

std::string FeedbackCaption(const FeedbackOptions& options) {
  return "errors of the final state (root mean square), expected loss with its standard error, and the share of runs "
         "whose events are not as "
         "planned, of " +
         std::to_string(options.samples) + " noisy runs in each loop and to first order";
}

void PrintFeedback(const std::string& name, const FeedbackOptions& options, const NamedStudies& studies) {
  PrintTableIfAny(name + FeedbackCaption(options), FeedbackTable(studies));
  const size_t width = LayoutOfStandardOutput().width;
  for (const std::string& line : FeedbackWarnings(studies)) std::cout << Paragraph(line, width) << std::endl;
}

std::vector<std::string> FeedbackWarnings(const NamedStudies& studies) {
  std::vector<std::string> lines;
  for (const auto& [name, study] : studies) {
    if (!study->reason.empty()) continue;
    const auto warn = [&, of = name](const char* loop, const Covariance& covariance) {
      const std::string warning = covariance.Warning();
      if (!warning.empty()) lines.push_back(of + loop + warning);
    };
    warn(", open loop: ", study->open.covariance);
    if (study->closed) warn(", closed loop: ", study->closed->covariance);
  }
  return lines;
}

}  // namespace saltus
