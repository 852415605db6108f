#include "identify/learned_law.h"

#include <algorithm>
#include <cmath>

#include "identify/statistics.h"

namespace saltus {
namespace {

constexpr int kPoints = 25;  // of the curve

// The standard error of what has these derivatives by the law's parameters.
double ErrorOf(const FitProblem& problem, const FitResult& fit, double factor, const std::vector<double>& slope) {
  double variance = 0;
  for (std::size_t i = 0; i < slope.size(); ++i) {
    const std::vector<double>& row = fit.covariance[problem.num_plain + i];
    for (std::size_t j = 0; j < slope.size(); ++j) variance += slope[i] * row[problem.num_plain + j] * slope[j];
  }
  return std::sqrt(std::max(0.0, factor * variance));
}

}  // namespace

LearnedLaw LearnedLawOf(const FitProblem& problem, const FitResult& fit, double loss_scale) {
  LearnedLaw learned{*problem.LawAt(fit.point.coordinates), 0, {}};
  std::vector<double> approach, sliding;
  for (const MotionAtSamples& motion : fit.motion) {
    for (const Vec2d& speeds : motion.impact_speeds) {
      approach.push_back(speeds[0]);
      sliding.push_back(speeds[1]);
    }
  }
  learned.impacts = static_cast<int>(approach.size());
  if (approach.empty() || fit.covariance.empty()) return learned;
  const auto [slowest, fastest] = std::minmax_element(approach.begin(), approach.end());
  const auto middle = sliding.begin() + static_cast<std::ptrdiff_t>(sliding.size() / 2);
  std::nth_element(sliding.begin(), middle, sliding.end());
  const double factor = CovarianceFactor(problem, fit, loss_scale);
  for (int i = 0; i < kPoints; ++i) {
    const double speed = *slowest + (*fastest - *slowest) * i / (kPoints - 1);
    const ImpactLawAt at = EvaluateLaw(learned.law, speed, *middle);
    learned.curve.push_back({speed,
                             *middle,
                             at.restitution,
                             ErrorOf(problem, fit, factor, at.restitution_slope),
                             at.friction,
                             ErrorOf(problem, fit, factor, at.friction_slope)});
  }
  return learned;
}

LearnedEventFunctions LearnedEventsOf(const FitProblem& problem, const FitResult& fit) {
  LearnedEventFunctions learned{*problem.EventsAt(fit.point.coordinates), {}};
  for (std::size_t s = 0; s < fit.motion.size(); ++s) {
    for (const ImpactState& impact : fit.motion[s].impacts) {
      const int body = impact.candidate.a, number = impact.candidate.b;
      const double radius = problem.scene.bodies[body].radius;
      const Vec2d &position = impact.position[0], &before = impact.velocity[0];
      const EventAt at = EvaluateEvents(learned.functions, number, position, before, radius);
      const Plane& plane = problem.scene.planes[number];
      const double gap = plane.normal.normalized().dot(Vec2d(position - plane.point)) - radius;
      learned.impacts.push_back({static_cast<int>(s), body, number, position, before, at.after, at.normal, gap});
    }
  }
  return learned;
}

}  // namespace saltus
