#include "scene/path_motion.h"

#include <algorithm>

namespace saltus {

bool IsPath(const PrescribedMotion& path) {
  return path.times.size() >= 2 && path.times.size() == path.positions.size() &&
         std::ranges::adjacent_find(path.times, std::ranges::greater_equal()) == path.times.end();
}

// The slopes k_i at the times solve
//
//   h_i k_(i-1) + 2 (h_(i-1) + h_i) k_i + h_(i-1) k_(i+1) = 3 (h_i r_(i-1) + h_(i-1) r_i)
//
// with lengths h_i and mean velocities r_i, and an equation at each end from the continuous third derivative.
PathMotion::PathMotion(const PrescribedMotion& path) : times_(path.times), positions_(path.positions) {
  const std::size_t n = times_.size() - 1;
  std::vector<double> h(n);
  std::vector<Vec2d> r(n);
  for (std::size_t i = 0; i < n; ++i) {
    h[i] = times_[i + 1] - times_[i];
    r[i] = (positions_[i + 1] - positions_[i]) / h[i];
  }
  if (n == 1) {
    slopes_ = {r[0], r[0]};
    return;
  }
  if (n == 2) {
    const Vec2d bend = (r[1] - r[0]) / (h[0] + h[1]);
    slopes_ = {r[0] - h[0] * bend, r[0] + h[0] * bend, r[1] + h[1] * bend};
    return;
  }
  std::vector<double> diagonal(n + 1), above(n + 1), below(n + 1);
  slopes_.resize(n + 1);
  const auto set_end = [&](std::size_t row, std::size_t at, std::size_t beside, std::vector<double>* other) {
    const double sum = h[at] + h[beside];
    diagonal[row] = h[beside];
    (*other)[row] = sum;
    slopes_[row] = ((3 * h[at] + 2 * h[beside]) * h[beside] * r[at] + h[at] * h[at] * r[beside]) / sum;
  };
  set_end(0, 0, 1, &above);
  set_end(n, n - 1, n - 2, &below);
  for (std::size_t i = 1; i < n; ++i) {
    below[i] = h[i];
    diagonal[i] = 2 * (h[i - 1] + h[i]);
    above[i] = h[i - 1];
    slopes_[i] = 3 * (h[i] * r[i - 1] + h[i - 1] * r[i]);
  }
  for (std::size_t i = 1; i <= n; ++i) {
    const double factor = below[i] / diagonal[i - 1];
    diagonal[i] -= factor * above[i - 1];
    slopes_[i] -= factor * slopes_[i - 1];
  }
  slopes_[n] /= diagonal[n];
  for (std::size_t i = n; i-- > 0;) slopes_[i] = (slopes_[i] - above[i] * slopes_[i + 1]) / diagonal[i];
}

PathMotion::Point PathMotion::SampleAt(double time) const {
  const auto next = std::upper_bound(times_.begin() + 1, times_.end() - 1, time);
  const std::size_t i = next - times_.begin() - 1;
  const double h = times_[i + 1] - times_[i], s = time - times_[i];
  const Vec2d r = (positions_[i + 1] - positions_[i]) / h, a = slopes_[i];
  const Vec2d third = (a + slopes_[i + 1] - 2 * r) / (h * h), second = (r - a) / h - h * third;
  return {positions_[i] + s * (a + s * (second + s * third)),
          a + s * (2 * second + 3 * s * third),
          2 * second + 6 * s * third,
          6 * third};
}

Scene ShiftTimeOrigin(Scene scene, double time) {
  const auto move = [time](std::optional<PrescribedMotion>* path, Vec2d* position) {
    if (!*path) return;
    *position = PathMotion(**path).SampleAt(time).position;
    for (double& node : (*path)->times) node -= time;
  };
  for (Body& body : scene.bodies) move(&body.path, &body.position);
  for (Plane& plane : scene.planes) move(&plane.motion, &plane.point);
  return scene;
}

}  // namespace saltus
