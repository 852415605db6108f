// Hybrid systems whose functions were recorded in Python, and their problems.
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <optional>
#include <tuple>

#include "arrays.h"
#include "blackbox/command_scheme.h"
#include "computation.h"
#include "control/hybrid_shooting.h"
#include "convert.h"
#include "feedback.h"
#include "hybrid/recorded_functions.h"
#include "programs/hybrid_document.h"
#include "programs/remarks.h"

namespace saltus::python {
namespace {

using Node = std::tuple<std::string, int, int, int, double>;
using Outputs = std::tuple<int, std::vector<Node>, std::vector<int>>;  // as of _expression.outputs

RecordedFunction ReadFunction(int num_inputs, const Outputs& recorded) {
  ExpressionGraph recording{.num_inputs = num_inputs, .outputs = std::get<2>(recorded)};
  for (const auto& [name, a, b, c, value] : std::get<1>(recorded)) {
    ExpressionGraph::Node& node =
        recording.nodes.emplace_back(ExpressionGraph::Node{.a = a, .b = b, .c = c, .value = value});
    if (!FindOperation(name, &node.operation)) throw py::value_error("operation: found '" + name + "'");
  }
  if (const std::string wrong = WhatIsWrongWith(recording); !wrong.empty()) throw py::value_error(wrong);
  return RecordedFunction(recording);
}

using TransitionTuple = std::tuple<std::string, Outputs, Outputs, int, int>;
using ModeTuple =
    std::tuple<std::string, std::vector<std::string>, Outputs, std::vector<TransitionTuple>, std::optional<Outputs>>;

HybridSystem MakeSystem(const std::vector<ModeTuple>& modes, const std::vector<std::string>& controls,
                        const std::vector<std::string>& parameters, bool slides) {
  HybridLayout layout{.num_controls = static_cast<int>(controls.size()),
                      .num_parameters = static_cast<int>(parameters.size()),
                      .control_names = controls,
                      .parameter_names = parameters};
  std::vector<RecordedSystem::Mode> recorded;
  for (const auto& [name, states, flow, transitions, fly] : modes) {
    const int of_guards = static_cast<int>(states.size()) + 1 + layout.num_parameters;
    layout.mode_names.push_back(name);
    layout.state_sizes.push_back(static_cast<int>(states.size()));
    layout.num_guards.push_back(static_cast<int>(transitions.size()));
    layout.state_names.insert(layout.state_names.end(), states.begin(), states.end());
    RecordedSystem::Mode& mode =
        recorded.emplace_back(RecordedSystem::Mode{ReadFunction(of_guards + layout.num_controls, flow), {}});
    if (fly) mode.fly.emplace(ReadFunction(of_guards + layout.num_controls + 1, *fly));
    for (const auto& [guard_name, guard, reset, next_mode, accumulation_mode] : transitions) {
      layout.guard_names.push_back(guard_name);
      const bool reads_control = std::ranges::any_of(std::get<1>(guard), [&](const Node& node) {
        return std::get<0>(node) == "input" && std::get<1>(node) >= of_guards;
      });
      mode.transitions.push_back({ReadFunction(of_guards + (reads_control ? layout.num_controls : 0), guard),
                                  ReadFunction(of_guards, reset),
                                  next_mode,
                                  accumulation_mode});
    }
  }
  return HybridSystem(std::make_shared<RecordedSystem>(std::move(layout), std::move(recorded), slides));
}

// name, "steps" | "event" | "end", "cost" | "value" | "equality" | "inequality", mode, guard, before, letters of what
// the function reads (some of "xupth", in this order), sizes of these, the function.
using TermTuple =
    std::tuple<std::string, std::string, std::string, int, int, bool, std::string, std::vector<int>, Outputs>;

HybridTerm ReadTerm(const TermTuple& tuple) {
  const auto& [name, at, role, mode, guard, before, reads, sizes, function] = tuple;
  HybridTerm term{.name = name, .mode = mode, .guard = guard, .before = before};
  term.at = at == "steps"   ? HybridTerm::At::kEachInterval
            : at == "event" ? HybridTerm::At::kEvent
                            : HybridTerm::At::kEnd;
  term.role = role == "equality"     ? HybridTerm::Role::kEquality
              : role == "inequality" ? HybridTerm::Role::kInequality
              : role == "value"      ? HybridTerm::Role::kValue
                                     : HybridTerm::Role::kCost;
  const auto has = [&reads = reads](char letter) { return reads.find(letter) != std::string::npos; };
  term.with_state = has('x');
  term.with_control = has('u');
  term.with_parameters = has('p');
  term.with_time = has('t');
  term.with_length = has('h');
  int inputs = 0;
  for (const int size : sizes) inputs += size;
  term.function = std::make_shared<RecordedCost>(ReadFunction(inputs, function), sizes);
  return term;
}

HybridOptions ReadIntegration(double tolerance, int steps, bool wait, int most_events, int most_repeats) {
  HybridOptions options;
  if (!(tolerance > 0) || std::isinf(tolerance)) throw py::value_error("tolerance: expected a finite number > 0");
  if (steps < 0) throw py::value_error("steps_per_interval: expected a number of at least 0");
  options.tolerance = tolerance;
  options.steps_per_interval = steps;
  if (most_events < 1) throw py::value_error("most_events: expected a number of at least 1");
  if (most_repeats < 1) throw py::value_error("most_repeats: expected a number of at least 1");
  options.wait_behind_guards = wait;
  options.most_events = most_events;
  options.most_repeats = most_repeats;
  return options;
}

// A time-stepping scheme in Python: `step`(mode, t, x, u, p, h) returns the next mode's name and state, and `jacobian`,
// of the same arguments, its derivatives by [x u p], or is None.
class CallableScheme final : public HybridScheme {
 public:
  CallableScheme(std::string name, const HybridSystem& system, py::object step, py::object jacobian,
                 Computation* computation)
      : name_(std::move(name)),
        system_(system),
        step_(std::move(step)),
        jacobian_(std::move(jacobian)),
        computation_(computation) {}

  std::string name() const override { return name_; }
  int Step(const SchemeStep& at, double* next, double* jacobian, std::string* error) override {
    const StepFunction call = [this](const SchemeStep& step, double* after, std::string* why) {
      return Call(step, after, why);
    };
    if (jacobian == nullptr || jacobian_.is_none()) return DifferenceStep(system_, at, call, next, jacobian, error);
    const int mode = Call(at, next, error);
    if (mode < 0) return mode;
    const bool done = computation_->WithPython([&] {
      const py::ssize_t columns = system_.state_size(at.mode) + system_.num_controls() + system_.num_parameters();
      const Array rows = ReadArray(Ask(jacobian_, at), name_ + ": jacobian", {system_.state_size(mode), columns});
      std::copy_n(rows.data(), rows.size(), jacobian);
    });
    return done ? mode : Stopped(error);
  }

 private:
  static int Stopped(std::string* error) {
    *error = kStopped;
    return -1;
  }

  py::object Ask(const py::object& function, const SchemeStep& at) const {
    const auto array = [](const double* numbers, int size) {
      return ToArray({numbers, static_cast<std::size_t>(size)}, {size});
    };
    return function(system_.ModeName(at.mode),
                    at.t,
                    array(at.x, system_.state_size(at.mode)),
                    array(at.u, system_.num_controls()),
                    array(at.p, system_.num_parameters()),
                    at.h);
  }

  int Call(const SchemeStep& at, double* next, std::string* error) {
    int mode = 0;
    const bool done = computation_->WithPython([&] {
      const auto [name, state] = Ask(step_, at).cast<std::pair<std::string, py::object>>();
      while (mode < system_.num_modes() && system_.ModeName(mode) != name) ++mode;
      if (mode == system_.num_modes()) throw py::value_error(name_ + ": found mode '" + name + "' after a step");
      const Array numbers = ReadArray(state, name_ + ": the state after a step", {system_.state_size(mode)});
      std::copy_n(numbers.data(), numbers.size(), next);
    });
    return done ? mode : Stopped(error);
  }

  const std::string name_;
  const HybridSystem& system_;
  const py::object step_, jacobian_;
  Computation* const computation_;
};

std::string JoinReasons(const std::string& a, const std::string& b) {
  return a.empty() || b.empty() ? a + b : a + "; " + b;
}

// Mode, initial state, parameters, duration, control or None, and the lengths of its intervals or None.
using Guess = std::tuple<int, py::object, py::object, double, py::object, py::object>;

// For a rollout within a longer computation, which makes a result of what was found until it is stopped, and needs
// short rollouts for it: returns true from 0.3 s after the stop on.
StopRequest StopAfterGrace(Computation* computation) {
  using Clock = std::chrono::steady_clock;
  return [computation, end = std::optional<Clock::time_point>()]() mutable {
    if (!computation->Stopped()) return false;
    if (!end) end = Clock::now() + std::chrono::milliseconds(300);
    return Clock::now() >= *end;
  };
}

// A problem without its guess, which every call brings along: several threads may call at the same time.
class Problem {
 public:
  Problem(const HybridSystem& system, const std::vector<TermTuple>& terms, double tolerance, int steps, bool wait,
          int most_events, int most_repeats)
      : problem_{.system = system,
                 .guess = {},
                 .integration = ReadIntegration(tolerance, steps, wait, most_events, most_repeats)} {
    for (const TermTuple& term : terms) problem_.terms.push_back(ReadTerm(term));
  }

  // The problem with a guess, whose rollouts end when `stop` returns true. Throws ValueError if something is wrong with
  // it.
  HybridProblem At(const Guess& guess, StopRequest stop = nullptr) const {
    const auto& [mode, initial, parameters, duration, control, durations] = guess;
    const HybridSystem& system = problem_.system;
    HybridInput input{.mode = mode, .duration = duration};
    input.initial = ToVector(ReadArray(initial, "initial", {system.state_size(mode)}));
    input.parameters = ToVector(ReadArray(parameters, "parameters", {system.num_parameters()}));
    if (!control.is_none()) {
      const py::array given = py::array::ensure(control);
      if (!given || given.ndim() < 1)
        throw py::value_error("control: expected an array (K, " + std::to_string(system.num_controls()) + ")");
      input.num_intervals = static_cast<int>(given.shape(0));
      input.control = ToVector(ReadArray(control, "control", {input.num_intervals, system.num_controls()}));
    }
    if (!durations.is_none()) input.lengths = ToVector(ReadArray(durations, "durations", {input.num_intervals}));
    HybridProblem problem = problem_;
    problem.guess = std::move(input);
    if (const std::string wrong = WhatIsWrongWith(problem); !wrong.empty()) throw py::value_error(wrong);
    problem.integration.stop = std::move(stop);
    return problem;
  }

  py::dict Rollout(const Guess& guess) const {
    Computation computation;
    const HybridProblem problem = At(guess, computation.stop());
    Json motion;
    computation.RunOrThrow([&] {
      HybridSimulator simulator(problem.system, problem.integration);
      const bool ok = simulator.Rollout(problem.guess);
      motion = HybridMotionToJson(simulator, problem.guess, ok, /*states=*/ok);
      if (ok) AddIntegrationError(problem, &simulator, &motion);
    });
    return ToPython(motion);
  }

  // Row-major: final state and event times by [initial control parameters duration]; a remark, the integration error.
  py::tuple FinalDerivatives(const Guess& guess) const {
    Computation computation;
    const HybridProblem problem = At(guess, computation.stop());
    HybridSensitivity found;
    std::vector<double> times;
    std::string remark;
    double error = 0;
    computation.RunOrThrow([&] {
      HybridSimulator simulator(problem.system, problem.integration);
      if (!simulator.Rollout(problem.guess)) throw std::runtime_error(simulator.WhyFailed());
      found = simulator.Sensitivity();
      remark = JoinReasons(simulator.WhyNotDifferentiable(), simulator.WhyInaccurate());
      error = simulator.IntegrationError();
      for (std::size_t i = 0; i < found.times.size(); ++i) {
        if (simulator.events()[i].is_switch) continue;
        times.insert(times.end(), found.times[i].begin(), found.times[i].end());
      }
    });
    const py::ssize_t columns = found.columns, events = static_cast<py::ssize_t>(times.size()) / columns;
    const py::ssize_t rows = static_cast<py::ssize_t>(found.final_state.size()) / columns;
    return py::make_tuple(
        ToArray(found.final_state, {rows, columns}), ToArray(times, {events, columns}), remark, error);
  }

  // The number of steps of the integration is kept, while it suffices, as long as the mode, the intervals and the
  // duration are the same.
  py::tuple LossAndGradient(const Guess& guess) {
    const HybridProblem problem = At(guess, user_.stop());
    std::vector<double> gradient;
    double loss = 0;
    std::string remark;
    Json remarks;
    Computation computation;
    computation.RunOrThrow([&] {
      const OneUser::Use use(&user_, &computation);
      const HybridInput& input = problem.guess;
      const auto same = [&](const HybridInput& other) {
        return other.mode == input.mode && other.num_intervals == input.num_intervals &&
               other.duration == input.duration;
      };
      if (shooting_ == nullptr || !same(shooting_->problem().guess)) {
        shooting_ = std::make_unique<HybridShooting>(WithAllFree(problem));
        shooting_->set_accurate(true);
      }
      std::vector<double> z = input.control;
      z.resize(static_cast<std::size_t>(input.num_intervals) * problem.system.num_controls());
      z.insert(z.end(), input.initial.begin(), input.initial.end());
      z.insert(z.end(), input.parameters.begin(), input.parameters.end());
      z.push_back(input.duration);
      gradient.resize(z.size());
      if (!shooting_->Evaluate(z, &loss, gradient.data())) throw std::runtime_error(shooting_->WhyFailed());
      remark = shooting_->simulator().WhyNotDifferentiable();
      remarks = RemarksToJson(RemarksOn(shooting_->simulator()));
    });
    return py::make_tuple(
        loss, ToArray(gradient, {static_cast<py::ssize_t>(gradient.size())}), remark, ToPython(remarks));
  }

  // bounds: of each of the controls, of the free initial states, of the free parameters, and of the duration; pairs.
  py::tuple Solve(const Guess& guess, const std::string& solver, bool control, const std::vector<int>& initial,
                  const std::vector<int>& parameters, bool duration,
                  const std::vector<std::vector<std::pair<double, double>>>& bounds, int iterations,
                  double learning_rate, std::vector<double> guess_states, const py::object& callback) const {
    Computation computation;
    HybridProblem problem = At(guess, StopAfterGrace(&computation));
    problem.guess_states = std::move(guess_states);
    problem.free = {.control = control, .initial = initial, .parameters = parameters, .duration = duration};
    const auto split =
        [](const std::vector<std::pair<double, double>>& pairs, std::vector<double>* min, std::vector<double>* max) {
          for (const auto& [low, high] : pairs) {
            min->push_back(low);
            max->push_back(high);
          }
        };
    split(bounds.at(0), &problem.free.control_min, &problem.free.control_max);
    split(bounds.at(1), &problem.free.initial_min, &problem.free.initial_max);
    split(bounds.at(2), &problem.free.parameters_min, &problem.free.parameters_max);
    if (!bounds.at(3).empty()) {
      problem.free.duration_min = bounds[3][0].first;
      problem.free.duration_max = bounds[3][0].second;
    }
    if (const std::string wrong = WhatIsWrongWith(problem); !wrong.empty()) throw py::value_error(wrong);
    SolverOptions options;
    if (iterations < 0) throw py::value_error("iterations: expected a number of at least 0");
    if (!(learning_rate > 0) || !std::isfinite(learning_rate)) {
      throw py::value_error("learning_rate: expected a finite number > 0");
    }
    options.iterations = iterations;
    options.learning_rate = learning_rate;
    SolveReport report;
    Json document;
    options.stop = computation.stop();
    if (!callback.is_none()) {
      options.callback = [&](int iteration, double loss) {
        bool on = true;
        return computation.WithPython([&] {
          const py::object answer = callback(iteration, loss);
          on = answer.is_none() || answer.cast<bool>();
        }) && on;
      };
    }
    computation.Run([&] {
      report = saltus::Solve(solver, problem, options);
      if (report.termination != Termination::kNotApplicable) document = HybridRunToJson(problem, report, true);
    });
    if (report.termination == Termination::kNotApplicable) throw py::value_error(report.reason);
    return py::make_tuple(ToPython(document), computation.StoppedBy());
  }

  // The motion from the guess, for feedback.
  PlannedMotion Planned(const Guess& guess) const {
    const HybridProblem problem = At(guess);
    PlannedMotion planned;
    Computation().RunOrThrow([&] {
      const auto simulator = std::make_shared<HybridSimulator>(problem.system, problem.integration);
      if (!simulator->Rollout(problem.guess)) throw std::runtime_error(simulator->WhyFailed());
      LinearMotion linear = Linearize(*simulator, problem.guess);
      if (!simulator->WhyNotFinite().empty()) throw std::runtime_error(simulator->WhyNotFinite());
      planned = {
          .plan = MakePlan(*simulator, problem.guess),
          .linear = std::move(linear),
          .what_is_wrong_with = [simulator](const TrackingCost& cost) { return WhatIsWrongWith(cost, *simulator); },
          .make_plant = [system = problem.system,
                         input = problem.guess,
                         steps = simulator->steps_per_interval()] { return MakePlant(system, input, steps); },
          .remark = simulator->WhyNotDifferentiable()};
    });
    return planned;
  }

  py::tuple TrackContinuously(const Guess& guess, const std::vector<Eigen::MatrixXd>& Q, const Eigen::MatrixXd& R,
                              const Eigen::MatrixXd& QT) const {
    Computation computation;
    const HybridProblem problem = At(guess, computation.stop());
    Regulator regulator;
    std::string remark;
    computation.RunOrThrow([&] {
      HybridSimulator simulator(problem.system, problem.integration);
      if (!simulator.Rollout(problem.guess)) throw std::runtime_error(simulator.WhyFailed());
      const TrackingCost cost{.Q = Q, .R = R, .QT = QT};
      if (const std::string wrong = WhatIsWrongWith(cost, simulator); !wrong.empty()) {
        throw std::invalid_argument(wrong);
      }
      regulator = saltus::TrackContinuously(simulator, problem.guess, cost);
      if (regulator.gains.empty()) {
        throw std::runtime_error("two transitions without time between them: no regulator in continuous time");
      }
      remark = simulator.WhyNotDifferentiable();
    });
    return RegulatorToPython(regulator, remark);
  }

  // Audits a scheme in Python, or if `command` is not empty that command.
  py::dict Audit(const Guess& guess, const std::string& name, const py::object& step, const py::object& jacobian,
                 const std::string& command, int steps, bool width_sweep, double budget) const {
    if (steps < 1) throw py::value_error("steps: expected a number of at least 1");
    Computation computation;
    const HybridProblem problem = At(guess, StopAfterGrace(&computation));
    HybridAuditOptions options{.steps = steps, .width_sweep = width_sweep, .stop = computation.stop()};
    options.refinement.budget = budget;
    HybridAudit audit;
    std::shared_ptr<HybridScheme> scheme;
    if (command.empty()) scheme = std::make_shared<CallableScheme>(name, problem.system, step, jacobian, &computation);
    computation.RunOrThrow([&] {
      if (!command.empty())
        scheme = std::make_shared<CommandScheme>(problem.system, CommandOptions{.name = name, .command = command});
      audit = AuditScheme(problem, scheme.get(), options);
    });
    return ToPython(HybridAuditToJson(problem, audit));
  }

 private:
  HybridProblem problem_;
  std::unique_ptr<HybridShooting> shooting_;  // of the last gradient
  OneUser user_;                              // of shooting_
};

}  // namespace

void BindHybrid(py::module_* module) {
  py::class_<HybridSystem>(*module, "HybridSystem")
      .def(py::init(&MakeSystem), py::arg("modes"), py::arg("controls"), py::arg("parameters"), py::arg("slides"));
  py::class_<Problem> problem(*module, "HybridProblem");
  problem
      .def(py::init<const HybridSystem&, const std::vector<TermTuple>&, double, int, bool, int, int>(),
           py::arg("system"),
           py::arg("terms"),
           py::arg("tolerance"),
           py::arg("steps_per_interval"),
           py::arg("wait_behind_guards"),
           py::arg("most_events"),
           py::arg("most_repeats"))
      .def(
          "check", [](const Problem& checked, const Guess& guess) { checked.At(guess); }, py::arg("guess"))
      .def("rollout", &Problem::Rollout, py::arg("guess"))
      .def("final_derivatives", &Problem::FinalDerivatives, py::arg("guess"))
      .def("loss_and_gradient", &Problem::LossAndGradient, py::arg("guess"))
      .def("solve",
           &Problem::Solve,
           py::arg("guess"),
           py::arg("solver"),
           py::arg("control"),
           py::arg("initial"),
           py::arg("parameters"),
           py::arg("duration"),
           py::arg("bounds"),
           py::arg("iterations"),
           py::arg("learning_rate"),
           py::arg("guess_states"),
           py::arg("callback"));
  problem.def("planned", &Problem::Planned, py::arg("guess"))
      .def("track_continuously",
           &Problem::TrackContinuously,
           py::arg("guess"),
           py::arg("Q"),
           py::arg("R"),
           py::arg("QT"));
  problem.def("audit",
              &Problem::Audit,
              py::arg("guess"),
              py::arg("name"),
              py::arg("step"),
              py::arg("jacobian"),
              py::arg("command"),
              py::arg("steps"),
              py::arg("width_sweep"),
              py::arg("budget"));
  module->def("hybrid_solvers", [] { return SummariesOf(HybridSolvers()); });
}

}  // namespace saltus::python
