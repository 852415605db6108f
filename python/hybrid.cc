// Hybrid systems whose functions were recorded in Python, and their problems.
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <tuple>
#include <variant>

#include "arrays.h"
#include "base/number_text.h"
#include "base/parallel_for.h"
#include "blackbox/session.h"
#include "computation.h"
#include "control/hybrid_shooting.h"
#include "convert.h"
#include "feedback.h"
#include "hybrid/mechanical/bodies_file.h"
#include "hybrid/recorded_functions.h"
#include "hybrid/recorded_mechanics.h"
#include "output/page.h"
#include "programs/hybrid_program.h"
#include "programs/json_output.h"
#include "saltus/control/scene_problem.h"
#include "saltus/identify/hybrid_fit.h"
#include "saltus/optimality/hybrid_certificate.h"
#include "scene/yaml_value.h"

namespace saltus::python {
namespace {

using Node = std::tuple<std::string, int, int, int, double>;
using Outputs = std::tuple<int, std::vector<Node>, std::vector<int>>;  // as of _expression.outputs

ExpressionGraph ReadGraph(int num_inputs, const Outputs& recorded) {
  ExpressionGraph recording{.num_inputs = num_inputs, .outputs = std::get<2>(recorded)};
  for (const auto& [name, a, b, c, value] : std::get<1>(recorded)) {
    ExpressionGraph::Node& node =
        recording.nodes.emplace_back(ExpressionGraph::Node{.a = a, .b = b, .c = c, .value = value});
    if (!FindOperation(name, &node.operation)) throw py::value_error("operation: found '" + name + "'");
  }
  if (const std::string wrong = Validate(recording); !wrong.empty()) throw py::value_error(wrong);
  return recording;
}

RecordedFunction ReadFunction(int num_inputs, const Outputs& recorded) {
  return RecordedFunction(ReadGraph(num_inputs, recorded));
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

constexpr double kMostGap = 1e-6;  // of a closed contact, relative to the numbers of the state

// Gap, restitution, friction; slide, its row, reach and distance, or None.
using ContactTuple = std::tuple<Outputs, Outputs, Outputs, std::optional<Outputs>, std::optional<Outputs>,
                                std::optional<Outputs>, std::optional<Outputs>>;

MechanicalSystem MakeMechanicalSystem(const Outputs& mass, const Outputs& force,
                                      const std::vector<ContactTuple>& contacts,
                                      const std::vector<std::string>& coordinates,
                                      const std::vector<std::string>& controls,
                                      const std::vector<std::string>& parameters,
                                      const std::vector<std::string>& contact_names, bool poisson, double rest_speed) {
  const int n = static_cast<int>(coordinates.size()), m = static_cast<int>(controls.size()),
            num_p = static_cast<int>(parameters.size());
  MechanicalLayout layout{.num_coordinates = n,
                          .num_controls = m,
                          .num_parameters = num_p,
                          .num_contacts = static_cast<int>(contacts.size()),
                          .contact_names = contact_names,
                          .coordinate_names = coordinates,
                          .control_names = controls,
                          .parameter_names = parameters};
  MechanicalRecording recording{
      .mass = ReadGraph(n + num_p, mass), .force = ReadGraph(2 * n + 1 + num_p + m, force), .contacts = {}};
  const auto optional = [&](const std::optional<Outputs>& recorded) {
    return recorded ? std::optional<ExpressionGraph>(ReadGraph(n + num_p, *recorded)) : std::nullopt;
  };
  for (const auto& [gap, restitution, friction, slide, slide_row, reach, distance] : contacts) {
    recording.contacts.push_back({.gap = ReadGraph(n + num_p, gap),
                                  .restitution = ReadGraph(num_p, restitution),
                                  .friction = ReadGraph(num_p, friction),
                                  .slide = optional(slide),
                                  .slide_row = optional(slide_row),
                                  .reach = optional(reach),
                                  .distance = optional(distance)});
  }
  if (const std::string wrong = Validate(layout, recording); !wrong.empty()) throw py::value_error(wrong);
  const auto law = poisson ? MechanicalOptions::Law::kPoisson : MechanicalOptions::Law::kNewton;
  return MechanicalSystem(MakeMechanicalFunctions(std::move(layout), recording),
                          {.law = law, .rest_speed = rest_speed});
}

// The number of a mode by the letters of its contacts.
int ModeOf(const MechanicalSystem& system, const std::string& status) {
  const std::vector<char>& friction = system.functions().layout().has_friction;
  if (!system.IsStatus(status)) {
    const bool slides = std::ranges::count(friction, 1) > 0;
    throw py::value_error("mode: found '" + status + "', expected a letter for each of " +
                          std::to_string(friction.size()) + " contacts: o (open) or n (closed)" +
                          (slides ? ", and of contacts with friction also s, + or -" : ""));
  }
  return system.Mode(status);
}

std::vector<std::string> GuardsOf(const MechanicalSystem& system, int mode) {
  std::vector<std::string> names;
  for (int guard = 0; guard < system.hybrid().num_guards(mode); ++guard) {
    names.push_back(system.hybrid().GuardName(mode, guard));
  }
  return names;
}

std::vector<std::string> NextModesOf(const MechanicalSystem& system, int mode, int guard,
                                     const std::vector<double>& parameters) {
  std::vector<std::string> names;
  for (const int next : system.hybrid().functions().NextModes(mode, guard, parameters.data())) {
    names.push_back(system.hybrid().ModeName(next));
  }
  return names;
}

// name, "steps" | "always" | "event" | "end", "cost" | "value" | "equality" | "inequality", mode, name of the guard,
// before, the only interval or event, letters of what the function reads (some of "xiupth", in this order; i: the
// initial state), sizes of these, the function.
using TermTuple = std::tuple<std::string, std::string, std::string, int, std::string, bool, int, std::string,
                             std::vector<int>, Outputs>;

// A term that was recorded, or one that was read from a file.
using GivenTerm = std::variant<HybridTerm, TermTuple>;

HybridTerm ReadTerm(const GivenTerm& given) {
  if (const auto* term = std::get_if<HybridTerm>(&given)) return *term;
  const auto& [name, at, role, mode, event, before, only, reads, sizes, function] = std::get<TermTuple>(given);
  HybridTerm term{.name = name, .mode = mode, .event = event, .before = before};
  (at == "event" ? term.occurrence : term.interval) = only;
  term.always = at == "always";
  term.at = term.always || at == "steps" ? HybridTerm::Timing::kEachInterval
            : at == "event"              ? HybridTerm::Timing::kEvent
                                         : HybridTerm::Timing::kEnd;
  term.role = role == "equality"     ? HybridTerm::Role::kEquality
              : role == "inequality" ? HybridTerm::Role::kInequality
              : role == "value"      ? HybridTerm::Role::kValue
                                     : HybridTerm::Role::kCost;
  const auto has = [&reads = reads](char letter) { return reads.find(letter) != std::string::npos; };
  term.with_state = has('x');
  term.with_initial = has('i');
  term.with_control = has('u');
  term.with_parameters = has('p');
  term.with_time = has('t');
  term.with_length = has('h');
  int inputs = 0;
  for (const int size : sizes) inputs += size;
  term.function = std::make_shared<RecordedCost>(ReadFunction(inputs, function), sizes);
  return term;
}

// Returns what Python makes a problem of: the motion, the terms and what is optimized.
py::dict PartsOf(const HybridProblem& problem) {
  const auto& [system, guess, terms, free, integration, states] = problem;
  using py::literals::operator""_a;
  return py::dict("controls"_a = system.layout().control_names,
                  "parameters"_a = system.layout().parameter_names,
                  "initial"_a = guess.initial,
                  "values"_a = guess.parameters,
                  "duration"_a = guess.duration,
                  "control"_a = ToArray(guess.control, {guess.num_intervals, system.num_controls()}),
                  "terms"_a = terms,
                  "free"_a = py::make_tuple(free.control, free.initial, free.parameters, free.duration),
                  "control_bounds"_a = py::make_tuple(free.control_min, free.control_max),
                  "parameter_bounds"_a = py::make_tuple(free.parameters_min, free.parameters_max),
                  "duration_bounds"_a = py::make_tuple(free.duration_min, free.duration_max));
}

// Reads a scene of discs as a problem of a hybrid system.
py::dict SceneAsHybrid(const Scene& scene) {
  if (const std::string why = UnsupportedByHybridProblem(scene); !why.empty()) {
    throw py::value_error("scene: found " + why + ", which a problem of a hybrid system does not have");
  }
  const HybridProblem problem = MakeHybridProblem(scene);
  const HybridSystem& system = problem.system;
  py::dict parts = PartsOf(problem), states, guards, next_modes;
  for (int mode = 0; mode < system.num_modes(); ++mode) {
    std::vector<std::string> of_states, of_guards;
    for (int i = 0; i < system.state_size(mode); ++i) of_states.push_back(system.StateName(mode, i));
    for (int i = 0; i < system.num_guards(mode); ++i) {
      of_guards.push_back(system.GuardName(mode, i));
      const int next = mode + of_guards.back().starts_with("waypoint ");
      next_modes[py::make_tuple(system.ModeName(mode), of_guards.back())] = system.ModeName(next);
    }
    states[py::str(system.ModeName(mode))] = of_states;
    guards[py::str(system.ModeName(mode))] = of_guards;
  }
  parts["system"] = system;
  parts["states"] = states;
  parts["guards"] = guards;
  parts["next_modes"] = next_modes;
  return parts;
}

// Reads the problem of a file of bodies, by its text and its name in errors.
py::dict ReadBodiesFile(const std::string& text, const std::string& name) {
  std::optional<BodiesProblem> task;
  const auto error = internal::ReadYaml(text, name, [&](const YAML::Node& root) { task.emplace(ReadBodies(root)); });
  if (error) Raise(*error);
  const MechanicalLayout& layout = task->system.functions().layout();
  py::dict parts = PartsOf(task->problem);
  parts["system"] = task->system;
  parts["coordinates"] = layout.coordinate_names;
  parts["contacts"] = layout.contact_names;
  parts["draw"] = py::cpp_function([draw = ExtrasOf(task->bodies).draw](double t, const std::vector<double>& x) {
    HybridDrawing drawing;
    draw(0, t, x.data(), nullptr, &drawing);
    return py::make_tuple(drawing.lines(), drawing.circles());
  });
  return parts;
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
  bool HasJacobian() const override { return !jacobian_.is_none(); }
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

// Returns why a mechanical system is not in a mode: a closed contact has a gap.
std::string ReasonNotInMode(const MechanicalSystem& system, int mode, const HybridInput& input) {
  const MechanicalFunctions& functions = system.functions();
  const std::string status = system.hybrid().ModeName(mode);
  double size = 1;
  for (const double number : input.initial) size = std::max(size, std::abs(number));
  for (int i = 0; i < functions.layout().num_contacts; ++i) {
    const double gap = functions.Gap(i, input.initial.data(), input.parameters.data());
    if (status[i] == 'o' || std::abs(gap) <= kMostGap * size) continue;
    return "contact '" + functions.layout().contact_names[i] + "' is closed in mode '" + status + "', and its gap is " +
           ToText(gap, 6) + "; leave the mode out to have it found";
  }
  return "";
}

}  // namespace

std::string ReasonNoStart(const MechanicalSystem& system, HybridInput* input) {
  const auto finite = [](const std::vector<double>& numbers) {
    return std::ranges::all_of(numbers, [](double number) { return std::isfinite(number); });
  };
  if (!finite(input->initial) || !finite(input->parameters)) {
    input->mode = std::max(input->mode, 0);  // what checks the input of any system refuses it
    return "";
  }
  if (input->mode >= 0) {
    const std::string why = system.ValidateAt(input->initial, input->parameters);
    return why.empty() ? ReasonNotInMode(system, input->mode, *input) : why;
  }
  std::vector<double> control = input->control;
  control.resize(system.hybrid().num_controls());
  MechanicalSystem::Start start = system.FindMode(input->initial, control, input->parameters, input->begin);
  input->mode = start.mode;
  return start.mode >= 0 ? "" : std::move(start.reason);
}

namespace {

// A problem without its guess, which every call brings along: several threads may call at the same time.
class Problem {
 public:
  Problem(const HybridSystem& system, const std::vector<GivenTerm>& terms, double tolerance, int steps, bool wait,
          int most_events, int most_repeats)
      : problem_{.system = system,
                 .guess = {},
                 .integration = ReadIntegration(tolerance, steps, wait, most_events, most_repeats)} {
    for (const GivenTerm& term : terms) problem_.terms.push_back(ReadTerm(term));
  }
  Problem(const MechanicalSystem& system, const std::vector<GivenTerm>& terms, double tolerance, int steps, bool wait,
          int most_events, int most_repeats)
      : Problem(system.hybrid(), terms, tolerance, steps, wait, most_events, most_repeats) {
    mechanical_ = system;
  }

  // The problem with a guess, whose rollouts end when `stop` returns true. Throws ValueError if something is wrong with
  // it.
  HybridProblem ProblemAtGuess(const Guess& guess, StopRequest stop = nullptr) const {
    const auto& [mode, initial, parameters, duration, control, durations] = guess;
    const HybridSystem& system = problem_.system;
    HybridInput input{.mode = mode, .duration = duration};
    input.initial = ToVector(ReadArray(initial, "initial", {system.state_size(std::max(mode, 0))}));
    input.parameters = ToVector(ReadArray(parameters, "parameters", {system.num_parameters()}));
    if (!control.is_none()) {
      const py::array given = py::array::ensure(control);
      if (!given || given.ndim() < 1) {
        throw py::value_error("control: expected an array (K, " + std::to_string(system.num_controls()) + ")");
      }
      input.num_intervals = static_cast<int>(given.shape(0));
      input.control = ToVector(ReadArray(control, "control", {input.num_intervals, system.num_controls()}));
    }
    if (!durations.is_none()) input.lengths = ToVector(ReadArray(durations, "durations", {input.num_intervals}));
    if (mechanical_) {
      if (const std::string why = ReasonNoStart(*mechanical_, &input); !why.empty()) {
        throw py::value_error("initial: " + why);
      }
    }
    HybridProblem problem = problem_;
    problem.guess = std::move(input);
    if (const std::string wrong = Validate(problem); !wrong.empty()) throw py::value_error(wrong);
    problem.integration.stop = std::move(stop);
    return problem;
  }

  py::dict Rollout(const Guess& guess) const {
    Computation computation;
    const HybridProblem problem = ProblemAtGuess(guess, computation.stop());
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
    const HybridProblem problem = ProblemAtGuess(guess, computation.stop());
    HybridSensitivity found;
    std::vector<double> times;
    std::string remark;
    double error = 0;
    computation.RunOrThrow([&] {
      HybridSimulator simulator(problem.system, problem.integration);
      if (!simulator.Rollout(problem.guess)) throw std::runtime_error(simulator.FailureReason());
      found = simulator.Sensitivity();
      remark = JoinReasons(simulator.ReasonNotDifferentiable(), simulator.ReasonInaccurate());
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
    const HybridProblem problem = ProblemAtGuess(guess, user_.stop());
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
               other.duration == input.duration && other.lengths == input.lengths;
      };
      if (shooting_ == nullptr || !same(shooting_->problem().guess)) {
        shooting_ = std::make_unique<HybridShooting>(FreeAllVariables(problem));
        shooting_->set_accurate(true);
      }
      std::vector<double> z = input.control;
      z.resize(static_cast<std::size_t>(input.num_intervals) * problem.system.num_controls());
      z.insert(z.end(), input.initial.begin(), input.initial.end());
      z.insert(z.end(), input.parameters.begin(), input.parameters.end());
      z.push_back(input.duration);
      gradient.resize(z.size());
      if (!shooting_->Evaluate(z, &loss, gradient.data())) throw std::runtime_error(shooting_->FailureReason());
      remark = shooting_->simulator().ReasonNotDifferentiable();
      Remarks found = RemarksOn(shooting_->simulator());
      const auto add = [&](const char* kind, const std::string& text) {
        if (text.empty()) return;
        remark += (remark.empty() ? "" : "; ") + text;
        found.push_back({kind, text});
      };
      add("derivative", shooting_->DescribeJumpsAndKinks(loss));
      add("guess", shooting_->TermsWithoutEvents());
      remarks = RemarksToJson(found);
    });
    return py::make_tuple(
        loss, ToArray(gradient, {static_cast<py::ssize_t>(gradient.size())}), remark, ToPython(remarks));
  }

  // The losses at points, rows of what is free, and their gradients if asked for: as of a problem that is evaluated for
  // the first time. NaN where there is none, and the reasons, and the remarks on gradients, by the numbers of the
  // points.
  py::tuple Losses(const Guess& guess, bool control, const std::vector<int>& initial,
                   const std::vector<int>& parameters, bool duration, const py::object& points, bool with_gradients,
                   int threads, const py::object& counter) const {
    Computation computation;
    HybridProblem problem = ProblemAtGuess(guess, computation.stop());
    problem.free = {.control = control, .initial = initial, .parameters = parameters, .duration = duration};
    if (const std::string wrong = Validate(problem); !wrong.empty()) throw py::value_error(wrong);
    const HybridShooting first(problem);
    const py::ssize_t size = first.num_variables();
    const py::array any = py::array::ensure(points);
    if (!any || any.ndim() < 2 || any.size() != any.shape(0) * size) {
      throw py::value_error("points: expected an array of P points of " + std::to_string(size) + " numbers");
    }
    const py::ssize_t count = any.shape(0);
    const Array read = ReadArray(any.attr("reshape")(count, size), "points", {count, size});
    Array losses(Shape{count}), gradients(Shape{with_gradients ? count : 0, size});
    std::vector<std::string> reasons(count), remarks(with_gradients ? count : 0);
    std::vector<std::map<int, HybridShooting>> shootings(ReadThreads(threads));  // of each thread, by the first mode
    const double* from = read.data();
    double *loss = losses.mutable_data(), *gradient = with_gradients ? gradients.mutable_data() : nullptr;
    WorkCount work(&computation, counter, count);
    computation.RunOrThrow([&] {
      ParallelFor(static_cast<int>(shootings.size()), static_cast<int>(count), [&](int thread, int i) {
        if (work.shows()) work.Add(1);
        const std::span<const double> point(from + i * size, static_cast<std::size_t>(size));
        double* const row = gradient == nullptr ? nullptr : gradient + i * size;
        int mode = std::get<0>(guess);
        std::string& why = reasons[i];
        if (mechanical_) {
          HybridInput input = first.InputAt(point);
          input.mode = mode;
          why = ReasonNoStart(*mechanical_, &input);
          mode = input.mode;
        }
        if (why.empty()) {
          auto known = shootings[thread].find(mode);
          if (known == shootings[thread].end()) {
            HybridProblem from_mode = problem;
            from_mode.guess.mode = mode;
            known = shootings[thread].emplace(mode, from_mode).first;
            known->second.set_accurate(true);
          }
          HybridShooting& shooting = known->second;
          shooting.simulator().ResetStepChoice();
          if (!shooting.Evaluate(point, &loss[i], row)) {
            why = shooting.FailureReason();
          } else if (with_gradients) {
            remarks[i] =
                JoinReasons(shooting.simulator().ReasonNotDifferentiable(), shooting.DescribeJumpsAndKinks(loss[i]));
          }
        }
        if (why.empty()) return;
        loss[i] = std::numeric_limits<double>::quiet_NaN();
        if (row != nullptr) std::fill_n(row, size, loss[i]);
      });
    });
    const auto by_number = [](const std::vector<std::string>& texts) {
      py::dict out;
      for (std::size_t i = 0; i < texts.size(); ++i) {
        if (!texts[i].empty()) out[py::int_(i)] = texts[i];
      }
      return out;
    };
    return py::make_tuple(losses, gradients, by_number(reasons), by_number(remarks));
  }

  // The final state; with a cotangent of it also its derivative by initial state, control and parameters.
  py::tuple EndState(const Guess& guess, const py::object& cotangent) const {
    Computation computation;
    const HybridProblem problem = ProblemAtGuess(guess, computation.stop());
    std::vector<double> final_state;
    HybridSimulator simulator(problem.system, problem.integration);
    computation.RunOrThrow([&] {
      if (!simulator.Rollout(problem.guess)) throw std::runtime_error(simulator.FailureReason());
      final_state.assign(simulator.final_state().begin(), simulator.final_state().end());
    });
    const auto size = static_cast<py::ssize_t>(final_state.size());
    const Array final_array = ToArray(final_state, {size});
    if (cotangent.is_none()) return py::make_tuple(final_array);
    const Array by_final = ReadArray(cotangent, "cotangent", {size});
    HybridGradient by;
    std::string remark;
    computation.RunOrThrow([&] {
      by = simulator.Adjoint(View(by_final));
      if (!simulator.ReasonNotFinite().empty()) throw std::runtime_error(simulator.ReasonNotFinite());
      remark = simulator.ReasonNotDifferentiable();
    });
    WarnOfRemark(remark);
    const py::ssize_t intervals = problem.guess.num_intervals, m = problem.system.num_controls();
    by.control.resize(intervals * m);
    by.parameters.resize(problem.guess.parameters.size());
    return py::make_tuple(final_array,
                          ToArray(by.initial, {static_cast<py::ssize_t>(by.initial.size())}),
                          ToArray(by.control, {intervals, m}),
                          ToArray(by.parameters, {static_cast<py::ssize_t>(by.parameters.size())}));
  }

  // bounds: of each of the controls, of the free initial states, of the free parameters, and of the duration; pairs.
  py::tuple Solve(const Guess& guess, const std::string& solver, bool control, const std::vector<int>& initial,
                  const std::vector<int>& parameters, bool duration,
                  const std::vector<std::vector<std::pair<double, double>>>& bounds, int iterations,
                  double learning_rate, std::vector<double> guess_states, const py::object& callback,
                  const std::optional<std::vector<std::pair<int, int>>>& sequence, double seconds) const {
    Computation computation(seconds);
    HybridProblem problem = ProblemAtGuess(guess, StopAfterGrace(&computation));
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
      if (bounds[3][0].first != -INFINITY) problem.free.duration_min = bounds[3][0].first;
      problem.free.duration_max = bounds[3][0].second;
    }
    if (const std::string wrong = Validate(problem); !wrong.empty()) throw py::value_error(wrong);
    SolverOptions options;
    if (iterations < 0) throw py::value_error("iterations: expected a number of at least 0");
    if (!(learning_rate > 0) || !std::isfinite(learning_rate)) {
      throw py::value_error("learning_rate: expected a finite number > 0");
    }
    options.limits.iterations = iterations;
    options.descent.learning_rate = learning_rate;
    if (sequence) {
      options.sequences.given.emplace();
      for (const auto& [mode, guard] : *sequence) options.sequences.given->push_back({mode, guard, false});
    }
    SolveReport report;
    Json document;
    options.monitor.stop = computation.stop();
    if (!callback.is_none()) {
      options.monitor.callback = [&](int iteration, double loss) {
        bool on = true;
        return computation.WithPython([&] {
          const py::object answer = callback(iteration, loss);
          on = answer.is_none() || answer.cast<bool>();
        }) && on;
      };
    }
    computation.Run([&] {
      report = saltus::Solve(solver, problem, options);
      if (report.termination == Termination::kInterrupted) computation.AddWhyTimedOut(&report.reason);
      if (report.termination != Termination::kNotApplicable) document = HybridRunToJson(problem, report, true);
    });
    if (report.termination == Termination::kNotApplicable) throw py::value_error(report.reason);
    return py::make_tuple(ToPython(document), computation.StoppedBy());
  }

  // Returns the problem as the page of a program has it: the system, the guess, its motion, loss and gradient.
  py::object PageDocument(const Guess& guess) const {
    Computation computation;
    const HybridProblem problem = ProblemAtGuess(guess, computation.stop());
    Json document;
    computation.RunOrThrow([&] {
      Json motion = DrawnMotionToJson(problem, problem.guess);
      document = HybridLossToJson(problem, false);
      // The system last, as it has the modes that motions have met.
      document["system"] = HybridSystemToJson(problem.system);
      document["guess"] = HybridInputToJson(problem.system, problem.guess);
      document["motion"] = std::move(motion);
    });
    return ToPython(document);
  }

  // The motion from the guess, for feedback.
  PlannedMotion Planned(const Guess& guess) const {
    const HybridProblem problem = ProblemAtGuess(guess);
    PlannedMotion planned;
    Computation().RunOrThrow([&] {
      const auto simulator = std::make_shared<HybridSimulator>(problem.system, problem.integration);
      if (!simulator->Rollout(problem.guess)) throw std::runtime_error(simulator->FailureReason());
      LinearMotion linear = Linearize(*simulator, problem.guess);
      if (!simulator->ReasonNotFinite().empty()) throw std::runtime_error(simulator->ReasonNotFinite());
      planned = {.plan = MakePlan(*simulator, problem.guess),
                 .linear = std::move(linear),
                 .what_is_wrong_with = [simulator](const TrackingCost& cost) { return Validate(cost, *simulator); },
                 .make_plant = [simulator, input = problem.guess] { return MakePlant(*simulator, input); },
                 .remark = simulator->ReasonNotDifferentiable()};
    });
    return planned;
  }

  py::tuple TrackContinuously(const Guess& guess, const std::vector<Eigen::MatrixXd>& Q, const Eigen::MatrixXd& R,
                              const Eigen::MatrixXd& QT) const {
    Computation computation;
    const HybridProblem problem = ProblemAtGuess(guess, computation.stop());
    Regulator regulator;
    std::string remark;
    computation.RunOrThrow([&] {
      HybridSimulator simulator(problem.system, problem.integration);
      if (!simulator.Rollout(problem.guess)) throw std::runtime_error(simulator.FailureReason());
      const TrackingCost cost{.Q = Q, .R = R, .QT = QT};
      if (const std::string wrong = Validate(cost, simulator); !wrong.empty()) {
        throw std::invalid_argument(wrong);
      }
      regulator = saltus::TrackContinuously(simulator, problem.guess, cost);
      if (regulator.gains.empty()) {
        throw std::runtime_error("two transitions without time between them: no regulator in continuous time");
      }
      remark = simulator.ReasonNotDifferentiable();
    });
    return RegulatorToPython(regulator, remark);
  }

  // Returns the motion from the guess with what was measured of it, for identification: (quantity, time, value, sigma,
  // whether this is stated) of each residual of its terms.
  HybridExperiment Experiment(const Guess& guess, const std::string& name,
                              const std::vector<std::tuple<std::string, double, double, double, bool>>& data) const {
    HybridExperiment experiment{.name = name, .problem = ProblemAtGuess(guess), .data = {}};
    for (const auto& [quantity, time, value, sigma, is_stated] : data) {
      experiment.data.push_back({quantity, time, value, sigma, is_stated});
    }
    if (!mechanical_) return experiment;
    experiment.begin = [system = *mechanical_, mode = std::get<0>(guess)](HybridInput* input) {
      input->mode = mode;
      return ReasonNoStart(system, input);
    };
    return experiment;
  }

  // Audits a scheme in Python, or if `command` is not empty that command.
  py::dict Audit(const Guess& guess, const std::string& name, const py::object& step, const py::object& jacobian,
                 const std::string& command, int steps, bool width_sweep, double budget, double audit_seconds,
                 double seconds) const {
    if (steps < 1) throw py::value_error("steps: expected a number of at least 1");
    Computation computation(seconds);
    const HybridProblem problem = ProblemAtGuess(guess, StopAfterGrace(&computation));
    HybridAuditOptions options{.steps = steps, .width_sweep = width_sweep, .stop = computation.stop()};
    options.refinement.budget = budget;
    options.refinement.seconds = audit_seconds;
    HybridAudit audit;
    std::shared_ptr<HybridScheme> scheme;
    if (command.empty()) scheme = std::make_shared<CallableScheme>(name, problem.system, step, jacobian, &computation);
    computation.RunOrThrow([&] {
      if (!command.empty()) {
        scheme = std::make_shared<CommandScheme>(problem.system, CommandOptions{.name = name, .command = command});
      }
      audit = AuditScheme(problem, scheme.get(), options);
    });
    Json document = HybridAuditToJson(problem, audit);
    if (audit.interrupted) document["reason"] = computation.ReasonTimedOut();
    return ToPython(document);
  }

 private:
  HybridProblem problem_;
  std::optional<MechanicalSystem> mechanical_;
  std::unique_ptr<HybridShooting> shooting_;  // of the last gradient
  OneUser user_;                              // of shooting_
};

}  // namespace

void BindHybrid(py::module_* module) {
  const py::class_<HybridExperiment> experiment(*module, "HybridExperiment");
  py::class_<HybridSystem>(*module, "HybridSystem")
      .def(py::init(&MakeSystem), py::arg("modes"), py::arg("controls"), py::arg("parameters"), py::arg("slides"));
  py::class_<HybridTerm>(*module, "HybridTerm")
      .def_readonly("name", &HybridTerm::name)
      .def_property_readonly(
          "at", [](const HybridTerm& term) { return term.at == HybridTerm::Timing::kEachInterval ? "steps" : "end"; })
      .def_property_readonly("role", [](const HybridTerm& term) {
        return term.role == HybridTerm::Role::kEquality ? "equality" : "cost";
      });
  module->def("read_bodies", &ReadBodiesFile, py::arg("text"), py::arg("name"));
  module->def("scene_as_hybrid", &SceneAsHybrid, py::arg("scene"));
  py::class_<MechanicalSystem>(*module, "MechanicalSystem")
      .def(py::init(&MakeMechanicalSystem),
           py::arg("mass"),
           py::arg("force"),
           py::arg("contacts"),
           py::arg("coordinates"),
           py::arg("controls"),
           py::arg("parameters"),
           py::arg("contact_names"),
           py::arg("poisson"),
           py::arg("rest_speed"))
      .def("mode", &ModeOf, py::arg("status"))
      .def("guards", &GuardsOf, py::arg("mode"))
      .def("next_modes", &NextModesOf, py::arg("mode"), py::arg("guard"), py::arg("parameters"));
  py::class_<Problem> problem(*module, "HybridProblem");
  const auto define_with = [&]<typename System>(const System*) {
    problem.def(py::init<const System&, const std::vector<GivenTerm>&, double, int, bool, int, int>(),
                py::arg("system"),
                py::arg("terms"),
                py::arg("tolerance"),
                py::arg("steps_per_interval"),
                py::arg("wait_behind_guards"),
                py::arg("most_events"),
                py::arg("most_repeats"));
  };
  define_with(static_cast<const HybridSystem*>(nullptr));
  define_with(static_cast<const MechanicalSystem*>(nullptr));
  problem
      .def(
          "check", [](const Problem& checked, const Guess& guess) { checked.ProblemAtGuess(guess); }, py::arg("guess"))
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
           py::arg("callback"),
           py::arg("sequence"),
           py::arg("seconds"));
  problem
      .def("losses",
           &Problem::Losses,
           py::arg("guess"),
           py::arg("control"),
           py::arg("initial"),
           py::arg("parameters"),
           py::arg("duration"),
           py::arg("points"),
           py::arg("with_gradients"),
           py::arg("threads"),
           py::arg("counter"))
      .def("end_state", &Problem::EndState, py::arg("guess"), py::arg("cotangent"));
  problem.def("page_document", &Problem::PageDocument, py::arg("guess"))
      .def("experiment", &Problem::Experiment, py::arg("guess"), py::arg("name"), py::arg("data"));
  module->def(
      "render_page",
      [](const std::string& document) { return HybridPage(Json::parse(document)).Render(); },
      py::arg("document"));
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
              py::arg("budget"),
              py::arg("audit_seconds"),
              py::arg("seconds"));
  module->def("hybrid_solvers", [] { return SummariesOf(HybridSolvers()); });
}

}  // namespace saltus::python
