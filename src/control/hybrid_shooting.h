// Single shooting of a hybrid system. The decision variables are the free ones among the control (K x m), components
// of the initial state, parameters and the duration.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "hybrid/free_variables.h"
#include "saltus/control/shooting_function.h"
#include "saltus/hybrid/hybrid_problem.h"

namespace saltus {

// The problem with everything free that a motion depends on, without bounds: its variables are the control, the initial
// state, the parameters and the duration.
HybridProblem FreeAllVariables(HybridProblem problem);

// Whether the control, or terms, are given on the intervals of the guess, which must not move with events.
bool IsOnGrid(const HybridProblem& problem);

class HybridShooting : public ShootingFunction {
 public:
  // Precondition: Validate(problem) is empty.
  explicit HybridShooting(const HybridProblem& problem);

  const HybridProblem& problem() const { return problem_; }
  HybridSimulator& simulator() { return simulator_; }
  // Whether every motion is as accurate as the integration's options ask, and not only the first one. The number of
  // steps may then change from one evaluation to the next, and the loss with it, by its error.
  void set_accurate(bool accurate) { accurate_ = accurate; }
  void set_stop(std::function<bool()> stop) { stop_ = std::move(stop); }

  int num_variables() const override { return static_cast<int>(guess_.size()); }
  const std::vector<double>& initial_guess() const override { return guess_; }
  bool Evaluate(std::span<const double> z, double* loss, double* gradient) override;
  std::string FailureReason() const override { return why_; }
  bool stopped() const override { return stopped_; }

  // Costs that read nothing but the control and the length of their interval, in any mode: their residuals have a
  // derivative by few variables, which is not dense as that of others is.
  static bool IsOfIntervalAlone(const HybridTerm& term);
  // Leaves the residuals of such costs out; the loss has them. Returns false, and leaves none out, if there are no
  // others.
  bool LeaveOutCostsOfIntervals();

  // The residuals of equalities come first, then those of inequalities, of costs that are no squares, and of squares.
  // Constraints at each event have none, because their number changes with the motion.
  int num_residuals() const override { return num_residuals_; }
  int num_equalities() const { return num_equalities_; }
  int num_inequalities() const { return num_inequalities_; }
  int num_values() const { return num_values_; }
  bool EvaluateResiduals(std::span<const double> z, double* residuals, double* jacobian) override;
  void ResidualJacobian(double* jacobian) override;

  std::vector<double> InitialStateAt(std::span<const double> z) const override { return InputAt(z).initial; }
  std::vector<double> ControlAt(std::span<const double> z) const override { return InputAt(z).control; }
  std::vector<double> DurationsAt(std::span<const double> z) const override;
  std::vector<double> ParametersAt(std::span<const double> z) const override { return InputAt(z).parameters; }
  int num_adjoints() const override { return num_adjoints_; }

  HybridInput InputAt(std::span<const double> z) const;

  // Computes the loss and the violation of the constraints of any input of the system. Returns false if they do not
  // exist; FailureReason() has the reason.
  struct Outcome {
    double loss = 0;
    double violation = 0;  // the largest |r| of an equality, r of an inequality
    std::string worst;     // the name of that term
  };
  bool Simulate(const HybridInput& input, Outcome* outcome);
  // Whether the last input has a motion, to which a term may not apply.
  bool HasMotion() const { return has_motion_; }

  // A term of the problem at a place of the last motion, for conditions of optimality: its residuals and their
  // derivatives by the blocks that the term reads.
  struct TermAt {
    const HybridTerm* term = nullptr;
    std::shared_ptr<const ceres::CostFunction> function = nullptr;  // FunctionIn() of the term
    int interval = -1, event = -1;                                  // neither: the end
    std::vector<double> residuals;
    std::vector<std::vector<double>> jacobians;  // of the function's blocks, row-major
    std::vector<std::vector<double>> blocks;     // what it reads
  };
  // Returns false if a function has no finite value or derivative there; FailureReason() has the reason.
  bool EvaluateTerms(std::vector<TermAt>* terms);
  const std::vector<FreeVariable>& variables() const { return variables_; }

  // Returns the term by which the loss, of about this size, or a constraint jumps as an event of the last motion
  // crosses the beginning of an interval, where the term reads the state before the event or behind it; nullptr if none
  // does.
  const HybridTerm* FindJumpingTerm(int event, int interval, double loss) const;
  // Returns a remark on the events of the last motion at which the loss jumps so, and on recorded costs that have a
  // kink where the motion is; empty if there are none.
  std::string DescribeJumpsAndKinks(double loss);
  // Returns a remark on the terms at events of which the last motion has none; empty if there are none.
  std::string TermsWithoutEvents() const;

 protected:
  // The motion whose loss is computed: that of the simulator, with located events. A motion of another kind overrides
  // these five. Move() returns false if there is none, with the reason in Fail(); only a motion that was asked for
  // derivatives has those of Adjoint().
  virtual bool Move(const HybridInput& input, bool with_derivatives);
  virtual const std::vector<HybridEvent>& Events() const { return simulator_.events(); }
  virtual int ModeAt(int node) const { return simulator_.ModeAt(node); }  // at the beginning of an interval, or the end
  virtual std::span<const double> StateAt(int node) const { return simulator_.StateAt(node); }
  virtual HybridGradient Adjoint(const HybridCotangent& cotangent) { return simulator_.Adjoint(cotangent); }
  // Keeps the reason why there is no loss, or no derivative of it, and returns false.
  bool Fail(std::string why);

 private:
  // A place in the motion where a term is evaluated, with the data that its function reads.
  struct Place {
    const HybridTerm* term;
    std::shared_ptr<const ceres::CostFunction> function;
    int interval = -1, event = -1;  // neither: the end
    std::span<const double> state;
    double time = 0, length = 0;  // s; of the interval, if there is one
    int first_row = 0;
  };
  // Residuals and Jacobians at a place, one matrix (rows x size, row-major) for each block.
  struct Values {
    std::vector<double> residuals;
    std::vector<std::vector<double>> jacobians;
  };

  bool Rollout(std::span<const double> z, bool with_derivatives = true);
  bool RolloutOf(HybridInput input, bool with_derivatives = true);
  // Finds every place of a term. Returns false if a term is not defined in this motion.
  bool FindPlaces();
  // Returns the function of a term in an interval that begins in a mode, or at the end.
  std::shared_ptr<const ceres::CostFunction> CostInMode(const HybridTerm& term, int mode) const;
  std::vector<const double*> BlocksOf(const Place& place) const;
  // Evaluates a term at a place. Returns false if the function has no finite value.
  bool ValuesAt(const Place& place, bool with_jacobians, Values* values) const;
  std::vector<double>* StateIn(HybridCotangent* cotangent, const Place& place) const;
  // The derivative of weighted residuals: through the motion, and by the parts of the input that terms read directly.
  struct Derivative {
    HybridCotangent cotangent;
    bool reads_motion = false;
    HybridGradient direct;
  };
  Derivative MakeUndefinedDerivative() const;
  // Adds that of the residuals at a place, weighted.
  void PullBack(const Place& place, const Values& values, const Eigen::RowVectorXd& weights, Derivative* sum) const;
  // Returns the derivative by all of the input: by the sensitivities of the motion, or by an adjoint without these.
  HybridGradient TotalOf(Derivative of, const HybridSensitivity* motion);
  std::string DescribeLossJumps(double loss) const;
  std::string DescribeLossKinks();
  // Returns the change of the numbers that a term reads at a place, as the variables change along a direction.
  // `motion`: as of TotalOf().
  Eigen::VectorXd ChangeAt(const Place& place, const HybridSensitivity* motion, const std::vector<double>& direction);
  std::vector<std::string> NamesAt(const Place& place) const;
  int ModeOf(const Place& place) const;
  std::string DescribePlace(const Place& place) const;
  // Keep the reason, as Fail() does.
  bool FailAt(const Place& place);
  bool FailAtDerivatives();

  // Returns whether the residuals of a term are among those of EvaluateResiduals().
  bool HasRows(const HybridTerm& term) const;
  void CountResiduals();

  const HybridProblem problem_;
  HybridSimulator simulator_;
  std::function<bool()> stop_;
  bool stopped_ = false, accurate_ = false, has_motion_ = false;
  HybridInput start_;  // the guess of the problem; without a control that of zeros
  std::vector<FreeVariable> variables_;
  std::vector<double> guess_;
  HybridInput input_;          // of the last rollout
  std::vector<Place> places_;  // of costs, and then of constraints
  bool leaves_out_ = false;    // the residuals of costs of intervals alone
  int num_residuals_ = 0, num_equalities_ = 0, num_inequalities_ = 0, num_values_ = 0;
  std::string why_;
  int num_adjoints_ = 0;
};

}  // namespace saltus
