#include "solve/search/hybrid_search.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/random.h"
#include "saltus/solve/hybrid_solver.h"
#include "solve/enough_steps.h"
#include "solve/phases/hybrid_phases.h"
#include "solve/phases/interior_point.h"
#include "solve/search/sequence_search.h"
#include "solve/solve_chain.h"

namespace saltus {
namespace {

constexpr size_t kMostModes = 24;   // of those created as motions meet them
constexpr int kMostDoublings = 12;  // of a control, until it moves what sticks

using Sequence = std::vector<ModeEvent>;
using Finding = FindingOf<HybridMotion>;

// The problem of a search, for SequenceSearch.
class HybridSearch {
 public:
  using Run = HybridPhaseRun;
  static constexpr char kLeftOut[] = "neighbours beyond the first 200";

  explicit HybridSearch(const HybridPhaseRun& run, const HybridProblem& problem)
      : run_(run), problem_(problem), events_(AllEvents()) {}

  double MeritOf(const HybridMotion& motion) const { return run_.MeritOf(motion); }
  double ViolationOf(const HybridMotion& motion) const { return run_.ViolationOf(motion); }
  RelaxedOptima<HybridPhaseRun> SolveRelaxed(const SolverOptions&) const { return {}; }

  std::optional<HybridMotion> BeginAtRandom(std::uint64_t seed, int number) const {
    const HybridFree& free = run_.problem().free;
    Random random(seed * 1000003 + number);
    HybridMotion motion = run_.guess();
    motion.exact = {};
    if (free.control) {
      std::fill(motion.control.begin(), motion.control.end(), 0.0);
      AddRandomControl(number == 0 ? 0 : 1, &random, &motion);
    }
    for (const FreeVariable& variable : FreeVariables(free, run_.control_width(), /*num_intervals=*/0)) {
      if (variable.kind == FreeVariable::Kind::kDuration) continue;
      const double part = random.Uniform(0, 1), range = variable.max - variable.min;
      double& value = variable.Access(motion);
      const double size = std::max(1.0, std::abs(value));
      value = std::isfinite(range) ? variable.min + part * range : value + (2 * part - 1) * size;
    }
    return motion;
  }

  std::optional<HybridMotion> BeginAround(const HybridMotion& best, std::uint64_t seed, int number) const {
    constexpr double kParts[] = {0.1, 0.3, 1};
    if (!run_.problem().free.control) return std::nullopt;
    Random random(seed * 1000003 + 500009 + number);
    HybridMotion motion = best;
    motion.exact = {};
    AddRandomControl(kParts[number % 3], &random, &motion);
    return motion;
  }

  std::vector<Sequence> NeighboursOf(const HybridMotion& motion, bool* left_out) const {
    const Sequence& sequence = motion.exact.contacts;
    std::vector<Sequence> neighbours;
    const auto add = [&](Sequence next) {
      if (next == sequence || !run_.IsPossible(next)) return;
      if (std::find(neighbours.begin(), neighbours.end(), next) == neighbours.end()) {
        neighbours.push_back(std::move(next));
      }
    };
    for (const size_t removed : {1, 2}) {
      for (size_t i = 0; i + removed <= sequence.size(); ++i) {
        Sequence next = sequence;
        next.erase(next.begin() + i, next.begin() + i + removed);
        add(std::move(next));
      }
    }
    for (size_t i = 0; i <= sequence.size(); ++i) {
      for (const ModeEvent& event : events_) {
        Sequence with = sequence;
        with.insert(with.begin() + i, event);
        if (i < sequence.size()) {
          Sequence other = sequence;
          other[i] = event;
          add(std::move(other));
        }
        add(with);
        for (const ModeEvent& second : events_) {
          if (second.mode != event.next_mode || event.mode == event.next_mode) continue;
          Sequence both = with;
          both.insert(both.begin() + i + 1, second);
          add(std::move(both));
        }
      }
    }
    *left_out = neighbours.size() > sequence_search::kMostNeighbours;
    if (*left_out) neighbours.resize(sequence_search::kMostNeighbours);
    return neighbours;
  }

  Finding SolveFrom(HybridMotion from, const SearchStartOf<Run>& search_start, double most_loss,
                    const SolverOptions& options) const {
    Finding finding;
    HybridProblem problem = problem_;
    problem.guess = run_.InputOf(from);
    bool first = true;
    const bool is_worth_more = search_start.is_guess || search_start.effort == SearchStartOf<Run>::Effort::kThorough;
    // Neither an optimum nor lower than its start, one of many solves is not worth a more accurate one.
    const auto is_of_use = [&](const SolveReport& report) {
      const double lower = report.guess.loss - kSameOptimum * std::abs(report.guess.loss);
      return search_start.is_guess || report.termination == Termination::kConverged ||
             report.solution.loss < std::min(lower, most_loss);
    };
    const auto solve = [&](const HybridProblem& start, const SolverOptions& own) {
      HybridProblem at = problem_;
      if (!std::exchange(first, false)) {
        at.guess = start.guess;
        from = MotionOf(start.guess);
      }
      HybridPhaseRun run("mode_search", at, own, from, search_start.sequence);
      if (!search_start.is_guess) run.set_one_of_many(most_loss);
      run.set_certifies(search_start.certifies);
      if (auto refused = run.StartFailure()) return *refused;
      SolveReport report = UpdateHybridSequence(&run);
      // The start of the user and the best motion are worth a solve with second derivatives, where one without them
      // finds no optimum.
      const bool ended =
          report.termination == Termination::kConverged || report.termination == Termination::kInterrupted;
      if (is_worth_more && !ended && HasInteriorPoint()) {
        HybridPhaseRun other("mode_search", at, own, from, search_start.sequence);
        other.set_algorithm(AugmentedLagrangian::Algorithm::kInteriorPoint);
        if (SolveReport second = UpdateHybridSequence(&other); EndsBetter(second, report)) report = std::move(second);
      }
      finding.trial = {report.solution.control,
                       report.solution.durations,
                       report.solution.initial_state,
                       report.solution.parameters,
                       {}};
      run.Simulate(&finding.trial);
      return report;
    };
    finding.report = SolveWithEnoughSteps(problem, options, solve, is_of_use);
    finding.work = finding.report.work.evaluations * WorkBySteps();
    return finding;
  }

  // With equalities as costs and without inequalities.
  int Shoot(const SolverOptions& options, const SearchStartOf<Run>& start, HybridMotion* motion) const {
    HybridProblem relaxed = run_.problem();
    std::erase_if(relaxed.terms, [](const HybridTerm& term) { return term.role == HybridTerm::Role::kInequality; });
    for (HybridTerm& term : relaxed.terms) {
      if (!term.IsCost()) term.role = HybridTerm::Role::kCost;
    }
    relaxed.guess.control = motion->control;
    relaxed.guess.initial = motion->initial;
    relaxed.guess.parameters = motion->parameters;
    const SolveReport report = Solve("ceres_lm", relaxed, options);
    if (!report.history.losses.empty()) {
      motion->control = report.solution.control;
      motion->initial = report.solution.initial_state;
      motion->parameters = report.solution.parameters;
      if (!report.solution.durations.empty()) motion->durations = report.solution.durations;
    }
    // Several threads are here, and a run has one simulator: each start is simulated by another run.
    if (start.is_more) *motion = HybridPhaseRun("mode_search", problem_, options, std::move(*motion)).guess();
    return report.work.evaluations;
  }

  double WorkByRollout() const { return 10 + 1.0 * StatesOfSteps(); }
  double WorkOf(const HybridMotion&, const SearchStartOf<Run>&) const { return WorkBySteps(); }
  int starts_of_sequence() const { return 1; }
  bool LacksEvents(const HybridMotion& motion) const {
    return std::ranges::any_of(
        events_, [&](const ModeEvent& event) { return std::ranges::count(motion.exact.contacts, event) == 0; });
  }
  bool starts_are_cheap() const { return false; }
  double long_work() const { return INFINITY; }
  bool descends_from_guess() const { return false; }
  bool by_arcs() const { return false; }
  double lowest_loss() const { return 0; }
  double LowestAlong(const Sequence&) const { return 0; }
  bool AllCostsAreSquares() const {
    return std::ranges::none_of(problem_.terms,
                                [](const HybridTerm& term) { return term.role == HybridTerm::Role::kValue; });
  }
  double LossForUser(double loss) const { return loss; }

  LocalOptimum OptimumOf(const HybridMotion& motion) const {
    LocalOptimum found{{}, motion.exact.loss, {}};
    for (const HybridEvent& event : motion.exact.events) {
      found.sequence.push_back({event.mode, event.guard, false});
      found.times.push_back(event.time);
    }
    return found;
  }

 private:
  // Adds controls at random, linear in time, of up to a part of the size of each control and as much of a slope.
  void AddRandomControl(double part, Random* random, HybridMotion* motion) const {
    const int width = run_.control_width();
    const double duration = DurationOf(*motion);
    const std::vector<double> sizes = ControlSizes();
    for (int i = 0; i < width; ++i) {
      const double mean = random->Symmetric() * sizes[i], slope = random->Symmetric() * sizes[i];
      double begin = 0;
      for (size_t k = 0; k < motion->durations.size(); ++k) {
        const double place = 2 * (begin + 0.5 * motion->durations[k]) / duration - 1;
        motion->control[k * width + i] += part * (mean + place * slope);
        begin += motion->durations[k];
      }
    }
  }

  // Every guard, with the mode that its reset leads to from the first state of a motion in that mode.
  Sequence AllEvents() const {
    const HybridSystem& system = problem_.system;
    Sequence events = run_.guess().exact.contacts;
    if (system.functions().CreatesModes()) return EventsOfCreatedModes(std::move(events));
    const auto known = [&](int mode, int guard) {
      return std::any_of(events.begin(), events.end(), [&](const ModeEvent& event) {
        return event.mode == mode && event.guard == guard;
      });
    };
    std::vector<double> after(system.functions().most_states());
    for (int mode = 0; mode < system.num_modes(); ++mode) {
      std::vector<double> x(system.state_size(mode), 1.0);
      if (mode == problem_.guess.mode) x = problem_.guess.initial;
      for (int guard = 0; guard < system.num_guards(mode); ++guard) {
        if (known(mode, guard)) continue;
        const ModePoint at{mode, 0, x.data(), nullptr, problem_.guess.parameters.data()};
        const int next = system.functions().Reset(at, guard, after.data());
        if (next >= 0 && next < system.num_modes()) events.push_back({mode, guard, next});
      }
    }
    return Distinct(events);
  }

  // Returns the events of modes that the guess meets, and of those that events lead to from there.
  Sequence EventsOfCreatedModes(Sequence events) const {
    const HybridFunctions& functions = problem_.system.functions();
    std::vector<int> modes = {problem_.guess.mode};
    const auto add = [&](int mode) {
      if (std::find(modes.begin(), modes.end(), mode) == modes.end() && modes.size() < kMostModes) {
        modes.push_back(mode);
      }
    };
    for (const ModeEvent& event : events) add(event.next_mode);
    for (size_t i = 0; i < modes.size(); ++i) {
      const int mode = modes[i];
      for (int guard = -1; guard < functions.num_guards(mode); ++guard) {
        for (const int next : functions.NextModes(mode, guard, problem_.guess.parameters.data())) {
          add(next);
          events.push_back({mode, guard, next});
        }
      }
    }
    return Distinct(events);
  }

  static Sequence Distinct(const Sequence& events) {
    Sequence distinct;
    for (const ModeEvent& event : events) {
      if (std::find(distinct.begin(), distinct.end(), event) == distinct.end()) distinct.push_back(event);
    }
    return distinct;
  }

  // Returns the size of each control: within its bounds, or the one that changes the state by its size in the duration.
  std::vector<double> ControlSizes() const {
    const HybridProblem& problem = run_.problem();
    const HybridInput& guess = problem.guess;
    const int m = run_.control_width(), n = static_cast<int>(guess.initial.size()),
              P = static_cast<int>(guess.parameters.size()), columns = n + 1 + P + m;
    std::vector<double> xdot(n), jacobian(n * columns), sizes(m, 1.0);
    const std::vector<double> zeros(m);
    const ModePoint start{guess.mode, 0, guess.initial.data(), zeros.data(), guess.parameters.data()};
    problem.system.functions().FlowJacobian(start, xdot.data(), jacobian.data());
    for (int c = 0; c < m; ++c) {
      double size = 0;
      for (int i = 0; i < n; ++i) {
        const double by = std::abs(jacobian[i * columns + n + 1 + P + c]) * guess.duration;
        if (by > 0) size = std::max(size, run_.scales().state[guess.mode][i] / by);
      }
      if (size > 0 && std::isfinite(size)) sizes[c] = size;
      const HybridFree& free = problem.free;
      double most = INFINITY;
      if (!free.control_min.empty()) most = std::min(most, std::abs(free.control_min[c]));
      if (!free.control_max.empty()) most = std::min(most, std::abs(free.control_max[c]));
      for (int k = 0; k < kMostDoublings && sizes[c] < most && !Moves(c, sizes[c]); ++k) sizes[c] *= 2;
      sizes[c] = std::min(sizes[c], most);
    }
    return sizes;
  }

  // Whether a control, held at +-size, moves the system, in which contacts may stick.
  bool Moves(int control, double size) const {
    if (!problem_.system.functions().CreatesModes()) return true;
    HybridSimulator simulator(problem_.system, problem_.integration);
    HybridInput input = run_.problem().guess;
    std::vector<std::vector<double>> ends;
    for (const double sign : {0.0, 1.0, -1.0}) {
      std::fill(input.control.begin(), input.control.end(), 0.0);
      for (size_t k = control; k < input.control.size(); k += run_.control_width()) input.control[k] = sign * size;
      if (simulator.Rollout(input)) {
        ends.emplace_back(simulator.final_state().begin(), simulator.final_state().end());
      } else if (sign == 0) {
        return true;
      }
    }
    return std::any_of(ends.begin(), ends.end(), [&](const auto& end) { return end != ends[0]; });
  }

  double WorkBySteps() const { return 20 + 4.0 * StatesOfSteps(); }

  // Each counted as often as it takes the time of one of a small system: mechanical systems solve for the forces of
  // closed contacts in each stage.
  double StatesOfSteps() const {
    constexpr double kMechanical = 10;
    const double times = problem_.system.functions().CreatesModes() ? kMechanical : 1;
    return times * run_.num_steps() * static_cast<double>(problem_.guess.initial.size());
  }

  const HybridPhaseRun& run_;
  const HybridProblem& problem_;
  const Sequence events_;
};

}  // namespace

SolveReport SolveHybridByModeSearch(const HybridProblem& problem, const SolverOptions& options) {
  HybridPhaseRun run("mode_search", problem, options);
  if (auto refused = run.StartFailure()) return *refused;
  SolveReport report = SequenceSearch(&run, HybridSearch(run, problem)).Search();
  HybridSimulator simulator(problem.system, problem.integration);
  if (!report.history.losses.empty() && simulator.Rollout(SolutionOf(problem, report))) {
    report.solution.integration_error = simulator.IntegrationError();
  }
  return report;
}

}  // namespace saltus
