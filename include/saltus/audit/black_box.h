// Simulators of others as black boxes. A black box answers requests for final states and, if it has them, for
// intermediate states, single steps and gradients.
//
// MakeBlackBoxContact() makes a contact model of a black box. Its rollouts are requests, and its gradients are those of
// the simulator or else differences of final states, of a width that its precision allows. AuditBlackBox() audits them.
// Shapes are those of simulate/simulator.h, with four numbers [p_x p_y v_x v_y] for each of the B discs and two for
// each of the C controlled discs: spin and torques are not supported.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "saltus/audit/audit.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// A request to a black box. Its answer does not depend on earlier requests.
struct BlackBoxRequest {
  enum class Kind {
    kSimulate,  // the final state
    kGradient,  // the final state, and the derivatives of the scalar product of `of_final` and the final state
    kStep       // the state after one step of length `duration` from any state, under the forces `control` on all discs
  };
  Kind kind = Kind::kSimulate;
  int steps = 1;                        // of the scene's time grid, a multiple of BlackBoxTraits::grid_steps
  double duration = 0;                  // s, of all steps
  std::vector<double> initial;          // B x 4
  std::vector<double> control;          // N: steps x C x 2; of kStep, B x 2
  std::vector<double> final_cotangent;  // kGradient: B x 4
  bool states = false;                  // kSimulate: asks for intermediate states, if the simulator has them
  bool parameters = false;              // kGradient: asks for derivatives by parameters, if the simulator has them
};

// An answer. Members that were not asked for are empty.
struct BlackBoxAnswer {
  std::string error;            // why there is no answer; empty if there is one
  std::vector<double> final;    // B x 4
  std::vector<double> states;   // (steps / grid_steps + 1) x B x 4, if asked for
  std::vector<double> initial;  // kGradient: derivatives by the initial state, B x 4
  std::vector<double> control;  // kGradient: derivatives by the control, steps x C x 2
  // kGradient: derivatives by parameters with their names (scene_parameter.h), if asked for and available.
  std::vector<std::pair<std::string, double>> parameters;
};

// Properties that a black box reports of itself, for a scene.
struct BlackBoxTraits {
  std::string name;                                     // the name that it reports; may be empty
  std::string not_applicable;                           // why it does not support the scene; empty if it does
  std::string error;                                    // why it gives no answers; empty if it does
  bool gradient = false, step = false, states = false;  // answers kGradient, kStep, BlackBoxRequest::states
  bool simulate = true;                                 // answers kSimulate
  bool names = false;     // steps of states by name (blackbox/protocol.h), in place of rows of discs
  bool jacobian = false;  // Jacobians of steps; of hybrid systems
  int grid_steps = 1;     // numbers of steps are multiples of this
};

class BlackBox {
 public:
  virtual ~BlackBox() = default;

  virtual const std::string& name() const = 0;  // the name of its row in tables

  // Returns its properties for a scene, whose steps, duration, initial states and forces are not read: each request has
  // its own.
  virtual BlackBoxTraits Describe(const Scene& scene) = 0;
  // Returns the answers in the order of the requests. Thread-safe. If stopped, missing answers have the error
  // kStopped.
  virtual std::vector<BlackBoxAnswer> Evaluate(const Scene& scene, const std::vector<BlackBoxRequest>& requests,
                                               const StopRequest& stop) = 0;
};

// Options of the derivatives of a black box.
struct BlackBoxOptions {
  double noise = 0;  // relative noise of the answers, by which widths of differences increase; 0: rounding of double
  bool differences = false;  // whether derivatives are differences even if the simulator has a gradient
  int segments = 2;          // equal parts of the horizon in which differences change the control
  bool touches = false;      // whether single steps are asked for to find the contacts of a rollout
};

// Makes a contact model of a black box whose name has no colon. `traits` are those of the scenes that it is used for.
Contact MakeBlackBoxContact(std::shared_ptr<BlackBox> box, const BlackBoxTraits& traits,
                            const BlackBoxOptions& options = {});

// Makes a contact model of a black box. The noise of its answers is measured and determines the widths of differences.
Contact MakeMeasuredContact(const std::shared_ptr<BlackBox>& box, const Scene& scene,
                            const StopRequest& stop = nullptr);

// The time, s, within which an audit is planned, from the time that its first gradient takes; 0: no limit.
struct AuditTime {
  double seconds = 0;
  std::function<double()> clock = nullptr;  // s, from any start; null: a steady clock
};

// Audits a black box as AuditModel() does. Without a gradient of the simulator, differences of final states are
// audited. The class is that of a head-on impact of the first pair that collides in exact dynamics. If the black box
// fails, the reason of the gradient states this. The verdict is kUnknown, with the reason in the first remark, if
// answers to the same request differ by so much that they decide derivatives, or if no study with a verdict fits into
// the time.
ModelAudit AuditBlackBox(const std::shared_ptr<BlackBox>& box, const Scene& scene,
                         const std::optional<ModelGradient>& reference, const AuditOptions& options = {},
                         const AuditTime& time = {});

}  // namespace saltus
