// A motion through a given sequence of impacts as a constrained least squares problem in which every step is a cost.
//
// The cuts (impacts, and instants that terms of the objective name) divide [0, T] into phases of free length. Unknown
// are the times of the cuts, the nodes of every disc that the problem concerns and the forces of each step, or in place
// of these the positions or velocities at the start that the scene optimizes; impacts happen only between phases, so
// every function is smooth. The functions are those of control/phase_costs.h; steps may be those of a contact model
// instead of exact arcs (control/model_step.h).
//
// Numbers are expected to be of order one: the scene is one without units (its lengths, times and loss of order one).
#pragma once

#include <array>
#include <functional>
#include <optional>
#include <vector>

#include "control/phase_costs.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/control/own_term.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/simulator.h"
#include "solve/phases/augmented_lagrangian.h"
#include "solve/phases/phase_rotations.h"

namespace saltus {

struct PhaseCut {
  std::optional<Candidate> impact;  // none: an instant that does not move
  double time = 0;                  // s; of an impact, where the search starts
  double overlap = 0;               // of the contact distance: the gap at the impact is less than nothing by so much
  std::optional<ContactMode> mode = {};  // of the impact: slips or sticks; none: by Coulomb's law
};

// A piecewise constant control: an entry of its rows (Scene::control_width()) at time t.
using ControlAt = std::function<double(int entry, double t)>;

class PhaseTranscription {
 public:
  // `steps` has one number a phase, cuts.size() + 1 in all; a phase of no steps has no length, and its impact happens
  // at the time of the next cut (or the final time). Nodes start where the discs get from the scene's initial state
  // under `force`, with the impacts at the times of their cuts, whatever the gaps there. Preconditions: cuts rise in
  // time within [0, T]; some phase has steps. `terms` must outlive this object. The pairs of `apart` never come nearer
  // than the distance at which they touch and `margin` of it, except for the phases that an impact of theirs begins or
  // ends. Discs fly as in a step of `flight`, which must outlive this object and fly over any length; if it is null,
  // exactly.
  PhaseTranscription(const Scene& scene, const std::vector<OwnTerm>& terms, std::vector<PhaseCut> cuts,
                     std::vector<int> steps, const ControlAt& force, const ContactSequence& apart = {},
                     double margin = 0, const Simulator* flight = nullptr);
  PhaseTranscription(const PhaseTranscription&) = delete;

  AugmentedLagrangian::Summary Minimize(AugmentedLagrangian::Options options);

  // The times of the cuts, and the final time.
  std::vector<double> CutTimes() const;
  // Returns the normal velocity just before the impact at each cut, negative if closing; 0 for instants.
  std::vector<double> CutSpeeds();
  double Duration() const { return times_.back(); }
  // Returns the initial state, in the layout of a simulator's.
  std::vector<double> InitialState() const;
  // One row a step, and the steps' lengths.
  void Control(std::vector<double>* control, std::vector<double>* durations) const;

 private:
  using Node = std::array<double, 4>;
  // The nodes of the two sides of an impact; -1 for a side that does not move.
  struct ImpactNodes {
    std::array<int, 2> before = {-1, -1}, after = {-1, -1};
    std::array<int, 2> rotation_before = {-1, -1}, rotation_after = {-1, -1};  // -1: does not spin
  };

  int num_phases() const { return static_cast<int>(steps_.size()); }
  bool Concerns(int body, const ContactSequence& apart) const;
  // Whether a disc has a node at each step, not only at the ends of phases: exact flight without force may be one step.
  bool IsDense(int body) const { return flight_ != nullptr || stepped_[body]; }
  int StepsOf(int body, int phase) const { return IsDense(body) ? steps_[phase] : std::min(steps_[phase], 1); }
  double* NodeAt(int i) { return nodes_[i].data(); }
  double* ForceOn(int body, int phase, int step) {
    return forces_[first_force_[phase] + step * scene_.num_controlled() + place_[body]].data();
  }
  double* Begin(int phase) { return &times_[boundary_[phase]]; }
  double* End(int phase) { return &times_[boundary_[phase + 1]]; }

  void Lay(const ControlAt& force, const ContactSequence& apart);
  void LayTurns(int phase, const ControlAt& force);
  Node FlyOnce(int body, const Node& x, const double* force, double h) const;
  void Strike(int index, std::vector<int>* last);
  std::vector<double*> BlocksOf(const ImpactCut& cut, const ImpactNodes& nodes);
  int AddNode(const Node& node);
  void AddSteps();
  void HoldWhatIsGiven();
  void KeepApartAtStart();
  void AddImpacts();
  void AddBounds();
  void AddTerms();
  void AddRunning(const RunningTerm& term);
  void AddLimit(const SpeedLimit& limit);
  void AddOwn(const OwnTerm& term);
  void KeepApart(const Candidate& pair, double margin);
  double LeastLength() const;

  Scene scene_;
  const std::vector<OwnTerm>& terms_;
  const Simulator* flight_;
  std::vector<PhaseCut> cuts_;
  std::vector<int> steps_;
  std::vector<int> place_;     // of each disc in the control, or -1
  std::vector<bool> stepped_;  // of each disc: something is asked of it at each step
  std::vector<double> times_;  // of the boundaries of phases: 0, those of the cuts, T
  std::vector<int>
      boundary_;  // of each phase and after the last one: which of the times; one that has no length shares it
  std::vector<Node> nodes_;   // the initial ones first
  std::vector<int> initial_;  // of each disc: its first node, or -1
  PhaseRotations rotations_;
  std::vector<std::vector<std::vector<int>>> tracks_;  // of each disc that the problem concerns and phase: its nodes
  std::vector<int> final_;                             // of each disc: its last node
  std::vector<ImpactNodes> impacts_;
  std::vector<std::array<double, 2>> forces_;  // step by step, of all controlled discs
  std::vector<double> turns_;                  // likewise torque / radius of all turned discs
  std::vector<int> first_force_;               // of each phase
  AugmentedLagrangian problem_;
};

}  // namespace saltus
