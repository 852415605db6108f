#include "saltus/simulate/exact_run.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "base/number_text.h"
#include "contact/event/event_ties.h"
#include "control/hybrid_shooting.h"
#include "control/scene_constraints.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/registry.h"
#include "scene/path_motion.h"
#include "scene/scene_rules.h"
#include "scene/units.h"
#include "simulate/flight.h"

namespace saltus {
namespace {

constexpr double kSameEnd = 1e-6;  // of how far and how fast discs move

struct RunSettings {
  std::string model;
  int tie_order = 0;
  std::optional<int> most_impacts;
  StopRequest stop;
  bool stopped() const { return stop && stop(); }
};

// Runs `scene` for control intervals of one length, from number `first` on. `x` is the state at the start, in the
// layout of an initial state, and becomes the state at the end.
bool RunEqualIntervals(const RunSettings& settings, const Scene& scene, const std::vector<double>& control, int first,
                       double start, std::vector<double>* x, ExactRun* run) {
  const std::unique_ptr<Simulator> simulator = MakeSimulator(settings.model, scene, Precision::kDouble);
  simulator->set_tie_order(settings.tie_order);
  const auto has_too_many = [&settings, run, of = simulator.get()] {
    return settings.most_impacts &&
           run->contacts.size() + of->touches().size() > static_cast<size_t>(*settings.most_impacts);
  };
  simulator->set_stop([&] { return has_too_many() || settings.stopped(); });
  const bool ran = simulator->Rollout(*x, control);
  if (has_too_many()) {
    run->reason = "discs meet more than " + std::to_string(*settings.most_impacts) + " times";
    return false;
  }
  if (!ran) {
    run->reason = settings.stopped() ? kStopped : "the exact rollout fails: " + simulator->FailureReason();
    return false;
  }
  simulator->set_stop(nullptr);
  std::vector<double> end(simulator->state_size());
  simulator->GetState(simulator->num_steps(), end);
  *x = ToInitial(end, scene.num_bodies());
  if (const int unresolved = NumUnresolvedSteps(*simulator)) {
    run->reason = "there is no exact motion: " + DescribeUnresolved(unresolved, simulator->num_steps());
    run->end = *x;
    return false;
  }
  for (const Event& event : EventsOf(*simulator)) {
    run->events.push_back(event);
    run->events.back().time += start;
  }
  for (const StepTouch& at : EventTouches(*simulator)) {
    run->contacts.push_back(at.touch.candidate);
    run->places.push_back({first + at.step, at.touch.time});
    if (at.touch.kind != ContactKind::kImpact) run->only_impacts = false;
  }
  for (Tie& tie : TiesOf(*simulator)) {
    tie.time += start;
    run->ambiguous.push_back(std::move(tie));
  }
  run->loss += EffortLoss(scene.objective, control, simulator->step());
  return true;
}

// Returns what is wrong with the sizes and numbers of the arguments of SimulateExactly(); empty if nothing is.
std::string ValidateShapes(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                           const std::vector<double>& durations) {
  const auto sizes = [](const char* what, size_t found, const std::string& expected) {
    return std::string(what) + ": found " + std::to_string(found) + " numbers, expected " + expected;
  };
  const size_t size = InitialSize(scene), width = scene.control_width();
  if (initial.size() != size) return sizes("initial state", initial.size(), std::to_string(size));
  if (!durations.empty() && control.size() != width * durations.size()) {
    return sizes("control", control.size(), std::to_string(width * durations.size()));
  }
  if (width == 0 ? !control.empty() : control.empty() || control.size() % width != 0) {
    return sizes("control",
                 control.size(),
                 width == 0 ? "none, as nothing is pushed" : "a positive multiple of " + std::to_string(width));
  }
  const auto finite = [](double value) { return std::isfinite(value); };
  if (!std::all_of(initial.begin(), initial.end(), finite)) return "initial state: expected finite numbers";
  if (!std::all_of(control.begin(), control.end(), finite)) return "control: expected finite numbers";
  if (!std::ranges::all_of(durations, [](double value) { return value >= 0 && std::isfinite(value); })) {
    return "durations: expected finite numbers >= 0";
  }
  const double sum = std::accumulate(durations.begin(), durations.end(), 0.0);
  if (!durations.empty() && !scene.objective.duration && std::abs(sum - scene.duration) > 1e-9 * scene.duration) {
    return "durations: found a sum of " + std::to_string(sum) + ", expected the scene's duration, " +
           std::to_string(scene.duration);
  }
  return "";
}

// Adds the costs of running and via terms of a scene whose flights are integrated.
void AddIntegratedLoss(Scene scene, const std::vector<double>& initial, const std::vector<double>& control,
                       const std::vector<double>& lengths, ExactRun* run) {
  scene.objective.terminal.clear();
  scene.objective.limits.clear();
  scene.objective.effort = 0;
  scene.objective.duration.reset();
  scene.design.clear();
  const HybridProblem problem = MakeHybridProblem(scene);
  HybridShooting shooting(problem);
  HybridShooting::Outcome outcome;
  run->ok = shooting.Simulate(InputOf(problem, initial, control, lengths), &outcome);
  run->loss += outcome.loss;
  if (!run->ok) run->reason = shooting.FailureReason();
}

// Adds the costs of running and via terms, and of the duration.
void AddLossOnTheWay(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                     const std::vector<double>& durations, ExactRun* run) {
  const Objective& objective = scene.objective;
  std::vector<double> lengths = durations;
  if (lengths.empty()) lengths.assign(scene.steps, scene.dt());
  if (objective.duration) {
    run->loss += objective.duration->weight * std::accumulate(lengths.begin(), lengths.end(), 0.0);
  }
  if (objective.running.empty() && objective.via.empty()) return;
  if (!NonBallisticForces(scene).empty()) return AddIntegratedLoss(scene, initial, control, lengths, run);
  if (const std::string beyond = NonPlaneGeometry(scene); !beyond.empty()) {
    run->ok = false;
    run->reason = "the scene has " + beyond + "; running and waypoint costs are integrated between impacts on planes";
    return;
  }
  if (!run->only_impacts) {
    run->ok = false;
    run->reason =
        "discs rest on or graze each other or a plane; running and waypoint costs are those of motions with impacts "
        "only: start from a guess without such contacts";
    return;
  }
  run->loss += RunningLoss(scene, Flight(scene, initial, control, lengths, *run));
}

// Simulates `scene` with the order of ties in `settings`. Precondition: the model can simulate the scene.
ExactRun SimulateInOrder(const RunSettings& settings, const Scene& whole, const std::vector<double>& initial,
                         const std::vector<double>& control, const std::vector<double>& durations) {
  ExactRun run;
  std::vector<double> x = initial;
  Scene scene = whole;
  // The scenes of parts of the horizon have no terms at other times.
  scene.objective.running.clear();
  scene.objective.via.clear();
  scene.objective.duration.reset();
  if (durations.empty()) {
    if (!RunEqualIntervals(settings, scene, control, 0, 0, &x, &run)) return run;
  } else {
    const size_t width = scene.control_width();
    double start = 0;
    for (size_t begin = 0, end = 0; begin < durations.size(); begin = end) {
      while (end < durations.size() && durations[end] == durations[begin]) ++end;
      if (durations[begin] == 0) continue;
      Scene part = ShiftTimeOrigin(scene, start);
      part.steps = static_cast<int>(end - begin);
      part.duration = part.steps * durations[begin];
      const std::vector<double> rows(control.begin() + width * begin, control.begin() + width * end);
      const int first = static_cast<int>(begin);
      if (!RunEqualIntervals(settings, part, rows, first, start, &x, &run)) {
        if (end < durations.size()) run.end.clear();
        return run;
      }
      start += part.duration;
    }
  }
  run.ok = true;
  run.end = std::move(x);
  run.loss +=
      TerminalLoss(scene.objective, ToState(run.end, scene.num_bodies()), InitialSize(scene) / scene.num_bodies());
  AddLossOnTheWay(whole, initial, control, durations, &run);
  return run;
}

// Compares final states on the scale of the distances and speeds of the discs.
class SameFinalState {
 public:
  SameFinalState(const Scene& scene, const std::vector<double>& initial, const ExactRun& run)
      : end_(run.end), moves_(4 * scene.bodies.size()) {
    for (size_t i = 0; i < moves_; i += 4) {
      const double way = std::hypot(end_[i] - initial[i], end_[i + 1] - initial[i + 1]);
      length_ = std::max({length_, way, scene.bodies[i / 4].radius});
      speed_ = std::max({speed_, std::hypot(initial[i + 2], initial[i + 3]), std::hypot(end_[i + 2], end_[i + 3])});
    }
    speed_ = std::max(speed_, length_ / scene.duration);
  }
  bool operator()(const ExactRun& other) const {
    for (size_t i = 0; i < end_.size(); ++i) {
      if (std::abs(other.end[i] - end_[i]) > kSameEnd * SizeOf(i)) return false;
    }
    return true;
  }

 private:
  // Returns the scale of entry i. Rotations stand at the end; a disc turns by about as much as it moves.
  double SizeOf(size_t i) const {
    if (i < moves_) return i % 4 < 2 ? length_ : speed_;
    return i % kSpin == 0 ? 1 : speed_ / length_;
  }

  const std::vector<double>& end_;
  size_t moves_;
  double length_ = 0, speed_ = 0;
};

}  // namespace

const ModelTraits* ExactModel() {
  const auto exact = std::ranges::find_if(AllContactModels(), &ModelTraits::event_driven);
  return exact == AllContactModels().end() ? nullptr : &*exact;
}

ExactRun SimulateExactly(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                         const std::vector<double>& durations, const StopRequest& stop) {
  return SimulateUpTo(std::nullopt, scene, initial, control, durations, stop);
}

ExactRun SimulateUpTo(std::optional<int> most_impacts, const Scene& scene, const std::vector<double>& initial,
                      const std::vector<double>& control, const std::vector<double>& durations,
                      const StopRequest& stop) {
  if (!scene.units.natural) {  // once for all parts
    const Scene natural = ToNaturalUnits(scene);
    const UnitFactors to(scene.units, natural.units);
    ExactRun run = SimulateUpTo(most_impacts,
                                natural,
                                ConvertInitial(initial, scene.num_bodies(), scene.units, natural.units),
                                Multiplied(control, to.force),
                                Multiplied(durations, to.time),
                                stop);
    if (run.ok) run.loss = ConvertLoss(run.loss, natural.units, scene.units);
    if (!run.end.empty()) {
      run.end = ConvertInitial(std::move(run.end), scene.num_bodies(), natural.units, scene.units);
    }
    for (Event& event : run.events) event.time /= to.time;
    for (ExactRun::Place& place : run.places) place.time /= to.time;
    for (Tie& tie : run.ambiguous) tie.time /= to.time;
    if (run.spread) {
      run.spread->lowest = ConvertLoss(run.spread->lowest, natural.units, scene.units);
      run.spread->highest = ConvertLoss(run.spread->highest, natural.units, scene.units);
    }
    return run;
  }
  const auto refuse = [](const std::string& reason) {
    ExactRun run;
    run.reason = reason;
    return run;
  };
  const ModelTraits* exact = ExactModel();
  if (exact == nullptr) return refuse("no event-driven contact model is registered");
  std::string reason = ReasonNotApplicable(exact->name, scene);
  if (reason.empty()) reason = ValidateShapes(scene, initial, control, durations);
  if (reason.empty() && scene.optimize == Optimize::kPosition) {
    if (const std::optional<SceneError> error = FindOverlapAt(scene, initial)) reason = error->ToString();
  }
  if (!reason.empty()) return refuse(reason);
  Scene part = scene;
  if (!control.empty()) part.steps = static_cast<int>(control.size() / scene.control_width());
  if (reason = ReasonNotApplicable(exact->name, part); !reason.empty()) return refuse(reason);

  RunSettings settings{std::string(exact->name), 0, most_impacts, stop};
  ExactRun run = SimulateInOrder(settings, part, initial, control, durations);
  // Where flights are integrated, every order was tried at the tie.
  if (!run.ok || run.ambiguous.empty() || !NonBallisticForces(part).empty()) return run;
  int orders = 0;
  for (const Tie& tie : run.ambiguous) orders = std::max(orders, NumTieOrders(tie.num_contacts));
  const SameFinalState same(scene, initial, run);
  bool decides = false;
  run.spread = {run.loss, run.loss};
  for (settings.tie_order = 1; settings.tie_order <= orders; ++settings.tie_order) {
    const ExactRun other = SimulateInOrder(settings, part, initial, control, durations);
    if (settings.stopped()) return refuse(kStopped);
    if (!other.ok) continue;
    decides = decides || !same(other);
    run.spread->lowest = std::min(run.spread->lowest, other.loss);
    run.spread->highest = std::max(run.spread->highest, other.loss);
  }
  if (!decides) {
    run.ambiguous.clear();
    run.spread.reset();
  }
  return run;
}

std::string DescribeTies(const std::vector<Tie>& ambiguous, const std::optional<LossSpread>& spread) {
  if (ambiguous.empty() || !spread) return TiesToString(ambiguous);
  return TiesToString(ambiguous) + "; the loss is " + ToText(spread->lowest, 6) + " to " + ToText(spread->highest, 6);
}

}  // namespace saltus
