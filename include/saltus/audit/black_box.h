// A simulator that others wrote, asked for final states and, where it has more, for more.
//
// Everything that takes a contact model takes one, by ContactOf(): rollouts are questions to it, gradients are its own
// or else differences of its final states, of a width that its precision allows. AuditBlackBox says what that is worth.
// Shapes are those of simulate/simulator.h, with four numbers for a disc.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "saltus/audit/audit.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// A question for a black box, which starts each one afresh, whatever it has been asked before.
struct Question {
  enum class Kind {
    kSimulate,  // the final state from an initial one
    kGradient,  // likewise, and the derivatives of of_final . (final state)
    kStep       // the state after one step of length `duration` from any state, under the forces `control` on all discs
  };
  Kind kind = Kind::kSimulate;
  int steps = 1;                 // of the scene's time grid, a multiple of BlackBoxTraits::grid_steps
  double duration = 0;           // s, of all steps
  std::vector<double> initial;   // B x 4
  std::vector<double> control;   // steps x C x 2; of kStep, B x 2
  std::vector<double> of_final;  // kGradient: B x 4
  bool states = false;           // kSimulate: those in between, too, of simulators that give them
  bool parameters = false;       // kGradient: by parameters of the scene, too, of simulators that give them
};

struct Answer {
  std::string error;            // why there is none
  std::vector<double> final;    // B x 4
  std::vector<double> states;   // (steps / grid_steps + 1) x B x 4, if asked for
  std::vector<double> initial;  // kGradient: B x 4
  std::vector<double> control;  // kGradient: steps x C x 2
  // kGradient: derivatives by parameters, with their names (scene_parameter.h), if asked for and given.
  std::vector<std::pair<std::string, double>> parameters;
};

// The answer of a black box about itself and a scene.
struct BlackBoxTraits {
  std::string name;            // as it calls itself; may be empty
  std::string not_applicable;  // why it cannot take the scene
  std::string error;           // why it cannot be asked at all
  bool gradient = false, step = false, states = false;
  int grid_steps = 1;  // numbers of steps that it takes are multiples of this
};

class BlackBox {
 public:
  virtual ~BlackBox() = default;

  virtual const std::string& name() const = 0;  // the row's name

  // Steps, duration, initial states and forces of the scene are without meaning: each question has its own.
  virtual BlackBoxTraits Describe(const Scene& scene) = 0;
  // Answers in the order of the questions. Thread-safe. If stopped, those missing have the error kStopped.
  virtual std::vector<Answer> Ask(const Scene& scene, const std::vector<Question>& questions,
                                  const StopRequest& stop) = 0;
};

// How questions are turned into derivatives.
struct AskingOptions {
  double noise = 0;          // relative, of the answers: widths of differences grow with it; 0 is that of double
  bool differences = false;  // of final states, even if the simulator gives a gradient
  int segments = 2;          // equal parts of the horizon in which differences change the control
  bool touches = false;      // find out what touches in a rollout, where the simulator gives steps
};

// The black box as a contact model of its name, which has no colon, for scenes that it takes like `traits` says.
Contact ContactOf(std::shared_ptr<BlackBox> box, const BlackBoxTraits& traits, const AskingOptions& options = {});

// Makes a contact model of a black box, with widths that suit the noise of its answers, which is measured.
Contact MeasuredContactOf(const std::shared_ptr<BlackBox>& box, const Scene& scene, const StopRequest& stop = nullptr);

// The time, s, within which an audit is planned, from the time that its first gradient takes; 0: no limit.
struct AuditTime {
  double seconds = 0;
  std::function<double()> clock = nullptr;  // s, from any start; null: a steady clock
};

// Audits a black box as AuditModel() does, with differences of final states in place of a gradient that the simulator
// does not give. The class is that of a head-on impact of the first pair that collides in exact dynamics. If it fails,
// that is the reason of the gradient. The verdict is kUnknown, and the first remark says why, if answers to the same
// question differ by so much that they decide derivatives, or if no study that gives a verdict fits into the time.
ModelAudit AuditBlackBox(const std::shared_ptr<BlackBox>& box, const Scene& scene,
                         const std::optional<ModelGradient>& reference, const AuditOptions& options = {},
                         const AuditTime& time = {});

}  // namespace saltus
