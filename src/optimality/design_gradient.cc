#include "optimality/design_gradient.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include "saltus/control/objective.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/registry.h"

namespace saltus {
namespace {

double LargestOf(const std::vector<double>& numbers) {
  double largest = 0;
  for (const double number : numbers) largest = std::max(largest, std::abs(number));
  return largest;
}

// The initial state with the fixed discs where the scene has them.
std::vector<double> InitialIn(const Scene& scene, std::vector<double> initial) {
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (scene.bodies[i].fixed) std::copy_n(scene.bodies[i].position.data(), 2, &initial[4 * i]);
  }
  return initial;
}

// Exact simulations of a control whose interval boundaries follow the impacts on them.
class FollowingRuns {
 public:
  FollowingRuns(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                const std::vector<double>& durations, const ExactRun& run, const StopRequest& stop)
      : scene_(scene), initial_(initial), control_(control), durations_(durations), run_(run), stop_(stop) {
    nodes_ = NodesOf(durations);
    for (std::size_t k = 0; k < run.events.size(); ++k) {
      const auto at = std::min_element(nodes_.begin(), nodes_.end(), [&](double a, double b) {
        return std::abs(a - run.events[k].time) < std::abs(b - run.events[k].time);
      });
      const bool inside = at != nodes_.begin() && at + 1 != nodes_.end();
      if (inside && std::abs(*at - run.events[k].time) <= kOnNode * nodes_.back()) {
        follows_.emplace_back(k, at - nodes_.begin());
      }
    }
  }

  // The loss with other values of the design parameters; nothing if the impacts are not the same then.
  std::optional<double> LossAt(const std::vector<double>& values) const {
    const Scene designed = WithDesign(scene_, values);
    const std::vector<double> initial = InitialIn(designed, initial_);
    std::vector<double> nodes = nodes_, lengths = durations_;
    for (int i = 0; i < kMostRuns; ++i) {
      const ExactRun run = SimulateExactly(designed, initial, control_, lengths, stop_);
      if (!run.ok || run.contacts != run_.contacts) return std::nullopt;
      double moved = 0;
      for (const auto& [event, node] : follows_) {
        moved = std::max(moved, std::abs(nodes[node] - run.events[event].time));
        nodes[node] = run.events[event].time;
      }
      if (moved <= kSettled * nodes_.back()) return run.loss;
      for (std::size_t k = 0; k < lengths.size(); ++k) {
        lengths[k] = nodes[k + 1] - nodes[k];
        if (!(lengths[k] > 0)) return std::nullopt;
      }
    }
    return std::nullopt;
  }

 private:
  static constexpr double kOnNode = 1e-8, kSettled = 1e-15;  // of the duration
  static constexpr int kMostRuns = 20;

  static std::vector<double> NodesOf(const std::vector<double>& durations) {
    std::vector<double> nodes = {0};
    for (const double length : durations) nodes.push_back(nodes.back() + length);
    return nodes;
  }

  const Scene& scene_;
  const std::vector<double>&initial_, &control_, &durations_;
  const ExactRun& run_;
  const StopRequest& stop_;
  std::vector<double> nodes_;
  std::vector<std::pair<std::size_t, std::size_t>> follows_;  // events, and the nodes that move with them
};

// Of a parameter, in natural units: by which it is changed for a difference.
double WidthOf(const SceneParameter& parameter, double value) {
  constexpr double kWidth = 3e-4;
  return parameter.kind == SceneParameter::Kind::kMass ? kWidth * value : kWidth;
}

std::optional<double> Difference(const FollowingRuns& runs, std::vector<double> values, std::size_t i, double width,
                                 const ParameterRange& range) {
  struct Rule {
    std::array<int, 5> nodes;
    std::array<double, 5> weights;
  };
  static constexpr Rule kRules[] = {
      {{-2, -1, 1, 2, 2}, {1. / 12, -8. / 12, 8. / 12, -1. / 12, 0}},
      {{0, 1, 2, 3, 4}, {-25. / 12, 4, -3, 4. / 3, -1. / 4}},
      {{0, -1, -2, -3, -4}, {25. / 12, -4, 3, -4. / 3, 1. / 4}},
  };
  const double at = values[i];
  for (const Rule& rule : kRules) {
    double sum = 0;
    bool applies = true;
    for (std::size_t j = 0; j < rule.nodes.size() && applies; ++j) {
      if (rule.weights[j] == 0) continue;
      values[i] = at + rule.nodes[j] * width;
      const bool within = values[i] >= range.min && values[i] <= range.max;
      const std::optional<double> loss = within ? runs.LossAt(values) : std::nullopt;
      applies = loss.has_value();
      if (applies) sum += rule.weights[j] * *loss;
    }
    if (applies) return sum / width;
  }
  return std::nullopt;
}

bool HasPathCosts(const Objective& objective) {
  return objective.duration || !objective.running.empty() || !objective.via.empty();
}

std::vector<double> TerminalCostate(const Scene& scene, const std::vector<double>& end, int body_size) {
  std::vector<double> costate(end.size());
  TerminalGradient(scene.objective, end, body_size, costate);
  return costate;
}

}  // namespace

DesignGradient GradientByDesign(const Scene& scene, const std::vector<double>& initial,
                                const std::vector<double>& control, const std::vector<double>& durations,
                                const StopRequest& stop) {
  DesignGradient gradient;
  const auto refuse = [&](const std::string& why) {
    gradient.reason = why;
    return gradient;
  };
  if (scene.objective.HasConstraints())
    return refuse("terminal equality constraints have no derivatives by parameters");
  const ExactRun run = SimulateExactly(scene, initial, control, durations, stop);
  if (!run.ok) return refuse(run.reason);
  gradient.ambiguous = run.ambiguous;
  if (!run.ambiguous.empty()) return refuse(TiesToString(run.ambiguous));
  if (!run.only_impacts) return refuse("discs rest on or graze each other or a wall");

  Scene rolled = scene;
  if (scene.num_controlled() > 0) rolled.steps = static_cast<int>(control.size()) / scene.control_width();
  const std::unique_ptr<Simulator> simulator = MakeSimulator(Contact(ExactModel()->name), rolled, Precision::kDouble);
  const std::vector<double> costate =
      TerminalCostate(scene, ToState(run.end, scene.num_bodies()), simulator->body_size());
  gradient.costate = LargestOf(costate);
  if (durations.empty()) {
    if (HasPathCosts(scene.objective)) return refuse("path costs and a free duration have no adjoint by parameters");
    simulator->set_stop(stop);
    if (!simulator->Rollout(initial, control)) return refuse(simulator->WhyFailed());
    Sensitivity all;
    simulator->Adjoint(costate, /*with_parameters=*/true, &all);
    gradient.by = std::move(all.parameters.design);
    gradient.initial = std::move(all.initial);
    gradient.costate = std::max(gradient.costate, LargestOf(gradient.initial));
  } else {
    const FollowingRuns runs(scene, initial, control, durations, run, stop);
    const std::vector<double> values = DesignOf(scene);
    for (std::size_t i = 0; i < values.size(); ++i) {
      DesignParameter natural = scene.design[i];  // its own bounds do not matter here
      natural.min = natural.max = std::nullopt;
      const std::optional<double> by =
          Difference(runs, values, i, WidthOf(natural.parameter, values[i]), RangeOf(natural));
      if (!by) return refuse("the impacts change with " + NameOf(natural.parameter, scene));
      gradient.by.push_back(*by);
    }
  }
  if (stop && stop()) return refuse(kStopped);
  if (!std::ranges::all_of(gradient.by, [](double by) { return std::isfinite(by); })) {
    return refuse("a derivative by a parameter is not finite");
  }
  return gradient;
}

}  // namespace saltus
