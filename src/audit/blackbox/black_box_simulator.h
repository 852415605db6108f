// A black box as a simulator: rollouts are questions, and derivatives that it does not give are finite differences.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "audit/attribution/contact_run.h"
#include "saltus/audit/black_box.h"

namespace saltus {

// Returns the width of differences by positions, m, for answers with a relative noise, and discs that are up to
// `extent`, m, from the origin and move by `moved`, m, in a step.
double WidthOfDifferences(double noise, double extent, double moved);

class BlackBoxSimulator final : public Simulator {
 public:
  static constexpr int kNumbers = 4;  // of a disc

  BlackBoxSimulator(std::shared_ptr<BlackBox> box, const Scene& scene, Precision precision, const ModelTraits& model,
                    const BlackBoxTraits& traits, const BlackBoxOptions& options)
      : Simulator(scene, precision, model.grid_steps),
        box_(std::move(box)),
        model_(model),
        traits_(traits),
        options_(options) {}

  const ModelTraits& traits() const override { return model_; }
  int body_size() const override { return kNumbers; }
  std::size_t LeastMemory() const override { return 0; }
  std::optional<VariableFreeFlight> FreeFlightOfLength(double) const override { return std::nullopt; }
  const std::vector<StepTouch>& touches() const override { return touches_; }

  bool Rollout(std::span<const double> initial, std::span<const double> control) override;
  void GetState(int k, std::span<double> x) const override;
  void AdjointInto(std::span<const double> cotangent, const SensitivityView& out) override;
  void Step(std::span<const double> x, std::span<const double> force, std::span<double> next,
            std::vector<Touch>* touches) const override;
  void Linearize(std::span<const double> x, std::span<const double> force, bool with_parameters,
                 StepLinearization* linearization) const override;
  void ExpandInitial(std::span<const double> initial, std::span<double> x) const override;

 private:
  // A variable of differences: a number of the initial state, or of the control in some steps of the grid.
  struct Variable {
    int index;  // into the initial state, or into the forces of a step
    bool control;
    int begin, end;
    double width;
  };

  BlackBoxRequest MakeRequest(BlackBoxRequest::Kind kind, int steps) const;
  std::vector<BlackBoxAnswer> RequestAnswers(const std::vector<BlackBoxRequest>& requests) const {
    return box_->Evaluate(scene_, requests, stop_);
  }
  bool Fail(const std::string& why);
  // Returns the forces on all discs in step k of the simulator.
  std::vector<double> ForceIn(int k) const;
  const std::vector<double>& StateAt(int k) const;
  void FindTouches();
  int FindState(std::span<const double> x) const;
  bool AdjointByItself(std::span<const double> cotangent, const SensitivityView& out);
  void AdjointByDifferences(std::span<const double> cotangent, const SensitivityView& out);
  std::vector<Variable> Variables(bool with_control) const;
  double Width(double speed, double extent) const { return WidthOfDifferences(options_.noise, extent, speed * step()); }
  double LargestSpeed(std::span<const double> x) const;

  BlackBoxRequest StepFrom(std::span<const double> x, std::span<const double> force) const;
  std::vector<Touch> TouchesIn(std::span<const double> x, std::span<const double> force,
                               std::span<const double> next) const;
  std::vector<std::vector<int>> IslandsOf(const std::vector<Touch>& touches) const;
  StepLinearization::Island LinearizeIsland(std::span<const double> x, std::span<const double> force,
                                            const std::vector<int>& bodies) const;
  StepLinearization::FreeFlight MeasureFreeFlight() const;

  std::shared_ptr<BlackBox> box_;
  ModelTraits model_;
  BlackBoxTraits traits_;
  BlackBoxOptions options_;
  std::string why_failed_;
  std::vector<double> initial_, control_;            // of the last rollout; the control by steps of the grid
  mutable std::vector<std::vector<double>> states_;  // empty where not known
  mutable int last_found_ = 0;
  std::vector<StepTouch> touches_;
  mutable std::optional<StepLinearization::FreeFlight> free_;
};

// Returns the traits that the box reports for a scene; an error if the scene has more than discs and planes.
BlackBoxTraits TraitsFor(BlackBox* box, const Scene& scene);

// An experiment with a black box: a head-on impact of a pair of the scene, alone and without friction.
//
//   e     speed of separation / closing speed
//   feed  h d(relative velocity at the end) / d(displacement)
//   keep  d(relative position at the end) / d(displacement) - d(relative velocity) / d(displacement) * (time since)
//
// of a displacement of the first disc towards the other before the impact, small beside what it moves in a step: 1 is
// left of it by an impulse at a step boundary, 0 by a projection, -e by an impact whose time is resolved. These are
// measured without forces. The class is that of the same contact under the acceleration that the scene has there: the
// force of some models jumps by it.

// A contact of a scene.
struct HeadOnPair {
  Candidate pair;
  double acceleration = 0;  // of the first towards the other, relative, m/s^2
};

class HeadOnImpact final : public ContactBench {
 public:
  // `noise` is the relative noise of the answers.
  HeadOnImpact(std::shared_ptr<BlackBox> box, const Scene& scene, const HeadOnPair& meeting, double noise,
               const StopRequest& stop);

  // Returns the reason why the experiment is not possible; empty if it is.
  const std::string& reason() const { return reason_; }
  // Length of a step of the simulator on the scene's time grid, s.
  double step() const { return traits_.grid_steps * grid_step_; }

  // The state before is the gap, m, and the closing speed, m/s.
  std::vector<double> FarBefore() const { return {kApproach * speed_ * step(), speed_}; }
  ContactRun Run(double h, std::span<const double> from, bool onset_only) const override;
  NormalMap Linearize(double h, std::span<const double> before_largest) const override;
  // Without intermediate states, every step needs a call of the box with another number of steps.
  int MostSteps() const override { return traits_.states ? ContactBench::MostSteps() : kMostCalls; }

  // Whether the force that gives the first disc its acceleration does not change its velocity in free flight.
  bool IgnoresForce() const;

  // Measures at the scene's steps, or at `finer` times as many: medians over nine phases of the impact within a step.
  // Returns std::nullopt if an answer is missing.
  std::optional<BlackBoxFindings::HeadOn> Measure(int finer) const;

 private:
  static constexpr double kApproach = 12.37;  // steps from the start of the first run to the impact
  static constexpr int kMostCalls = 500;

  struct Motion {
    double position = 0, velocity = 0;  // of the first disc to the other, m, m/s
  };
  // The start of a run: a gap, a closing speed and a relative acceleration.
  struct Start {
    double gap, speed, acceleration;
  };
  BlackBoxRequest MakeRequest(const Start& start, int steps, double h) const;
  Motion MotionIn(std::span<const double> state) const;
  // Returns d(motion) / d(displacement) of these runs; empty if an answer is missing.
  std::vector<Motion> Slopes(const std::vector<Start>& starts, int steps, double h) const;
  std::vector<BlackBoxAnswer> RequestAnswers(const std::vector<BlackBoxRequest>& requests) const;
  // Returns the motion after steps first, first + 1, ...; empty if an answer is missing.
  std::vector<Motion> Motions(const Start& start, double h, int first, int count) const;

  std::shared_ptr<BlackBox> box_;
  double noise_;
  StopRequest stop_;
  Scene scene_;
  double grid_step_;
  int num_steps_;  // of the scene's grid, over which e, keep and feed are measured
  Vec2d towards_;  // the direction in which the first disc moves
  double reach_;   // distance of the first disc from the other, or from the plane, in contact
  double speed_, acceleration_;
  BlackBoxTraits traits_;
  std::string reason_;
};

}  // namespace saltus
