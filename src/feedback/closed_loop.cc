#include "saltus/feedback/closed_loop.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "base/normal_stream.h"
#include "base/parallel_for.h"
#include "feedback/noisy_states.h"
#include "hybrid/runge_kutta.h"

namespace saltus {
namespace {

// The touches of consecutive steps as events: impacts that have a time, and the beginnings of contacts that last.
class TouchEvents {
 public:
  // Those of one step, which follows the step of the last call.
  void Add(std::span<const Touch> touches, std::vector<EventLabel>* events) {
    std::vector<EventLabel> now;
    for (const Touch& touch : touches) {
      const Candidate& c = touch.candidate;
      const EventLabel label{c.a, c.b, c.plane ? 1 : 0};
      const bool impact = touch.time >= 0 && touch.kind == ContactKind::kImpact;
      const auto in = [&](const std::vector<EventLabel>& labels) {
        return std::find(labels.begin(), labels.end(), label) != labels.end();
      };
      if (impact || (!in(before_) && !in(now))) events->push_back(label);
      now.push_back(label);
    }
    before_ = std::move(now);
  }

 private:
  std::vector<EventLabel> before_;
};

class HybridPlant final : public Plant {
 public:
  HybridPlant(const HybridSystem& system, const HybridInput& input, int steps_per_interval)
      : mode_at_start_(input.mode),
        times_(input.Times()),
        piece_{.parameters = input.parameters},
        simulator_(system, {.steps_per_interval = steps_per_interval, .wait_behind_guards = true}) {}

  void Start(const Eigen::VectorXd& x) override {
    mode_ = mode_at_start_;
    x_ = x;
    events_.clear();
  }

  bool Advance(int k, std::span<const double> u) override {
    std::vector<HybridEvent> at_once;
    if (!TakeEventsBehindGuards(
            simulator_.system(), times_[k], u, piece_.parameters, &mode_, &x_, &at_once, /*saltation=*/nullptr)) {
      return false;
    }
    piece_.mode = mode_;
    piece_.initial.assign(x_.data(), x_.data() + x_.size());
    piece_.control.assign(u.begin(), u.end());
    piece_.begin = times_[k];
    piece_.duration = times_[k + 1] - times_[k];
    if (!simulator_.Rollout(piece_)) return false;
    for (const std::vector<HybridEvent>* events : {&std::as_const(at_once), &simulator_.events()}) {
      for (const HybridEvent& event : *events) events_.push_back({event.mode, event.guard, event.next_mode});
    }
    mode_ = simulator_.final_mode();
    x_ = Eigen::Map<const Eigen::VectorXd>(simulator_.final_state().data(), simulator_.final_state().size());
    return true;
  }

 private:
  int mode_at_start_;
  std::vector<double> times_;
  HybridInput piece_;
  HybridSimulator simulator_;
};

class ScenePlant final : public Plant {
 public:
  explicit ScenePlant(std::unique_ptr<Simulator> simulator)
      : simulator_(std::move(simulator)), force_(simulator_->force_size()), next_(simulator_->state_size()) {}

  void Start(const Eigen::VectorXd& x) override {
    x_ = x;
    events_.clear();
    touch_events_ = {};
  }

  bool Advance(int /*k*/, std::span<const double> u) override {
    simulator_->ExpandForce(u, 0, force_);
    touches_.clear();
    simulator_->Step({x_.data(), next_.size()}, force_, next_, &touches_);
    x_ = Eigen::Map<const Eigen::VectorXd>(next_.data(), next_.size());
    touch_events_.Add(touches_, &events_);
    return x_.allFinite();
  }

 private:
  std::unique_ptr<Simulator> simulator_;
  std::vector<double> force_, next_;
  std::vector<Touch> touches_;
  TouchEvents touch_events_;
};

// The nodes of the branches of each event, whose phase is that after the event or that before it.
void AddBranches(Plan* plan, const std::function<std::vector<Eigen::VectorXd>(int event, int first, int last)>& late,
                 const std::function<std::vector<Eigen::VectorXd>(int event, int first, int last)>& early) {
  const auto nodes = [&](int phase) {
    const auto range = std::equal_range(plan->phases.begin(), plan->phases.end() - 1, phase);
    return std::pair(static_cast<int>(range.first - plan->phases.begin()),
                     static_cast<int>(range.second - plan->phases.begin()) - 1);
  };
  for (int event = 0; event < static_cast<int>(plan->events.size()); ++event) {
    const auto [after, last_after] = nodes(event + 1);
    const auto [before, last_before] = nodes(event);
    plan->late.push_back(
        {after, after <= last_after ? late(event, after, last_after) : std::vector<Eigen::VectorXd>()});
    plan->early.push_back(
        {before, before <= last_before ? early(event, before, last_before) : std::vector<Eigen::VectorXd>()});
  }
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
  run.as_planned = run.ok && plant->events() == plan.events;
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
  std::vector<int> interval_of;  // of each event
  for (int k = 0; k <= K; ++k) {
    const std::span<const double> x = k == 0 ? std::span<const double>(input.initial) : motion.StateAt(k);
    plan.states.emplace_back(Eigen::Map<const Eigen::VectorXd>(x.data(), x.size()));
    plan.phases.push_back(static_cast<int>(interval_of.size()));
    if (k < K) interval_of.insert(interval_of.end(), intervals[k].times.size(), k);
  }
  for (const HybridEvent& event : motion.events()) plan.events.push_back({event.mode, event.guard, event.next_mode});
  RungeKutta integrator(system.functions());
  // From a state and time over the nodes in turn, which are in order of time or against it.
  const auto extend = [&](int mode, std::span<const double> x0, double t, int interval, int from, int to) {
    std::vector<Eigen::VectorXd> states;
    Eigen::VectorXd x = Eigen::Map<const Eigen::VectorXd>(x0.data(), x0.size()), next(x.size());
    const double* u = plan.control.data() + static_cast<std::ptrdiff_t>(interval) * plan.num_controls;
    for (int node = from, by = from <= to ? 1 : -1; node != to + by; node += by) {
      const int steps = std::max(motion.steps_per_interval(), 1);
      const double h = (times[node] - t) / steps;
      for (int i = 0; i < steps; ++i, t += h) {
        integrator.Step({{mode, t, x.data(), u, input.parameters.data()}, h}, next.data());
        std::swap(x, next);
      }
      t = times[node];
      states.push_back(x);
    }
    if (from > to) std::reverse(states.begin(), states.end());
    return states;
  };
  AddBranches(
      &plan,
      [&](int event, int first, int last) {
        const HybridEvent& at = motion.events()[event];
        return extend(at.mode, at.before, at.time, interval_of[event], first, last);
      },
      [&](int event, int first, int last) {
        const HybridEvent& at = motion.events()[event];
        return extend(at.next_mode, at.after, at.time, std::min(interval_of[event] + 1, K - 1), last, first);
      });
  return plan;
}

Plan MakePlan(const Simulator& motion, std::span<const double> control) {
  const int K = motion.num_steps(), n = motion.state_size(), size = motion.body_size();
  Plan plan{.num_controls = motion.control_width(), .control = {control.begin(), control.end()}};
  CHECK_EQ(static_cast<int>(control.size()), motion.control_size());
  const std::optional<FlightOver> over = motion.FreeFlightOver(motion.step());
  TouchEvents touch_events;
  std::vector<int> interval_of;
  std::size_t touch = 0;
  for (int k = 0; k <= K; ++k) {
    Eigen::VectorXd x(n);
    motion.GetState(k, {x.data(), static_cast<std::size_t>(n)});
    plan.states.push_back(std::move(x));
    plan.phases.push_back(static_cast<int>(plan.events.size()));
    std::vector<Touch> now;
    for (; touch < motion.touches().size() && motion.touches()[touch].step == k; ++touch) {
      now.push_back(motion.touches()[touch].touch);
    }
    touch_events.Add(now, &plan.events);
    interval_of.resize(plan.events.size(), k);
  }
  // One step of free flight of a disc, forwards or backwards.
  std::vector<double> force(motion.force_size());
  const auto fly = [&](int body, bool backwards, Eigen::VectorXd* x) {
    const Body& disc = motion.scene().bodies[body];
    if (disc.fixed) return;
    const StepLinearization::FreeFlight& f = over->flight;
    const double determinant = f.pp * f.vv - f.pv * f.vp;
    for (int j = 0; j < 2; ++j) {
      double &p = (*x)[size * body + j], &v = (*x)[size * body + 2 + j];
      const double a = force[2 * body + j] / disc.mass + motion.scene().gravity[j];
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
    if (size == 4 + kSpin) (*x)[size * body + 4] += (backwards ? -1 : 1) * motion.step() * (*x)[size * body + 5];
  };
  const auto extend = [&](int event, int interval, int start, int from, int to) {
    std::vector<Eigen::VectorXd> states;
    if (!over) return states;
    motion.ExpandForce(control, interval, force);
    const EventLabel& label = plan.events[event];
    Eigen::VectorXd x = plan.states[start];
    for (int node = start, by = from <= to ? 1 : -1; node != to;) {
      node += by;
      fly(label.a, by < 0, &x);
      if (label.c == 0) fly(label.b, by < 0, &x);
      // The other discs are where they are planned to be.
      Eigen::VectorXd state = plan.states[node];
      state.segment(size * label.a, size) = x.segment(size * label.a, size);
      if (label.c == 0) state.segment(size * label.b, size) = x.segment(size * label.b, size);
      states.push_back(std::move(state));
    }
    if (from > to) std::reverse(states.begin(), states.end());
    return states;
  };
  AddBranches(
      &plan,
      [&](int event, int first, int last) { return extend(event, interval_of[event], first - 1, first, last); },
      [&](int event, int first, int last) {
        return extend(event, std::min(interval_of[event] + 1, K - 1), last + 1, last, first);
      });
  return plan;
}

bool FeedbackControl(const Plan& plan, const std::vector<Eigen::MatrixXd>& gains, int k, const Eigen::VectorXd& x,
                     std::span<const EventLabel> events, std::span<double> u) {
  const auto m = static_cast<std::size_t>(plan.num_controls);
  const auto take = [&](int interval) { std::copy_n(plan.control.begin() + interval * m, m, u.begin()); };
  take(k);
  const int planned = plan.phases[k], phase = static_cast<int>(events.size());
  if (gains.empty() || std::abs(phase - planned) > 1 || events.size() > plan.events.size() ||
      !std::equal(events.begin(), events.end(), plan.events.begin())) {
    return false;
  }
  const Eigen::VectorXd* reference = &plan.states[k];
  int interval = k;
  if (phase != planned) {
    const Plan::Branch& branch = phase < planned ? plan.late[phase] : plan.early[planned];
    const int at = k - branch.first;
    if (at < 0 || at >= static_cast<int>(branch.states.size())) return false;
    reference = &branch.states[at];
    // The last interval that begins in this phase, or the first.
    const auto range = std::equal_range(plan.phases.begin(), plan.phases.end() - 1, phase);
    if (range.first == range.second) return false;
    interval = static_cast<int>((phase < planned ? range.second - 1 : range.first) - plan.phases.begin());
  }
  if (reference->size() != x.size() || gains[interval].cols() != x.size()) return false;
  take(interval);
  Eigen::Map<Eigen::VectorXd>(u.data(), u.size()) -= gains[interval] * (x - *reference);
  return true;
}

std::unique_ptr<Plant> MakePlant(const HybridSystem& system, const HybridInput& input, int steps_per_interval) {
  return std::make_unique<HybridPlant>(system, input, steps_per_interval);
}

std::unique_ptr<Plant> MakePlant(std::unique_ptr<Simulator> simulator) {
  return std::make_unique<ScenePlant>(std::move(simulator));
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
    bool ok = false, as_planned = false;
    double loss = 0;
    Eigen::VectorXd final_state;
  };
  std::vector<Outcome> outcomes(options.samples);
  ParallelFor(threads, options.samples, [&](int thread, int sample) {
    if (!plants[thread]) plants[thread] = make_plant();
    const ClosedLoopRun run = RunWith(plan, gains, roots, SeedOf(options.seed, sample), plants[thread].get());
    outcomes[sample] = {run.ok, run.as_planned, run.ok && loss ? loss(run) : 0.0, run.final_state};
  });
  // Sums in the order of the samples, so that they do not depend on threads.
  const Eigen::VectorXd& planned = plan.states.back();
  const Eigen::Index n = planned.size();
  MonteCarlo out;
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(n);
  Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(n, n);
  double losses = 0;
  int ran = 0;
  for (const Outcome& outcome : outcomes) {
    if (!outcome.ok) {
      ++out.failed;
      continue;
    }
    ++ran;
    losses += outcome.loss;
    if (!outcome.as_planned) ++out.otherwise;
    if (outcome.final_state.size() != n) continue;
    ++out.counted;
    const Eigen::VectorXd error = outcome.final_state - planned;
    sum += error;
    squares += error * error.transpose();
  }
  if (out.counted > 1) {
    out.mean = planned + sum / out.counted;
    out.covariance = (squares - sum * sum.transpose() / out.counted) / (out.counted - 1);
  }
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
