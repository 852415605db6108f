// Gradients by the adjoint, of all models, against two independent ways: forward sensitivities through the steps'
// linearizations, and central differences of the loss where no contact begins or ends within the difference.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <numeric>

#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"
#include "test_scenes.h"

namespace saltus {
namespace {

struct Case {
  std::string model;
  std::string name;
  Scene scene;
};

// Made once, as every process lists the tests, whichever it runs.
const std::vector<Case>& AllCases() {
  static std::vector<Case> cases;
  if (!cases.empty()) return cases;
  const std::vector<std::pair<std::string, Scene>> scenes = {{"bounce_once", ProblemScene("bounce_once")},
                                                             {"bounce_off_the_grid", BounceOffTheGrid()},
                                                             {"launch_off_the_grid", LaunchOffTheGrid()},
                                                             {"two_balls", ProblemScene("two_balls")},
                                                             {"four_discs", FourDiscs(0)},
                                                             {"four_discs_with_friction", FourDiscs(0.3)}};
  for (const ModelTraits& model : AllContactModels()) {
    for (const auto& [name, scene] : scenes) {
      if (!ReasonNotApplicable(model.name, scene).empty()) continue;
      // Models that act at a distance solve for all discs in every step; of many they are tested by their own tests.
      if (model.push_gap > 0 && scene.num_bodies() > 2) continue;
      cases.push_back({std::string(model.name), name, scene});
    }
  }
  return cases;
}

void PrintTo(const Case& c, std::ostream* out) { *out << c.model << " on " << c.name; }

std::string NameOf(const testing::TestParamInfo<Case>& info) { return info.param.model + "_" + info.param.name; }

double Dot(std::span<const double> a, std::span<const double> b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
}

// A control that differs from step to step, and that is not along the line of centres of two discs: where they meet
// without slip, friction has a kink.
std::vector<double> WavyControl(const Scene& scene, int num_steps) {
  std::vector<double> control = InitialControl(scene, num_steps);
  for (size_t i = 0; i < control.size(); ++i) control[i] += (i % 2 == 0 ? 0.15 : -0.1) + 0.02 * std::sin(0.7 * i + 0.3);
  return control;
}

// Everything a loss depends on.
struct Point {
  Scene scene;
  std::vector<double> initial;
  std::vector<double> control;
};

struct Evaluation {
  double loss;
  std::vector<StepTouch> touches;
  Sensitivity gradient;
};

Evaluation Evaluate(const std::string& model, const Point& at, bool with_gradient) {
  auto simulator = MakeSimulator(model, at.scene, Precision::kDouble);
  EXPECT_TRUE(simulator->Rollout(at.initial, at.control));
  std::vector<double> x(simulator->state_size());
  simulator->GetState(simulator->num_steps(), x);
  Evaluation result{TerminalLoss(at.scene.objective, x, simulator->body_size()) +
                        EffortLoss(at.scene.objective, at.control, simulator->step()),
                    simulator->touches(),
                    {}};
  if (!with_gradient) return result;
  std::vector<double> cotangent(x.size());
  TerminalGradient(at.scene.objective, x, simulator->body_size(), cotangent);
  simulator->Adjoint(cotangent, /*with_parameters=*/true, &result.gradient);
  AddEffortGradient(at.scene.objective, at.control, simulator->step(), result.gradient.control);
  return result;
}

bool SameTouches(const std::vector<StepTouch>& a, const std::vector<StepTouch>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const StepTouch& l, const StepTouch& r) {
    return l.step == r.step && l.touch.candidate == r.touch.candidate && l.touch.mode == r.touch.mode;
  });
}

class AdjointOf : public testing::TestWithParam<Case> {
 protected:
  AdjointOf() : model_(GetParam().model), at_{GetParam().scene, InitialState(GetParam().scene), {}} {
    num_steps_ = at_.scene.steps / FindContactModel(model_)->grid_steps;
    at_.control = WavyControl(at_.scene, num_steps_);
  }

  std::string model_;
  Point at_;
  int num_steps_;
};

// ---------------------------------------------------------------------------------------------------------------------
// Forward sensitivities.

struct Direction {
  std::vector<double> initial, control;
};

// One per entry of the initial state, one for all of them, one for all of the control, and some steps of it.
std::vector<Direction> Directions(const Scene& scene, int num_steps) {
  const size_t num_initial = 4 * scene.num_bodies(), num_control = 2 * size_t(scene.num_controlled()) * num_steps;
  const Direction zero{std::vector<double>(num_initial), std::vector<double>(num_control)};
  std::vector<Direction> directions;
  Direction all = zero;
  for (size_t i = 0; i < num_initial; ++i) {
    if (scene.bodies[i / 4].fixed) continue;
    directions.push_back(zero);
    directions.back().initial[i] = 1;
    all.initial[i] = std::cos(1.1 * i);
  }
  for (size_t i = 0; i < num_control; ++i) all.control[i] = std::cos(0.9 * i + 0.2);
  directions.push_back(all);
  for (size_t i = 0; i < num_control; i += num_control / 7 + 1) {
    directions.push_back(zero);
    directions.back().control[i] = 1;
  }
  return directions;
}

// The change of the final state by each direction, through the linearizations of the steps of the last rollout.
std::vector<std::vector<double>> Propagate(const Simulator& simulator, std::span<const double> control,
                                           const std::vector<Direction>& directions) {
  const int body_size = simulator.body_size();
  std::vector<std::vector<double>> dx(directions.size(), std::vector<double>(simulator.state_size()));
  for (size_t d = 0; d < directions.size(); ++d) {
    for (size_t i = 0; i < directions[d].initial.size(); ++i) {
      dx[d][i / 4 * body_size + i % 4] = directions[d].initial[i];
    }
  }
  std::vector<double> x(simulator.state_size()), next(x.size()), force(2 * simulator.num_bodies());
  StepLinearization linearization;
  for (int k = 0; k < simulator.num_steps(); ++k) {
    simulator.GetState(k, x);
    simulator.ExpandForce(control, k, force);
    simulator.Linearize(x, force, /*with_parameters=*/false, &linearization);
    for (size_t d = 0; d < directions.size(); ++d) {
      simulator.ExpandForce(directions[d].control, k, force);
      linearization.Apply(dx[d], force, next);
      dx[d] = next;
    }
  }
  return dx;
}

TEST_P(AdjointOf, EqualsForwardSensitivity) {
  auto simulator = MakeSimulator(model_, at_.scene, Precision::kDouble);
  ASSERT_TRUE(simulator->Rollout(at_.initial, at_.control));
  std::vector<double> x(simulator->state_size()), cotangent(x.size());
  simulator->GetState(num_steps_, x);
  TerminalGradient(at_.scene.objective, x, simulator->body_size(), cotangent);
  Sensitivity gradient;
  simulator->Adjoint(cotangent, /*with_parameters=*/false, &gradient);

  const std::vector<Direction> directions = Directions(at_.scene, num_steps_);
  const std::vector<std::vector<double>> dx = Propagate(*simulator, at_.control, directions);
  for (size_t d = 0; d < directions.size(); ++d) {
    const double forward = Dot(cotangent, dx[d]);
    const double adjoint = Dot(gradient.initial, directions[d].initial) + Dot(gradient.control, directions[d].control);
    double magnitude = 0;
    for (size_t i = 0; i < x.size(); ++i) magnitude += std::abs(cotangent[i] * dx[d][i]);
    // Each step rounds.
    EXPECT_NEAR(adjoint, forward, 4e-15 * num_steps_ * magnitude) << "direction " << d;
  }
}

// ---------------------------------------------------------------------------------------------------------------------
// Differences.

using Move = std::function<void(Point*, double)>;

// A group of derivatives that are compared by the largest among them.
struct Group {
  std::string name;
  std::vector<double> derivatives;
  std::vector<Move> moves;

  void Add(double derivative, Move move) {
    derivatives.push_back(derivative);
    moves.push_back(std::move(move));
  }
};

// All moving discs pushed, the control as it was: to give a disc a constant force.
Point PushAll(const Point& at, int num_steps) {
  Point all = at;
  all.scene.control = {};
  all.control.clear();
  std::map<int, int> place;
  for (int c = 0; c < at.scene.num_controlled(); ++c) place[at.scene.control.bodies[c]] = c;
  for (int i = 0; i < at.scene.num_bodies(); ++i) {
    if (at.scene.bodies[i].fixed) continue;
    all.scene.control.bodies.push_back(i);
    all.scene.control.initial.push_back(Vec2d::Zero());
  }
  for (int k = 0; k < num_steps; ++k) {
    for (int body : all.scene.control.bodies) {
      const size_t from = place.count(body) ? 2 * (size_t(k) * at.scene.num_controlled() + place[body]) : 0;
      for (int j = 0; j < 2; ++j) all.control.push_back(place.count(body) ? at.control[from + j] : 0);
    }
  }
  return all;
}

// Adds `push` to one component of the force on the disc at place `c` in every step.
Move ConstantForce(int c, int axis) {
  return [=](Point* at, double push) {
    for (size_t i = 2 * c + axis; i < at->control.size(); i += 2 * at->scene.num_controlled()) at->control[i] += push;
  };
}

std::vector<Group> StateAndControl(const Scene& scene, const Sensitivity& gradient) {
  Group position{"position", {}, {}}, velocity{"velocity", {}, {}}, control{"control", {}, {}};
  for (int i = 0; i < 4 * scene.num_bodies(); ++i) {
    if (scene.bodies[i / 4].fixed) continue;
    Group& group = i % 4 < 2 ? position : velocity;
    group.Add(gradient.initial[i], [i](Point* at, double step) { at->initial[i] += step; });
  }
  for (size_t i = 0; i < gradient.control.size(); i += gradient.control.size() / 11 + 1) {
    control.Add(gradient.control[i], [i](Point* at, double step) { at->control[i] += step; });
  }
  return {position, velocity, control};
}

std::vector<Group> Parameters(const Scene& scene, const ParameterGradient& gradient) {
  Group restitution{"restitution", {}, {}}, friction{"friction", {}, {}}, stiffness{"stiffness", {}, {}},
      damping{"damping", {}, {}}, gravity{"gravity", {}, {}}, mass{"mass", {}, {}};
  restitution.Add(gradient.restitution, [](Point* at, double step) { at->scene.contact.restitution += step; });
  if (scene.contact.friction > 0) {
    friction.Add(gradient.friction, [](Point* at, double step) { at->scene.contact.friction += step; });
  }
  // In units of 1000 N/m.
  stiffness.Add(1000 * gradient.stiffness, [](Point* at, double step) { at->scene.contact.stiffness += 1000 * step; });
  if (scene.contact.damping > 0) {
    damping.Add(gradient.damping, [](Point* at, double step) { at->scene.contact.damping += step; });
  }
  for (int j = 0; j < 2; ++j) {
    gravity.Add(gradient.gravity[j], [j](Point* at, double step) { at->scene.gravity[j] += step; });
  }
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (scene.bodies[i].fixed) continue;
    mass.Add(gradient.mass[i], [i](Point* at, double step) { at->scene.bodies[i].mass += step; });
  }
  return {restitution, friction, stiffness, damping, gravity, mass};
}

// A central difference of the loss, of fourth order; NaN if what touches changes within it.
double Difference(const std::string& model, const Point& at, const std::vector<StepTouch>& touches, const Move& move,
                  double step) {
  double loss[4];
  const double offsets[4] = {-step, -step / 2, step / 2, step};
  for (int i = 0; i < 4; ++i) {
    Point moved = at;
    move(&moved, offsets[i]);
    const Evaluation evaluation = Evaluate(model, moved, false);
    if (!SameTouches(evaluation.touches, touches)) return std::nan("");
    loss[i] = evaluation.loss;
  }
  return (8 * (loss[2] - loss[1]) - (loss[3] - loss[0])) / (6 * step);
}

struct Numeric {
  double value = std::nan("");
  double error = HUGE_VAL;
};

// The difference over the width at which it depends least on the width, rounding of the loss included: some models are
// smooth on small scales only.
Numeric BestDifference(const std::string& model, const Point& at, const std::vector<StepTouch>& touches,
                       const Move& move) {
  // The rounding error of a loss of order one, after hundreds of steps.
  const double rounding = std::max(1e-14, FindContactModel(model)->accuracy);
  Numeric best;
  double last = std::nan("");
  for (double step = 1e-2; step > 1e-7; step /= 4) {
    const double difference = Difference(model, at, touches, move, step);
    const double error = std::abs(difference - last) + rounding / step;
    if (error < best.error) best = {difference, error};
    last = difference;
  }
  return best;
}

// Compares each derivative with a difference. Returns how many could not be, because what touches changes.
int CompareWithDifferences(const std::string& model, const Point& at, const std::vector<StepTouch>& touches,
                           const Group& group) {
  double largest = 0;
  for (double derivative : group.derivatives) largest = std::max(largest, std::abs(derivative));
  int ties = 0;
  for (size_t i = 0; i < group.moves.size(); ++i) {
    const Numeric numeric = BestDifference(model, at, touches, group.moves[i]);
    if (std::isnan(numeric.value)) {
      ++ties;
      continue;
    }
    // Errors of iterations disturb differences, and derivatives by linear systems near the edge of a cone even more.
    const double accuracy = FindContactModel(model)->accuracy;
    const double blur = accuracy > 0 ? numeric.error + 1e3 * accuracy * largest : 0;
    EXPECT_NEAR(group.derivatives[i], numeric.value, 1e-6 * largest + 1e-9 + blur) << group.name << " " << i;
  }
  return ties;
}

class DerivativeOf : public AdjointOf {};

// Where there are differences to compare with: not if the impact falls on a node of the time grid, nor if the Jacobian
// is by its source not that of the step.
std::vector<Case> CasesWithDifferences() {
  std::vector<Case> cases = AllCases();
  std::erase_if(cases,
                [](const Case& c) { return c.name == "bounce_once" || FindContactModel(c.model)->published_jacobian; });
  return cases;
}

TEST_P(DerivativeOf, EqualsDifferencesAwayFromTies) {
  if (at_.scene.contact.restitution == 1) at_.scene.contact.restitution = 0.95;  // above 1 there is none
  const Evaluation here = Evaluate(model_, at_, true);
  ASSERT_FALSE(here.touches.empty());
  int ties = 0, all = 0;
  std::vector<Group> groups = StateAndControl(at_.scene, here.gradient);
  const std::vector<Group> parameters = Parameters(at_.scene, here.gradient.parameters);
  if (FindContactModel(model_)->push_gap > 0) {
    groups.resize(2);  // a rollout of these models takes long
  } else {
    groups.insert(groups.end(), parameters.begin(), parameters.end());
  }
  for (const Group& group : groups) {
    ties += CompareWithDifferences(model_, at_, here.touches, group);
    all += group.moves.size();
  }

  if (FindContactModel(model_)->push_gap > 0) return;
  const Point pushed = PushAll(at_, num_steps_);
  Group force{"force", {}, {}};
  for (int c = 0; c < pushed.scene.num_controlled(); ++c) {
    for (int j = 0; j < 2; ++j) {
      // The effort is that of a control, not of a constant force.
      force.Add(here.gradient.parameters.force[pushed.scene.control.bodies[c]][j], ConstantForce(c, j));
    }
  }
  Point without_effort = pushed;
  without_effort.scene.objective.effort = 0;
  ties += CompareWithDifferences(model_, without_effort, here.touches, force);
  all += force.moves.size();
  EXPECT_LE(ties, (all + 9) / 10);
}

INSTANTIATE_TEST_SUITE_P(AllModels, AdjointOf, testing::ValuesIn(AllCases()), NameOf);
INSTANTIATE_TEST_SUITE_P(AllModels, DerivativeOf, testing::ValuesIn(CasesWithDifferences()), NameOf);

}  // namespace
}  // namespace saltus
