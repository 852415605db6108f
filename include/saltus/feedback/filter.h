// An extended Kalman filter whose mean flows through events and whose covariance passes them by saltation matrices
// (Kong, Payne, Zhu, Johnson 2021, The salted Kalman filter).
//
// The mean follows the exact motion of a hybrid system or of a scene. The estimate may be in another mode than the
// truth: before the truth's event, the estimate is already behind its own, or the other way round. The rules are:
//
//   * The mode of the estimate is that of its mean. A measurement corrects the mean and does not change its mode.
//   * A mean that a correction has put behind a guard which falls has the guard's event at once, in the next Predict;
//     its covariance then passes the saltation matrix there. Where the guard rises, its next event is that after the
//     guard has been above zero.
//   * A scene has no modes. If a correction makes discs of the mean overlap that approach each other, the prediction
//     begins where they touched: the mean is first continued backwards, in free flight of all discs, until none
//     overlap.
//   * Until the estimate and the truth are in the same mode, the innovations are larger than their covariance predicts.
//     This lasts for about the standard deviation of the time of the event.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "saltus/hybrid/hybrid_simulator.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/simulator.h"

namespace saltus {

namespace internal {
class FilterMotion;
}

// Checks the mean and the covariance of a state of `size` numbers: their sizes, whether they are finite, and whether
// the covariance is symmetric and positive semidefinite. Returns "found x, expected y", or an empty text if they are
// valid.
std::string ValidateEstimate(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance, Eigen::Index size);

class SaltedKalmanFilter {
 public:
  // Filters a hybrid system, from an estimate at `time`. Precondition: the mode exists, ValidateEstimate(mean,
  // covariance, size of its state) is empty, and `parameters` has as many finite numbers as the system has parameters.
  SaltedKalmanFilter(HybridSystem system, std::vector<double> parameters, double time, int mode, Eigen::VectorXd mean,
                     Eigen::MatrixXd covariance, HybridOptions integration = {});
  // Filters a scene, from an estimate at `time`, s. A state has [p_x p_y v_x v_y] of each disc in turn (with spin, [p_x
  // p_y v_x v_y angle, angular velocity]), and a control is a row of control_width() numbers. The scene's initial
  // state, duration and steps play no part. Precondition: the event-driven model is applicable to the scene, and
  // ValidateEstimate(mean, covariance, InitialSize(scene)) is empty. `stop` is asked during each Predict, which
  // fails as soon as the answer is true.
  SaltedKalmanFilter(Scene scene, double time, Eigen::VectorXd mean, Eigen::MatrixXd covariance,
                     StopRequest stop = nullptr);
  ~SaltedKalmanFilter();
  SaltedKalmanFilter(SaltedKalmanFilter&&) noexcept;
  SaltedKalmanFilter& operator=(SaltedKalmanFilter&&) noexcept;

  // Predicts the estimate at a later time under a constant control (none: zeros): P <- F P F' + W, with F the
  // derivative of the flow, saltation matrices included. Returns false if the mean has no motion, if `process`, W, has
  // another size than the state at the end, or if a number is not finite; FailureReason() then gives the reason, and
  // the estimate is as before. Precondition: time >= this->time().
  bool Predict(double time, std::span<const double> control = {}, const Eigen::MatrixXd& process = {});

  // Corrects the estimate by a measurement z = h(x) + error, given h at the mean, its Jacobian C there, and the
  // covariance V of the error, which is positive semidefinite. Returns the log likelihood of the innovation, or
  // std::nullopt if the covariance of the innovation, C P C' + V, is not positive definite or if the result is not
  // finite; FailureReason() then gives the reason, and the estimate is as before. The covariance is updated in Joseph's
  // form. Precondition: for r measurements and a state of n numbers, z and h have r numbers, C is r x n, and V is r x
  // r.
  std::optional<double> Update(const Eigen::VectorXd& z, const Eigen::VectorXd& h, const Eigen::MatrixXd& C,
                               const Eigen::MatrixXd& V);
  // Corrects the estimate by a linear measurement z = C x + error.
  std::optional<double> Update(const Eigen::VectorXd& z, const Eigen::MatrixXd& C, const Eigen::MatrixXd& V) {
    return Update(z, C * mean_, C, V);
  }

  double time() const { return time_; }
  int mode() const { return mode_; }  // 0 for a scene
  const Eigen::VectorXd& mean() const { return mean_; }
  const Eigen::MatrixXd& covariance() const { return covariance_; }
  // Events of the mean of a hybrid system in the last Predict; none of a scene.
  const std::vector<HybridEvent>& events() const;
  // The reason why the last Predict or Update failed; empty if it succeeded.
  const std::string& FailureReason() const { return why_; }

 private:
  std::unique_ptr<internal::FilterMotion> motion_;
  double time_ = 0;
  int mode_ = 0;
  Eigen::VectorXd mean_;
  Eigen::MatrixXd covariance_;
  std::string why_;
};

}  // namespace saltus
