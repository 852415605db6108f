#include "saltus/feedback/closed_loop.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "base/parallel_for.h"
#include "base/random.h"
#include "base/time_grid.h"
#include "feedback/noisy_states.h"
#include "feedback/scene_intervals.h"
#include "hybrid/runge_kutta.h"

namespace saltus {
namespace {

class HybridPlant final : public Plant {
 public:
  HybridPlant(const HybridSimulator& motion, const HybridInput& input)
      : mode_at_start_(input.mode),
        times_(input.Times()),
        piece_{.parameters = input.parameters},
        simulator_(motion.system(), {.steps_per_interval = motion.steps_per_interval(), .wait_behind_guards = true}) {
    for (int k = 0; k < input.num_intervals; ++k) {
      HybridOptions options = motion.StepsBetween(times_[k], times_[k + 1]);
      options.wait_behind_guards = true;
      if (!options.divisions.empty()) of_divided_.try_emplace(k, motion.system(), options);
    }
  }

  void Start(const Eigen::VectorXd& x) override {
    mode_ = mode_at_start_;
    x_ = x;
    events_.clear();
  }

  bool Advance(int k, std::span<const double> u) override {
    std::vector<HybridEvent> immediate;
    if (!TakeEventsBehindGuards(
            simulator_.system(), times_[k], u, piece_.parameters, &mode_, &x_, &immediate, /*saltation=*/nullptr)) {
      return false;
    }
    piece_.mode = mode_;
    piece_.initial.assign(x_.data(), x_.data() + x_.size());
    piece_.control.assign(u.begin(), u.end());
    piece_.begin = times_[k];
    piece_.duration = times_[k + 1] - times_[k];
    const auto divided = of_divided_.find(k);
    HybridSimulator& simulator = divided == of_divided_.end() ? simulator_ : divided->second;
    if (!simulator.Rollout(piece_)) return false;
    for (const std::vector<HybridEvent>* events : {&std::as_const(immediate), &simulator.events()}) {
      for (const HybridEvent& event : *events) events_.push_back({event.mode, event.guard, event.next_mode, k});
    }
    mode_ = simulator.final_mode();
    x_ = Eigen::Map<const Eigen::VectorXd>(simulator.final_state().data(), simulator.final_state().size());
    return true;
  }

 private:
  int mode_at_start_;
  std::vector<double> times_;
  HybridInput piece_;
  HybridSimulator simulator_;
  std::map<int, HybridSimulator> of_divided_;  // those of intervals that the motion's steps divide
};

class ScenePlant final : public Plant {
 public:
  explicit ScenePlant(SceneIntervals intervals)
      : intervals_(std::move(intervals)),
        force_(intervals_.simulator().force_size()),
        full_(intervals_.simulator().state_size()),
        next_(full_.size()) {}

  // A model may keep numbers of its own of each disc behind those of the state, which begin as in a rollout.
  void Start(const Eigen::VectorXd& x) override {
    const Simulator& simulator = intervals_.simulator();
    CHECK(x.size() == simulator.initial_size() || x.size() == simulator.state_size())
        << "found a state of " << x.size() << " numbers, expected " << simulator.initial_size();
    x_ = x;
    if (x.size() != simulator.state_size()) {
      simulator.ExpandInitial(ToInitial({x.data(), static_cast<std::size_t>(x.size())}, simulator.num_bodies()), full_);
    }
    events_.clear();
    touch_events_ = {};
  }

  bool Advance(int k, std::span<const double> u) override {
    const SceneIntervals::Interval& interval = intervals_[k];
    if (interval.simulator == nullptr) return true;
    const int bodies = interval.simulator->num_bodies();
    const auto size = static_cast<std::size_t>(x_.size()) / bodies, full = full_.size() / bodies;
    for (int b = 0; b < bodies; ++b) std::copy_n(x_.data() + b * size, size, full_.data() + b * full);
    interval.simulator->ExpandForce(u, 0, force_);
    touches_.clear();
    interval.simulator->Step(full_, force_, next_, &touches_);
    full_.swap(next_);
    for (int b = 0; b < bodies; ++b) std::copy_n(full_.data() + b * full, size, x_.data() + b * size);
    touch_events_.Add(touches_, [&](std::size_t i) {
      if (!interval.LastsFromStart(touches_[i])) events_.push_back(LabelOf(touches_[i].candidate, k));
    });
    return x_.allFinite();
  }

 private:
  SceneIntervals intervals_;
  std::vector<double> force_, full_, next_;
  std::vector<Touch> touches_;
  TouchEvents touch_events_;
};

// The states of a branch of an event at the nodes first, ..., last, under the control of an interval.
using BranchStates = std::function<std::vector<Eigen::VectorXd>(int event, int interval, int first, int last)>;

// Whether two events cannot change places: those that share a moving disc, and all events of a hybrid system.
bool Ordered(const Plan& plan, int event, int other) {
  if (plan.discs.empty()) return true;
  return std::ranges::any_of(plan.discs[event], [&](int disc) {
    return std::ranges::find(plan.discs[other], disc) != plan.discs[other].end();
  });
}

// A branch reaches to the event of the same discs before or after; it is empty if no interval begins between the two.
// The control before an event that happens as its interval begins is that of the interval before.
void AddBranches(Plan* plan, const std::function<bool(int event)>& on_node, const BranchStates& late,
                 const BranchStates& early) {
  const auto first_node_behind = [&](int event) {
    return static_cast<int>(std::upper_bound(plan->phases.begin(), plan->phases.end(), event) - plan->phases.begin());
  };
  const int K = plan->num_intervals(), num_events = static_cast<int>(plan->events.size());
  for (int event = 0; event < num_events; ++event) {
    int before = event - 1, after = event + 1;
    while (before >= 0 && !Ordered(*plan, event, before)) --before;
    while (after < num_events && !Ordered(*plan, event, after)) ++after;
    // The nodes in [begin, at) have the events of these discs before this one behind them, those in [at, end) this one.
    const int begin = before < 0 ? 0 : first_node_behind(before), at = first_node_behind(event);
    const int end = after < num_events ? first_node_behind(after) : K;
    const int last_before = on_node(event) && at - 2 >= begin ? at - 2 : at - 1;
    Plan::Branch& behind = plan->late.emplace_back(Plan::Branch{at, last_before, {}});
    Plan::Branch& ahead = plan->early.emplace_back(Plan::Branch{begin, at, {}});
    if (begin < at && at < end) {
      behind.states = late(event, last_before, at, end - 1);
      ahead.states = early(event, at, begin, at - 1);
    }
  }
}

enum Occurrence : char { kNotYet, kHappened, kNotCounted };

// Returns the planned events that have happened up to node k; std::nullopt if others have, or in another order.
std::optional<std::vector<Occurrence>> MatchEvents(const Plan& plan, int k, std::span<const EventLabel> events) {
  std::vector<Occurrence> happened(plan.events.size(), kNotYet);
  // Counts only the first of the events with which a contact comes to last, and none while it lasts.
  for (const Plan::SustainedContact& contact : plan.sustained) {
    for (std::size_t i = contact.event + 1; contact.from <= k && i < plan.events.size(); ++i) {
      if (plan.events[i] == contact.pair && plan.events[i].interval <= contact.to) happened[i] = kNotCounted;
    }
  }
  for (const EventLabel& event : events) {
    const bool lasts = std::ranges::any_of(plan.sustained, [&](const Plan::SustainedContact& contact) {
      return contact.pair == event && contact.from <= k && event.interval <= contact.to &&
             (contact.event < 0 || happened[contact.event] != kNotYet);
    });
    if (lasts) continue;
    std::size_t i = 0;
    while (i < happened.size() && (happened[i] != kNotYet || plan.events[i] != event)) ++i;
    if (i == happened.size()) return std::nullopt;
    for (std::size_t before = 0; before < i; ++before) {
      if (happened[before] == kNotYet && Ordered(plan, static_cast<int>(before), static_cast<int>(i)))
        return std::nullopt;
    }
    happened[i] = kHappened;
  }
  return happened;
}

struct NoiseRoots {
  explicit NoiseRoots(const Noise& noise)
      : initial(RootOfCovariance(noise.initial)),
        control(RootOfCovariance(noise.control)),
        process(RootOfCovariance(noise.process)),
        measurement(RootOfCovariance(noise.measurement)) {}
  Eigen::MatrixXd initial, control, process, measurement;
};

void Disturb(const Eigen::MatrixXd& root, NormalStream* stream, Eigen::Ref<Eigen::VectorXd> x) {
  if (root.size() == 0) return;
  Eigen::VectorXd normal(root.cols());
  for (double& number : normal) number = stream->Next();
  if (root.rows() == x.size()) x += root * normal;
}

// The seed of a sample's stream: SplitMix64 (Steele, Lea, Flood 2014) of both numbers.
std::uint64_t SeedOf(std::uint64_t seed, int sample) {
  std::uint64_t z = seed * 0x9e3779b97f4a7c15 + static_cast<std::uint64_t>(sample) + 1;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
  z = (z ^ (z >> 27)) * 0x94d049bb133111eb;
  return z ^ (z >> 31);
}

ClosedLoopRun RunWith(const Plan& plan, const std::vector<Eigen::MatrixXd>& gains, const NoiseRoots& noise,
                      std::uint64_t seed, Plant* plant) {
  NormalStream stream(seed);
  ClosedLoopRun run;
  const auto m = static_cast<std::size_t>(plan.num_controls);
  run.control.resize(plan.num_intervals() * m);
  Eigen::VectorXd x0 = plan.states[0];
  Disturb(noise.initial, &stream, x0);
  plant->Start(x0);
  run.ok = true;
  for (int k = 0; k < plan.num_intervals() && run.ok; ++k) {
    const std::span<double> u(run.control.data() + k * m, m);
    Eigen::VectorXd measured = plant->state();
    Disturb(noise.measurement, &stream, measured);
    FeedbackControl(plan, gains, k, measured, plant->events(), u);
    Disturb(noise.control, &stream, Eigen::Map<Eigen::VectorXd>(u.data(), u.size()));
    const Eigen::Map<const Eigen::VectorXd> acts(u.data(), static_cast<Eigen::Index>(m));
    run.ok = acts.allFinite() && plant->state().allFinite() && plant->Advance(k, u);
    Disturb(noise.process, &stream, plant->state());
  }
  if (run.ok) {
    const auto happened = MatchEvents(plan, plan.num_intervals(), plant->events());
    run.as_planned = happened && std::ranges::count(*happened, kNotYet) == 0;
  }
  run.mode = plant->mode();
  run.final_state = plant->state();
  return run;
}

}  // namespace

Plan MakePlan(HybridSimulator& motion, const HybridInput& input) {
  const HybridSystem& system = motion.system();
  const int K = input.num_intervals;
  const std::vector<double> times = input.Times();
  Plan plan{.num_controls = system.num_controls(), .control = input.control};
  plan.control.resize(static_cast<std::size_t>(K) * plan.num_controls);
  const std::vector<HybridSensitivity> intervals = motion.IntervalSensitivities();
  for (int k = 0; k <= K; ++k) {
    const std::span<const double> x = k == 0 ? std::span<const double>(input.initial) : motion.StateAt(k);
    plan.states.emplace_back(Eigen::Map<const Eigen::VectorXd>(x.data(), x.size()));
    plan.phases.push_back(static_cast<int>(plan.events.size()));
    for (std::size_t i = 0; k < K && i < intervals[k].times.size(); ++i) {
      const HybridEvent& event = motion.events()[plan.events.size()];
      plan.events.push_back({event.mode, event.guard, event.next_mode, k});
    }
  }
  RungeKutta integrator(system.functions());
  // Extends the motion from a state and time over the nodes in turn, which are in order of time or against it.
  const auto extend = [&](int mode, std::span<const double> x0, double t, int interval, int from, int to) {
    std::vector<Eigen::VectorXd> states;
    Eigen::VectorXd x = Eigen::Map<const Eigen::VectorXd>(x0.data(), x0.size()), next(x.size());
    const double* u = plan.control.data() + static_cast<std::ptrdiff_t>(interval) * plan.num_controls;
    for (int node = from, by = from <= to ? 1 : -1; node != to + by; node += by) {
      const double begin = t, end = times[node];
      HybridOptions parts = motion.StepsBetween(std::min(begin, end), std::max(begin, end));
      if (end < begin) {
        std::ranges::reverse(parts.divisions);
        for (double& part : parts.divisions) part = 1 - part;
      }
      parts.divisions.push_back(1);
      for (const double part : parts.divisions) {
        const double h = (begin + part * (end - begin) - t) / parts.steps_per_interval;
        for (int i = 0; i < parts.steps_per_interval; ++i, t += h) {
          integrator.Step({{mode, t, x.data(), u, input.parameters.data()}, h}, next.data());
          std::swap(x, next);
        }
        t = begin + part * (end - begin);
      }
      states.push_back(x);
    }
    if (from > to) std::reverse(states.begin(), states.end());
    return states;
  };
  AddBranches(
      &plan,
      [](int) { return false; },
      [&](int event, int interval, int first, int last) {
        const HybridEvent& at = motion.events()[event];
        return extend(at.mode, at.before, at.time, interval, first, last);
      },
      [&](int event, int interval, int first, int last) {
        const HybridEvent& at = motion.events()[event];
        return extend(at.next_mode, at.after, at.time, interval, last, first);
      });
  return plan;
}

Plan MakePlan(const Simulator& motion, std::span<const double> control) {
  return MakePlan(SceneIntervals(motion), control);
}

namespace {

// Adds events, phases and sustained contacts.
void AddEvents(const SceneIntervals& motion, const std::vector<SceneEvent>& events, Plan* plan) {
  auto event = events.begin();
  for (int k = 0; k < motion.size(); ++k) {
    plan->phases.push_back(static_cast<int>(plan->events.size()));
    for (; event != events.end() && event->label.interval == k; ++event) {
      plan->events.push_back(event->label);
      plan->discs.push_back(event->discs);
    }
    if (motion[k].simulator == nullptr) {
      for (Plan::SustainedContact& contact : plan->sustained) contact.to += contact.to == k - 1;
      continue;
    }
    for (const Touch& touch : motion.touches(k)) {
      if (touch.kind != ContactKind::kSustained) continue;
      const EventLabel pair = LabelOf(touch.candidate, k);
      const auto goes_on = std::ranges::find_if(plan->sustained, [&](const Plan::SustainedContact& contact) {
        return contact.pair == pair && contact.to >= k - 1;
      });
      if (goes_on != plan->sustained.end()) {
        goes_on->to = k;
        continue;
      }
      // The first event of the pair in this interval, or the last before.
      const auto of_pair = std::find(plan->events.begin() + plan->phases[k], plan->events.end(), pair);
      int first = static_cast<int>(of_pair - plan->events.begin());
      if (of_pair == plan->events.end()) {
        for (first = plan->phases[k] - 1; first >= 0 && plan->events[first] != pair;) --first;
      }
      plan->sustained.push_back({pair, first, first < 0 ? 0 : k + 1, k});
    }
  }
  plan->phases.push_back(static_cast<int>(plan->events.size()));
}

}  // namespace

Plan MakePlan(const SceneIntervals& motion, std::span<const double> control) {
  const Simulator& simulator = motion.simulator();
  const int K = motion.size(), width = simulator.control_width(), size = simulator.body_size();
  CHECK_EQ(static_cast<int>(control.size()), K * width);
  Plan plan{.num_controls = width, .control = {control.begin(), control.end()}};
  for (int k = 0; k <= K; ++k) {
    const std::vector<double> x = motion.State(k);
    plan.states.emplace_back(Eigen::Map<const Eigen::VectorXd>(x.data(), static_cast<Eigen::Index>(x.size())));
  }
  const std::vector<SceneEvent> events = PlannedEvents(motion);
  AddEvents(motion, events, &plan);
  // The free flight of a disc over interval k, forwards or backwards.
  std::vector<double> force(simulator.force_size());
  const auto fly = [&](int k, int body, bool backwards, Eigen::VectorXd* x) {
    const Body& disc = simulator.scene().bodies[body];
    if (disc.fixed || motion[k].simulator == nullptr) return;
    const StepLinearization::FreeFlight f = motion[k].simulator->FreeFlightOfLength(motion[k].length)->flight;
    const double determinant = f.pp * f.vv - f.pv * f.vp;
    for (int j = 0; j < 2; ++j) {
      double &p = (*x)[size * body + j], &v = (*x)[size * body + 2 + j];
      const double a = force[2 * body + j] / disc.mass + simulator.scene().gravity[j];
      if (backwards) {
        const double dp = p - f.pa * a, dv = v - f.va * a;
        p = (f.vv * dp - f.pv * dv) / determinant;
        v = (f.pp * dv - f.vp * dp) / determinant;
      } else {
        const double was = p;
        p = f.pp * was + f.pv * v + f.pa * a;
        v = f.vp * was + f.vv * v + f.va * a;
      }
    }
    if (size == 4 + kSpin) (*x)[size * body + 4] += (backwards ? -1 : 1) * motion[k].length * (*x)[size * body + 5];
  };
  const bool flies = simulator.FreeFlightOfLength(simulator.step()).has_value();
  // Extends the motion over `nodes` nodes from `from` on, forwards or backwards, from the state at the node before.
  const auto extend = [&](int event, int interval, int from, int nodes, bool backwards) {
    std::vector<Eigen::VectorXd> states;
    if (!flies) return states;
    const int by = backwards ? -1 : 1;
    simulator.ExpandForce(control.subspan(static_cast<std::size_t>(interval) * width, width), 0, force);
    const EventLabel& label = plan.events[event];
    Eigen::VectorXd x = plan.states[from - by];
    for (int node = from; node != from + by * nodes; node += by) {
      const int k = backwards ? node : node - 1;
      fly(k, label.a, backwards, &x);
      if (label.c == 0) fly(k, label.b, backwards, &x);
      // The other discs are where they are planned to be.
      Eigen::VectorXd state = plan.states[node];
      state.segment(size * label.a, size) = x.segment(size * label.a, size);
      if (label.c == 0) state.segment(size * label.b, size) = x.segment(size * label.b, size);
      states.push_back(std::move(state));
    }
    if (backwards) std::reverse(states.begin(), states.end());
    return states;
  };
  AddBranches(
      &plan,
      [&](int event) {
        const int k = events[event].label.interval;
        const double time = motion.touches(k)[events[event].touch].time;
        return time >= 0 && IsOnNode(time, motion[k].length);
      },
      [&](int event, int interval, int first, int last) {
        return extend(event, interval, first, last - first + 1, /*backwards=*/false);
      },
      [&](int event, int interval, int first, int last) {
        return extend(event, interval, last, last - first + 1, /*backwards=*/true);
      });
  return plan;
}

bool FeedbackControl(const Plan& plan, const std::vector<Eigen::MatrixXd>& gains, int k, const Eigen::VectorXd& x,
                     std::span<const EventLabel> events, std::span<double> u) {
  const auto m = static_cast<std::size_t>(plan.num_controls);
  const auto take = [&](int interval) { std::copy_n(plan.control.begin() + interval * m, m, u.begin()); };
  take(k);
  if (gains.empty()) return false;
  const std::optional<std::vector<Occurrence>> happened = MatchEvents(plan, k, events);
  if (!happened) return false;
  const Eigen::VectorXd* reference = &plan.states[k];
  int interval = k, odd = -1;
  for (int i = 0; i < static_cast<int>(happened->size()); ++i) {
    const bool planned = i < plan.phases[k];
    if ((*happened)[i] == (planned ? kHappened : kNotYet) || (*happened)[i] == kNotCounted) continue;
    if (odd >= 0) return false;
    odd = i;
    const Plan::Branch& branch = planned ? plan.late[i] : plan.early[i];
    const int at = k - branch.first;
    if (at < 0 || at >= static_cast<int>(branch.states.size())) return false;
    reference = &branch.states[at];
    interval = branch.interval;
  }
  if (reference->size() != x.size() || gains[interval].cols() != x.size() || !reference->allFinite()) return false;
  take(interval);
  Eigen::Map<Eigen::VectorXd>(u.data(), u.size()) -= gains[interval] * (x - *reference);
  return true;
}

std::unique_ptr<Plant> MakePlant(const HybridSimulator& motion, const HybridInput& input) {
  return std::make_unique<HybridPlant>(motion, input);
}

std::unique_ptr<Plant> MakePlant(std::unique_ptr<Simulator> simulator) {
  return std::make_unique<ScenePlant>(SceneIntervals(std::move(simulator)));
}

std::unique_ptr<Plant> MakePlant(const Contact& contact, const Scene& scene, std::span<const double> lengths) {
  return std::make_unique<ScenePlant>(SceneIntervals(contact, scene, lengths));
}

ClosedLoopRun RunClosedLoop(const Plan& plan, const std::vector<Eigen::MatrixXd>& gains, const Noise& noise,
                            std::uint64_t seed, int sample, Plant* plant) {
  return RunWith(plan, gains, NoiseRoots(noise), SeedOf(seed, sample), plant);
}

MonteCarlo RunMonteCarlo(const Plan& plan, const std::vector<Eigen::MatrixXd>& gains, const Noise& noise,
                         const std::function<std::unique_ptr<Plant>()>& make_plant, const MonteCarloOptions& options,
                         const std::function<double(const ClosedLoopRun&)>& loss) {
  CHECK_GT(options.samples, 0);
  const int threads = NumThreads(options.threads);
  const NoiseRoots roots(noise);
  std::vector<std::unique_ptr<Plant>> plants(threads);
  struct Outcome {
    bool done = false, ok = false, as_planned = false;
    double loss = 0;
    Eigen::VectorXd final_state;
  };
  std::vector<Outcome> outcomes(options.samples);
  ParallelFor(threads, options.samples, [&](int thread, int sample) {
    if (options.stop && options.stop()) return;
    if (!plants[thread]) plants[thread] = make_plant();
    const ClosedLoopRun run = RunWith(plan, gains, roots, SeedOf(options.seed, sample), plants[thread].get());
    outcomes[sample] = {true, run.ok, run.as_planned, run.ok && loss ? loss(run) : 0.0, run.final_state};
  });
  // The sums are in the order of the samples, so that they do not depend on threads.
  const Eigen::VectorXd& planned = plan.states.back();
  const Eigen::Index n = planned.size();
  MonteCarlo out;
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(n);
  Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(n, n);
  double losses = 0;
  int ran = 0;
  for (const Outcome& outcome : outcomes) {
    out.simulated += outcome.done;
    if (!outcome.ok) {
      out.failed += outcome.done;
      continue;
    }
    ++ran;
    losses += outcome.loss;
    if (!outcome.as_planned) ++out.off_plan;
    if (outcome.final_state.size() != n) continue;
    ++out.counted;
    const Eigen::VectorXd error = outcome.final_state - planned;
    sum += error;
    squares += error * error.transpose();
  }
  // Without runs these are 0 / 0.
  out.mean = planned + sum / out.counted;
  out.covariance = (squares - sum * sum.transpose() / out.counted) / std::max(0, out.counted - 1);
  if (ran > 1) {
    out.loss = losses / ran;
    double spread = 0;
    for (const Outcome& outcome : outcomes) {
      if (outcome.ok) spread += (outcome.loss - out.loss) * (outcome.loss - out.loss);
    }
    out.loss_error = std::sqrt(spread / (ran - 1.0) / ran);
  }
  return out;
}

}  // namespace saltus
