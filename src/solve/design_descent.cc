#include "solve/design_descent.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "optimality/design_gradient.h"
#include "saltus/control/objective.h"
#include "saltus/scene/scene_parameter.h"

namespace saltus {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kMostSteps = 60, kMostBacktracks = 12;
constexpr double kVanished = 0.3 * kCertificateTolerance;  // of a projected gradient, relative to the costates
constexpr double kLongest = 0.25;                          // of a step, in natural units
constexpr double kSufficient = 1e-4;                       // Armijo's constant
constexpr double kNoise = 1e-11;                           // relative, of losses that solvers find

// A point of the descent.
struct Point {
  VectorXd p, gradient;
  SolveReport report;
  double costate = 1;
  double loss() const { return report.final_loss; }
};

class Descent {
 public:
  Descent(const SolverEntry& solver, const SolveRequest& request, const SolverOptions& options)
      : solver_(&solver), request_(request), options_(options) {
    for (const DesignParameter& design : request.scene.design) ranges_.push_back(RangeOf(design));
  }

  SolveReport Run() {
    const std::vector<double> given = DesignOf(request_.scene);
    std::string why;
    std::optional<Point> start = Evaluate(Eigen::Map<const VectorXd>(given.data(), Size(given)), options_.guess, &why);
    if (!start) return Failed(given, why);
    Point at = std::move(*start);
    const double initial_loss = at.report.initial_loss, initial_violation = at.report.initial_violation;
    losses_ = {initial_loss, at.loss()};
    // A search is for the first point. From there on the sequence is known.
    if (solver_->name == "mode_search") solver_ = FindSolver("ceres_phases");
    bool goes_on = !options_.callback || (options_.callback(0, initial_loss) && options_.callback(1, at.loss()));
    MatrixXd inverse = MatrixXd::Identity(at.p.size(), at.p.size());
    bool vanished = false, stuck = false;
    for (int k = 0; k < kMostSteps && goes_on && !stuck && !Stopped(); ++k) {
      if ((vanished = Largest(Projected(at)) <= kVanished * at.costate)) break;
      std::optional<Point> next = Search(at, Direction(at, inverse));
      if (!next) next = Search(at, Direction(at, inverse = MatrixXd::Identity(at.p.size(), at.p.size())));
      stuck = !next;
      if (stuck) break;
      Update(next->p - at.p, next->gradient - at.gradient, &inverse);
      at = std::move(*next);
      losses_.push_back(at.loss());
      goes_on = !options_.callback || options_.callback(static_cast<int>(losses_.size()) - 1, at.loss());
    }
    SolveReport report = std::move(at.report);
    report.initial_loss = initial_loss;
    report.initial_violation = initial_violation;
    report.losses = losses_;
    report.iterations = iterations_;
    report.evaluations = evaluations_;
    report.seconds = seconds_;
    report.parameters.assign(at.p.begin(), at.p.end());
    report.certificate.reset();
    report.termination = !goes_on || Stopped() ? Termination::kInterrupted
                         : vanished            ? Termination::kConverged
                         : stuck               ? Termination::kNoProgress
                                               : Termination::kIterationLimit;
    report.reason = vanished ? "" : stuck ? "no change of the parameters along the descent lowers the loss" : "";
    return report;
  }

 private:
  static Eigen::Index Size(const std::vector<double>& numbers) { return static_cast<Eigen::Index>(numbers.size()); }
  static double Largest(const VectorXd& v) { return v.size() == 0 ? 0.0 : v.cwiseAbs().maxCoeff(); }
  bool Stopped() const { return options_.stop && options_.stop(); }

  SolveReport Failed(const std::vector<double>& given, const std::string& why) {
    SolveReport report = std::move(last_);
    report.parameters = given;
    if (report.termination == Termination::kConverged) report.termination = Termination::kNoProgress;
    report.reason = why;
    return report;
  }

  // Solves with these parameters. Nothing, and why, if the solver does not converge or there is no derivative.
  std::optional<Point> Evaluate(const VectorXd& p, const std::optional<ControlGuess>& guess, std::string* why) {
    const Scene scene = WithDesign(request_.scene, std::vector<double>(p.begin(), p.end()));
    SolveRequest given = request_;
    given.scene = scene;
    given = WithGivenDesign(std::move(given));
    if (const std::optional<SceneError> error = Validate(given.scene)) {
      *why = error->ToString();
      return std::nullopt;
    }
    SolverOptions options = options_;
    options.guess = guess;
    options.callback = nullptr;
    last_ = solver_->solve(given, options);
    iterations_ += last_.iterations;
    evaluations_ += last_.evaluations;
    seconds_ += last_.seconds;
    if (last_.termination != Termination::kConverged) {
      *why = "with the parameters given, " + std::string(solver_->name) + " does not converge" +
             (last_.reason.empty() ? "" : ": " + last_.reason);
      return std::nullopt;
    }
    const DesignGradient gradient =
        GradientByDesign(scene, last_.initial_state, last_.control, last_.durations, options_.stop);
    if (!gradient.ok()) {
      *why = gradient.reason;
      return std::nullopt;
    }
    Point point{p, Eigen::Map<const VectorXd>(gradient.by.data(), Size(gradient.by)), last_, 1};
    point.costate = std::max(1.0, gradient.costate);
    return point;
  }

  // Whether a parameter is at a bound beyond which the loss would fall.
  bool IsHeld(const Point& at, Eigen::Index i) const {
    return (at.p[i] <= ranges_[i].min && at.gradient[i] > 0) || (at.p[i] >= ranges_[i].max && at.gradient[i] < 0);
  }
  VectorXd Projected(const Point& at) const {
    VectorXd gradient = at.gradient;
    for (Eigen::Index i = 0; i < gradient.size(); ++i) {
      if (IsHeld(at, i)) gradient[i] = 0;
    }
    return gradient;
  }

  // Down, among the parameters that are not held, and not too far.
  VectorXd Direction(const Point& at, const MatrixXd& inverse) const {
    const VectorXd gradient = Projected(at);
    VectorXd direction = -(inverse * gradient);
    for (Eigen::Index i = 0; i < direction.size(); ++i) {
      if (IsHeld(at, i)) direction[i] = 0;
    }
    if (!(direction.dot(gradient) < 0)) direction = -gradient;
    return direction * std::min(1.0, kLongest / std::max(Largest(direction), 1e-300));
  }

  std::optional<Point> Search(const Point& at, const VectorXd& direction) {
    double length = 1;
    for (int i = 0; i < kMostBacktracks && !Stopped(); ++i, length *= 0.5) {
      VectorXd p = at.p + length * direction;
      for (Eigen::Index j = 0; j < p.size(); ++j) p[j] = std::clamp(p[j], ranges_[j].min, ranges_[j].max);
      if (p == at.p) return std::nullopt;
      std::string why;
      std::optional<Point> next = Evaluate(p, ControlGuess{at.report.control, at.report.durations}, &why);
      if (!next) continue;
      const double noise = kNoise * std::max(1.0, std::abs(at.loss()));
      const double needed = kSufficient * at.gradient.dot(p - at.p);
      const bool flatter = Largest(Projected(*next)) < Largest(Projected(at));
      if (next->loss() <= at.loss() + needed || (flatter && next->loss() <= at.loss() + noise)) return next;
    }
    return std::nullopt;
  }

  static void Update(const VectorXd& s, const VectorXd& y, MatrixXd* inverse) {
    const double sy = s.dot(y);
    if (!(sy > 1e-12 * s.norm() * y.norm())) return;
    const MatrixXd left = MatrixXd::Identity(s.size(), s.size()) - s * y.transpose() / sy;
    *inverse = (left * *inverse * left.transpose() + s * s.transpose() / sy).eval();
  }

  const SolverEntry* solver_;
  const SolveRequest& request_;
  const SolverOptions& options_;
  std::vector<ParameterRange> ranges_;
  std::vector<double> losses_;
  SolveReport last_;
  int iterations_ = 0, evaluations_ = 0;
  double seconds_ = 0;
};

}  // namespace

std::string WhyNotDescent(const Scene& scene) {
  const std::string found = "optimize: found " + NameOf(scene.design.front().parameter, scene);
  if (scene.optimize != Optimize::kControl) {
    return found + " without a control; gd, ceres_lbfgs and ceres_lm take parameters alone";
  }
  if (scene.objective.HasConstraints() || !scene.no_contact.empty()) {
    return found + " beside constraints, whose multipliers would be a part of its derivative";
  }
  return "";
}

SolveRequest WithGivenDesign(SolveRequest request) {
  request.scene.design.clear();
  return request;
}

SolveReport DescendDesign(const SolverEntry& solver, const SolveRequest& request, const SolverOptions& options) {
  return Descent(solver, request, options).Run();
}

}  // namespace saltus
