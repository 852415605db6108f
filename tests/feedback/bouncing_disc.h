// Recordings of a bouncing disc, made by a simulator of its own, and the errors of two filters on them.
//
// The disc has radius 0.1 m, falls under 9.8 m/s^2 and bounces off the ground with restitution 0.8, without friction.
// Its motion is that of the closed form, with small normal errors of the velocity at the times of the samples. Samples
// of the position have normal errors, and one in twenty is an outlier. Both filters have the same mean at the first
// time, the same covariances of all errors, and leave out samples whose innovation has a probability below 0.001.
// Within 0.1 s of a bounce the estimate may be on the other side of it, so that errors are counted farther away.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>
#include <cstdint>

#include "base/linear_algebra.h"
#include "base/random.h"
#include "saltus/feedback/filter.h"
#include "saltus/scene/scene.h"

namespace saltus {

inline constexpr double kDiscRadius = 0.1, kDiscGravity = 9.8, kDiscRestitution = 0.8;

// The state [x y v_x v_y] of the disc after a time, and the derivative by which an extended Kalman filter without
// saltation matrices takes its covariance there: each bounce has the Jacobian of its reset, as if its time were fixed.
inline Eigen::Vector4d BounceFor(Eigen::Vector4d x, double time, Eigen::Matrix4d* without_saltation = nullptr) {
  Eigen::Matrix4d F = Eigen::Matrix4d::Identity();
  const auto fly = [&](double t) {
    x.head<2>() += t * x.tail<2>();
    x[1] -= 0.5 * kDiscGravity * t * t;
    x[3] -= kDiscGravity * t;
    Eigen::Matrix4d flight = Eigen::Matrix4d::Identity();
    flight(0, 2) = flight(1, 3) = t;
    F = flight * F;
  };
  // A mean below the ground is first flown back to it: until then is negative.
  for (int bounces = 0; bounces < 100; ++bounces) {
    const double height = x[1] - kDiscRadius, root = std::sqrt(std::max(x[3] * x[3] + 2 * kDiscGravity * height, 0.0));
    const double until = (x[3] + root) / kDiscGravity;
    const bool again = bounces > 0 && until < 1e-9;
    if (until >= time || again || (height < 0 && x[3] >= 0)) break;
    fly(until);
    time -= until;
    x[3] *= -kDiscRestitution;
    Eigen::Matrix4d reset = Eigen::Matrix4d::Identity();
    reset(3, 3) = -kDiscRestitution;
    F = reset * F;
  }
  fly(time);
  if (without_saltation) *without_saltation = F;
  return x;
}

struct FilterScore {
  double position = 0, velocity = 0;  // mean errors away from bounces, m and m/s
  double covered = 0;                 // share of states inside the ellipsoid of probability 0.95, away from bounces
  double covered_at_all_times = 0;
  int lost = 0;  // recordings on which it failed
};
struct FilterScores {
  FilterScore salted, plain;
};

inline FilterScores CompareFilters(int seeds) {
  using Eigen::Matrix2d, Eigen::Matrix4d, Eigen::MatrixXd, Eigen::Vector2d, Eigen::Vector4d;
  using Matrix42d = Eigen::Matrix<double, 4, 2>;
  constexpr int kSamples = 30;
  constexpr double kStep = 0.1, kMeasured = 0.1, kJolt = 0.02, kOutlier = 0.5, kRare = 13.8155;  // chi squared, 2
  const Matrix4d P0 = Vector4d(0.05, 0.05, 0.3, 0.3).cwiseAbs2().asDiagonal();
  const Matrix4d W = Vector4d(0, 0, kJolt, kJolt).cwiseAbs2().asDiagonal();
  const Matrix2d V = kMeasured * kMeasured * Matrix2d::Identity();
  const MatrixXd C = MatrixXd::Identity(2, 4);
  Scene scene;
  scene.bodies = {{.name = "disc", .radius = kDiscRadius, .position = Vec2d(0, 1.2)}};
  scene.planes = {{.name = "ground", .point = Vec2d(0, 0), .normal = Vec2d(0, 1)}};
  scene.gravity = Vec2d(0, -kDiscGravity);
  scene.contact.restitution = kDiscRestitution;
  FilterScores scores;
  int counted = 0;
  for (int seed = 1; seed <= seeds; ++seed) {
    NormalStream normal(static_cast<std::uint64_t>(seed));
    const auto errors = [&](double x, double y, double vx, double vy) {
      Vector4d e;
      for (double& number : e) number = normal.Next();
      return Vector4d(e.cwiseProduct(Vector4d(x, y, vx, vy)));
    };
    const Vector4d start(0, 1.2, 0.5, 0);
    Vector4d truth = start + errors(0.05, 0.05, 0.3, 0.3);
    SaltedKalmanFilter salted(scene, 0, start, P0);
    Vector4d mean = start;
    Matrix4d P = P0;
    bool ok = true;
    for (int k = 1; k <= kSamples; ++k) {
      truth = BounceFor(truth, kStep) + errors(0, 0, kJolt, kJolt);
      const Vector2d error = errors(kMeasured, kMeasured, 0, 0).head<2>();
      const Vector2d z = truth.head<2>() + (k % 20 == seed % 20 ? Vector2d(kOutlier, kOutlier) : error);
      ok = ok && salted.Predict(k * kStep, {}, W);
      Matrix4d F;
      mean = BounceFor(mean, kStep, &F);
      P = F * P * F.transpose() + W;
      const auto rare = [&](const Eigen::VectorXd& x, const MatrixXd& covariance) {
        const Vector2d innovation = z - x.head<2>();
        return innovation.dot(Matrix2d(covariance.topLeftCorner(2, 2) + V).inverse() * innovation) > kRare;
      };
      if (ok && !rare(salted.mean(), salted.covariance())) salted.Update(z, C, V);
      if (!rare(mean, P)) {
        const Matrix42d gain = P.leftCols<2>() * Matrix2d(P.topLeftCorner<2, 2>() + V).inverse();
        mean += gain * (z - mean.head<2>());
        Matrix4d rest = Matrix4d::Identity();
        rest.leftCols<2>() -= gain;
        P = Matrix4d(rest * P * rest.transpose()) + Matrix4d(kMeasured * kMeasured * gain * gain.transpose());
      }
      // To the bounces before and after.
      const double root = std::sqrt(truth[3] * truth[3] + 2 * kDiscGravity * (truth[1] - kDiscRadius));
      const bool away = root - std::abs(truth[3]) > 0.1 * kDiscGravity;
      const auto score = [&](const Vector4d& x, const Matrix4d& covariance, FilterScore* of) {
        const Vector4d miss = x - truth;
        const double inside = miss.dot(SolveLdlt(covariance, miss)) <= 9.48773 ? 1 : 0;  // chi squared, 4
        of->covered_at_all_times += inside / (seeds * kSamples);
        if (!away) return;
        of->covered += inside;
        of->position += miss.head<2>().norm();
        of->velocity += miss.tail<2>().norm();
      };
      counted += away;
      score(salted.mean(), salted.covariance(), &scores.salted);
      score(mean, P, &scores.plain);
    }
    if (!ok) ++scores.salted.lost;
  }
  for (FilterScore* of : {&scores.salted, &scores.plain}) {
    for (double* sum : {&of->position, &of->velocity, &of->covered}) *sum /= counted;
  }
  return scores;
}

}  // namespace saltus
