#include "optimality/design_gradient.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

#include "base/statistics.h"
#include "control/design_difference.h"
#include "saltus/control/objective.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"
#include "simulate/flight.h"

namespace saltus {
namespace {

// Returns the initial state with the fixed discs at their positions in the scene.
std::vector<double> InitialIn(const Scene& scene, std::vector<double> initial) {
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (scene.bodies[i].fixed) std::copy_n(scene.bodies[i].position.data(), 2, &initial[4 * i]);
  }
  return initial;
}

// Exact simulations of a control whose interval boundaries follow the impacts on them, if `follow`.
class FollowingRuns {
 public:
  FollowingRuns(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                const std::vector<double>& durations, bool follow, const ExactRun& run,
                const std::vector<ConstraintCertificate>& constraints, const StopRequest& stop)
      : scene_(scene),
        initial_(initial),
        control_(control),
        durations_(durations),
        run_(run),
        constraints_(constraints),
        stop_(stop) {
    for (const double length : durations) nodes_.push_back(nodes_.back() + length);
    for (std::size_t k = 0; k < run.events.size() && follow; ++k) {
      const auto at = std::min_element(nodes_.begin(), nodes_.end(), [&](double a, double b) {
        return std::abs(a - run.events[k].time) < std::abs(b - run.events[k].time);
      });
      const bool inside = at != nodes_.begin() && at + 1 != nodes_.end();
      if (inside && std::abs(*at - run.events[k].time) <= kOnNode * nodes_.back()) {
        follows_.emplace_back(k, at - nodes_.begin());
      }
    }
  }

  // Returns the Lagrangian at other values of the design parameters; without constraints it is the loss. Empty if the
  // impacts differ from those at the given values.
  std::vector<double> LagrangianAt(const std::vector<double>& values) const {
    const Scene designed = WithDesign(scene_, values);
    const std::vector<double> initial = InitialIn(designed, initial_);
    std::vector<double> nodes = nodes_, lengths = durations_;
    for (int i = 0; i < kMostRuns; ++i) {
      const ExactRun run = SimulateExactly(designed, initial, control_, lengths, stop_);
      if (!run.ok || run.contacts != run_.contacts) return {};
      double moved = 0;
      for (const auto& [event, node] : follows_) {
        moved = std::max(moved, std::abs(nodes[node] - run.events[event].time));
        nodes[node] = run.events[event].time;
      }
      if (moved <= kSettled * nodes_.back()) return {run.loss + SumOfConstraints(designed, initial, lengths, run)};
      for (std::size_t k = 0; k < lengths.size(); ++k) {
        lengths[k] = nodes[k + 1] - nodes[k];
        if (!(lengths[k] > 0)) return {};
      }
    }
    return {};
  }

 private:
  static constexpr double kOnNode = 1e-8, kSettled = 1e-15;  // of the duration
  static constexpr int kMostRuns = 20;

  // Returns the sum of multipliers times the terminal equality constraints and hard waypoints.
  double SumOfConstraints(const Scene& designed, const std::vector<double>& initial, const std::vector<double>& lengths,
                          const ExactRun& run) const {
    if (constraints_.empty()) return 0;
    const Flight flight(designed, initial, control_, lengths, run);
    double sum = 0;
    std::size_t next = 0;
    const auto add = [&](const auto& term, const DiscStates& at) {
      using Quantity = TerminalTerm::Quantity;
      Vec2d quantity(0, 0);
      if (term.quantity == Quantity::kPosition) quantity = at.p[term.body];
      if (term.quantity == Quantity::kVelocity) quantity = at.v[term.body];
      if (term.quantity == Quantity::kAngle) quantity[0] = at.angle[term.body];
      if (term.quantity == Quantity::kAngularVelocity) quantity[0] = at.spin[term.body];
      sum += Dot(constraints_[next++].multiplier, quantity);
    };
    for (const bool region : {false, true}) {
      for (const TerminalTerm& term : designed.objective.terminal) {
        if (term.hard && term.region.has_value() == region) add(term, flight.end());
      }
      for (const ViaTerm& term : designed.objective.via) {
        if (term.hard && !region) add(term, flight.Before(term.time));
      }
    }
    for (const SpeedLimit& limit : designed.objective.limits) {
      if (limit.at != SpeedLimit::At::kEnd) continue;
      sum += constraints_[next++].multiplier[0] * flight.end().v[limit.body].squaredNorm() / (2 * limit.max);
    }
    return sum;
  }

  const Scene& scene_;
  const std::vector<double>&initial_, &control_, &durations_;
  const ExactRun& run_;
  const std::vector<ConstraintCertificate>& constraints_;
  const StopRequest& stop_;
  std::vector<double> nodes_ = {0};
  std::vector<std::pair<std::size_t, std::size_t>> follows_;  // events, and the nodes that move with them
};

bool HasPathCosts(const Objective& objective) {
  return objective.duration || !objective.running.empty() || !objective.via.empty();
}

// Returns the number of constraints but those by limits that always hold.
std::size_t NumConstraints(const Objective& objective) {
  const auto hard = [](const auto& term) { return term.hard; };
  const auto at_end = [](const SpeedLimit& limit) { return limit.at == SpeedLimit::At::kEnd; };
  return std::ranges::count_if(objective.terminal, hard) + std::ranges::count_if(objective.via, hard) +
         std::ranges::count_if(objective.limits, at_end);
}

}  // namespace

DesignGradient GradientByDesign(const Scene& scene, const std::vector<double>& initial,
                                const std::vector<double>& control, const std::vector<double>& durations,
                                const std::vector<ConstraintCertificate>& constraints, const StopRequest& stop) {
  DesignGradient gradient;
  const auto refuse = [&](const std::string& why) {
    gradient.reason = why;
    return gradient;
  };
  if (constraints.size() > NumConstraints(scene.objective)) {
    return refuse(
        "the derivatives by parameters are not computed where a limit is active before the end: give the parameters "
        "values, or the limit at: end");
  }
  if (constraints.size() != NumConstraints(scene.objective)) {
    return refuse("the derivatives by parameters of a loss with constraints need the multipliers of these");
  }
  const ExactRun run = SimulateExactly(scene, initial, control, durations, stop);
  if (!run.ok) return refuse(run.reason);
  gradient.ambiguous = run.ambiguous;
  if (!run.ambiguous.empty()) return refuse(TiesToString(run.ambiguous));
  if (!run.only_impacts) return refuse("discs rest on or graze each other or a wall");

  Scene rolled = scene;
  if (scene.num_controlled() > 0) rolled.steps = static_cast<int>(control.size()) / scene.control_width();
  const std::unique_ptr<Simulator> simulator = MakeSimulator(Contact(ExactModel()->name), rolled, Precision::kDouble);
  const std::vector<double> end = ToState(run.end, scene.num_bodies());
  std::vector<double> costate(end.size());
  TerminalGradient(scene.objective, end, simulator->body_size(), costate);
  // In natural units costates are about 1, but they vanish with a loss that reaches zero.
  gradient.costate = std::max(1.0, Largest(costate));
  for (const ConstraintCertificate& constraint : constraints) {
    gradient.costate = std::max(gradient.costate, constraint.multiplier.cwiseAbs().maxCoeff());
  }
  if (durations.empty() && constraints.empty() && !HasPathCosts(scene.objective)) {
    simulator->set_stop(stop);
    if (!simulator->Rollout(initial, control)) return refuse(simulator->WhyFailed());
    Sensitivity all;
    simulator->Adjoint(costate, /*with_parameters=*/true, &all);
    gradient.by = std::move(all.parameters.design);
    gradient.initial = std::move(all.initial);
    gradient.costate = std::max(gradient.costate, Largest(gradient.initial));
  } else {
    std::vector<double> lengths = durations;
    if (lengths.empty()) lengths.assign(rolled.steps, scene.duration / rolled.steps);
    const FollowingRuns runs(scene, initial, control, lengths, !durations.empty(), run, constraints, stop);
    for (std::size_t i = 0; i < scene.design.size(); ++i) {
      const std::vector<double> by = DifferenceByDesign(
          scene, DesignOf(scene), i, [&](const std::vector<double>& values) { return runs.LagrangianAt(values); });
      if (by.empty()) return refuse("the impacts change with " + NameOf(scene.design[i].parameter, scene));
      gradient.by.push_back(by[0]);
    }
  }
  if (stop && stop()) return refuse(kStopped);
  if (!std::ranges::all_of(gradient.by, [](double by) { return std::isfinite(by); })) {
    return refuse("a derivative by a parameter is not finite");
  }
  return gradient;
}

void JudgeParameters(const Scene& scene, const std::vector<double>& by, double costate, Certificate* certificate) {
  double worst = certificate->initial.value_or(0);
  std::string of = "initial state";
  for (std::size_t i = 0; i < scene.design.size(); ++i) {
    const SceneParameter& parameter = scene.design[i].parameter;
    ParameterCertificate entry{parameter, NameOf(parameter, scene), ValueOf(parameter, scene)};
    entry.derivative = by[i];
    const ParameterRange range = RangeOf(scene.design[i]);
    const bool held =
        (entry.value <= range.min && entry.derivative > 0) || (entry.value >= range.max && entry.derivative < 0);
    if (!held) entry.residual = std::abs(entry.derivative) / costate;
    if (!(entry.residual <= worst)) {
      worst = entry.residual;
      of = entry.name;
    }
    certificate->parameters.push_back(std::move(entry));
  }
  if (!(worst <= kCertificateTolerance) && certificate->IsStationary()) {
    certificate->verdict = Certificate::Verdict::kNotStationary;
    certificate->reason = "the largest residual is that of the derivative by " + of;
  }
}

}  // namespace saltus
