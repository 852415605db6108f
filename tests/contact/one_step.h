// One step of a contact model from a given state, and its linearization against differences.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "saltus/simulate/registry.h"

namespace saltus::contact_test {

// Discs without a trajectory; positions, velocities and forces come with each step. A grid step is 1/480 s.
inline Scene DiscScene(std::vector<Body> bodies, std::vector<Plane> planes = {}) {
  Scene scene;
  scene.steps = 480;
  scene.bodies = std::move(bodies);
  scene.planes = std::move(planes);
  return scene;
}

class OneStep {
 public:
  OneStep(const std::string& model, const Scene& scene)
      : simulator_(MakeSimulator(model, scene, Precision::kDouble)),
        size_(simulator_->body_size()),
        force_(2 * scene.num_bodies(), 0.0) {
    start_.resize(simulator_->state_size());
    simulator_->ExpandInitial(InitialState(scene), start_);
  }

  int size() const { return size_; }
  double h() const { return simulator_->step(); }
  // Entry j of disc i: p_x p_y v_x v_y rotation...
  double& start(int i, int j) { return start_[i * size_ + j]; }
  double& force(int i, int j) { return force_[2 * i + j]; }
  double after(int i, int j) const { return after_[i * size_ + j]; }
  const std::vector<Touch>& touches() const { return touches_; }

  void Run() {
    after_.assign(start_.size(), 0.0);
    touches_.clear();
    simulator_->Step(start_, force_, after_, &touches_);
  }

  // Dense A and B at the start, and the derivative by restitution, friction, stiffness, damping and the masses of the
  // discs of the only island.
  void Linearize(Eigen::MatrixXd* A, Eigen::MatrixXd* B) const {
    StepLinearization linearization;
    simulator_->Linearize(start_, force_, false, &linearization);
    linearization.ToDense(A, B);
  }
  Eigen::MatrixXd ParameterDerivatives() const {
    StepLinearization linearization;
    simulator_->Linearize(start_, force_, true, &linearization);
    return linearization.islands.at(0).P;
  }

  // Compares the linearization at the start with central differences: `rows` and `columns` say which entries of a body
  // (0..size-1) and, in the columns, which of its force (size, size + 1) are compared.
  void ExpectDerivative(const std::vector<int>& rows, const std::vector<int>& columns, double width,
                        double tolerance) const {
    Eigen::MatrixXd A, B;
    Linearize(&A, &B);
    const int num_bodies = simulator_->num_bodies();
    for (int body = 0; body < num_bodies; ++body) {
      if (simulator_->scene().bodies[body].fixed) continue;
      for (int column : columns) {
        const bool state = column < size_;
        const Eigen::VectorXd actual = state ? A.col(body * size_ + column) : B.col(2 * body + column - size_);
        const Eigen::VectorXd expected = Difference(body, column, width);
        for (int other = 0; other < num_bodies; ++other) {
          for (int row : rows) {
            const double scale = 1 + std::abs(expected[other * size_ + row]);
            EXPECT_NEAR(actual[other * size_ + row], expected[other * size_ + row], tolerance * scale)
                << "entry " << row << " of disc " << other << " by entry " << column << " of disc " << body;
          }
        }
      }
    }
  }

 private:
  Eigen::VectorXd Difference(int body, int column, double width) const {
    const auto at = [&](double shift) {
      std::vector<double> x = start_, force = force_;
      (column < size_ ? x[body * size_ + column] : force[2 * body + column - size_]) += shift;
      Eigen::VectorXd next(x.size());
      simulator_->Step(x, force, {next.data(), x.size()});
      return next;
    };
    return (at(width) - at(-width)) / (2 * width);
  }

  std::unique_ptr<Simulator> simulator_;
  int size_;
  std::vector<double> start_, force_, after_;
  std::vector<Touch> touches_;
};

}  // namespace saltus::contact_test
