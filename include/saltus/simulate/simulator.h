// A contact model bound to a scene: rollout, adjoint and per-step linearization, behind an interface of doubles.
//
// Nothing above this floor knows the type of a model, its scalar, or Jets.
//
// Shapes. A scene has B discs, C of them controlled. A model takes K steps of length step(): K = scene.steps, divided
// by the grid steps that one step of the model covers. A body's state is [p_x p_y v_x v_y rotation...], of body_size()
// numbers; the state of the scene is that of all discs in scene order, state_size() = B * body_size() numbers.
// A control is K rows of [u_x u_y] of each controlled disc, in N; if R of them are turned, torque / radius of each
// follows, in N too: K x (2 C + R) numbers (Scene::control_width()). The forces on all discs in one step are B x 2
// numbers; if any disc is turned, B more follow, torque / radius of each. The initial state is B x 4: [p_x p_y v_x v_y]
// of each disc; if the scene has discs that spin, B x 2 more follow: [angle, angular velocity] of each. The rotation in
// a body's state is the same two numbers then.
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

// Asked at short intervals by what may compute for long: true to make it stop. Once true it must stay so. It is asked
// from every thread that computes.
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

// The reason why a rollout failed; without words, a state is not finite.
struct RolloutFailure {
  int step = -1;
  int body = -1;  // one of those concerned; -1: none in particular
  std::string_view what;
};

// Derivatives of one number with respect to the parameters of the scene.
struct ParameterGradient {
  double restitution = 0;
  double friction = 0;
  double stiffness = 0;
  double damping = 0;
  // In a scene with materials: by MaterialPairIndex() (materials.h). Restitution and friction above are then those of
  // pairs without a material, as here at 0.
  std::vector<PairConstants<double>> pairs;
  Vec2d gravity = Vec2d::Zero();
  std::vector<double> mass;     // B; 0 for fixed discs; at the moment of inertia that the disc has
  std::vector<Vec2d> force;     // B; with respect to a constant force on the disc; 0 for fixed discs
  std::vector<double> inertia;  // B, if the scene has discs that spin; 0 for the others
  // The derivatives by Scene::design, in its order: total ones, as the mass or radius of a solid disc changes its
  // moment of inertia too.
  std::vector<double> design;
};

// The derivative by restitution or friction, of the pair of materials that the parameter names if the scene has any.
double ByContact(const SceneParameter& parameter, const ParameterGradient& gradient);

// Derivatives of one number with respect to all that determines a rollout.
struct Sensitivity {
  std::vector<double> initial;   // as the initial state; 0 for fixed discs and what cannot spin
  std::vector<double> control;   // as the control
  ParameterGradient parameters;  // if asked for
};

// Where to write a sensitivity. What is empty or null is not wanted, and costs nothing.
struct SensitivityView {
  std::span<double> initial;                // as the initial state
  std::span<double> control;                // as the control
  ParameterGradient* parameters = nullptr;  // its vectors are resized
  // Added to the sensitivity to the control: factor * addend (as the control), such as the gradient of another
  // function. Done in one go, a long control passes through memory once.
  double factor = 0;
  std::span<const double> addend = {};
};

// x' = f(x, u) to first order at one point: dx' = A dx + B du + P dparameters. Dense over the discs that touch
// something in the step, constant for those that fly.
class StepLinearization {
 public:
  // Discs that are stepped together. Columns of A: their states; of B: the forces on them and, if discs are turned,
  // then torque / radius of each; of P: restitution, friction, stiffness, damping, their masses, if the scene has discs
  // that spin, their inverse moments of inertia and, if it has materials, restitution and friction of each pair of
  // materials from 1 on, by MaterialPairIndex() (only if parameters were asked for).
  struct Island {
    std::vector<int> bodies;
    Eigen::MatrixXd A, B, P;
  };
  // dp' = pp dp + pv dv + pa da, dv' = vp dp + vv dv + va da, with a = u/m + g: every block is a multiple of the
  // identity.
  struct FreeFlight {
    double pp, pv, pa, vp, vv, va;  // 1, s, s^2, 1/s, 1, s
  };

  int body_size = 4;
  FreeFlight free{};
  std::vector<Island> islands;
  std::vector<int> flying;                // discs that are in no island
  std::vector<Eigen::MatrixXd> rotation;  // of each flying disc, rotation' by rotation; empty without rotation
  std::vector<double> inverse_mass;       // of all discs, 1/kg; 0 if fixed
  bool turns = false;                     // some disc of the scene is turned
  std::vector<Eigen::Vector2d> turning;   // if so, of each flying disc, rotation' by torque / radius

  // Numbers of the forces in a step.
  std::size_t force_size() const { return (turns ? 3 : 2) * inverse_mass.size(); }
  // next = A x + B force, with x of state_size() and force of force_size() numbers.
  void Apply(std::span<const double> x, std::span<const double> force, std::span<double> next) const;
  // x = A^T next, force = B^T next.
  void ApplyTranspose(std::span<const double> next, std::span<double> x, std::span<double> force) const;
  // Dense A (state_size x state_size) and B (state_size x force_size()), for tests and small solvers.
  void ToDense(Eigen::MatrixXd* A, Eigen::MatrixXd* B) const;
};

// Free flight for some time, and its derivative by that time.
struct FlightOver {
  StepLinearization::FreeFlight flight, by_time;
  // The free flight of the angle, by the angular velocity and the angular acceleration, of discs that spin.
  StepLinearization::FreeFlight turn = {}, turn_by_time = {};
};

// Numbers of the initial state of a scene.
int InitialSize(const Scene& scene);

class Simulator {
 public:
  virtual ~Simulator() = default;

  virtual const ModelTraits& traits() const = 0;
  const Scene& scene() const { return scene_; }
  Precision precision() const { return precision_; }
  int num_bodies() const { return scene_.num_bodies(); }
  int num_controlled() const { return scene_.num_controlled(); }
  int num_steps() const { return num_steps_; }
  double step() const { return scene_.duration / num_steps_; }
  virtual int body_size() const = 0;
  int state_size() const { return num_bodies() * body_size(); }
  int initial_size() const { return InitialSize(scene_); }
  int control_width() const { return scene_.control_width(); }  // numbers of a control in each step
  int control_size() const { return num_steps_ * control_width(); }
  int force_size() const { return (scene_.num_turned() > 0 ? 3 : 2) * num_bodies(); }

  // Runs all K steps from `initial` under `control`. False if a state is not finite, if the
  // iterations of a step do not arrive, or if the model breaks its contract (contact_model.h); then neither Adjoint nor
  // states after that step may be asked for. False too if it was stopped; then nothing may.
  virtual bool Rollout(std::span<const double> initial, std::span<const double> control) = 0;
  // Why the last rollout returned false, with the model, the step and the disc; empty if it returned true.
  std::string WhyFailed() const;

  // Results of the last rollout: state k = 0..K (state_size() numbers), and the contacts, in order of steps.
  virtual void GetState(int k, std::span<double> x) const = 0;
  virtual const std::vector<StepTouch>& touches() const = 0;
  // Impacts of the last rollout whose order decided what followed, in order of steps; those of a tie stand together.
  const std::vector<StepTie>& ties() const { return ties_; }

  // The gradient of a function of the final state of the last rollout, by the adjoint: `cotangent` is its derivative
  // with respect to state K (state_size() numbers). Cost: less than a rollout, linear in steps and discs; discs that
  // are not controlled cost only where they touch, unless parameters are asked for. Precondition: Rollout returned
  // true.
  virtual void AdjointInto(std::span<const double> cotangent, const SensitivityView& out) = 0;
  void Adjoint(std::span<const double> cotangent, bool with_parameters, Sensitivity* sensitivity);

  // Bounds what a rollout keeps besides its control: states and, per contact and step, those of the two discs. What
  // does not fit is simulated again when the adjoint needs it, at the cost of one more rollout and with the same bits.
  // Kept in any case: touches(), 48 bytes each, the control, 16 bytes per step and controlled disc, and
  // LeastMemory(), about 2 sqrt(K) states. Takes effect with the next rollout.
  void set_memory_limit(std::size_t bytes) { memory_limit_ = bytes; }
  std::size_t memory_limit() const { return memory_limit_; }
  // In which order event-driven models take tied impacts: 0, their own, or one of those of event_ties.h. Of the latter
  // only values are of use, not derivatives. Takes effect with the next rollout.
  void set_tie_order(int order) { tie_order_ = order; }
  // The smallest limit that can be kept, in bytes.
  virtual std::size_t LeastMemory() const = 0;

  // Rollouts and adjoints ask in every step with contact, and then leave their results half done. Who computes many
  // steps by Step or Linearize asks stopped().
  void set_stop(StopRequest stop) { stop_ = std::move(stop); }
  bool stopped() const { return stop_ && stop_(); }

  // One step from any state under any force (force_size() numbers, on every disc), what touches in it, and its
  // linearization. What makes a rollout fail makes `next` not a number. Thread-safe among themselves.
  virtual void Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
                    std::vector<Touch>* touches = nullptr) const = 0;
  virtual void Linearize(std::span<const double> x, std::span<const double> force, bool with_parameters,
                         StepLinearization* linearization) const = 0;

  // Free flight in one step of any length h > 0, s; nothing if the model takes lengths without derivatives only.
  virtual std::optional<FlightOver> FreeFlightOver(double h) const = 0;

  // The full state that belongs to `initial`: rotation that is not in it at its start value, fixed discs at rest.
  virtual void ExpandInitial(std::span<const double> initial, std::span<double> x) const = 0;

  // The force on every disc (force_size() numbers) in step k of a control; zero on discs that are not controlled.
  void ExpandForce(std::span<const double> control, int k, std::span<double> force) const;
  // The other way round: of numbers for every disc, such as derivatives by the force, those of a row of a control.
  void SelectControl(std::span<const double> force, std::span<double> row) const;

 protected:
  Simulator(const Scene& scene, Precision precision, int grid_steps)
      : scene_(scene), precision_(precision), num_steps_(scene.steps / grid_steps) {}

  // Returns the failure of a simulator that another one is made of.
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

// A state of a scene with so many bodies, of a model whose bodies have no rotation or the scene's, in the shape of an
// initial state; and back.
std::vector<double> ToInitial(std::span<const double> state, int num_bodies);
std::vector<double> ToState(std::span<const double> initial, int num_bodies);

// The scene's own initial state, and its initial control held over K steps.
std::vector<double> InitialState(const Scene& scene);
std::vector<double> InitialControl(const Scene& scene, int num_steps);

}  // namespace saltus
