#include "saltus/feedback/filter.h"

#include <glog/logging.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <numbers>

#include "feedback/noisy_states.h"

namespace saltus {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

HybridOptions BehindGuards(HybridOptions options) {
  options.wait_behind_guards = true;
  return options;
}

}  // namespace

SaltedKalmanFilter::SaltedKalmanFilter(HybridSystem system, std::vector<double> parameters, double time, int mode,
                                       Eigen::VectorXd mean, Eigen::MatrixXd covariance, HybridOptions integration)
    : simulator_(std::move(system), BehindGuards(integration)),
      parameters_(std::move(parameters)),
      time_(time),
      mode_(mode),
      mean_(std::move(mean)),
      covariance_(std::move(covariance)) {
  CHECK(mode_ >= 0 && mode_ < simulator_.system().num_modes());
  CHECK_EQ(mean_.size(), simulator_.system().state_size(mode_));
  CHECK(covariance_.rows() == mean_.size() && covariance_.cols() == mean_.size());
}

bool SaltedKalmanFilter::Predict(double time, std::span<const double> control, const Eigen::MatrixXd& process) {
  const HybridSystem& system = simulator_.system();
  const double duration = time - time_;
  CHECK_GE(duration, 0.0) << "a filter predicts forwards";
  if (duration == 0) return true;
  HybridInput input{.parameters = parameters_, .duration = duration, .begin = time_};
  input.control.assign(control.begin(), control.end());
  input.control.resize(system.num_controls());
  int mode = mode_;
  Eigen::VectorXd x = mean_;
  Eigen::MatrixXd F = Eigen::MatrixXd::Identity(x.size(), x.size());
  if (!TakeEventsBehindGuards(system, time_, input.control, parameters_, &mode, &x, nullptr, &F)) {
    why_ = "the mean is behind a guard whose resets do not end";
    return false;
  }
  input.mode = mode;
  input.initial.assign(x.data(), x.data() + x.size());
  if (duration > longest_) simulator_.ChooseStepsAnew();
  longest_ = std::max(longest_, duration);
  if (!simulator_.Rollout(input)) {
    why_ = simulator_.WhyFailed();
    return false;
  }
  const HybridSensitivity by = simulator_.IntervalSensitivities()[0];
  const Eigen::Map<const RowMajor> end(by.final_state.data(), by.final_state.size() / by.columns, by.columns);
  F = end.leftCols(x.size()) * F;
  covariance_ = F * covariance_ * F.transpose();
  if (process.size() > 0) {
    CHECK(process.rows() == covariance_.rows() && process.cols() == covariance_.cols()) << "W has another size";
    covariance_ += process;
  }
  const std::span<const double> final_state = simulator_.final_state();
  mean_ = Eigen::Map<const Eigen::VectorXd>(final_state.data(), final_state.size());
  mode_ = simulator_.final_mode();
  time_ = time;
  return true;
}

double SaltedKalmanFilter::Update(const Eigen::VectorXd& z, const Eigen::VectorXd& h, const Eigen::MatrixXd& C,
                                  const Eigen::MatrixXd& V) {
  CHECK(C.rows() == z.size() && C.cols() == mean_.size() && h.size() == z.size());
  CHECK(V.rows() == z.size() && V.cols() == z.size());
  const Eigen::VectorXd innovation = z - h;
  const Eigen::LLT<Eigen::MatrixXd> factors(C * covariance_ * C.transpose() + V);
  CHECK(factors.info() == Eigen::Success) << "the covariance of the measurement is not positive definite";
  const Eigen::MatrixXd gain = factors.solve(C * covariance_).transpose();
  const Eigen::MatrixXd rest = Eigen::MatrixXd::Identity(mean_.size(), mean_.size()) - gain * C;
  mean_ += gain * innovation;
  covariance_ = rest * covariance_ * rest.transpose() + gain * V * gain.transpose();
  const Eigen::VectorXd white = factors.matrixL().solve(innovation);
  double log_determinant = 0;
  for (Eigen::Index i = 0; i < z.size(); ++i) log_determinant += 2 * std::log(factors.matrixLLT()(i, i));
  return -0.5 * (white.squaredNorm() + log_determinant + z.size() * std::log(2 * std::numbers::pi));
}

}  // namespace saltus
