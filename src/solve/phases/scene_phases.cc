#include "solve/phases/scene_phases.h"

#include <ceres/cost_function.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "control/control_bounds.h"
#include "control/phase_costs.h"
#include "control/scene_constraints.h"

namespace saltus {
namespace {

using Function = std::shared_ptr<const ceres::CostFunction>;

// A block of a function: some numbers of a block of a hybrid term.
struct Picked {
  int block;
  std::vector<int> places;
};

// A function of some numbers of the blocks of a hybrid term.
class PickedCost final : public ceres::CostFunction {
 public:
  PickedCost(Function function, std::vector<Picked> picked, std::vector<int> sizes)
      : function_(std::move(function)), picked_(std::move(picked)) {
    *mutable_parameter_block_sizes() = std::move(sizes);
    set_num_residuals(function_->num_residuals());
    std::size_t size = 0;
    for (const Picked& one : picked_) size += one.places.size();
    values_.resize(size);
    derivatives_.resize(size * num_residuals());
    size = 0;
    for (const Picked& one : picked_) {
      blocks_.push_back(values_.data() + size);
      by_.push_back(derivatives_.data() + size * num_residuals());
      size += one.places.size();
    }
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const int rows = num_residuals();
    double* value = values_.data();
    for (const Picked& one : picked_) {
      for (const int place : one.places) *value++ = parameters[one.block][place];
    }
    if (!function_->Evaluate(blocks_.data(), residuals, jacobians != nullptr ? by_.data() : nullptr)) return false;
    if (jacobians == nullptr) return true;
    for (std::size_t block = 0; block < parameter_block_sizes().size(); ++block) {
      if (jacobians[block] != nullptr) std::fill_n(jacobians[block], rows * parameter_block_sizes()[block], 0.0);
    }
    for (std::size_t i = 0; i < picked_.size(); ++i) {
      const auto& [block, places] = picked_[i];
      if (jacobians[block] == nullptr) continue;
      for (int row = 0; row < rows; ++row) {
        for (std::size_t k = 0; k < places.size(); ++k) {
          jacobians[block][row * parameter_block_sizes()[block] + places[k]] += by_[i][row * places.size() + k];
        }
      }
    }
    return true;
  }

 private:
  const Function function_;
  const std::vector<Picked> picked_;
  std::vector<const double*> blocks_;
  mutable std::vector<double*> by_;
  mutable std::vector<double> values_, derivatives_;  // a transcription is evaluated by one thread
};

std::vector<int> Successive(int first, int count) {
  std::vector<int> places;
  for (int i = 0; i < count; ++i) places.push_back(first + i);
  return places;
}

// Makes a term of a function of some numbers. The places of discs in the state and in the control are those of
// scene_problem.h.
class TermMaker {
 public:
  TermMaker(const Scene& scene, HybridTerm term) : scene_(scene), term_(std::move(term)) {
    if (term_.with_state || term_.with_initial) sizes_.push_back((scene.Spins() ? 4 + kSpin : 4) * scene.num_bodies());
    if (term_.with_control) sizes_.push_back(scene.control_width());
    of_control_ = static_cast<int>(sizes_.size()) - 1;
    if (term_.with_time) sizes_.push_back(1);
    if (term_.with_length) sizes_.push_back(1);
  }

  // Add the next block of the function.
  void ReadState(int body) { Read(0, Successive(4 * body, 4), &term_.reads_states); }
  void ReadForce(int body) {
    const std::vector<int>& bodies = scene_.control.bodies;
    const auto place = static_cast<int>(std::ranges::find(bodies, body) - bodies.begin());
    Read(of_control_, Successive(2 * place, 2), &term_.reads_controls);
  }
  void ReadTime() { picked_.push_back({static_cast<int>(sizes_.size()) - 1 - term_.with_length, {0}}); }
  void ReadLength() { picked_.push_back({static_cast<int>(sizes_.size()) - 1, {0}}); }

  HybridTerm Make(Function function) && {
    term_.function = std::make_shared<PickedCost>(std::move(function), std::move(picked_), std::move(sizes_));
    return std::move(term_);
  }

 private:
  void Read(int block, std::vector<int> places, std::vector<int>* reads) {
    reads->insert(reads->end(), places.begin(), places.end());
    picked_.push_back({block, std::move(places)});
  }

  const Scene& scene_;
  HybridTerm term_;
  std::vector<int> sizes_;
  std::vector<Picked> picked_;
  int of_control_;
};

bool Has(const std::vector<int>& bodies, int body) { return std::ranges::find(bodies, body) != bodies.end(); }

// Returns the scene without what is asked of its discs in single steps, and with what moves them alone.
Scene WithoutSteps(Scene scene) {
  scene.objective.effort = 0;
  scene.objective.running.clear();
  scene.objective.limits.clear();
  scene.no_contact.clear();
  scene.design.clear();
  return scene;
}

int GuardOf(const ContactSequence& pairs, const Candidate& pair) {
  const auto place = std::ranges::find_if(pairs, [&](const Candidate& c) {
    const bool turned = !c.plane && c.a == pair.b && c.b == pair.a;
    return c.plane == pair.plane && ((c.a == pair.a && c.b == pair.b) || turned);
  });
  return static_cast<int>(place - pairs.begin());
}

}  // namespace

std::vector<double> WaypointsOf(const Scene& scene) {
  std::set<double> times;
  for (const ViaTerm& via : scene.objective.via) times.insert(via.time);
  return {times.begin(), times.end()};
}

ScenePhases::ScenePhases(const Scene& scene, const PlanOf<Candidate>& plan, const std::vector<double>& waypoints,
                         const ContactSequence& apart, const Simulator* flight)
    : scene_(scene), problem_(MakeHybridProblem(WithoutSteps(scene))) {
  if (flight != nullptr) problem_.system = SceneSystemOf(WithoutSteps(scene), SceneParameters::kNone, flight);
  const HybridFunctions& functions = problem_.system.functions();
  const ContactSequence pairs = AllPairs(scene);
  const std::vector<double> own_waypoints = WaypointsOf(scene);

  scales_.are_natural = true;
  for (int mode = 0; mode < functions.num_modes(); ++mode) {
    std::vector<double>& sizes = scales_.state.emplace_back(functions.state_size(mode), 1.0);
    for (int i = 0; i < scene.num_bodies() && scene.Spins(); ++i) {  // what the rim turns is a length
      std::fill_n(&sizes[4 * scene.num_bodies() + kSpin * i], kSpin, 1 / scene.bodies[i].radius);
    }
    std::vector<double>& gaps = scales_.guard.emplace_back(functions.num_guards(mode), 1.0);
    for (std::size_t i = 0; i < pairs.size(); ++i) gaps[i] = MakeImpactConstants(scene, pairs[i]).contact_distance;
  }

  plan_.tied = plan.tied;
  plan_.regimes = plan.regimes;
  int mode = 0;
  std::size_t passed = 0;
  for (const std::optional<Candidate>& impact : plan.cuts) {
    instants_.push_back(NAN);
    if (impact) {
      plan_.cuts.emplace_back(ModeEvent{mode, GuardOf(pairs, *impact), mode});
      continue;
    }
    plan_.cuts.emplace_back(std::nullopt);
    if (passed < waypoints.size()) instants_.back() = waypoints[passed++];
    const bool is_next = mode < std::ssize(own_waypoints) && own_waypoints[mode] == instants_.back();
    if (!is_next) continue;  // it has no term here
    plan_.cuts.back() = ModeEvent{mode, static_cast<int>(pairs.size()), mode + 1};
    ++mode;
  }
  for (const Candidate& pair : apart) {
    for (int in = 0; in < functions.num_modes(); ++in) plan_.apart.push_back({in, GuardOf(pairs, pair), in});
  }

  AddEfforts();
  for (const RunningTerm& term : scene.objective.running) AddRunning(term);
  for (const SpeedLimit& limit : scene.objective.limits) AddLimit(limit);
  if (scene.optimize == Optimize::kPosition) AddSeparationAtStart();
}

// Adds the effort of each disc by itself.
void ScenePhases::AddEfforts() {
  const int forces = 2 * scene_.num_controlled(), width = scene_.control_width();
  if (scene_.objective.effort == 0) return;
  for (int i = 0; i < width; i += i < forces ? 2 : 1) {
    const std::vector<int> of_one = Successive(i, i < forces ? 2 : 1);
    problem_.terms.push_back(MakeEffortCost(scene_.objective.effort, width, of_one));
  }
}

void ScenePhases::AddRunning(const RunningTerm& term) {
  const Body& body = scene_.bodies[term.body];
  if (body.fixed) return;
  const bool pushed = Has(scene_.control.bodies, term.body);
  TermMaker maker(scene_,
                  {.name = "running term",
                   .at = HybridTerm::Timing::kEachInterval,
                   .with_state = true,
                   .with_control = pushed,
                   .with_time = true,
                   .with_length = true});
  maker.ReadState(term.body);
  if (pushed) maker.ReadForce(term.body);
  maker.ReadTime();
  maker.ReadLength();
  const RunningCost cost{scene_.gravity, 1 / body.mass, pushed, term};
  problem_.terms.push_back(std::move(maker).Make(
      MakeFunction(cost, pushed ? std::vector{4, 2, 1, 1} : std::vector{4, 1, 1}, RunningCost::kRows)));
}

// Under a constant force the speed is largest at the ends of a step, of which each begins the next one but before
// impacts; and if the disc has no force, at its impacts, at the start and at the end.
void ScenePhases::AddLimit(const SpeedLimit& limit) {
  const auto add = [&](HybridTerm term) {
    term.name = "limit of the speed of " + scene_.bodies[limit.body].name;
    term.role = HybridTerm::Role::kInequality;
    TermMaker maker(scene_, std::move(term));
    maker.ReadState(limit.body);
    problem_.terms.push_back(std::move(maker).Make(MakeFunction(SpeedBound{limit.max}, {4}, SpeedBound::kRows)));
  };
  add({.at = HybridTerm::Timing::kEnd, .with_state = true});
  if (limit.at == SpeedLimit::Timing::kEnd) return;
  const bool coasts = !Has(scene_.control.bodies, limit.body);
  if (coasts) {
    add({.at = HybridTerm::Timing::kEnd, .with_initial = true});
  } else {
    add({.at = HybridTerm::Timing::kEachInterval, .with_state = true});
  }
  const ContactSequence pairs = AllPairs(scene_);
  std::set<int> guards;
  for (const auto& event : plan_.cuts) {
    if (event) guards.insert(event->guard);
  }
  for (const int guard : guards) {
    const bool takes_part = guard < std::ssize(pairs) &&
                            (pairs[guard].a == limit.body || (!pairs[guard].plane && pairs[guard].b == limit.body));
    if (!takes_part) continue;
    for (const bool before : {true, false}) {
      if (!before && !coasts) continue;
      add({.at = HybridTerm::Timing::kEvent,
           .event = problem_.system.functions().GuardName(0, guard),
           .before = before,
           .with_state = true});
    }
  }
}

// Adds that discs do not overlap at the start, if their positions are optimized.
void ScenePhases::AddSeparationAtStart() {
  const auto is_free = [&](int body) { return Has(scene_.free, body); };
  for (const Candidate& c : AllPairs(scene_)) {
    if (!is_free(c.a) && (c.plane || !is_free(c.b))) continue;
    StartGap gap{MakeImpactConstants(scene_, c).contact_distance, std::nullopt};
    if (c.plane) gap.plane = MakeHalfPlane(scene_.planes[c.b]);
    TermMaker maker(scene_, {.name = "gap at the start", .role = HybridTerm::Role::kInequality, .with_initial = true});
    maker.ReadState(c.a);
    if (!c.plane) maker.ReadState(c.b);
    problem_.terms.push_back(
        std::move(maker).Make(MakeFunction(gap, c.plane ? std::vector{4} : std::vector{4, 4}, StartGap::kRows)));
  }
}

std::unique_ptr<HybridTranscription> ScenePhases::Make(const Trial& start, std::vector<double> times,
                                                       const std::vector<double>& overlaps,
                                                       const std::vector<int>& steps, double margin) const {
  for (std::size_t k = 0; k < instants_.size(); ++k) {
    if (!std::isnan(instants_[k])) times[k] = instants_[k];
  }
  times.resize(plan_.cuts.size());
  times.push_back(scene_.duration);
  const HybridTranscription::Start from{
      InitialOf(scene_, start), {}, std::move(times), ControlOf(start, scene_.control_width())};
  auto transcription = std::make_unique<HybridTranscription>(
      problem_, scales_, plan_, from, overlaps, steps, /*substeps=*/1, margin, std::vector<HeldGuard>());
  return transcription->valid() ? std::move(transcription) : nullptr;
}

void ScenePhases::TakeControl(const HybridTranscription& transcription, Trial* trial) const {
  transcription.Control(&trial->control, &trial->durations);
  if (scene_.optimize != Optimize::kControl) trial->initial = transcription.InitialState();
  // A phase that vanished may be a little less than nothing.
  for (double& duration : trial->durations) duration = std::max(duration, 1e-12 * scene_.duration);
  if (!scene_.objective.duration) {
    const double whole = DurationOf(*trial);
    for (double& duration : trial->durations) duration *= scene_.duration / whole;
  }
  MoveWithinBounds(scene_, trial->control);  // multipliers leave about 1e-10 beyond
}

}  // namespace saltus
