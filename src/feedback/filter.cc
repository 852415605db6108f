#include "saltus/feedback/filter.h"

#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "base/linear_algebra.h"
#include "base/number_text.h"
#include "feedback/noisy_states.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "scene/scene_rules.h"

namespace saltus {
namespace {

// Returns F P F^T.
Eigen::MatrixXd Transported(const Eigen::MatrixXd& F, const Eigen::MatrixXd& P) {
  return MultiplyByTransposed(Multiply(F, P), F);
}

HybridOptions BehindGuards(HybridOptions options) {
  options.wait_behind_guards = true;
  return options;
}

}  // namespace

namespace internal {

// The motion that the mean of a filter follows.
class FilterMotion {
 public:
  virtual ~FilterMotion() = default;
  // Moves the mean over a time > 0, s, and gives the derivative F of the state at the end by that at the beginning.
  // Returns why it cannot, or an empty text.
  virtual std::string Advance(double from, double duration, std::span<const double> control, int* mode,
                              Eigen::VectorXd* x, Eigen::MatrixXd* F) = 0;
  virtual const std::vector<HybridEvent>& events() const = 0;
};

}  // namespace internal

namespace {

class HybridMotion final : public internal::FilterMotion {
 public:
  HybridMotion(HybridSystem system, std::vector<double> parameters, HybridOptions integration)
      : simulator_(std::move(system), BehindGuards(integration)), parameters_(std::move(parameters)) {}

  const HybridSystem& system() const { return simulator_.system(); }
  const std::vector<HybridEvent>& events() const override { return simulator_.events(); }

  std::string Advance(double from, double duration, std::span<const double> control, int* mode, Eigen::VectorXd* x,
                      Eigen::MatrixXd* F) override {
    HybridInput input{.parameters = parameters_, .duration = duration, .begin = from};
    input.control.assign(control.begin(), control.end());
    input.control.resize(system().num_controls());
    *F = Eigen::MatrixXd::Identity(x->size(), x->size());
    if (!TakeEventsBehindGuards(system(), from, input.control, parameters_, mode, x, nullptr, F)) {
      return "the mean is behind a guard whose resets do not end";
    }
    input.mode = *mode;
    input.initial.assign(x->data(), x->data() + x->size());
    if (!simulator_.RolloutAccurately(input)) return simulator_.FailureReason();
    const HybridSensitivity by = simulator_.IntervalSensitivities()[0];
    if (!simulator_.ReasonNotFinite().empty()) return "the mean has no derivative: " + simulator_.ReasonNotFinite();
    const Eigen::Map<const RowMajor> end(by.final_state.data(), by.final_state.size() / by.columns, by.columns);
    *F = Multiply(end.leftCols(x->size()), *F);
    const std::span<const double> final_state = simulator_.final_state();
    *x = Eigen::Map<const Eigen::VectorXd>(final_state.data(), final_state.size());
    *mode = simulator_.final_mode();
    return "";
  }

 private:
  HybridSimulator simulator_;
  std::vector<double> parameters_;
};

class SceneMotion final : public internal::FilterMotion {
 public:
  SceneMotion(Scene scene, StopRequest stop) : scene_(std::move(scene)), stop_(std::move(stop)) {
    scene_.steps = 1;
    scene_.free.clear();
    scene_.optimize = scene_.num_controlled() > 0 ? Optimize::kControl : Optimize::kNone;
    scene_.objective = {};
  }

  const std::vector<HybridEvent>& events() const override { return no_events_; }

  std::string Advance(double /*from*/, double duration, std::span<const double> control, int* /*mode*/,
                      Eigen::VectorXd* x, Eigen::MatrixXd* F) override {
    std::vector<double> row(control.begin(), control.end());
    row.resize(scene_.control_width());
    const double before = TimeSinceTouch(*x, row);
    Eigen::MatrixXd backwards = Eigen::MatrixXd::Identity(x->size(), x->size());
    if (before > 0) {
      *x = Flown(*x, row, -before);
      const int size = BodySize(*x);
      for (int b = 0; b < scene_.num_bodies(); ++b) {
        if (scene_.bodies[b].fixed) continue;
        for (int j = 0; j < 2; ++j) backwards(size * b + j, size * b + 2 + j) = -before;
        if (size > 4) backwards(size * b + 4, size * b + 5) = -before;
      }
    }
    if (duration + before != scene_.duration || !simulator_) {
      scene_.duration = duration + before;
      simulator_.reset();
      if (std::string reason_not_applicable = ReasonNotApplicable({"event"}, scene_); !reason_not_applicable.empty())
        return reason_not_applicable;
      simulator_ = MakeSimulator({"event"}, scene_, Precision::kDouble);
      simulator_->set_stop(stop_);
    }
    std::vector<double> force(simulator_->force_size());
    simulator_->ExpandForce(row, 0, force);
    const std::span<const double> state(x->data(), static_cast<std::size_t>(x->size()));
    StepLinearization step;
    simulator_->Linearize(state, force, /*with_parameters=*/false, &step);
    Eigen::MatrixXd by_force;
    step.ToDense(F, &by_force);
    *F = Multiply(*F, backwards);
    Eigen::VectorXd next(x->size());
    simulator_->Step(state, force, {next.data(), state.size()});
    if (simulator_->stopped()) return kStopped;
    if (!next.allFinite() || !F->allFinite()) return "the mean has no motion of rigid discs, or no derivative of it";
    *x = next;
    return "";
  }

 private:
  int BodySize(const Eigen::VectorXd& x) const { return static_cast<int>(x.size()) / scene_.num_bodies(); }

  // Returns the state after free flight for a time that may be negative.
  Eigen::VectorXd Flown(Eigen::VectorXd x, std::span<const double> row, double time) const {
    const int size = BodySize(x);
    std::vector<Vec2d> acceleration(scene_.num_bodies(), scene_.gravity);
    for (int c = 0; c < static_cast<int>(scene_.control.bodies.size()); ++c) {
      const int body = scene_.control.bodies[c];
      acceleration[body] += Vec2d(row[2 * c], row[2 * c + 1]) / scene_.bodies[body].mass;
    }
    for (int b = 0; b < scene_.num_bodies(); ++b) {
      if (scene_.bodies[b].fixed) continue;
      for (int j = 0; j < 2; ++j) {
        double &p = x[size * b + j], &v = x[size * b + 2 + j];
        p += time * (v + 0.5 * time * acceleration[b][j]);
        v += time * acceleration[b][j];
      }
      if (size > 4) x[size * b + 4] += time * x[size * b + 5];
    }
    return x;
  }

  bool Overlaps(const Eigen::VectorXd& x) const {
    Scene scene = scene_;
    const int size = BodySize(x);
    for (int b = 0; b < scene.num_bodies(); ++b) scene.bodies[b].position = Vec2d(x[size * b], x[size * b + 1]);
    return FindOverlap(scene).has_value();
  }

  // Returns how long ago overlapping discs touched, s; 0 if none overlap, or if they did not touch within kLongest.
  double TimeSinceTouch(const Eigen::VectorXd& x, std::span<const double> row) const {
    constexpr double kLongest = 1, kRounding = 1e-15;
    if (!Overlaps(x)) return 0;
    double inside = 0, outside = 1e-6;
    while (Overlaps(Flown(x, row, -outside))) {
      inside = outside;
      outside *= 2;
      if (outside > kLongest) return 0;
    }
    while (outside - inside > kRounding + 1e-12 * outside) {
      const double middle = 0.5 * (inside + outside);
      (Overlaps(Flown(x, row, -middle)) ? inside : outside) = middle;
    }
    return outside;
  }

  Scene scene_;
  StopRequest stop_;
  std::unique_ptr<Simulator> simulator_;
  const std::vector<HybridEvent> no_events_;
};

}  // namespace

std::string ValidateEstimate(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance, Eigen::Index size) {
  if (mean.size() != size) {
    return "mean: found " + std::to_string(mean.size()) + " numbers, expected " + std::to_string(size);
  }
  if (!mean.allFinite()) return "mean: found a number that is not finite";
  const std::string wrong = ValidateSymmetric(covariance, size, /*definite=*/false);
  return wrong.empty() ? "" : "covariance: " + wrong;
}

SaltedKalmanFilter::SaltedKalmanFilter(HybridSystem system, std::vector<double> parameters, double time, int mode,
                                       Eigen::VectorXd mean, Eigen::MatrixXd covariance, HybridOptions integration)
    : time_(time), mode_(mode), mean_(std::move(mean)), covariance_(std::move(covariance)) {
  CHECK(mode_ >= 0 && mode_ < system.num_modes());
  CHECK_EQ(ValidateEstimate(mean_, covariance_, system.state_size(mode_)), "");
  motion_ = std::make_unique<HybridMotion>(std::move(system), std::move(parameters), integration);
}

SaltedKalmanFilter::SaltedKalmanFilter(Scene scene, double time, Eigen::VectorXd mean, Eigen::MatrixXd covariance,
                                       StopRequest stop)
    : time_(time), mean_(std::move(mean)), covariance_(std::move(covariance)) {
  CHECK_EQ(ValidateEstimate(mean_, covariance_, InitialSize(scene)), "");
  motion_ = std::make_unique<SceneMotion>(std::move(scene), std::move(stop));
}

SaltedKalmanFilter::~SaltedKalmanFilter() = default;
SaltedKalmanFilter::SaltedKalmanFilter(SaltedKalmanFilter&&) noexcept = default;
SaltedKalmanFilter& SaltedKalmanFilter::operator=(SaltedKalmanFilter&&) noexcept = default;

const std::vector<HybridEvent>& SaltedKalmanFilter::events() const { return motion_->events(); }

bool SaltedKalmanFilter::Predict(double time, std::span<const double> control, const Eigen::MatrixXd& process) {
  CHECK_GE(time, time_) << "a filter predicts forwards";
  why_.clear();
  if (time == time_) return true;
  int mode = mode_;
  Eigen::VectorXd x = mean_;
  Eigen::MatrixXd F;
  why_ = motion_->Advance(time_, time - time_, control, &mode, &x, &F);
  if (!why_.empty()) return false;
  Eigen::MatrixXd covariance = Transported(F, covariance_);
  if (process.size() > 0) {
    if (why_ = ValidateSymmetric(process, x.size(), /*definite=*/false); !why_.empty()) {
      why_ = "process: " + why_;
      return false;
    }
    covariance += process;
  }
  if (!covariance.allFinite()) {
    why_ = "the covariance at t = " + ToText(time) + " is too large for a number of double precision";
    return false;
  }
  covariance_ = std::move(covariance);
  mean_ = std::move(x);
  mode_ = mode;
  time_ = time;
  return true;
}

std::optional<double> SaltedKalmanFilter::Update(const Eigen::VectorXd& z, const Eigen::VectorXd& h,
                                                 const Eigen::MatrixXd& C, const Eigen::MatrixXd& V) {
  CHECK(C.rows() == z.size() && C.cols() == mean_.size() && h.size() == z.size());
  CHECK(V.rows() == z.size() && V.cols() == z.size());
  const Eigen::VectorXd innovation = z - h;
  const Eigen::MatrixXd seen = Multiply(C, covariance_);
  const CholeskySolver factors(MultiplyByTransposed(seen, C) + V);
  why_.clear();
  if (!factors.ok()) {
    why_ = "the covariance of the innovation, C P C' + V, is not positive definite: raise V";
    return std::nullopt;
  }
  const Eigen::MatrixXd gain = factors.Solve(seen).transpose();
  const Eigen::MatrixXd rest = Eigen::MatrixXd::Identity(mean_.size(), mean_.size()) - Multiply(gain, C);
  const Eigen::VectorXd mean = mean_ + Multiply(gain, innovation);
  const Eigen::MatrixXd covariance = Transported(rest, covariance_) + Transported(gain, V);
  const Eigen::VectorXd white = factors.SolveLower(innovation);
  const double likelihood =
      -0.5 * (white.squaredNorm() + factors.LogDeterminant() + z.size() * std::log(2 * std::numbers::pi));
  if (!mean.allFinite() || !covariance.allFinite() || !std::isfinite(likelihood)) {
    why_ = "the measurement, its Jacobian or the covariances are too large for numbers of double precision";
    return std::nullopt;
  }
  mean_ = mean;
  covariance_ = covariance;
  return likelihood;
}

}  // namespace saltus
