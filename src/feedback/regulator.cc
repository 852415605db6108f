#include "saltus/feedback/regulator.h"

#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "base/linear_algebra.h"
#include "feedback/noisy_states.h"
#include "hybrid/runge_kutta.h"

namespace saltus {
namespace {

constexpr int kMostSubsteps = 1 << 12;  // of a step of the motion, for the Riccati equation

const Eigen::MatrixXd& WeightOf(const TrackingCost& cost, int mode, Eigen::Index size) {
  const Eigen::MatrixXd& Q = cost.Q[cost.Q.size() == 1 ? 0 : mode];
  CHECK(Q.rows() == size && Q.cols() == size) << "Q has another size than the state";
  return Q;
}

// The flow of a mode and the Hamiltonian system [A -B R^-1 B'; -Q -A'] along it.
class Hamiltonian {
 public:
  Hamiltonian(const HybridSystem& system, const HybridInput& input, const TrackingCost& cost)
      : system_(system), input_(input), cost_(cost), R_(cost.R) {
    CHECK(R_.ok()) << "R is not positive definite";
  }

  // The transition matrix over a step in so many substeps.
  Eigen::MatrixXd Transition(const FlowStep& step, int substeps) {
    const int n = system_.state_size(step.mode);
    Eigen::VectorXd x = Eigen::Map<const Eigen::VectorXd>(step.x, n);
    Eigen::MatrixXd M = Eigen::MatrixXd::Identity(2 * n, 2 * n);
    const double h = step.h / substeps;
    using cooper_verner::kStages;
    std::array<Eigen::VectorXd, kStages> slopes;
    std::array<Eigen::MatrixXd, kStages> changes;
    for (int i = 0; i < substeps; ++i) {
      const auto combine = [&](int row, Eigen::VectorXd* stage, Eigen::MatrixXd* matrix) {
        *stage = x;
        *matrix = M;
        for (int j = 0; j < cooper_verner::kRows[row].count; ++j) {
          const cooper_verner::Term& term = cooper_verner::kRows[row].terms[j];
          *stage += h * term.factor * slopes[term.stage];
          *matrix += h * term.factor * changes[term.stage];
        }
      };
      Eigen::VectorXd stage;
      Eigen::MatrixXd matrix;
      for (int s = 0; s < kStages; ++s) {
        combine(s, &stage, &matrix);
        Evaluate(step, step.t + (i + cooper_verner::kC[s]) * h, stage, &slopes[s]);
        changes[s] = Multiply(matrix_, matrix);
      }
      combine(kStages, &stage, &matrix);
      x = stage;
      M = matrix;
    }
    return M;
  }

  Eigen::MatrixXd Gain(const FlowStep& at, const Eigen::MatrixXd& S) {
    Eigen::VectorXd slope;
    Evaluate(at, at.t, Eigen::Map<const Eigen::VectorXd>(at.x, system_.state_size(at.mode)), &slope);
    return R_.Solve(MultiplyTransposed(B_, S));
  }

 private:
  void Evaluate(const FlowStep& step, double t, const Eigen::VectorXd& x, Eigen::VectorXd* slope) {
    const Eigen::Index n = x.size(), m = system_.num_controls();
    RowMajor jacobian(n, n + 1 + system_.num_parameters() + m);
    slope->resize(n);
    system_.functions().FlowJacobian({step.mode, t, x.data(), step.u, step.p}, slope->data(), jacobian.data());
    B_ = jacobian.rightCols(m);
    matrix_.resize(2 * n, 2 * n);
    matrix_ << jacobian.leftCols(n), -Multiply(B_, R_.Solve(B_.transpose())),
        -WeightOf(cost_, system_.functions().BaseMode(step.mode), n), -jacobian.leftCols(n).transpose();
  }

  const HybridSystem& system_;
  const HybridInput& input_;
  const TrackingCost& cost_;
  const CholeskySolver R_;
  Eigen::MatrixXd B_, matrix_;
};

std::string NameOf(const HybridSystem& system, int mode, int guard) {
  return "guard '" + system.GuardName(mode, guard) + "' in mode '" + system.ModeName(mode) + "'";
}

// The guards of a motion at times within its control intervals, and their derivatives by state and control there.
class GuardsWithin {
 public:
  GuardsWithin(const HybridSimulator& motion, const HybridInput& input, const std::vector<HybridTie>& ties)
      : motion_(motion),
        system_(motion.system()),
        input_(input),
        times_(input.Times()),
        ties_(ties),
        gradient_(system_.functions().most_states() + 1 + system_.num_parameters() + system_.num_controls()) {}

  // Adds guards that reach zero at the time of the event of another one, and with it; guards that touch zero and
  // return; and, of systems whose modes are known, guards where they are least between two events, or at the end.
  void Add(int k, LinearInterval* interval) {
    const auto within = [&](double time) { return time > times_[k] && time <= times_[k + 1]; };
    for (const HybridTie& tie : ties_) {
      if (!within(tie.time)) continue;
      const auto& events = motion_.events();
      const auto first = std::ranges::find_if(
          events, [&](const HybridEvent& event) { return event.time == tie.time && event.mode == tie.mode; });
      if (first == events.end()) continue;
      for (const int guard : tie.guards) {
        if (guard == first->guard) continue;
        AddOne(k,
               tie.time,
               tie.mode,
               guard,
               " at the event of " + NameOf(system_, tie.mode, first->guard),
               first->guard,
               interval);
      }
    }
    for (const HybridGrazing& grazing : motion_.grazings()) {
      if (within(grazing.time)) AddOne(k, grazing.time, grazing.mode, grazing.guard, "", -1, interval);
    }
    if (system_.functions().CreatesModes()) return;
    AddLeastOnes(k, interval);
    if (k + 1 < input_.num_intervals) return;
    for (int guard = 0; guard < system_.num_guards(motion_.final_mode()); ++guard) {
      if (!system_.functions().IsSwitch(motion_.final_mode(), guard))
        AddOne(k, times_.back(), motion_.final_mode(), guard, " at the end", -1, interval);
    }
  }

 private:
  const double* ControlOf(int k) const {
    return input_.control.empty() ? none_.data()
                                  : &input_.control[static_cast<std::size_t>(k) * system_.num_controls()];
  }

  // Adds minima between the steps of the interval, of guards that fall and rise in one mode without an event.
  void AddLeastOnes(int k, LinearInterval* interval) {
    std::vector<GuardValue> before, now;
    std::vector<double> slope;
    for (int i = 0; i < motion_.num_steps(); ++i) {
      const double t = motion_.StepTime(i);
      if (t < times_[k] || t > times_[k + 1]) continue;
      const int mode = motion_.StepMode(i);
      const bool goes_on = i > 0 && !before.empty() && motion_.StepMode(i - 1) == mode && !motion_.IsReset(i - 1);
      slope.resize(system_.state_size(mode));
      now.resize(system_.num_guards(mode));
      const ModePoint at{mode, t, motion_.StepState(i).data(), ControlOf(k), input_.parameters.data()};
      system_.functions().Flow(at, slope.data());
      system_.functions().GuardRates(at, slope.data(), now.data());
      for (int guard = 0; goes_on && !motion_.IsReset(i) && guard < system_.num_guards(mode); ++guard) {
        const GuardValue &a = before[guard], &b = now[guard];
        if (system_.functions().IsSwitch(mode, guard) || !(a.rate < 0 && b.rate >= 0 && a.value > 0 && b.value > 0))
          continue;
        const double from = motion_.StepTime(i - 1);
        AddOne(k, from + (t - from) * a.rate / (a.rate - b.rate), mode, guard, "", -1, interval);
      }
      std::swap(before, now);
    }
  }

  // Adds a guard at a time, or at the event of another guard, which moves.
  void AddOne(int k, double time, int mode, int guard, const std::string& where, int other, LinearInterval* interval) {
    constexpr double kBefore = 1e-9;  // of the time since the beginning: events there have not happened
    const std::span<const double> x = k == 0 ? std::span<const double>(input_.initial) : motion_.StateAt(k);
    HybridInput input{.mode = k == 0 ? input_.mode : motion_.ModeAt(k),
                      .initial = {x.begin(), x.end()},
                      .parameters = input_.parameters,
                      .duration = (time - times_[k]) * (1 - kBefore)};
    input.control.assign(ControlOf(k), ControlOf(k) + system_.num_controls());
    input.begin = times_[k];
    if (!(input.duration > 0)) return;
    HybridOptions options = motion_.StepsBetween(input.begin, input.begin + input.duration);
    options.wait_behind_guards = true;
    HybridSimulator part(system_, options);
    if (!part.Rollout(input) || part.final_mode() != mode) return;
    const HybridSensitivity by = part.Sensitivity();
    const int n = system_.state_size(mode), m = system_.num_controls(), first = static_cast<int>(x.size());
    const Eigen::Map<const RowMajor> all(by.final_state.data(), n, by.columns);
    const ModePoint at{mode, time, part.final_state().data(), ControlOf(k), input_.parameters.data()};
    const auto change_of = [&](int of, Eigen::RowVectorXd* by_state, Eigen::RowVectorXd* by_control) {
      const double value = system_.functions().GuardGradient(at, of, gradient_.data());
      const Eigen::Map<const Eigen::RowVectorXd> by_x(gradient_.data(), n),
          by_u(gradient_.data() + n + 1 + system_.num_parameters(), m);
      *by_state = by_x * all.leftCols(first);
      *by_control = by_x * all.middleCols(first, m) + by_u;
      return value;
    };
    LinearGuard found{.name = NameOf(system_, mode, guard) + where, .time = time};
    found.value = std::max(change_of(guard, &found.by_state, &found.by_control), 0.0);
    if (other >= 0) {
      std::vector<double> slope(n);
      Eigen::RowVectorXd by_state, by_control;
      system_.functions().Flow(at, slope.data());
      double rate = 0, of_other = 0;
      system_.functions().GuardRate(at, guard, slope.data(), &rate);
      system_.functions().GuardRate(at, other, slope.data(), &of_other);
      change_of(other, &by_state, &by_control);
      found.by_state -= rate / of_other * by_state;
      found.by_control -= rate / of_other * by_control;
      found.value = 0;
    }
    interval->guards.push_back(std::move(found));
  }

  const HybridSimulator& motion_;
  const HybridSystem& system_;
  const HybridInput& input_;
  const std::vector<double> times_, none_ = std::vector<double>(1 + system_.num_controls());
  const std::vector<HybridTie>& ties_;
  std::vector<double> gradient_;
};

Eigen::MatrixXd Symmetric(const Eigen::MatrixXd& S) { return 0.5 * (S + S.transpose()); }

}  // namespace

LinearMotion Linearize(HybridSimulator& motion, const HybridInput& input) {
  const HybridSystem& system = motion.system();
  const int num_controls = system.num_controls();
  const std::vector<double> times = input.Times(), zeros(num_controls);
  const std::vector<HybridSensitivity> sensitivities = motion.IntervalSensitivities();
  GuardsWithin within(motion, input, motion.ties());
  LinearMotion linear;
  linear.end = times.back();
  std::size_t event = 0;
  for (int k = 0; k < input.num_intervals; ++k) {
    const HybridSensitivity& by = sensitivities[k];
    LinearInterval interval;
    interval.begin = times[k];
    interval.mode = k == 0 ? input.mode : motion.ModeAt(k);
    const int n = by.columns - num_controls;
    const Eigen::Map<const RowMajor> end(by.final_state.data(), by.final_state.size() / by.columns, by.columns);
    interval.A = end.leftCols(n);
    interval.B = end.rightCols(num_controls);
    // These guards do not end the interval by an event in the plan, but with noise they may.
    std::vector<char> fires(system.num_guards(interval.mode));
    const std::size_t first = event;
    for (const std::vector<double>& time : by.times) {
      const HybridEvent& happened = motion.events()[event++];
      const Eigen::Map<const Eigen::RowVectorXd> row(time.data(), by.columns);
      interval.events.push_back({.time = happened.time,
                                 .name = NameOf(system, happened.mode, happened.guard),
                                 .by_state = row.head(n),
                                 .by_control = row.tail(num_controls),
                                 .immediate = happened.immediate});
    }
    // The guard of the event that ends the phase goes to zero as planned; that of the event before comes from zero.
    const auto planned = [&](std::size_t i, int guard) {
      return i < motion.events().size() && motion.events()[i].mode == interval.mode &&
             motion.events()[i].guard == guard;
    };
    const double* u = input.control.empty() ? zeros.data() : &input.control[static_cast<std::size_t>(k) * num_controls];
    const std::span<const double> x = k == 0 ? std::span<const double>(input.initial) : motion.StateAt(k);
    std::vector<double> gradient(n + 1 + system.num_parameters() + num_controls);
    for (int guard = 0; guard < system.num_guards(interval.mode); ++guard) {
      if (planned(first, guard) || (first > 0 && planned(first - 1, guard))) continue;
      const ModePoint at{interval.mode, interval.begin, x.data(), u, input.parameters.data()};
      const double value = system.functions().GuardGradient(at, guard, gradient.data());
      if (!(value > 0)) continue;
      interval.guards.push_back({.name = NameOf(system, interval.mode, guard),
                                 .time = interval.begin,
                                 .value = value,
                                 .by_state = Eigen::Map<const Eigen::RowVectorXd>(gradient.data(), n),
                                 .by_control = Eigen::Map<const Eigen::RowVectorXd>(
                                     gradient.data() + gradient.size() - num_controls, num_controls)});
    }
    within.Add(k, &interval);
    interval.mode = system.functions().BaseMode(interval.mode);
    linear.intervals.push_back(std::move(interval));
  }
  return linear;
}

std::string Validate(const TrackingCost& cost, const HybridSimulator& motion) {
  const HybridSystem& system = motion.system();
  const auto count = static_cast<int>(cost.Q.size());
  if (count != 1 && count != system.functions().num_base_modes()) {
    return "Q: found " + std::to_string(count) + " matrices, expected 1 or one for each of " +
           std::to_string(system.functions().num_base_modes()) + " modes";
  }
  for (int i = 0; i < motion.num_steps(); ++i) {
    const int mode = motion.StepMode(i);
    if (i > 0 && mode == motion.StepMode(i - 1)) continue;
    const std::string wrong = ValidateSymmetric(
        cost.Q[count == 1 ? 0 : system.functions().BaseMode(mode)], system.state_size(mode), /*definite=*/false);
    if (!wrong.empty()) return "Q of mode '" + system.ModeName(mode) + "': " + wrong;
  }
  if (std::string wrong = ValidateSymmetric(cost.R, system.num_controls(), /*definite=*/true); !wrong.empty()) {
    return "R: " + wrong;
  }
  const std::string wrong = ValidateSymmetric(cost.QT, system.state_size(motion.final_mode()), /*definite=*/false);
  return wrong.empty() ? "" : "QT: " + wrong;
}

std::string Validate(const Regulator& regulator, const LinearMotion& motion) {
  if (regulator.gains.size() != motion.intervals.size()) {
    return "gains: found " + std::to_string(regulator.gains.size()) + ", expected one for each of " +
           std::to_string(motion.intervals.size()) + " intervals";
  }
  for (std::size_t k = 0; k < regulator.gains.size(); ++k) {
    const LinearInterval& at = motion.intervals[k];
    if (regulator.gains[k].rows() == at.B.cols() && regulator.gains[k].cols() == at.A.cols()) {
      if (regulator.gains[k].allFinite()) continue;
      return "gains: that of interval " + std::to_string(k) + " has a number that is not finite";
    }
    return "gains: that of interval " + std::to_string(k) + " has another shape than " + std::to_string(at.B.cols()) +
           " x " + std::to_string(at.A.cols());
  }
  return "";
}

Regulator Track(const LinearMotion& motion, const TrackingCost& cost) {
  const auto K = static_cast<int>(motion.intervals.size());
  const auto begin_of = [&](int k) { return k < K ? motion.intervals[k].begin : motion.end; };
  Regulator regulator;
  regulator.gains.resize(K);
  regulator.closed_loop.resize(K);
  regulator.cost_to_go.resize(K + 1);
  regulator.cost_to_go[K] = cost.QT;
  for (int k = K - 1; k >= 0; --k) {
    const LinearInterval& at = motion.intervals[k];
    const Eigen::MatrixXd& S = regulator.cost_to_go[k + 1];
    CHECK(S.rows() == at.A.rows()) << "QT has another size than the final state";
    const double weight = cost.per_time ? begin_of(k + 1) - at.begin : 1;
    regulator.gains[k] = Eigen::MatrixXd::Zero(at.B.cols(), at.A.cols());
    if (weight > 0) {
      const Eigen::MatrixXd SB = Multiply(S, at.B);
      const CholeskySolver factors(weight * cost.R + MultiplyTransposed(at.B, SB));
      if (!factors.ok()) return {};
      regulator.gains[k] = factors.Solve(MultiplyTransposed(SB, at.A));
      if (!regulator.gains[k].allFinite()) return {};
    }
    regulator.closed_loop[k] = at.A - Multiply(at.B, regulator.gains[k]);
    regulator.cost_to_go[k] = Symmetric(weight * WeightOf(cost, at.mode, at.A.cols()) +
                                        Multiply(MultiplyTransposed(at.A, S), regulator.closed_loop[k]));
  }
  return regulator;
}

Regulator TrackContinuously(const HybridSimulator& motion, const HybridInput& input, const TrackingCost& cost,
                            double tolerance) {
  const HybridSystem& system = motion.system();
  const std::vector<double> zeros(system.num_controls());
  const int K = input.num_intervals, num_steps = motion.num_steps();
  if (std::any_of(motion.events().begin(), motion.events().end(), [](const HybridEvent& e) { return e.immediate; })) {
    return {};
  }
  // The steps of the motion with their controls, and the step with which each interval begins.
  std::vector<FlowStep> steps(num_steps);
  std::vector<int> begins(K + 1, num_steps);
  for (int i = 0, k = -1; i < num_steps; ++i) {
    while (k + 1 < K && motion.StateAt(k + 1).data() == motion.StepState(i).data()) begins[++k] = i;
    const double end = i + 1 < num_steps ? motion.StepTime(i + 1) : input.begin + input.duration;
    const double* u =
        input.control.empty() ? zeros.data() : &input.control[static_cast<std::size_t>(std::max(k, 0)) * zeros.size()];
    const double t = motion.StepTime(i);
    steps[i] = {{motion.StepMode(i), t, motion.StepState(i).data(), u, input.parameters.data()},
                motion.IsReset(i) ? 0 : end - t};
    if (system.functions().Projects(steps[i].mode)) return {};
  }
  begins[0] = 0;
  Hamiltonian hamiltonian(system, input, cost);
  const auto sweep = [&](int substeps) {
    Regulator regulator;
    regulator.gains.resize(K);
    regulator.closed_loop.resize(K);
    regulator.cost_to_go.resize(K + 1);
    regulator.events.resize(motion.events().size());
    Eigen::MatrixXd S = regulator.cost_to_go[K] = cost.QT;
    std::size_t event = motion.events().size();
    for (int k = K - 1; k >= 0; --k) {
      Eigen::MatrixXd transition = Eigen::MatrixXd::Identity(S.rows(), S.rows());
      for (int i = begins[k + 1] - 1; i >= begins[k]; --i) {
        const FlowStep& step = steps[i];
        const int n = system.state_size(step.mode);
        if (motion.IsReset(i)) {
          const HybridEvent& happened = motion.events()[--event];
          Regulator::EventJump& at = regulator.events[event];
          const std::vector<double> xi = SaltationMatrix(system,
                                                         happened.mode,
                                                         happened.guard,
                                                         happened.time,
                                                         happened.before,
                                                         {step.u, zeros.size()},
                                                         input.parameters);
          at.time = happened.time;
          at.saltation = Eigen::Map<const RowMajor>(xi.data(), xi.size() / n, n);
          FlowStep after = step;
          after.mode = happened.next_mode;
          after.x = happened.after.data();
          at.cost_after = S;
          at.gain_after = hamiltonian.Gain(after, S);
          S = at.cost_before = Symmetric(at.saltation.transpose() * S * at.saltation);
          at.gain_before = hamiltonian.Gain(step, S);
          transition = transition * at.saltation;
          continue;
        }
        const Eigen::MatrixXd M = hamiltonian.Transition(step, substeps);
        S = Symmetric(SolveLuColumns(S * M.topRightCorner(n, n) - M.bottomRightCorner(n, n),
                                     M.bottomLeftCorner(n, n) - S * M.topLeftCorner(n, n)));
        transition = transition * (M.topLeftCorner(n, n) + M.topRightCorner(n, n) * S);
      }
      regulator.gains[k] = hamiltonian.Gain(steps[begins[k]], S);
      regulator.cost_to_go[k] = S;
      regulator.closed_loop[k] = transition;
    }
    return regulator;
  };
  Regulator regulator = sweep(1);
  double last = std::numeric_limits<double>::infinity();
  for (int substeps = 2; substeps <= kMostSubsteps; substeps *= 2) {
    Regulator finer = sweep(substeps);
    double error = 0;
    for (int k = 0; k < K; ++k) {
      error = std::max({error,
                        (finer.cost_to_go[k] - regulator.cost_to_go[k]).norm() / finer.cost_to_go[k].norm(),
                        (finer.closed_loop[k] - regulator.closed_loop[k]).norm() / finer.closed_loop[k].norm()});
    }
    regulator = std::move(finer);
    // An error that more steps do not lower is rounding.
    if (error <= tolerance || (error < 1e-7 && error > 0.1 * last)) break;
    last = error;
  }
  return regulator;
}

}  // namespace saltus
