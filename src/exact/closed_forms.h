// Loss, exact gradient and collisions of simple scenes in closed form, without simulating them step by step.
//
// Two families of scenes have one, with a loss of terminal costs and effort:
//
//   disc among planes   one moving disc; it flies parabolas and strikes planes, one at a time.
//   two discs           two moving discs and no plane; they collide at most once.
//
// Forces are constant in time (Scene::control.initial), gravity is any vector. Between collisions motion is a parabola,
// so the time of a collision is a root of a quadratic (disc and plane) or a quartic (two discs). At a collision with
// unit normal n, normal approach speed v_n < 0 and sliding velocity v_t of the relative motion, Newton's and Coulomb's
// laws give the impulse
//
//   P = p_n n + p_t t,   p_n = -(1 + e) m_eff v_n,   p_t = -sign(v_t) min(mu p_n, m_eff |v_t|).
//
// The gradient is the derivative of these formulas, with that of the time of the collision. Units are SI.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "saltus/scene/geometry.h"
#include "saltus/scene/scene.h"

namespace saltus {

struct ExactEvent {
  enum class Mode { kFrictionless, kSlip, kStick };
  double time = 0;  // s
  std::string a;    // name of a disc
  std::string b;    // name of the other disc, or of the plane
  Mode mode = Mode::kFrictionless;
};

// Derivatives of the loss.
struct ExactGradient {
  std::vector<Vec2d> position;              // by initial position, per body, 1/m
  std::vector<Vec2d> velocity;              // by initial velocity, per body, s/m
  std::vector<std::vector<Vec2d>> control;  // [step][controlled body], 1/N; empty without control
  double restitution = 0;
  double friction = 0;  // where the loss has only a right derivative (mu = 0), that one
};

struct ClosedForm {
  std::string family;  // as above
  double loss = 0;     // terminal + running
  double terminal = 0;
  double running = 0;           // effort * sum |u|^2 dt
  std::vector<Vec2d> position;  // at the final time, per body, m
  std::vector<Vec2d> velocity;  // at the final time, per body, m/s
  ExactGradient gradient;
  std::vector<ExactEvent> events;  // in order of time
};

// Returns the closed form of `scene` under its initial forces, or std::nullopt, and the reason in
// `reason_not_applicable`, if it has none here: another family or loss, or other collisions (a second collision of two
// discs, a corner, a grazing or a resting contact). `scene` must be valid (see Validate).
std::optional<ClosedForm> EvaluateClosedForm(const Scene& scene, std::string* reason_not_applicable = nullptr);

// The initial velocities with which one disc among planes reaches the target exactly.
//
// Along a given sequence of planes the final position is a smooth closed form of the initial velocity (see
// above), so that each sequence gives two equations in two unknowns, solved by Newton's method. A solution
// counts if the disc, released with this velocity, does strike these planes and no others.
//
// Scene: Zhong, Han, Brikis, "Differentiable Physics Simulations with Contacts: Do They Have Correct Gradients w.r.t.
// Position, Velocity and Control?", 2022, task 2. SI units.
struct LaunchSolution {
  Vec2d velocity = Vec2d::Zero();  // m/s
  std::vector<ExactEvent> events;  // what the disc strikes on its way
};

// The velocities of zero loss, in order of increasing speed, for all sequences of at most `max_hits` hits. Newton's
// method starts from the straight line to the target's mirror image and from a lattice around it; a solution that no
// start leads to is missed. Preconditions, else nothing and a reason in `reason_not_applicable`: one moving disc; the
// objective is one squared distance of its final position, without effort.
std::vector<LaunchSolution> FindLaunchSolutions(const Scene& scene, int max_hits = 3,
                                                std::string* reason_not_applicable = nullptr);

}  // namespace saltus
