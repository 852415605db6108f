#include <algorithm>
#include <cmath>
#include <optional>
#include <sstream>
#include <vector>

#include "base/linear_algebra.h"
#include "control/step_shooting.h"
#include "optimality/hybrid_conditions.h"
#include "saltus/control/objective.h"
#include "saltus/control/scene_problem.h"
#include "solve/shooting/path_problem.h"
#include "solve/shooting/step_shooting_solvers.h"
#include "solve/solve_run.h"

namespace saltus {
namespace {

constexpr double kImprovement = 1e-12;  // of the loss; less is none
constexpr int kIterationsPerNode = 20;  // of Ceres
constexpr int kNewtonSteps = 3;         // at last
constexpr double kRounding = 1e-15;     // of the loss: no worse
constexpr int kPolishes = 10;           // times that the best nodes are solved again, from where they ended
constexpr double kTolerance = 1e-14;    // relative change of the cost that ends them
constexpr double kAside = 1e-7;         // of the radius: the gap at the node where one-sided gradients are taken

// The impacts, each with its nearest node, the nearest first. Nodes that no force could change are left out.
std::vector<Arrival> ImpactsByNearness(const Simulator& simulator) {
  std::vector<std::pair<double, Arrival>> found;
  for (const StepTouch& touch : simulator.touches()) {
    if (touch.touch.time < 0 || touch.touch.kind != ContactKind::kImpact) continue;
    const double nodes = touch.step + touch.touch.time / simulator.step();
    const int node = static_cast<int>(std::lround(nodes));
    if (node >= 2) found.push_back({std::abs(nodes - node), {node, touch.touch.candidate}});
  }
  std::stable_sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<Arrival> arrivals;
  for (const auto& [distance, arrival] : found) arrivals.push_back(arrival);
  return arrivals;
}

// Moves impacts along the nodes of the time grid, for runs that have stalled where the loss has a kink.
class NodeSearch {
 public:
  // Starts at decision variables z of that loss. Precondition: forces are optimized, and the model has exact impact
  // times.
  NodeSearch(SolveRun* run, const std::vector<double>& z, double loss) : run_(run), z_(z), loss_(loss) {}

  // Runs Ceres; returns whether there was an impact. Each iteration of Ceres is recorded with the best loss so far;
  // `iterations` are allowed in all.
  bool Run(int iterations) {
    iterations_left_ = iterations;
    double loss = 0;
    if (!run_->shooting().Evaluate(z_, &loss, nullptr)) return false;
    arrivals_ = ImpactsByNearness(run_->shooting().simulator());
    if (arrivals_.empty()) return false;
    // A run has stalled where some of them are about to cross a node: as many of the nearest as make the loss better.
    while (!TryNodes(arrivals_) && arrivals_.size() > 1) arrivals_.pop_back();
    for (bool better = true; better;) {
      better = false;
      for (size_t i = 0; i < arrivals_.size(); ++i) {
        for (const int direction : {-1, 1}) {
          while (Move(i, direction)) better = true;
        }
      }
    }
    for (int i = 0; i < kPolishes && TryNodes(arrivals_); ++i) continue;
    Polish();
    return true;
  }

  const std::vector<double>& z() const { return z_; }
  double loss() const { return loss_; }
  bool interrupted() const { return interrupted_; }
  bool exhausted() const { return iterations_left_ <= 0; }
  int num_jacobians() const { return num_jacobians_; }
  const std::vector<Arrival>& arrivals() const { return arrivals_; }

  // The theta that balances the one-sided gradients best, and the largest component that is left, as a part of that of
  // the early one. Precondition: the search has ended with one arrival.
  struct Balance {
    double theta = 0;
    double residual = 0;
  };
  std::optional<Balance> BalanceGradients() {
    SingleShooting& shooting = run_->shooting();
    double loss = 0;
    if (!shooting.Evaluate(z_, &loss, nullptr)) return std::nullopt;
    PathProblem problem(&shooting, z_, arrivals_);
    problem.Minimize(0, kTolerance, {});  // linearizes
    const auto gaps = problem.LinearizeGaps();
    if (!gaps) return std::nullopt;
    const Eigen::VectorXd slope = gaps->jacobian.row(0);
    const Eigen::Map<const Eigen::VectorXd> z(z_.data(), z_.size());
    const double gap = kAside * shooting.scene().bodies[arrivals_.front().candidate.a].radius;
    Eigen::VectorXd gradients[2];  // early, late
    for (int side = 0; side < 2; ++side) {
      const Eigen::VectorXd aside = z + (side == 0 ? -gap : gap) / slope.squaredNorm() * slope;
      gradients[side].resize(z_.size());
      if (!shooting.Evaluate({aside.data(), z_.size()}, &loss, gradients[side].data())) return std::nullopt;
    }
    const Eigen::VectorXd jump = gradients[0] - gradients[1];
    Balance balance;
    balance.theta = -gradients[1].dot(jump) / jump.squaredNorm();
    balance.residual = (balance.theta * gradients[0] + (1 - balance.theta) * gradients[1]).lpNorm<Eigen::Infinity>() /
                       gradients[0].lpNorm<Eigen::Infinity>();
    return balance;
  }

 private:
  // Tries the best z with the impacts on these nodes; returns whether it is better than the present one.
  bool TryNodes(const std::vector<Arrival>& arrivals) {
    double loss = 0;
    if (interrupted_ || iterations_left_ <= 0 || !run_->shooting().Evaluate(z_, &loss, nullptr)) return false;
    PathProblem problem(&run_->shooting(), z_, arrivals);
    AfterIteration record(
        [this](const ceres::IterationSummary& summary) { return summary.iteration == 0 || run_->Record(loss_, z_); });
    const ceres::Solver::Summary summary =
        problem.Minimize(std::min(kIterationsPerNode, iterations_left_), kTolerance, {&record});
    interrupted_ = summary.termination_type == ceres::USER_SUCCESS;
    iterations_left_ -= static_cast<int>(summary.iterations.size()) - 1;
    num_jacobians_ += summary.num_jacobian_evaluations;
    std::vector<double> z = PutOntoNodes(problem.z(), arrivals);
    if (!run_->shooting().Evaluate(z, &loss, nullptr) || !(loss < loss_ - kImprovement * loss_)) return false;
    z_ = std::move(z);
    loss_ = loss;
    arrivals_ = arrivals;
    return true;
  }

  bool Move(size_t which, int direction) {
    std::vector<Arrival> arrivals = arrivals_;
    arrivals[which].node += direction;
    const int node = arrivals[which].node;
    return node >= 2 && node <= run_->shooting().simulator().num_steps() && TryNodes(arrivals);
  }

  // Polishes by Newton's method along the nodes, on which the loss is smooth: across them is a kink, at which steps of
  // Ceres that leave a node by rounding are refused.
  void Polish() {
    const Scene& scene = run_->shooting().scene();
    if (scene.objective.effort == 0 || !UnsupportedByHybridProblem(scene).empty()) return;
    const HybridProblem problem = MakeHybridProblem(scene);
    HybridInput input = problem.guess;
    for (int step = 0; step < kNewtonSteps && !interrupted_; ++step) {
      input.control = z_;
      const std::optional<HybridInput> next = AfterNewtonStep(problem, input, /*moving=*/false);
      if (!next) return;
      const std::vector<double> z = PutOntoNodes(next->control, arrivals_);
      double loss = 0;
      if (!run_->shooting().Evaluate(z, &loss, nullptr) || !(loss <= (1 + kRounding) * loss_)) return;
      z_ = z;
      loss_ = loss;
    }
  }

  // Returns decision variables near z with the impacts on the nodes to rounding, where Ceres leaves them nearly; z if
  // that fails.
  std::vector<double> PutOntoNodes(std::vector<double> z, const std::vector<Arrival>& arrivals) {
    constexpr int kCorrections = 3;  // Newton's method, the shortest step; it starts within 1e-6 of the solution
    std::vector<double> corrected = z;
    for (int i = 0; i < kCorrections; ++i) {
      double loss = 0;
      if (!run_->shooting().Evaluate(corrected, &loss, nullptr)) return z;
      PathProblem problem(&run_->shooting(), corrected, arrivals);
      problem.Minimize(0, kTolerance, {});  // linearizes
      const auto gaps = problem.LinearizeGaps();
      if (!gaps) return z;
      const Eigen::MatrixXd& slope = gaps->jacobian;
      const Eigen::VectorXd step = slope.transpose() * SolveLdlt(MultiplyByTransposed(slope, slope), gaps->values);
      if (!step.allFinite()) return z;
      Eigen::Map<Eigen::VectorXd>(corrected.data(), corrected.size()) -= step;
    }
    return corrected;
  }

  SolveRun* run_;
  std::vector<double> z_;
  double loss_;
  std::vector<Arrival> arrivals_;
  int iterations_left_ = 0;
  int num_jacobians_ = 0;
  bool interrupted_ = false;
};

constexpr double kBalanced = 1e-3;  // of the early gradient: what may be left of the sum of both

std::string Describe(const NodeSearch& search, const std::optional<NodeSearch::Balance>& balance) {
  std::ostringstream text;
  text << "impact on node";
  for (const Arrival& arrival : search.arrivals()) text << " " << arrival.node;
  if (balance) text << "; one-sided gradients balance at theta " << balance->theta << ", to " << balance->residual;
  return text.str();
}

// Continues after a stall at decision variables z with that loss; replaces both.
End MoveAlongNodes(SolveRun* run, int iterations, End stall, double* loss, std::vector<double>* z, int* num_jacobians) {
  NodeSearch search(run, *z, *loss);
  if (!search.Run(iterations)) return stall;
  *z = search.z();
  *loss = search.loss();
  *num_jacobians += search.num_jacobians();
  End end{Termination::kNoProgress, ""};
  std::optional<NodeSearch::Balance> balance;
  if (search.interrupted()) {
    end.termination = Termination::kInterrupted;
  } else if (search.exhausted()) {
    end.termination = Termination::kIterationLimit;
  } else if (search.arrivals().size() == 1) {
    balance = search.BalanceGradients();
    const bool stationary = balance && balance->theta >= 0 && balance->theta <= 1 && balance->residual < kBalanced;
    if (stationary) end.termination = Termination::kConverged;
  }
  end.words = Describe(search, balance);
  return end;
}

}  // namespace

SolveReport SolveByCeresShooting(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("ceres_shooting", request, options);
  SingleShooting& shooting = run.shooting();
  std::vector<double> z = run.initial_guess();
  double loss = 0;
  if (!shooting.Evaluate(z, &loss, nullptr)) {
    return run.Finish(z, Termination::kFailed, "loss not finite at iteration 0");
  }
  PathProblem problem(&shooting, z);
  RecordIteration record(
      &run, [&problem](double) { return problem.loss(); }, &problem.z());
  const ceres::Solver::Summary summary = problem.Minimize(options.limits.iterations, kFunctionTolerance, {&record});
  z = problem.z();
  int num_jacobians = summary.num_jacobian_evaluations;
  End end = RecordEnd(&run, &record, z, {summary.termination_type, summary.iterations, false});

  std::optional<double> final_loss;
  const bool kinks = shooting.simulator().traits().event_driven && request.scene.optimize == Optimize::kControl;
  if (kinks && end.termination == Termination::kNoProgress && shooting.Evaluate(z, &loss, nullptr)) {
    end = MoveAlongNodes(&run, options.limits.iterations - (run.num_recorded() - 1), end, &loss, &z, &num_jacobians);
    final_loss = loss;
  }
  std::vector<std::vector<double>> defects;
  if (shooting.Evaluate(z, &loss, nullptr)) {
    final_loss = loss;
    const Simulator& simulator = shooting.simulator();
    defects.push_back(LargestDefects(simulator, StatesOf(simulator), shooting.ControlAt(z)));
  }
  SolveReport report = run.Finish(z, end.termination, end.words, final_loss);
  report.work.evaluations = num_jacobians;
  report.history.defects = std::move(defects);
  return report;
}

}  // namespace saltus
