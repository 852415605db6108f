#include "solve/design_descent.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "control/design_difference.h"
#include "optimality/design_gradient.h"
#include "saltus/scene/scene_parameter.h"

namespace saltus {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kMostSteps = 60, kMostBacktracks = 12;
constexpr std::size_t kMostOptima = 4;                     // of a search, from which a descent starts
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

// Where a descent ends, and the losses at its points.
struct DescentEnd {
  Point at;
  std::vector<double> losses;
  bool vanished = false, stuck = false;
};

class Descent {
 public:
  Descent(const SolverEntry& solver, const SolveRequest& request, const SolverOptions& options)
      : solver_(&solver), request_(request), options_(options) {
    for (const DesignParameter& design : request.scene.design) ranges_.push_back(RangeOf(design));
  }

  SolveReport Run() {
    const std::vector<double> given = DesignOf(request_.scene);
    const VectorXd p = Eigen::Map<const VectorXd>(given.data(), Size(given));
    std::string why;
    std::optional<Point> start = Evaluate(p, options_.guess, &why);
    if (!start) return Failed(given, why);
    const SolveReport first = start->report;
    bool goes_on = !options_.callback || options_.callback(0, first.initial_loss);
    DescentEnd best = Descend(std::move(*start), &goes_on);
    // With other parameters another sequence may be the best: the descent starts from the next optima found as well.
    for (std::size_t i = 1; i < std::min(first.optima.size(), kMostOptima) && goes_on && !Stopped(); ++i) {
      sequence_ = first.optima[i].sequence;
      start = Evaluate(p, std::nullopt, &why);
      if (!start) continue;
      DescentEnd end = Descend(std::move(*start), &goes_on);
      if (end.vanished >= best.vanished && end.at.loss() < best.at.loss()) best = std::move(end);
    }
    SolveReport report = std::move(best.at.report);
    report.solver = solver_->name;
    report.optima = first.optima;
    report.searched = first.searched;
    report.initial_loss = first.initial_loss;
    report.initial_violation = first.initial_violation;
    report.losses = std::move(best.losses);
    report.losses.insert(report.losses.begin(), first.initial_loss);
    report.iterations = iterations_;
    report.evaluations = evaluations_;
    report.seconds = seconds_;
    report.parameters.assign(best.at.p.begin(), best.at.p.end());
    if (solver_->name == "hmp") {
      const Scene scene = WithDesign(request_.scene, report.parameters);
      JudgeParameters(scene, {best.at.gradient.begin(), best.at.gradient.end()}, best.at.costate, &*report.certificate);
    } else {
      report.certificate.reset();
    }
    report.termination = !goes_on || Stopped() ? Termination::kInterrupted
                         : best.vanished       ? Termination::kConverged
                         : best.stuck          ? Termination::kNoProgress
                                               : Termination::kIterationLimit;
    report.reason = best.stuck ? "no change of the parameters along the descent lowers the loss" : "";
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

  DescentEnd Descend(Point at, bool* goes_on) {
    // A search is for the first point. From there on the sequence is known.
    const SolverEntry* const searching = solver_;
    if (solver_->name == "mode_search") solver_ = FindSolver("ceres_phases");
    sequence_.reset();
    DescentEnd end{std::move(at), {}};
    const auto record = [&] {
      end.losses.push_back(end.at.loss());
      ++points_;
      *goes_on = *goes_on && (!options_.callback || options_.callback(points_, end.at.loss()));
    };
    record();
    MatrixXd inverse = MatrixXd::Identity(end.at.p.size(), end.at.p.size());
    for (int k = 0; k < kMostSteps && *goes_on && !Stopped(); ++k) {
      if ((end.vanished = Largest(Projected(end.at)) <= kVanished * end.at.costate)) break;
      std::optional<Point> next = Search(end.at, Direction(end.at, inverse));
      if (!next) {
        inverse = MatrixXd::Identity(end.at.p.size(), end.at.p.size());
        next = Search(end.at, Direction(end.at, inverse));
      }
      end.stuck = !next;
      if (end.stuck) break;
      Update(next->p - end.at.p, next->gradient - end.at.gradient, &inverse);
      end.at = std::move(*next);
      record();
    }
    solver_ = searching;
    return end;
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
    last_ = SolveFrom(given, guess);
    if (last_.termination != Termination::kConverged) {
      *why = "with the parameters given, " + std::string(solver_->name) + " does not converge" +
             (last_.reason.empty() ? "" : ": " + last_.reason);
      return std::nullopt;
    }
    std::vector<ConstraintCertificate> constraints;
    if (scene.objective.HasConstraints()) {
      constraints =
          Certify(given.scene, last_.initial_state, last_.control, last_.durations, options_.stop).constraints;
    }
    DesignGradient gradient =
        GradientByDesign(scene, last_.initial_state, last_.control, last_.durations, constraints, options_.stop);
    if (gradient.ok() && solver_->name == "hmp") DifferentiateLeastLoss(scene, &gradient);
    if (!gradient.ok()) {
      *why = gradient.reason;
      return std::nullopt;
    }
    return Point{p, Eigen::Map<const VectorXd>(gradient.by.data(), Size(gradient.by)), last_, gradient.costate};
  }

  SolveReport SolveFrom(const SolveRequest& given, const std::optional<ControlGuess>& guess) {
    SolverOptions options = options_;
    options.guess = guess;
    options.callback = nullptr;
    if (sequence_) {
      options.sequence = sequence_;
      options.search = false;
    }
    SolveReport report = solver_->solve(given, options);
    iterations_ += report.iterations;
    evaluations_ += report.evaluations;
    seconds_ += report.seconds;
    return report;
  }

  // The loss of hmp is that in continuous time: its derivative is not that of the control that the report has, but is
  // found from solves with other parameters.
  void DifferentiateLeastLoss(const Scene& scene, DesignGradient* gradient) {
    const ControlGuess guess{last_.control, last_.durations};
    const std::size_t impacts = last_.certificate->impacts.size();
    for (std::size_t i = 0; i < scene.design.size() && gradient->ok(); ++i) {
      const std::vector<double> by =
          DifferenceByDesign(scene, DesignOf(scene), i, [&](const std::vector<double>& values) -> std::vector<double> {
            SolveRequest other = request_;
            other.scene = WithDesign(scene, values);
            const SolveReport report = SolveFrom(WithGivenDesign(std::move(other)), guess);
            if (report.termination != Termination::kConverged) return {};
            if (report.certificate->impacts.size() != impacts) return {};
            return {report.final_loss};
          });
      if (by.empty())
        gradient->reason = "no finite difference of the least loss by " + NameOf(scene.design[i].parameter, scene);
      if (!by.empty()) gradient->by[i] = by[0];
    }
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

  // Returns the descent direction among the parameters that are not held, with a bounded length.
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
  std::optional<ContactSequence> sequence_;  // along which to solve; none: that of the options
  SolveReport last_;
  int iterations_ = 0, evaluations_ = 0, points_ = 0;
  double seconds_ = 0;
};

}  // namespace

std::string WhyNotDescent(const Scene& scene) {
  const std::string found = "optimize: found " + NameOf(scene.design.front().parameter, scene);
  if (scene.optimize != Optimize::kControl) {
    return found + " without a control; gd, ceres_lbfgs and ceres_lm take parameters alone";
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
