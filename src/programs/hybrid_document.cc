#include <algorithm>

#include "blackbox/protocol.h"
#include "control/hybrid_shooting.h"
#include "programs/hybrid_program.h"

namespace saltus {
namespace {

constexpr int kMostSamples = 400;  // of a motion that is drawn

Json NumbersOf(std::span<const double> numbers) { return std::vector<double>(numbers.begin(), numbers.end()); }

// Adds times, modes, states and guards of the simulator's last rollout, in order of time, and their drawings.
void AddSamples(const HybridSimulator& simulator, const HybridInput& input, bool ok, const DrawState& draw,
                Json* motion) {
  const HybridSystem& system = simulator.system();
  Json times = Json::array(), modes = Json::array(), states = Json::array(), guards = Json::array(),
       frames = Json::array();
  std::vector<double> begins = input.Times();  // of the control intervals
  begins.pop_back();
  const std::vector<double> no_control(system.num_controls());
  const auto add = [&](double time, int mode, std::span<const double> state) {
    times.push_back(time);
    modes.push_back(system.ModeName(mode));
    states.push_back(NumbersOf(state));
    if (draw) {
      HybridDrawing drawing;
      draw(mode, time, state.data(), input.parameters.data(), &drawing);
      frames.push_back({{"lines", drawing.lines()}, {"circles", drawing.circles()}});
    }
    // The control of the interval that begins at or before the time; of the last one at the end.
    const std::ptrdiff_t begun = std::ranges::upper_bound(begins, time) - begins.begin();
    const std::ptrdiff_t row = std::max<std::ptrdiff_t>(begun - 1, 0) * system.num_controls();
    const double* control = input.control.empty() ? no_control.data() : &input.control[row];
    Json& values = guards.emplace_back(Json::array());
    for (int guard = 0; guard < system.num_guards(mode) && !system.functions().IsSwitch(mode, guard); ++guard) {
      values.push_back(system.functions().Guard({mode, time, state.data(), control, input.parameters.data()}, guard));
    }
  };
  std::size_t next = 0;
  const std::vector<HybridEvent>& events = simulator.events();
  const auto add_events_until = [&](double time) {
    for (; next < events.size() && events[next].time <= time; ++next) {
      add(events[next].time, events[next].mode, events[next].before);
      add(events[next].time, events[next].next_mode, events[next].after);
    }
  };
  double last = -1;
  for (int k = 0; k < simulator.num_steps(); ++k) {
    const double time = simulator.StepTime(k);
    const std::size_t before = next;
    add_events_until(time);
    // A step after an event begins with the state that the event has added.
    if (next == before && time > last) add(time, simulator.StepMode(k), simulator.StepState(k));
    last = time;
  }
  if (ok) {
    const std::size_t before = next;
    add_events_until(input.duration);
    if (next == before) add(input.duration, simulator.final_mode(), simulator.final_state());
  }
  (*motion)["times"] = std::move(times);
  (*motion)["modes"] = std::move(modes);
  (*motion)["states"] = std::move(states);
  (*motion)["guards"] = std::move(guards);
  if (draw) (*motion)["frames"] = std::move(frames);
}

// {"initial", "control", "parameters", "duration"}.
Json HybridGradientToJson(const HybridInput& input, const HybridSystem& system, const HybridGradient& gradient) {
  std::vector<double> control = gradient.control, parameters = gradient.parameters;
  control.resize(static_cast<std::size_t>(input.num_intervals) * system.num_controls());
  parameters.resize(system.num_parameters());
  return {{"initial", gradient.initial},
          {"control", RowsToJson(control, system.num_controls())},
          {"parameters", parameters},
          {"duration", gradient.duration}};
}

}  // namespace

void AddIntegrationError(const HybridProblem& problem, HybridSimulator* simulator, Json* motion) {
  const double error = simulator->IntegrationError();
  (*motion)["integration_error"] = error;
  (*motion)["remarks"] = RemarksToJson(RemarksOn(*simulator, error, problem.integration.tolerance));
  const std::string remark = motion->value("remark", ""), why = simulator->ReasonInaccurate();
  if (!why.empty()) (*motion)["remark"] = remark.empty() ? why : remark + "; " + why;
}

Json HybridSystemToJson(const HybridSystem& system) {
  Json json = NamesToJson(system);
  for (int mode = 0; mode < system.functions().num_base_modes(); ++mode) {
    Json& guards = json["modes"][mode]["guards"] = Json::array();
    for (int guard = 0; guard < system.num_guards(mode); ++guard) guards.push_back(system.GuardName(mode, guard));
  }
  return json;
}

Json HybridInputToJson(const HybridSystem& system, const HybridInput& input) {
  std::vector<double> control = input.control;
  control.resize(static_cast<std::size_t>(input.num_intervals) * system.num_controls());
  Json item = {{"mode", system.ModeName(input.mode)}};
  SALTUS_ADD_MEMBERS(&item, input, initial, parameters, duration);
  item["intervals"] = input.num_intervals;
  item["control"] = RowsToJson(control, system.num_controls());
  return item;
}

Json HybridMotionToJson(const HybridSimulator& simulator, const HybridInput& input, bool ok, bool states,
                        const DrawState& draw) {
  const HybridSystem& system = simulator.system();
  Json motion = Json::object();
  if (!ok) motion["failed"] = simulator.FailureReason();
  if (simulator.accumulation()) motion["accumulation"] = *simulator.accumulation();
  if (ok) {
    motion["mode"] = system.ModeName(simulator.final_mode());
    motion["final"] = NumbersOf(simulator.final_state());
  }
  Json events = Json::array(), switches = Json::array();
  for (const HybridEvent& event : simulator.events()) {
    const std::string mode = system.ModeName(event.mode), guard = system.GuardName(event.mode, event.guard);
    if (event.is_switch) {
      switches.push_back({{"time", event.time}, {"mode", mode}, {"switch", guard}});
    } else {
      events.push_back({{"time", event.time},
                        {"mode", mode},
                        {"guard", guard},
                        {"next_mode", system.ModeName(event.next_mode)},
                        {"rate", event.rate}});
    }
  }
  motion["events"] = std::move(events);
  if (!switches.empty()) motion["switches"] = std::move(switches);
  motion["steps_per_interval"] = simulator.steps_per_interval();
  if (ok) {
    if (const std::string remark = simulator.ReasonNotDifferentiable(); !remark.empty()) motion["remark"] = remark;
    motion["remarks"] = RemarksToJson(RemarksOn(simulator));
  }
  if (states) AddSamples(simulator, input, ok, draw, &motion);
  return motion;
}

Json DrawnMotionToJson(const HybridProblem& problem, const HybridInput& input, const DrawState& draw) {
  HybridOptions options = problem.integration;
  HybridSimulator chosen(problem.system, options);
  chosen.Rollout(input);
  options.steps_per_interval = std::max(chosen.steps_per_interval(), kMostSamples / input.num_intervals + 1);
  HybridSimulator fine(problem.system, options);
  const bool ok = fine.Rollout(input);
  return HybridMotionToJson(fine, input, ok, true, draw);
}

Json HybridLossToJson(const HybridProblem& problem, bool states, Json* motion) {
  HybridShooting shooting(FreeAllVariables(problem));
  const std::vector<double>& z = shooting.initial_guess();
  std::vector<double> derivative(z.size());
  double loss = 0;
  const bool ok = shooting.Evaluate(z, &loss, derivative.data());
  const HybridInput input = shooting.InputAt(z);
  if (motion != nullptr) {
    HybridSimulator& simulator = shooting.simulator();
    const bool moved = simulator.FailureReason().empty();
    *motion = HybridMotionToJson(simulator, input, moved, states);
    if (moved) AddIntegrationError(problem, &simulator, motion);
  }
  if (!ok) {
    Json failed = {{"failed", shooting.FailureReason()}};
    if (shooting.Evaluate(z, &loss, nullptr)) failed["loss"] = loss;  // it has no gradient
    return failed;
  }
  const HybridInput by = shooting.InputAt(derivative);
  return {
      {"loss", loss},
      {"gradient", HybridGradientToJson(input, problem.system, {by.initial, by.control, by.parameters, by.duration})}};
}

Json HybridRunToJson(const HybridProblem& problem, const SolveReport& report, bool states) {
  Json item = {{"solver", report.solver}, {"termination", TerminationToString(report.termination)}};
  if (!report.reason.empty()) item["reason"] = report.reason;
  if (report.history.losses.empty()) return item;
  item["initial_loss"] = report.guess.loss;
  item["final_loss"] = report.solution.loss;
  item["losses"] = report.history.losses;
  SALTUS_ADD_MEMBERS(&item, report.work, iterations, evaluations, seconds);
  SALTUS_ADD_MEMBERS(&item, report.solution, integration_error);
  const HybridInput solution = SolutionOf(problem, report);
  item["solution"] = HybridInputToJson(problem.system, solution);
  const std::vector<double> times = solution.Times();
  for (int k = 0; k < solution.num_intervals; ++k) item["durations"].push_back(times[k + 1] - times[k]);
  HybridSimulator simulator(problem.system, problem.integration);
  const bool ok = simulator.Rollout(solution);
  item["motion"] = HybridMotionToJson(simulator, solution, ok, states);
  Remarks remarks;
  if (ok) remarks = RemarksOn(simulator, report.solution.integration_error, problem.integration.tolerance);
  if (problem.terms.empty()) {
    remarks.push_back(
        {"guess", "the problem has no costs and no constraints, so that any motion is optimal; add some"});
  }
  item["remarks"] = RemarksToJson(remarks);
  if (!report.certificate) return item;
  const Certificate& found = *report.certificate;
  Json certificate = {{"verdict", VerdictToString(found.verdict)}, {"in_words", VerdictInWords(found)}};
  if (!found.reason.empty()) certificate["reason"] = found.reason;
  SALTUS_ADD_MEMBERS(&certificate, found, stationarity, costate_jump, hamiltonian, transversality, final_time);
  AddCurvature(found, &certificate);
  SALTUS_ADD_MEMBERS(&certificate, found, gradient);
  Json events = Json::array();
  for (const ImpactCertificate& event : found.impacts) {
    Json& entry =
        events.emplace_back(Json{{"time", event.time}, {"mode", event.a}, {"guard", event.b}, {"rate", -event.speed}});
    AddResiduals(event, &entry);
  }
  certificate["events"] = std::move(events);
  item["certificate"] = std::move(certificate);
  return item;
}

Json HybridAuditToJson(const HybridProblem& problem, const HybridAudit& audit) {
  Json item = {{"scheme", audit.scheme}, {"verdict", VerdictToString(audit.verdict)}};
  if (const std::string why = audit.VerdictReason(); !why.empty()) item["reason"] = why;
  if (audit.interrupted) item["interrupted"] = true;
  if (audit.exact.initial.empty()) return item;
  SALTUS_ADD_MEMBERS(&item, audit, steps);
  if (audit.ok()) SALTUS_ADD_MEMBERS(&item, audit, loss);
  SALTUS_ADD_MEMBERS(&item, audit, exact_loss);
  HybridInput audited = problem.guess;
  if (const int width = problem.system.num_controls(); width > 0) {
    audited.num_intervals = static_cast<int>(audit.exact.control.size()) / width;
  }
  const auto gradient_to_json = [&](const HybridGradient& gradient) {
    Json json = HybridGradientToJson(audited, problem.system, gradient);
    json.erase("duration");
    return json;
  };
  item["gradient"] = gradient_to_json(audit.gradient);
  item["exact_gradient"] = gradient_to_json(audit.exact);
  if (audit.gradient_check && audit.gradient_check->agreement != Agreement::kUndecided) {
    item["agrees_with_differences"] = audit.gradient_check->agreement == Agreement::kAgrees;
  }
  if (!audit.refinement) return item;
  item["order"] = audit.order;
  for (const QuantityStudy& quantity : audit.refinement->quantities) {
    item["parts"].push_back({{"name", QuantityToString(quantity.quantity)}});
    item["parts"].back().update(JudgementToJson(quantity));
    for (const RefinementLevel& level : quantity.levels) {
      SALTUS_ADD_MEMBERS(&item["parts"].back()["levels"].emplace_back(), level, steps, error, smallest, largest);
    }
  }
  AddConditioning(*audit.refinement, &item);
  for (const SegmentError& segment : audit.segments) {
    SALTUS_ADD_MEMBERS(&item["segments"].emplace_back(), segment, time, mode, guard, step, error, stays);
  }
  if (audit.first_wrong >= 0) item["first_wrong"] = item["segments"][audit.first_wrong];
  if (audit.widths) item["width_sweep"] = WidthsToJson(*audit.widths);
  return item;
}

}  // namespace saltus
