#include "solve/shooting/node_search.h"

#include <algorithm>
#include <cmath>

#include "base/linear_algebra.h"
#include "optimality/condensed.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/exact_run.h"

namespace saltus {
namespace {

constexpr double kImprovement = 1e-12;  // of the loss; less is none
constexpr int kIterationsPerNode = 20;  // of Ceres
constexpr int kPolishes = 10;           // times that the best nodes are solved again, from where they ended
constexpr int kNewtonSteps = 3;         // at last
constexpr double kRounding = 1e-15;     // of the loss: no worse
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

// Records the best loss so far.
class RecordBest final : public ceres::IterationCallback {
 public:
  RecordBest(SolveRun* run, double loss, const std::vector<double>* z) : run_(run), loss_(loss), z_(z) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (summary.iteration == 0 || run_->Record(loss_, *z_)) return ceres::SOLVER_CONTINUE;
    return ceres::SOLVER_TERMINATE_SUCCESSFULLY;
  }

 private:
  SolveRun* run_;
  double loss_;
  const std::vector<double>* z_;
};

}  // namespace

NodeSearch::NodeSearch(SolveRun* run, const std::vector<double>& z, double loss) : run_(run), z_(z), loss_(loss) {}

bool NodeSearch::Run(int iterations) {
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

void NodeSearch::Polish() {
  const Scene& scene = run_->shooting().scene();
  if (scene.objective.effort == 0 || !BeyondTerminalCost(scene).empty()) return;
  const std::vector<double> lengths(scene.steps, scene.dt());
  for (int step = 0; step < kNewtonSteps && !interrupted_; ++step) {
    const ExactRun exact = SimulateExactly(scene, InitialState(scene), z_, lengths, run_->options().stop);
    if (!exact.ok || !exact.only_impacts) return;
    const Flight flight(scene, InitialState(scene), z_, lengths, exact);
    std::vector<std::optional<double>> held;
    for (const Flight::Hit& hit : flight.hits()) held.push_back(hit.on_node ? std::optional(0.5) : std::nullopt);
    const auto control = CondensedLoss(scene, flight, z_, lengths, std::move(held)).NewtonStep();
    if (!control) return;
    const std::vector<double> z = PutOntoNodes({control->begin(), control->end()}, arrivals_);
    double loss = 0;
    if (!run_->shooting().Evaluate(z, &loss, nullptr) || !(loss <= (1 + kRounding) * loss_)) return;
    z_ = z;
    loss_ = loss;
  }
}

bool NodeSearch::Move(size_t which, int direction) {
  std::vector<Arrival> arrivals = arrivals_;
  arrivals[which].node += direction;
  const int node = arrivals[which].node;
  return node >= 2 && node <= run_->shooting().simulator().num_steps() && TryNodes(arrivals);
}

bool NodeSearch::TryNodes(const std::vector<Arrival>& arrivals) {
  double loss = 0;
  if (interrupted_ || iterations_left_ <= 0 || !run_->shooting().Evaluate(z_, &loss, nullptr)) return false;
  PathProblem problem(&run_->shooting(), z_, arrivals);
  RecordBest record(run_, loss_, &z_);
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

std::vector<double> NodeSearch::PutOntoNodes(std::vector<double> z, const std::vector<Arrival>& arrivals) {
  constexpr int kCorrections = 3;  // Newton's method, the shortest step; it starts within 1e-6 of the solution
  std::vector<double> corrected = z;
  for (int i = 0; i < kCorrections; ++i) {
    double loss = 0;
    if (!run_->shooting().Evaluate(corrected, &loss, nullptr)) return z;
    PathProblem problem(&run_->shooting(), corrected, arrivals);
    problem.Minimize(0, kTolerance, {});  // linearizes
    const Eigen::MatrixXd slope = problem.GapJacobian();
    const Eigen::VectorXd step = slope.transpose() * SolveLdlt(MultiplyByTransposed(slope, slope), problem.Gaps());
    if (!step.allFinite()) return z;
    Eigen::Map<Eigen::VectorXd>(corrected.data(), corrected.size()) -= step;
  }
  return corrected;
}

std::optional<NodeSearch::Balance> NodeSearch::BalanceGradients() {
  SingleShooting& shooting = run_->shooting();
  double loss = 0;
  if (!shooting.Evaluate(z_, &loss, nullptr)) return std::nullopt;
  PathProblem problem(&shooting, z_, arrivals_);
  problem.Minimize(0, kTolerance, {});  // linearizes
  const Eigen::VectorXd slope = problem.GapJacobian().row(0);
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

}  // namespace saltus
