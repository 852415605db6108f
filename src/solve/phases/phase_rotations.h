// Discs that spin, in a motion through impacts (phase_transcription.h): unknown are their rotations [r angle, r w]
// at the start, just before and just after each of their impacts, and at the end. Between these they turn
// evenly, if nothing but impacts turns them, so that a step in between needs no rotation of its own. Discs under
// torques have one after every step.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "saltus/scene/scene.h"
#include "saltus/simulate/simulator.h"
#include "solve/phases/augmented_lagrangian.h"

namespace saltus {

class PhaseRotations {
 public:
  // Times are the places of unknowns in a list, of which the first is the start. Discs under torques turn as in a step
  // of `flight`; exactly, if it is null. It and the scene must outlive the object.
  PhaseRotations(const Scene& scene, const Simulator* flight);

  // A disc takes part; nothing if it cannot spin.
  void Add(int body);
  // Turns a disc until its next impact, at times[time]. Returns the node just before the impact; -1 if the disc does
  // not spin.
  int TurnTo(int body, int time, std::span<const double> times);
  // A span of equal steps from one time to another.
  struct Span {
    int begin, end, steps;
  };
  // The next ones of a disc that is turned, under torques of which torque / radius of step k stands in a list of
  // unknowns at first + k * stride.
  struct Torques {
    int first, stride;
  };
  void TurnUnder(int body, const Span& span, const Torques& torques, std::span<const double> turns,
                 std::span<const double> times);
  // Returns the node just after an impact, with `gain` more of angular velocity, rad/s.
  int Strike(int body, double gain);
  // The angular velocity that it has got to, rad/s; 0 if it does not spin.
  double SpinOf(int body) const;
  // All turn until the end.
  void End(int time, std::span<const double> times);

  // The node at the beginning of a step of a disc that is turned, counted over all phases; and the last one of any.
  int StepNode(int body, int step) const { return step_nodes_[body][step]; }
  int LastNode(int body) const { return last_[body]; }

  double* At(int node) { return rotations_[node].data(); }
  const double* At(int node) const { return rotations_[node].data(); }

  // After the end: turning and terminal terms, and what is given of the start. `times` and `turns` are the unknowns,
  // `least` as of PushedStep.
  void AddTo(std::span<double> times, std::span<double> turns, double least, AugmentedLagrangian* problem);
  // Copies the rotations at the start into an initial state of the scene.
  void CopyInitial(std::vector<double>* initial) const;

 private:
  bool IsFree(int body) const;  // its angular velocity at the start

  struct Turn {
    int from = 0, to = 0;    // rotations
    int begin = 0, end = 0;  // times
  };

  struct Step {
    int body = 0, from = 0, to = 0;  // rotations
    Span span;
    int index = 0, torque = 0;  // of the step, and of the unknown
  };
  double InverseMass(int body) const;  // r^2 / I

  const Scene& scene_;
  const Simulator* flight_;
  std::vector<std::array<double, 2>> rotations_;
  std::vector<Turn> turns_;
  std::vector<Step> steps_;
  std::vector<std::vector<int>> step_nodes_;  // of each disc
  std::vector<int> initial_, last_, since_;   // of each disc: its first and its last rotation, or -1; the time of that
};

}  // namespace saltus
