#include "feedback/feedback_study.h"

#include <cmath>

#include "feedback/noisy_states.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/registry.h"
#include "solve/motion.h"

namespace saltus {
namespace {

constexpr std::size_t kMostNumbers = std::size_t{1} << 26;  // of the matrices of one kind, 512 MiB

// The standard deviation that is given under a name; otherwise that under the name of all, or zero.
double DeviationOf(const FeedbackOptions& options, const std::string& name, const std::string& all = "") {
  double of_all = 0;
  for (const auto& [given, deviation] : options.deviations) {
    if (given == name) return options.scale * deviation;
    if (given == all) of_all = deviation;
  }
  return options.scale * of_all;
}

// A diagonal covariance; none if all are zero.
Eigen::MatrixXd Diagonal(const std::vector<double>& deviations) {
  const Eigen::Map<const Eigen::VectorXd> of(deviations.data(), static_cast<Eigen::Index>(deviations.size()));
  if (of.size() == 0 || of.cwiseAbs().maxCoeff() == 0) return {};
  return of.cwiseAbs2().asDiagonal();
}

// The data by which both kinds of problems are studied.
struct Study {
  const FeedbackOptions& options;
  int threads;
  Plan plan;
  LinearMotion linear;
  Noise noise = {};
  std::vector<Eigen::MatrixXd> Q = {};  // that of each mode, or one
  std::function<std::unique_ptr<Plant>()> make_plant = nullptr;
  std::function<double(const ClosedLoopRun&)> loss = nullptr;  // none: there are no losses
  // The expected loss to first order; set only if there is a loss.
  std::function<double(const Covariance&, const Regulator*)> expected_loss = nullptr;
};

FeedbackStudy Run(const Study& of) {
  const FeedbackOptions& options = of.options;
  FeedbackStudy study;
  for (const LinearInterval& interval : of.linear.intervals) study.times.push_back(interval.begin);
  study.times.push_back(of.linear.end);
  if (!IsFinite(of.linear)) {
    study.reason = "the motion has no derivative";
    return study;
  }
  if (study.reason = Validate(of.noise, of.linear); !study.reason.empty()) return study;
  study.planned = of.plan.states.back();
  study.samples = options.samples;
  if (of.loss) {
    study.loss = of.loss({.final_state = study.planned, .control = of.plan.control});
  }
  const auto loop = [&](const Regulator* regulator) {
    FeedbackStudy::Loop out{.covariance = Propagate(of.linear, of.noise, regulator)};
    if (of.expected_loss) out.expected_loss = of.expected_loss(out.covariance, regulator);
    if (options.samples > 0) {
      out.runs = RunMonteCarlo(of.plan,
                               regulator ? regulator->gains : std::vector<Eigen::MatrixXd>(),
                               of.noise,
                               of.make_plant,
                               {.samples = options.samples, .seed = options.seed, .threads = of.threads},
                               of.loss);
    }
    return out;
  };
  study.open = loop(nullptr);
  const int m = of.plan.num_controls;
  if (m == 0) return study;
  TrackingCost cost{.R = options.control * Eigen::MatrixXd::Identity(m, m), .per_time = true};
  for (const Eigen::MatrixXd& Q : of.Q) cost.Q.push_back(options.state * Q);
  cost.QT = options.final * Eigen::MatrixXd::Identity(study.planned.size(), study.planned.size());
  const Regulator regulator = Track(of.linear, cost);
  if (regulator.gains.empty()) {
    study.reason = kNoRegulator;
    return study;
  }
  study.closed = loop(&regulator);
  study.gains = regulator.gains;
  study.cost_to_go = regulator.cost_to_go;
  return study;
}

std::string ReasonTooLarge(int intervals, int states) {
  if (static_cast<std::size_t>(intervals) * states * states <= kMostNumbers) return "";
  return std::to_string(intervals) + " matrices of " + std::to_string(states) + " x " + std::to_string(states) +
         " numbers do not fit into 512 MiB";
}

Noise NoiseOf(const Scene& scene, const FeedbackOptions& options, int body_size) {
  constexpr const char* kNames[] = {"position", "position", "velocity", "velocity", "angle", "angular_velocity"};
  const auto of_states = [&](const std::string& prefix) {
    std::vector<double> deviations;
    for (const Body& body : scene.bodies) {
      for (int i = 0; i < body_size; ++i) {
        const bool moves = !body.fixed && (i < 4 || body.Spins());
        deviations.push_back(moves ? DeviationOf(options, prefix + kNames[i], prefix + kAllStates) : 0);
      }
    }
    return Diagonal(deviations);
  };
  // The deviations of forces, and of torques divided by radii (simulator.h).
  std::vector<double> controls(2 * scene.control.bodies.size(), DeviationOf(options, "force"));
  for (const int body : scene.control.torque_bodies) {
    controls.push_back(DeviationOf(options, "torque") / scene.bodies[body].radius);
  }
  const auto [initial, process, measured] = kDeviationPrefixes;
  return {of_states(initial), Diagonal(controls), of_states(process), of_states(measured)};
}

}  // namespace

FeedbackStudy StudyFeedback(const Scene& given, const std::vector<double>& initial, const std::vector<double>& control,
                            const std::vector<double>& durations, const FeedbackOptions& options, int threads) {
  double price_of_time = 0;
  Scene scene = FixFinalTime(given, {initial, control, durations}, &price_of_time);
  if (scene.num_controlled() > 0) scene.steps = static_cast<int>(control.size() / scene.control_width());
  FeedbackStudy none;
  none.reason = ReasonTooLarge(scene.steps, static_cast<int>(InitialSize(scene)));
  if (!none.reason.empty()) return none;
  // One step of the plant is one interval of the plan, whatever its model.
  Scene plant_scene = scene;
  plant_scene.steps *= FindContactModel(Contact(options.plant).name())->grid_steps;
  none.reason = ReasonNotApplicable(options.plant, plant_scene);
  if (!none.reason.empty()) return none;
  ScenePlan planned = PlanScene(scene, initial, control, durations);
  none.reason = planned.reason;
  if (!none.reason.empty()) return none;
  const int body_size = static_cast<int>(InitialSize(scene)) / scene.num_bodies(), n = body_size * scene.num_bodies();
  Study study{options, threads, std::move(planned.plan), std::move(planned.linear)};
  study.noise = NoiseOf(scene, options, body_size);
  study.Q = {Eigen::MatrixXd::Identity(n, n)};
  study.make_plant = [&] { return MakePlant(options.plant, plant_scene, planned.lengths); };
  if (scene.objective.running.empty() && scene.objective.via.empty()) {
    const auto width = static_cast<std::size_t>(scene.control_width());
    study.loss = [&, width, body_size, price_of_time](const ClosedLoopRun& run) {
      const std::span<const double> x(run.final_state.data(), static_cast<std::size_t>(run.final_state.size()));
      double loss = TerminalLoss(scene.objective, x, body_size) + price_of_time;
      for (std::size_t k = 0; k < planned.lengths.size(); ++k) {
        loss += EffortLoss(scene.objective, std::span(run.control).subspan(k * width, width), planned.lengths[k]);
      }
      return loss;
    };
    // Both terms are quadratic: that of the final state is the mean over points +-sqrt(r) l_j, where l_j are the
    // columns of a square root of the covariance; that of the effort the sum over such columns.
    study.expected_loss = [&](const Covariance& covariance, const Regulator* regulator) {
      const Eigen::MatrixXd root = RootOfCovariance(covariance.nodes.back());
      const auto r = static_cast<double>(root.cols());
      ClosedLoopRun at{.final_state = study.plan.states.back(), .control = study.plan.control};
      double sum = r == 0 ? study.loss(at) : 0;
      for (Eigen::Index j = 0; j < root.cols(); ++j) {
        for (const double side : {-1.0, 1.0}) {
          at.final_state = study.plan.states.back() + side * std::sqrt(r) * root.col(j);
          sum += study.loss(at) / (2 * r);
        }
      }
      for (std::size_t k = 0; k + 1 < covariance.nodes.size() && study.plan.num_controls > 0; ++k) {
        Eigen::MatrixXd of_control = Eigen::MatrixXd::Zero(study.plan.num_controls, study.plan.num_controls);
        if (study.noise.control.size() > 0) of_control += study.noise.control;
        if (regulator) {
          const Eigen::MatrixXd& K = regulator->gains[k];
          of_control += K * covariance.nodes[k] * K.transpose();
          if (study.noise.measurement.size() > 0) of_control += K * study.noise.measurement * K.transpose();
        }
        const Eigen::MatrixXd columns = RootOfCovariance(of_control);
        sum +=
            EffortLoss(scene.objective, {columns.data(), static_cast<std::size_t>(columns.size())}, planned.lengths[k]);
      }
      return sum;
    };
  }
  FeedbackStudy out = Run(study);
  out.plant = options.plant;
  out.remark = planned.remark;
  return out;
}

FeedbackStudy StudyFeedback(const HybridProblem& problem, const HybridInput& input, const FeedbackOptions& options,
                            int threads) {
  const HybridSystem& system = problem.system;
  HybridSimulator motion(system, problem.integration);
  FeedbackStudy none;
  if (!motion.Rollout(input)) {
    none.reason = motion.FailureReason();
    return none;
  }
  none.reason = ReasonTooLarge(input.num_intervals, system.functions().most_states());
  if (!none.reason.empty()) return none;
  Study study{options, threads, MakePlan(motion, input), Linearize(motion, input)};
  if (none.reason = motion.ReasonNotFinite(); !none.reason.empty()) return none;
  for (int mode = 0; mode < system.functions().num_base_modes(); ++mode) {
    study.Q.push_back(Eigen::MatrixXd::Identity(system.state_size(mode), system.state_size(mode)));
  }
  const auto of_states = [&](const std::string& prefix) {
    std::vector<double> deviations;
    for (int i = 0; i < system.state_size(input.mode); ++i) {
      deviations.push_back(DeviationOf(options, prefix + system.StateName(input.mode, i), prefix + kAllStates));
    }
    return Diagonal(deviations);
  };
  std::vector<double> controls;
  for (int i = 0; i < system.num_controls(); ++i) controls.push_back(DeviationOf(options, system.ControlName(i)));
  const auto [initial, process, measured] = kDeviationPrefixes;
  study.noise = {of_states(initial), Diagonal(controls), of_states(process), of_states(measured)};
  study.make_plant = [&] { return MakePlant(motion, input); };
  FeedbackStudy out = Run(study);
  if (out.reason.empty()) out.remark = motion.ReasonNotDifferentiable();
  return out;
}

double FinalError(const FeedbackStudy& study, const MonteCarlo& runs) {
  if (runs.counted < 2) return std::nan("");
  return std::sqrt(runs.covariance.trace() + (runs.mean - study.planned).squaredNorm());
}

double FinalError(const Covariance& covariance) { return std::sqrt(covariance.nodes.back().trace()); }

}  // namespace saltus
