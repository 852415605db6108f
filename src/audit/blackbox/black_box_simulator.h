// A black box as a simulator: rollouts are questions, and derivatives that it does not give are finite differences.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "saltus/audit/black_box.h"

namespace saltus {

// Returns the width of differences by positions, m, for answers with a relative noise, and discs that are up to
// `extent`, m, from the origin and move by `moved`, m, in a step.
double WidthOfDifferences(double noise, double extent, double moved);

class BlackBoxSimulator final : public Simulator {
 public:
  static constexpr int kNumbers = 4;  // of a disc

  BlackBoxSimulator(std::shared_ptr<BlackBox> box, const Scene& scene, Precision precision, const ModelTraits& model,
                    const BlackBoxTraits& traits, const AskingOptions& options)
      : Simulator(scene, precision, model.grid_steps),
        box_(std::move(box)),
        model_(model),
        traits_(traits),
        options_(options) {}

  const ModelTraits& traits() const override { return model_; }
  int body_size() const override { return kNumbers; }
  std::size_t LeastMemory() const override { return 0; }
  std::optional<FlightOver> FreeFlightOver(double) const override { return std::nullopt; }
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

  Question Ask(Question::Kind kind, int steps) const;
  std::vector<Answer> AnswersTo(const std::vector<Question>& questions) const {
    return box_->Ask(scene_, questions, stop_);
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

  Question StepFrom(std::span<const double> x, std::span<const double> force) const;
  std::vector<Touch> TouchesIn(std::span<const double> x, std::span<const double> force,
                               std::span<const double> next) const;
  std::vector<std::vector<int>> IslandsOf(const std::vector<Touch>& touches) const;
  StepLinearization::Island LinearizeIsland(std::span<const double> x, std::span<const double> force,
                                            const std::vector<int>& bodies) const;
  StepLinearization::FreeFlight MeasureFreeFlight() const;

  std::shared_ptr<BlackBox> box_;
  ModelTraits model_;
  BlackBoxTraits traits_;
  AskingOptions options_;
  std::string why_failed_;
  std::vector<double> initial_, control_;            // of the last rollout; the control by steps of the grid
  mutable std::vector<std::vector<double>> states_;  // empty where not known
  mutable int last_found_ = 0;
  std::vector<StepTouch> touches_;
  mutable std::optional<StepLinearization::FreeFlight> free_;
};

// Returns the traits that the box reports for a scene; an error if the scene has more than discs and planes.
BlackBoxTraits TraitsFor(BlackBox* box, const Scene& scene);

}  // namespace saltus
