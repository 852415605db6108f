// The derivatives that every contact model must have, as checks that say what is wrong, or nothing (conformance.h).
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "simulate/conformance_run.h"

namespace saltus::conformance {

inline bool SameTouches(const std::vector<Touch>& a, const std::vector<Touch>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const Touch& l, const Touch& r) {
    return l.candidate == r.candidate && l.mode == r.mode && l.kind == r.kind;
  });
}

// A column of a step's derivative by central differences. False near a tie: where what touches changes within the
// difference, or where half the width gives another result.
class StepDifference {
 public:
  StepDifference(const Simulator& simulator, std::vector<double> x, std::vector<double> force)
      : simulator_(simulator), x_(std::move(x)), force_(std::move(force)) {
    Eigen::VectorXd next(x_.size());
    simulator.Step(x_, force_, {next.data(), x_.size()}, &touches_);
  }

  bool Compute(bool by_force, int column, Eigen::VectorXd* derivative) const {
    Eigen::VectorXd half;
    if (!Central(by_force, column, 1e-6, derivative) || !Central(by_force, column, 5e-7, &half)) return false;
    return (*derivative - half).cwiseAbs().maxCoeff() < 1e-5 * (1 + half.cwiseAbs().maxCoeff());
  }

 private:
  bool Central(bool by_force, int column, double width, Eigen::VectorXd* derivative) const {
    Eigen::VectorXd up, down;
    if (!Shifted(by_force, column, width, &up) || !Shifted(by_force, column, -width, &down)) return false;
    *derivative = (up - down) / (2 * width);
    return true;
  }
  bool Shifted(bool by_force, int column, double shift, Eigen::VectorXd* next) const {
    std::vector<double> x = x_, force = force_;
    (by_force ? force : x)[column] += shift;
    next->resize(x.size());
    std::vector<Touch> touches;
    simulator_.Step(x, force, {next->data(), x.size()}, &touches);
    return SameTouches(touches, touches_);
  }

  const Simulator& simulator_;
  std::vector<double> x_, force_;
  std::vector<Touch> touches_;
};

// Steps of a rollout in which something touches, at most `count` of them, spread over the rollout.
inline std::vector<int> TouchedSteps(const Simulator& simulator, int count) {
  std::vector<int> all;
  for (const StepTouch& touch : simulator.touches()) {
    if (all.empty() || all.back() != touch.step) all.push_back(touch.step);
  }
  std::vector<int> some;
  const int size = static_cast<int>(all.size());
  for (int i = 0; i < std::min(size, count); ++i) some.push_back(all[i * size / std::min(size, count)]);
  return some;
}

// The linearization of steps with contact is the derivative of the step, away from ties.
inline std::string CheckDerivative(const Model& model, const Scene& scene) {
  if (model.traits.published_jacobian) return "";
  Run run(model, scene);
  const Simulator& simulator = run.simulator();
  const std::vector<int> steps = TouchedSteps(simulator, 12);
  if (steps.empty()) return "nothing touches";
  int compared = 0, ties = 0;
  for (const int k : steps) {
    std::vector<double> x(simulator.state_size()), force(2 * simulator.num_bodies());
    simulator.GetState(k, x);
    simulator.ExpandForce(InitialControl(scene, run.last()), k, force);
    StepLinearization linearization;
    simulator.Linearize(x, force, false, &linearization);
    Eigen::MatrixXd A, B;
    linearization.ToDense(&A, &B);
    const StepDifference difference(simulator, x, force);
    for (int column = 0; column < A.cols() + B.cols(); ++column) {
      const bool by_force = column >= A.cols();
      const int at = by_force ? column - A.cols() : column;
      if (scene.bodies[at / (by_force ? 2 : simulator.body_size())].fixed) continue;
      Eigen::VectorXd expected;
      if (!difference.Compute(by_force, at, &expected)) {
        ++ties;
        continue;
      }
      ++compared;
      const Eigen::VectorXd actual = by_force ? B.col(at) : A.col(at);
      const double error = (actual - expected).cwiseAbs().maxCoeff();
      if (!(error < 2e-5 * (1 + expected.cwiseAbs().maxCoeff()))) {
        return Say("step ", k, ", by ", by_force ? "force " : "state ", at, ": off by ", error);
      }
    }
  }
  if (compared < 2 * ties) return Say("only ", compared, " columns are away from ties, ", ties, " are not");
  return "";
}

// Resting, grazing and slipless contacts, exactly touching: results and derivatives are finite.
inline std::string CheckDegenerateStates(const Model& model) {
  for (const double friction : {0.0, 0.3}) {
    if (friction > 0 && !model.traits.friction) continue;
    for (const double overlap : {0.0, 1e-7, -1e-7}) {
      for (const Vec2d& velocity : {Vec2d(0, 0), Vec2d(1, 0), Vec2d(0, -1e-9), Vec2d(0, -2), Vec2d(0, 2)}) {
        Scene scene;
        scene.name = "degenerate";
        scene.duration = 0.5;
        scene.steps = 240;
        scene.gravity = {0, -9.8};
        scene.bodies = {{.name = "a", .radius = 0.2, .mass = 1, .position = {0, 0.2}},
                        {.name = "b", .radius = 0.2, .mass = 2, .position = {0.4, 0.2}}};
        scene.planes = {{"ground", {0, 0}, {0, 1}}};
        scene.contact.friction = friction;
        if (!model.reason_not_applicable(scene).empty()) continue;
        const std::unique_ptr<Simulator> simulator = model.make(scene);
        std::vector<double> initial = InitialState(scene), x(simulator->state_size()), next(x.size());
        initial[1] -= overlap;
        initial[2] = velocity[0];
        initial[3] = velocity[1];
        simulator->ExpandInitial(initial, x);
        const std::vector<double> force(4);
        simulator->Step(x, force, next);
        StepLinearization linearization;
        simulator->Linearize(x, force, true, &linearization);
        bool finite = std::all_of(next.begin(), next.end(), [](double value) { return std::isfinite(value); });
        for (const StepLinearization::Island& island : linearization.islands) {
          finite = finite && island.A.allFinite() && island.B.allFinite() && island.P.allFinite();
        }
        if (!finite) {
          return Say("not finite at overlap ", overlap, ", velocity ", velocity.transpose(), ", friction ", friction);
        }
      }
    }
  }
  return "";
}

}  // namespace saltus::conformance
