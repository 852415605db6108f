// Derivatives of a recorded motion: the reverse sweep for cotangents, and the forward sweep for all directions at once.
//
// Both differentiate the steps of the tape as they are. A step to a time of the grid, tau = duration * fraction, has
// the length tau - t, and t is a variable: the time of the event before it. A step to an event has the length s at
// which
//
//   g(x'(x, t, s, p, u), t + s, p) = 0,
//
// so that ds follows from the implicit function theorem. With the reset behind it that is the saltation matrix.
//
// Precondition: an input has all numbers of its control.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "hybrid/motion_tape.h"
#include "hybrid/runge_kutta.h"
#include "hybrid/tied_events.h"
#include "saltus/hybrid/hybrid_simulator.h"

namespace saltus {

// Whether the slopes of a function along a line differ from one side of a point to the other, or from `slope`, its
// derivative there, and do not approach each other nearer to it. `here`: its values at the point. `size`: of a part of
// the line by which the numbers there change by as much as they are. `value`: returns the values at a part of the line,
// or nothing where the function jumps.
bool HasKinkAlong(const Eigen::VectorXd& here, const Eigen::VectorXd& slope, double size,
                  const std::function<std::optional<Eigen::VectorXd>(double)>& value);

class MotionDerivatives {
 public:
  explicit MotionDerivatives(const HybridSystem& system);

  HybridGradient Adjoint(const HybridInput& input, const MotionTape& tape, const std::vector<HybridEvent>& events,
                         const HybridCotangent& cotangent);
  // Its columns of the parameters are zero unless `by_parameters`.
  HybridSensitivity Sensitivity(const HybridInput& input, const MotionTape& tape,
                                const std::vector<HybridEvent>& events, bool by_parameters);
  // Returns for each coincidence of the tape whether the derivative differs on another side: changes of the motion in
  // some directions of the input are compared with those that its events lead to if their order follows the change.
  std::vector<char> FindOneSided(const HybridInput& input, const MotionTape& tape, TiedEvents* tied);
  // A function that is not smooth where the motion is: in some directions of the input, its change on one side is not
  // that on the other.
  struct Kink {
    std::size_t entry = 0;  // of the tape: a reset, a step to the event of a guard, or the first one in the flow
    enum { kReset, kGuard, kFlow } kind = kReset;
    std::vector<std::string> names;  // of the flow or a guard: the numbers that are zero
  };
  std::vector<Kink> FindKinks(const HybridInput& input, const MotionTape& tape);
  // Sets the spread of the tie of a coincidence.
  void Compare(const HybridInput& input, const MotionTape& tape, const Coincidence& coincidence, TiedEvents* tied,
               HybridTie* tie) const;
  // Returns the value of HybridSimulator::IntervalSensitivities().
  std::vector<HybridSensitivity> Intervals(const HybridInput& input, const MotionTape& tape);

  // Returns the change of final state and event times, to first order, if each step that an event cuts, at its
  // beginning or at its end, is taken as two steps of half the length. Changes that are rounding count as none.
  struct Change {
    Eigen::VectorXd final_state;
    std::vector<double> times;
    double of_steps = 0;  // the largest change by a step alone, relative to the largest of its state
  };
  Change CompareWithHalvedCutSteps(const HybridInput& input, const MotionTape& tape, std::size_t num_events);

  // Says which derivative of the system's functions along the motion is the first that is not finite, with function,
  // mode, time and variables; or that derivatives overflow, if all are finite.
  std::string ReasonNotFinite(const HybridInput& input, const MotionTape& tape);

 private:
  void PushForward(const HybridInput& input, const MotionTape& tape, const TapeEntry& entry,
                   const Eigen::RowVectorXd& of_duration, RungeKutta::Tangent* at);
  Eigen::VectorXd CompareWithHalfSteps(const FlowStep& step, const double* after, double* relative);
  bool IsOneSided(const HybridInput& input, const MotionTape& tape, const Coincidence& coincidence,
                  const RungeKutta::Tangent& before, const RungeKutta::Tangent& after, const Eigen::MatrixXd& controls,
                  const Eigen::RowVectorXd& of_duration, TiedEvents* tied);
  // Changes of the input, and of the state at the beginning.
  struct Directions {
    Eigen::MatrixXd controls;
    Eigen::RowVectorXd duration;
    RungeKutta::Tangent begin;
  };
  Directions MakeDirections(const HybridInput& input) const;
  std::vector<std::string> UndecidedAt(const ModePoint& at) const;
  bool StaysAtZero(const ModePoint& at, int guard, const std::vector<double>& slope) const;
  int PieceBeside(ModePoint at, const RungeKutta::Tangent& directions, Eigen::Index column, double sign);
  // The numbers that a function returns at a point, and the mode to which it leads if it is a reset.
  struct Value {
    int mode = 0;
    Eigen::VectorXd numbers;
  };
  bool HasKink(const ModePoint& at, const RungeKutta::Tangent& directions, const double* jacobian, bool reads_control,
               const std::function<Value(const ModePoint&)>& value);
  std::string VariableName(int mode, int column) const;
  FlowStep StepOf(const HybridInput& input, const MotionTape& tape, const TapeEntry& entry) const;

  const HybridSystem& system_;
  RungeKutta integrator_;
  std::vector<double> state_, by_length_, guard_, reset_;
};

}  // namespace saltus
