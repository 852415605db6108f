// A simulator that others wrote, asked for final states and, where it has more, for more.
//
// Shapes are those of dynamics/simulator.h, with four numbers for a disc.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "saltus/dynamics/registry.h"

namespace saltus {

// What a black box is asked. It starts each question afresh, whatever it has been asked before.
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
};

struct Answer {
  std::string error;            // why there is none
  std::vector<double> final;    // B x 4
  std::vector<double> states;   // (steps / grid_steps + 1) x B x 4, of simulators that give them
  std::vector<double> initial;  // kGradient: B x 4
  std::vector<double> control;  // kGradient: steps x C x 2
};

// What a black box says of itself and of a scene.
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

}  // namespace saltus
