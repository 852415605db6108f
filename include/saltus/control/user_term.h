// User-defined costs and constraints of a scene: functions for Ceres in addition to the terms of scene files.
//
//   struct Drag {  // 0.1 |v|^2, integrated over time
//     template <typename T>
//     bool operator()(const T* x, const T* h, T* residuals) const {
//       for (int j = 0; j < 2; ++j) residuals[j] = sqrt(0.1 * h[0]) * x[2 + j];
//       return true;
//     }
//   };
//   UserTerm drag{.at = UserTerm::Timing::kEachStep, .states = {0}, .with_length = true};
//   drag.function = std::make_shared<ceres::AutoDiffCostFunction<Drag, 2, 4, 1>>(new Drag);
//   Solve("ceres_phases", {.scene = scene, .contact = "event", .terms = {drag}}, {});
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "saltus/scene/scene.h"

namespace ceres {
class CostFunction;
}

namespace saltus {

// A user-defined term. Its residuals are evaluated in the exact motion, in each control interval or at the end.
struct UserTerm {
  // At the beginning of each control interval, which is called a step here, or at the final time.
  enum class Timing { kEachStep, kEnd };
  // The role of all residuals r: the loss gains |r|^2 (without Ceres' half), or r = 0, or r <= 0.
  enum class Role { kCost, kEquality, kInequality };

  std::string name = "own term";  // for messages
  Timing at = Timing::kEnd;
  Role role = Role::kCost;

  // The function's parameter blocks, in this order, in SI units; one block for each disc that a list below names:
  //   [p_x p_y v_x v_y] of each of these discs, which are not fixed, at the beginning of the step, or at the final
  //   time, after impacts there
  std::vector<int> states = {};
  //   [u_x u_y] on each of these discs, which are controlled, constant over the step; kEachStep only
  std::vector<int> forces = {};
  //   [angle, angular velocity] of each of these discs, which spin, rad and rad/s; in kEachStep they have a torque
  //   control
  std::vector<int> rotations = {};
  //   [torque] on each of these discs, which have a torque control, N m, constant over the step; kEachStep only
  std::vector<int> torques = {};
  //   if set, the length of the step, or the final time, s (1 number)
  bool with_length = false;

  // The function, which must not keep state, because it is evaluated for every step.
  std::shared_ptr<const ceres::CostFunction> function = nullptr;

  // The scale of a constraint, > 0: a residual of this size counts as much as an error of a position by the size of the
  // scene. Constraints are satisfied to 1e-8 of it.
  double scale = 1;
};

// Returns the first error as "found x, expected y" behind the name of the term; empty if there is none. The sizes of
// the function's blocks are checked.
std::string Validate(const UserTerm& term, const Scene& scene);

}  // namespace saltus
