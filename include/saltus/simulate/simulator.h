// A contact model bound to a scene: rollout, adjoint and per-step linearization, behind an interface of doubles.
//
// Code that uses simulators does not depend on the type of a model, on its scalar, or on Jets.
//
// Shapes. A scene has B discs, C of them controlled. A model takes K steps of length step(): K = scene.steps, divided
// by the grid steps that one step of the model covers. A body's state is [p_x p_y v_x v_y rotation...], of body_size()
// numbers; the state of the scene is that of all discs in scene order, state_size() = B * body_size() numbers.
// A control is K rows of [u_x u_y] of each controlled disc, in N; if R of them have a torque control, torque / radius
// of each follows, in N too: K x (2 C + R) numbers (Scene::control_width()). The forces on all discs in one step are B
// x 2 numbers; if any disc has a torque control, B more follow, torque / radius of each. The initial state is B x 4:
// [p_x p_y v_x v_y] of each disc; if the scene has discs that spin, B x 2 more follow: [angle, angular velocity] of
// each, which is then the rotation in a body's state.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "saltus/contact/contact_model.h"
#include "saltus/scene/scene.h"

namespace saltus {

enum class Precision { kDouble, kFloat };

// A function that long computations call at short intervals, from every thread that computes. It returns true to stop
// them, and must return true ever after. Null: the computation is never stopped.
using StopRequest = std::function<bool()>;

// A contact that took effect in step `step` of a rollout.
struct StepTouch {
  int step = 0;
  Touch touch;  // disc and plane indices of the scene
};

// A contact that was tied in step `step` of a rollout.
struct StepTie {
  int step = 0;
  TiedContact contact;  // disc and plane indices of the scene
};

// The reason why a rollout failed.
struct RolloutFailure {
  int step = -1;            // -1: not known
  int body = -1;            // a disc of the contact group that failed; -1: none in particular
  std::string_view reason;  // empty: a state is not finite
};

// Derivatives of one number with respect to the parameters of the scene. Those that a model does not read are 0.
struct ParameterGradient {
  double restitution = 0;
  double friction = 0;
  double stiffness = 0;
  double damping = 0;
  // Restitution and friction of each pair of materials by MaterialPairIndex() (materials.h), in a scene with materials.
  // `restitution` and `friction` above are then those of pairs without a material, which have the index 0 here.
  std::vector<PairConstants<double>> pairs;
  Vec2d gravity = Vec2d::Zero();
  std::vector<double> mass;     // B; 0 for fixed discs; the moment of inertia is constant
  std::vector<Vec2d> force;     // B; with respect to a constant force on the disc; 0 for fixed discs
  std::vector<double> inertia;  // B, if the scene has discs that spin; 0 for discs that do not
  // B, in scenes with drag, springs or prescribed motions: by the coefficient of a linear drag of each disc.
  std::vector<double> drag;
  // The total derivatives by Scene::design, in its order: the mass or radius of a solid disc changes its moment of
  // inertia.
  std::vector<double> design;
};

// Returns the entry of `gradient` for a parameter of kind kRestitution or kFriction; in a scene with materials, that of
// the pair that the parameter names.
double ContactDerivative(const SceneParameter& parameter, const ParameterGradient& gradient);

// Derivatives of one number with respect to all inputs of a rollout.
struct Sensitivity {
  std::vector<double>
      initial;  // of the shape of the initial state; 0 for fixed discs, and for rotations without inertia
  std::vector<double> control;   // of the shape of the control
  ParameterGradient parameters;  // if asked for
};

// The memory into which a sensitivity is written (overwritten, not added). Parts that are empty or null are not
// computed.
struct SensitivityView {
  std::span<double> initial;                // of the shape of the initial state
  std::span<double> control;                // of the shape of the control
  ParameterGradient* parameters = nullptr;  // its vectors are resized
  // factor * addend is added to the derivative by the control, such as the gradient of the effort, so that a long
  // control passes through memory once only.
  double factor = 0;
  std::span<const double> addend = {};
};

// The linearization of x' = f(x, u) at one point, dx' = A dx + B du + P dparameters: dense for discs with contacts in
// the step, constant for discs in free flight.
class StepLinearization {
 public:
  // A contact group. Columns of A: states of its discs. Columns of B: the forces on them and, if discs have torque
  // controls, torque / radius of each. Columns of P, if parameters were asked for: restitution, friction, stiffness,
  // damping, masses of its discs, their inverse moments of inertia if the scene has discs that spin, and restitution
  // and friction of each pair of materials from 1 on, by MaterialPairIndex(), if it has materials; then, in scenes with
  // drag, springs or prescribed motions, the coefficients of a linear drag of its discs.
  struct Island {
    std::vector<int> bodies;
    Eigen::MatrixXd A, B, P;
  };
  // Free flight, dp' = pp dp + pv dv + pa da and dv' = vp dp + vv dv + va da with a = u/m + g; all blocks are multiples
  // of the identity.
  struct FreeFlight {
    double pp, pv, pa, vp, vv, va;  // 1, s, s^2, 1/s, 1, s
  };

  int body_size = 4;
  FreeFlight free{};
  std::vector<Island> islands;
  std::vector<int> flying;                // discs that are in no island
  std::vector<Eigen::MatrixXd> rotation;  // of each flying disc: d(next rotation)/d(rotation); empty without rotation
  std::vector<double> inverse_mass;       // of all discs, 1/kg; 0 if fixed
  bool has_torques = false;               // whether a disc of the scene has a torque control
  std::vector<Eigen::Vector2d>
      by_torque;  // with torque controls, of each flying disc: d(next rotation)/d(torque / radius)

  // Returns the size of the forces in a step, as Simulator::force_size().
  std::size_t force_size() const { return (has_torques ? 3 : 2) * inverse_mass.size(); }
  // Computes next = A x + B force, with x of state_size() and force of force_size() numbers.
  void Apply(std::span<const double> x, std::span<const double> force, std::span<double> next) const;
  // Computes x = A^T next and force = B^T next.
  void ApplyTranspose(std::span<const double> next, std::span<double> x, std::span<double> force) const;
  // Returns dense A (state_size x state_size) and B (state_size x force_size()), for tests and small solvers.
  void ToDense(Eigen::MatrixXd* A, Eigen::MatrixXd* B) const;
};

// The free flight of a step of some length, and its derivative by that length.
struct VariableFreeFlight {
  StepLinearization::FreeFlight flight, by_time;
  // The free flight of the angle, by the angular velocity and the angular acceleration, of discs that spin.
  StepLinearization::FreeFlight turn = {}, turn_by_time = {};
};

// Returns the size of the initial state of a scene: 4 B, or 6 B if a disc spins.
int InitialSize(const Scene& scene);

// The simulator of one scene under one contact model. It holds the states and contacts of its last rollout. Not
// thread-safe, apart from Step() and Linearize().
class Simulator {
 public:
  virtual ~Simulator() = default;

  virtual const ModelTraits& traits() const = 0;
  const Scene& scene() const { return scene_; }
  Precision precision() const { return precision_; }
  int num_bodies() const { return scene_.num_bodies(); }
  int num_controlled() const { return scene_.num_controlled(); }
  int num_steps() const { return num_steps_; }
  double step() const { return scene_.duration / num_steps_; }  // s
  virtual int body_size() const = 0;
  int state_size() const { return num_bodies() * body_size(); }
  int initial_size() const { return InitialSize(scene_); }
  int control_width() const { return scene_.control_width(); }  // size of a control in each step
  int control_size() const { return num_steps_ * control_width(); }
  int force_size() const { return (scene_.num_torques() > 0 ? 3 : 2) * num_bodies(); }

  // Simulates all K steps from `initial` under `control`. Returns false if a state is not finite, if the iterations of
  // a step do not converge, or if the model violates a guarantee of contact_model.h. Adjoint and states after that step
  // then have no meaning. Returns false too if it was stopped, and then has no results.
  virtual bool Rollout(std::span<const double> initial, std::span<const double> control) = 0;
  // Returns why the last rollout returned false, with the model, the step and the disc; empty if it returned true.
  std::string FailureReason() const;

  // Results of the last rollout: state k = 0..K (state_size() numbers), and the contacts, in order of steps.
  virtual void GetState(int k, std::span<double> x) const = 0;
  virtual const std::vector<StepTouch>& touches() const = 0;
  // Simultaneous impacts of the last rollout whose order changed the motion, in order of steps; those of a tie are
  // adjacent.
  const std::vector<StepTie>& ties() const { return ties_; }

  // Computes the gradient of a function of the final state of the last rollout by the adjoint. `cotangent` is the
  // derivative of the function with respect to state K (state_size() numbers). Cost: less than a rollout, linear in
  // steps and discs; discs without a control cost time in steps with contacts only, unless parameters are asked for.
  // Precondition: Rollout returned true.
  virtual void AdjointInto(std::span<const double> cotangent, const SensitivityView& out) = 0;
  // Computes it into a Sensitivity, which is resized; the parameters only if they are asked for.
  void Adjoint(std::span<const double> cotangent, bool with_parameters, Sensitivity* sensitivity);

  // Limits the memory of a rollout for states, and for the states of the two discs of each contact and step. States
  // that do not fit are simulated again for the adjoint, at the cost of one more rollout and with the same bits. In
  // addition a rollout has touches() (40 bytes each), the control (16 bytes per step and controlled disc) and
  // LeastMemory() (about 2 sqrt(K) states; all K + 1 in scenes with drag, springs or prescribed motions). Takes effect
  // with the next rollout. The default is 1 GiB.
  void set_memory_limit(std::size_t bytes) { memory_limit_ = bytes; }
  std::size_t memory_limit() const { return memory_limit_; }
  // Sets the order of tied impacts of event-driven models: 0 for their own, or a number of event_ties.h, with which
  // derivatives have no meaning. Takes effect with the next rollout.
  void set_tie_order(int order) { tie_order_ = order; }
  // Returns the smallest memory limit that a rollout can satisfy, in bytes.
  virtual std::size_t LeastMemory() const = 0;

  // Sets a request to stop, which rollouts and adjoints ask in every step with contact; their results are then
  // incomplete. A caller that computes many steps by Step or Linearize asks stopped() itself.
  void set_stop(StopRequest stop) { stop_ = std::move(stop); }
  bool stopped() const { return stop_ && stop_(); }

  // Computes one step from any state under any force (force_size() numbers, on all discs), its contacts, and its
  // linearization; `touches` is overwritten unless null. `next` is NaN where a rollout would fail. Both functions are
  // thread-safe, and independent of the last rollout.
  virtual void Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
                    std::vector<Touch>* touches = nullptr) const = 0;
  virtual void Linearize(std::span<const double> x, std::span<const double> force, bool with_parameters,
                         StepLinearization* linearization) const = 0;

  // Returns free flight in one step of any length h > 0, s; std::nullopt if the model has no derivative by the length.
  virtual std::optional<VariableFreeFlight> FreeFlightOfLength(double h) const = 0;

  // Writes the full state of an initial state: rotations that it does not have are at their start values, and fixed
  // discs are at rest.
  virtual void ExpandInitial(std::span<const double> initial, std::span<double> x) const = 0;

  // Writes the force on every disc (force_size() numbers) in step k of a control of k + 1 rows or more; zero on discs
  // that are not controlled.
  void ExpandForce(std::span<const double> control, int k, std::span<double> force) const;
  // Selects the control_width() numbers of one row of a control from force_size() numbers for all discs, such as
  // derivatives by the force.
  void SelectControl(std::span<const double> force, std::span<double> row) const;

 protected:
  Simulator(const Scene& scene, Precision precision, int grid_steps)
      : scene_(scene), precision_(precision), num_steps_(scene.steps / grid_steps) {}

  // Returns the failure of a simulator that is a part of this one.
  static const std::optional<RolloutFailure>& FailureOf(const Simulator& simulator) { return simulator.failure_; }

  Scene scene_;
  Precision precision_;
  int num_steps_;
  std::size_t memory_limit_ = std::size_t{1} << 30;
  std::optional<RolloutFailure> failure_;  // of the last rollout
  StopRequest stop_;
  std::vector<StepTie> ties_;
  int tie_order_ = 0;
};

// Convert a state (of a model without rotations, or with those of the scene) to the shape of an initial state, and
// back.
std::vector<double> ToInitial(std::span<const double> state, int num_bodies);
std::vector<double> ToState(std::span<const double> initial, int num_bodies);

// Return the scene's initial state and its initial control, which is the same in all `num_steps` steps. A fixed disc
// with a path has the velocity of the path at time 0.
std::vector<double> InitialState(const Scene& scene);
std::vector<double> InitialControl(const Scene& scene, int num_steps);

}  // namespace saltus
