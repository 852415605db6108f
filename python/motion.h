// A scene under a contact model as Python sees it: numbers of the scene, whatever units and origin are computed in.
#pragma once

#include "arrays.h"
#include "computation.h"
#include "saltus/control/single_shooting.h"
#include "saltus/simulate/registry.h"

namespace saltus::python {

// How the decision variables of `scene` are arranged for a model that takes `num_steps`: (K, C, 2) for a control, (K,
// C, 3) with torques (control_rows.h), (F, 2) for velocities and positions of F discs; flat with a free final time or
// angular velocities behind.
Shape VariablesShape(const SingleShooting& shooting);
// Whether these are not those of the library, as torques are among them.
bool HasTorques(const Scene& scene);

// Decision variables of `points` points as the library has them: positions from the scene's origin to that of the
// computation, torques where they belong. `z` as it is if there is nothing to do, else `moved` holds them.
std::span<const double> NearVariables(const Scene& scene, const Scene& near, std::span<const double> z,
                                      std::vector<double>* moved, size_t points = 1);
// The other way round, of a gradient of one point. Precondition: HasTorques(scene).
void PutGradient(const Scene& scene, std::span<const double> gradient, std::span<double> to);

// The first two of every `stride` numbers as a position, from one origin to another.
void ConvertPositions(std::span<double> numbers, size_t stride, const Units& from, const Units& to);

// Loss and gradient by the decision variables. Used by one thread at a time: others wait.
class Simulation {
 public:
  Simulation(const Scene& scene, const Contact& contact, const std::string& precision, double memory_limit);

  const Scene& scene() const { return scene_; }
  const std::string& contact() const { return contact_; }
  Shape shape() const { return VariablesShape(shooting_); }
  py::ssize_t num_variables() const { return SizeOf(shape()); }
  py::ssize_t num_steps() const { return shooting_.simulator().num_steps(); }
  int body_size() const { return shooting_.simulator().body_size(); }
  Array InitialGuess() const;

  double Loss(const py::object& z);
  py::tuple LossAndGradient(const py::object& z, const py::object& out);
  // Residuals whose squares are the loss but for effort, and their Jacobian.
  py::tuple Residuals(const py::object& z);
  // The states (K + 1, B, body size) of the motion, and what happened in it.
  py::dict Rollout(const py::object& z, const py::object& out);
  // The remarks on the motion of the last call; none before there is one.
  py::object Remarks();

  Array Step(const py::object& state, const py::object& force);
  py::tuple Linearize(const py::object& state, const py::object& force);

 private:
  Array Variables(const py::object& z) const;
  // Computes evaluate(z in the computation) as Compute does; keeps z if there may be remarks on its motion.
  template <typename Evaluate>
  void ComputeAt(const Array& variables, const Evaluate& evaluate);
  // Calls evaluate() without the GIL, as the only user. Throws if it returns false, or was stopped.
  template <typename Evaluate>
  void Compute(const Evaluate& evaluate);
  Array NearState(const py::object& state) const;
  Array Force(const py::object& force) const;
  // From states of the computation to those of the scene, in place.
  void MoveFromNear(std::span<double> states) const;

  Scene scene_, near_;
  std::string contact_;
  SingleShooting shooting_;
  std::vector<double> moved_;
  std::vector<double> unclear_;  // the decision variables of the last call, if there may be remarks on it
  OneUser user_;
};

}  // namespace saltus::python
