#include "programs/hybrid_document.h"

#include <algorithm>
#include <numeric>

#include "control/hybrid_shooting.h"

namespace saltus {
namespace {

Json RowsToJson(std::span<const double> numbers, int width) {
  Json rows = Json::array();
  for (std::size_t i = 0; width > 0 && i + width <= numbers.size(); i += width) {
    rows.push_back(NumbersToJson({numbers.begin() + i, numbers.begin() + i + width}));
  }
  return rows;
}

Json NumbersOf(std::span<const double> numbers) { return NumbersToJson({numbers.begin(), numbers.end()}); }

template <typename Name>
Json NamesToJson(int count, const Name& name) {
  Json names = Json::array();
  for (int i = 0; i < count; ++i) names.push_back(name(i));
  return names;
}

// Times, modes, states and guards of a motion, in order of time.
class Samples {
 public:
  Samples(const HybridSystem& system, const HybridInput& input)
      : system_(system), input_(input), begins_(input.Times()), no_control_(system.num_controls()) {
    begins_.pop_back();
  }

  void Add(double time, int mode, std::span<const double> state) {
    times_.push_back(NumberToJson(time));
    modes_.push_back(system_.ModeName(mode));
    states_.push_back(NumbersOf(state));
    Json values = Json::array();
    for (int guard = 0; guard < system_.num_guards(mode); ++guard) {
      values.push_back(NumberToJson(
          system_.functions().Guard({mode, time, state.data(), ControlAt(time), input_.parameters.data()}, guard)));
    }
    guards_.push_back(std::move(values));
  }
  void MoveTo(Json* motion) {
    (*motion)["times"] = std::move(times_);
    (*motion)["modes"] = std::move(modes_);
    (*motion)["states"] = std::move(states_);
    (*motion)["guards"] = std::move(guards_);
  }

 private:
  // Of the interval that begins at or before `time`; the last one at the end.
  const double* ControlAt(double time) const {
    if (input_.control.empty()) return no_control_.data();
    const std::ptrdiff_t begun = std::upper_bound(begins_.begin(), begins_.end(), time) - begins_.begin();
    return &input_.control[std::max<std::ptrdiff_t>(begun - 1, 0) * system_.num_controls()];
  }

  const HybridSystem& system_;
  const HybridInput& input_;
  std::vector<double> begins_;  // of the control intervals
  const std::vector<double> no_control_;
  Json times_ = Json::array(), modes_ = Json::array(), states_ = Json::array(), guards_ = Json::array();
};

// The problem with all free that a motion depends on.
HybridProblem WithAllFree(HybridProblem problem) {
  problem.free = {.control = problem.system.num_controls() > 0, .duration = true};
  problem.free.initial.resize(problem.guess.initial.size());
  problem.free.parameters.resize(problem.guess.parameters.size());
  std::iota(problem.free.initial.begin(), problem.free.initial.end(), 0);
  std::iota(problem.free.parameters.begin(), problem.free.parameters.end(), 0);
  return problem;
}

}  // namespace

Json HybridSystemToJson(const HybridSystem& system) {
  Json modes = Json::array();
  for (int mode = 0; mode < system.num_modes(); ++mode) {
    modes.push_back(
        {{"name", system.ModeName(mode)},
         {"states", NamesToJson(system.state_size(mode), [&](int i) { return system.StateName(mode, i); })},
         {"guards", NamesToJson(system.num_guards(mode), [&](int i) { return system.GuardName(mode, i); })}});
  }
  return {{"modes", std::move(modes)},
          {"controls", NamesToJson(system.num_controls(), [&](int i) { return system.ControlName(i); })},
          {"parameters", NamesToJson(system.num_parameters(), [&](int i) { return system.ParameterName(i); })}};
}

Json HybridInputToJson(const HybridSystem& system, const HybridInput& input) {
  std::vector<double> control = input.control;
  control.resize(static_cast<std::size_t>(input.num_intervals) * system.num_controls());
  return {{"mode", system.ModeName(input.mode)},
          {"initial", NumbersToJson(input.initial)},
          {"parameters", NumbersToJson(input.parameters)},
          {"duration", NumberToJson(input.duration)},
          {"intervals", input.num_intervals},
          {"control", RowsToJson(control, system.num_controls())}};
}

Json HybridMotionToJson(const HybridSimulator& simulator, const HybridInput& input, bool ok, bool states) {
  const HybridSystem& system = simulator.system();
  Json motion = Json::object();
  if (!ok) motion["failed"] = simulator.WhyFailed();
  if (simulator.accumulation()) motion["accumulation"] = NumberToJson(*simulator.accumulation());
  if (ok) {
    motion["mode"] = system.ModeName(simulator.final_mode());
    motion["final"] = NumbersOf(simulator.final_state());
  }
  Json events = Json::array();
  for (const HybridEvent& event : simulator.events()) {
    events.push_back({{"time", NumberToJson(event.time)},
                      {"mode", system.ModeName(event.mode)},
                      {"guard", system.GuardName(event.mode, event.guard)},
                      {"next_mode", system.ModeName(event.next_mode)},
                      {"rate", NumberToJson(event.rate)}});
  }
  motion["events"] = std::move(events);
  motion["steps_per_interval"] = simulator.steps_per_interval();
  if (ok) {
    if (const std::string remark = simulator.WhyNotDifferentiable(); !remark.empty()) motion["remark"] = remark;
  }
  if (!states) return motion;
  Samples samples(system, input);
  std::size_t next = 0;
  const std::vector<HybridEvent>& all = simulator.events();
  const auto add_events_until = [&](double time) {
    for (; next < all.size() && all[next].time <= time; ++next) {
      samples.Add(all[next].time, all[next].mode, all[next].before);
      samples.Add(all[next].time, all[next].next_mode, all[next].after);
    }
  };
  double last = -1;
  for (int k = 0; k < simulator.num_steps(); ++k) {
    const double time = simulator.StepTime(k);
    const std::size_t before = next;
    add_events_until(time);
    // A step after an event begins with the state that the event has added.
    if (next == before && time > last) samples.Add(time, simulator.StepMode(k), simulator.StepState(k));
    last = time;
  }
  if (ok) {
    const std::size_t before = next;
    add_events_until(input.duration);
    if (next == before) samples.Add(input.duration, simulator.final_mode(), simulator.final_state());
  }
  samples.MoveTo(&motion);
  return motion;
}

Json HybridGradientToJson(const HybridInput& input, const HybridSystem& system, const HybridGradient& gradient) {
  std::vector<double> control = gradient.control, parameters = gradient.parameters;
  control.resize(static_cast<std::size_t>(input.num_intervals) * system.num_controls());
  parameters.resize(system.num_parameters());
  return {{"initial", NumbersToJson(gradient.initial)},
          {"control", RowsToJson(control, system.num_controls())},
          {"parameters", NumbersToJson(parameters)},
          {"duration", NumberToJson(gradient.duration)}};
}

Json HybridLossToJson(const HybridProblem& problem, bool states, Json* motion) {
  HybridShooting shooting(WithAllFree(problem));
  const std::vector<double>& z = shooting.initial_guess();
  std::vector<double> derivative(z.size());
  double loss = 0;
  const bool ok = shooting.Evaluate(z, &loss, derivative.data());
  const HybridInput input = shooting.InputAt(z);
  if (motion != nullptr) {
    HybridSimulator& simulator = shooting.simulator();
    const bool moved = simulator.WhyFailed().empty();
    *motion = HybridMotionToJson(simulator, input, moved, states);
    if (moved) (*motion)["integration_error"] = NumberToJson(simulator.IntegrationError());
  }
  if (!ok) return {{"failed", shooting.WhyFailed()}};
  HybridGradient gradient;
  auto next = derivative.begin();
  const auto take = [&](std::size_t count, std::vector<double>* part) {
    part->assign(next, next + static_cast<std::ptrdiff_t>(count));
    next += static_cast<std::ptrdiff_t>(count);
  };
  take(input.control.size(), &gradient.control);
  take(input.initial.size(), &gradient.initial);
  take(input.parameters.size(), &gradient.parameters);
  gradient.duration = *next;
  return {{"loss", NumberToJson(loss)}, {"gradient", HybridGradientToJson(input, problem.system, gradient)}};
}

HybridInput SolutionOf(const HybridProblem& problem, const SolveReport& report) {
  HybridInput input = problem.guess;
  if (!report.initial_state.empty()) input.initial = report.initial_state;
  if (!report.parameters.empty()) input.parameters = report.parameters;
  if (!report.control.empty()) input.control = report.control;
  if (!report.durations.empty()) {
    input.duration = std::accumulate(report.durations.begin(), report.durations.end(), 0.0);
    input.num_intervals = static_cast<int>(report.durations.size());
    input.lengths = report.durations;
  }
  return input;
}

Json HybridRunToJson(const HybridProblem& problem, const SolveReport& report, bool states) {
  Json item = {{"solver", report.solver}, {"termination", TerminationToString(report.termination)}};
  if (!report.reason.empty()) item["reason"] = report.reason;
  if (report.losses.empty()) return item;
  item["initial_loss"] = NumberToJson(report.initial_loss);
  item["final_loss"] = NumberToJson(report.final_loss);
  item["losses"] = NumbersToJson(report.losses);
  item["iterations"] = report.iterations;
  item["evaluations"] = report.evaluations;
  item["seconds"] = report.seconds;
  item["integration_error"] = NumberToJson(report.integration_error);
  const HybridInput solution = SolutionOf(problem, report);
  item["solution"] = HybridInputToJson(problem.system, solution);
  const std::vector<double> times = solution.Times();
  for (int k = 0; k < solution.num_intervals; ++k) item["durations"].push_back(NumberToJson(times[k + 1] - times[k]));
  HybridSimulator simulator(problem.system, problem.integration);
  const bool ok = simulator.Rollout(solution);
  item["motion"] = HybridMotionToJson(simulator, solution, ok, states);
  if (!report.certificate) return item;
  const Certificate& found = *report.certificate;
  Json certificate = {{"verdict", VerdictToString(found.verdict)}};
  if (!found.reason.empty()) certificate["reason"] = found.reason;
  certificate["stationarity"] = NumberToJson(found.stationarity);
  certificate["costate_jump"] = NumberToJson(found.costate_jump);
  certificate["hamiltonian"] = NumberToJson(found.hamiltonian);
  certificate["transversality"] = NumberToJson(found.transversality);
  if (found.final_time) certificate["final_time"] = NumberToJson(*found.final_time);
  if (found.curvature) {
    certificate["curvature"] = {{"kind", CurvatureToString(found.curvature->kind)},
                                {"smallest", NumberToJson(found.curvature->smallest)}};
  }
  if (found.gradient) certificate["gradient"] = NumberToJson(*found.gradient);
  Json events = Json::array();
  for (const ImpactCertificate& event : found.impacts) {
    events.push_back({{"time", NumberToJson(event.time)},
                      {"mode", event.a},
                      {"guard", event.b},
                      {"rate", NumberToJson(-event.speed)},
                      {"multiplier", NumberToJson(event.multiplier)},
                      {"costate_jump", NumberToJson(event.jump)},
                      {"hamiltonian", NumberToJson(event.hamiltonian)},
                      {"on_node", event.on_node}});
  }
  certificate["events"] = std::move(events);
  item["certificate"] = std::move(certificate);
  return item;
}

Json HybridAuditToJson(const HybridProblem& problem, const HybridAudit& audit) {
  Json item = {{"scheme", audit.scheme}, {"verdict", VerdictToString(audit.verdict)}};
  if (const std::string why = audit.Why(); !why.empty()) item["reason"] = why;
  if (audit.interrupted) item["interrupted"] = true;
  if (audit.exact.initial.empty()) return item;
  item["steps"] = audit.steps;
  item["loss"] = NumberToJson(audit.loss);
  item["exact_loss"] = NumberToJson(audit.exact_loss);
  const auto gradient_to_json = [&](const HybridGradient& gradient) {
    Json json = HybridGradientToJson(problem.guess, problem.system, gradient);
    json.erase("duration");
    return json;
  };
  item["gradient"] = gradient_to_json(audit.gradient);
  item["exact_gradient"] = gradient_to_json(audit.exact);
  if (audit.parts.empty()) return item;
  item["order"] = NumberToJson(audit.order);
  for (const HybridAudit::Part& part : audit.parts) {
    Json levels = Json::array();
    for (const RefinementLevel& level : part.study.levels) {
      levels.push_back({{"steps", NumberToJson(level.steps)},
                        {"error", NumberToJson(level.error)},
                        {"smallest", NumberToJson(level.smallest)},
                        {"largest", NumberToJson(level.largest)}});
    }
    item["parts"].push_back({{"name", part.name},
                             {"verdict", VerdictToString(part.study.verdict)},
                             {"order", NumberToJson(part.study.order)},
                             {"levels", std::move(levels)},
                             {"wrong_signs", part.study.wrong_signs}});
  }
  for (const SegmentError& segment : audit.segments) {
    item["segments"].push_back({{"time", NumberToJson(segment.time)},
                                {"mode", segment.mode},
                                {"guard", segment.guard},
                                {"step", segment.step},
                                {"error", NumberToJson(segment.error)},
                                {"stays", segment.stays}});
  }
  if (audit.first_wrong >= 0) item["first_wrong"] = item["segments"][audit.first_wrong];
  if (!audit.widths) return item;
  Json sweeps = Json::array();
  for (const WidthSweep& sweep : audit.widths->sweeps) {
    sweeps.push_back({{"entry", sweep.entry},
                      {"gradient", NumberToJson(sweep.gradient)},
                      {"narrow", NumberToJson(sweep.narrow)},
                      {"wide", NumberToJson(sweep.wide)},
                      {"finding", WidthFindingToString(sweep.finding)},
                      {"widths", NumbersToJson(sweep.widths)},
                      {"slopes", NumbersToJson(sweep.slopes)}});
  }
  item["width_sweep"] = {{"summary", audit.widths->Summary()}, {"sweeps", std::move(sweeps)}};
  return item;
}

}  // namespace saltus
