// The run of one contact of a model with one length of step.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "saltus/audit/contact_class.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// The relative motion of two discs, or of a disc and a plane, along their normal.
class PairMotion {
 public:
  // `free` is the free flight of the simulator, which must outlive this object; `force` is on every disc, B x 2.
  PairMotion(const Simulator& simulator, const StepLinearization::FreeFlight& free, const Candidate& pair,
             std::span<const double> force);

  Vec2d NormalAt(std::span<const double> x) const;
  double Speed(std::span<const double> x) const;  // of separation, m/s
  // Returns the change of speed by a step between these states, less that of free flight, m/s.
  double Change(std::span<const double> from, std::span<const double> to) const;
  // Whether the closing speed is no more than the acceleration makes within a few steps.
  bool IsResting(std::span<const double> x) const;
  const StepLinearization::FreeFlight& free() const { return free_; }

 private:
  Vec2d Relative(std::span<const double> x, int offset) const;

  const Simulator& simulator_;
  StepLinearization::FreeFlight free_;
  Candidate pair_;
  Wall<double> wall_;  // of a pair with one
  Vec2d acceleration_;
};

// A pair about to meet, and the state of the scene before it does.
struct Encounter {
  int step = 0;  // of the model's rollout, in which the contact begins
  Candidate pair;
  std::vector<double> before;  // state_size() numbers, up to two steps earlier
  std::vector<double> force;   // on every disc, B x 2
};

// Returns the first contact of the model's rollout that takes a part of a pair's closing speed while nothing else is
// close; std::nullopt if there is none, or if the rollout is not finite.
std::optional<Encounter> FindEncounter(const Contact& contact, const Scene& scene, const StopRequest& stop);

// The effect of a contact on the velocity along the pair's normal.
struct ContactRun {
  bool begins = false;                 // the pair met within the steps allowed
  bool ends = false;                   // and parted, or came to rest
  double concentration = 0;            // largest change of a step / sum of their magnitudes
  double rebound = 0;                  // speed of separation / closing speed; 0 if it rests
  double first_full = 0;               // change in the second step of the contact / closing speed
  int steps = 0;                       // that were run
  int touched = 0;                     // of these, in contact
  std::vector<double> before;          // two steps before the contact
  std::vector<double> before_largest;  // two steps before that of the largest change
};

// Derivatives of the relative normal position and velocity after an impulse by the position before it.
struct NormalMap {
  double position_from_position = 0, velocity_from_position = 0;  // 1, 1/s
};

// Collects the steps of a contact into a run. All speeds and changes are relative to the closing speed.
class RunRecorder {
 public:
  explicit RunRecorder(bool onset_only) : onset_only_(onset_only) {}
  // Adds a step that changed the speed of separation by `change` to `speed`. `touched`: whether the pair may be in
  // contact. `before` is the state kLead steps before it.
  void Add(double change, double speed, bool touched, std::span<const double> before);
  bool ended() const { return run_.ends; }
  bool begun() const { return run_.begins; }
  const ContactRun& Finish();

  static constexpr int kLead = 2;  // steps before a contact from which it is run again

 private:
  bool onset_only_;
  ContactRun run_;
  double largest_ = 0, sum_ = 0;
  int felt_ = 0, at_rest_ = 0;
};

// An experiment with one contact, which can be run with any length of step.
class ContactBench {
 public:
  virtual ~ContactBench() = default;
  // Runs from a state before the contact until it is over; if `onset_only`, only its first two steps. The layout of a
  // state is known to the bench only.
  virtual ContactRun Run(double h, std::span<const double> from, bool onset_only) const = 0;
  // Linearizes the step that follows `before_largest` by two; free flight is divided out.
  virtual NormalMap Linearize(double h, std::span<const double> before_largest) const = 0;
  // The budget of steps of all runs together, after which the class is decided from the runs made.
  virtual int MostSteps() const { return 20'000; }
};

// Recognises the class of a contact from runs with steps of length `h` and finer, the first from the state `before`.
ContactRecognition RecogniseOnBench(const ContactBench& bench, double h, std::vector<double> before,
                                    double restitution);

// The bench of a contact in a model's rollout. All arguments must outlive it; states are those of the simulator.
class ModelBench final : public ContactBench {
 public:
  ModelBench(const Contact& contact, const Scene& scene, const Encounter& encounter, const StopRequest& stop)
      : contact_(contact), scene_(scene), encounter_(encounter), stop_(stop) {}

  ContactRun Run(double h, std::span<const double> from, bool onset_only) const override;
  NormalMap Linearize(double h, std::span<const double> before_largest) const override;

 private:
  // Returns a simulator of one step of length `h`.
  std::unique_ptr<Simulator> MakeSimulatorOfLength(double h) const;

  const Contact& contact_;
  const Scene& scene_;
  const Encounter& encounter_;
  const StopRequest& stop_;
};

}  // namespace saltus
