#include "solve/search/loss_bound.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <queue>

#include "saltus/simulate/registry.h"
#include "simulate/flight.h"

namespace saltus {
namespace {

constexpr double kRounding = 1e-9;  // by which a bound is lowered, relative
constexpr int kMostImpacts = 1000;  // of discs that nobody pushes, in their own motion

// The motion of the discs without forces, as long as no pushed disc touches them.
class UncollidedMotion {
 public:
  UncollidedMotion(const Scene& scene, const std::vector<bool>& pushed) : place_(scene.num_bodies(), -1) {
    Scene others = scene;
    others.bodies.clear();
    others.control = {};
    others.no_contact.clear();
    others.objective = {};
    others.optimize = Optimize::kNone;
    others.free.clear();
    others.steps = 1;
    for (int i = 0; i < scene.num_bodies(); ++i) {
      if (pushed[i]) continue;
      place_[i] = others.num_bodies();
      others.bodies.push_back(scene.bodies[i]);
    }
    if (others.bodies.empty()) return;
    const std::vector<double> initial = InitialState(others), durations = {others.duration};
    const ExactRun run = SimulateUpTo(kMostImpacts, others, initial, {}, durations);
    if (!run.ok || !run.only_impacts || !run.ambiguous.empty()) {
      known_ = false;
      return;
    }
    flight_.emplace(others, initial, std::vector<double>{}, durations, run);
    const auto meet = [&](const DiscStates& x) {
      for (const Vec2d& v : x.v) fastest_ = std::max(fastest_, v.norm());
    };
    meet(flight_->end());
    for (const Flight::Piece& piece : flight_->pieces()) {  // speeds are largest at the ends of pieces
      meet(piece.at_start);
      DiscStates end = piece.at_start;
      for (size_t i = 0; i < end.v.size(); ++i) end.v[i] += piece.duration * piece.acceleration[i];
      meet(end);
    }
  }

  bool known() const { return known_; }
  double fastest() const { return fastest_; }
  Vec2d Position(int body, double t) const { return flight_->StatesBefore(t).p[place_[body]]; }
  Vec2d End(int body, TerminalTerm::Quantity quantity) const {
    const DiscStates& end = flight_->end();
    return quantity == TerminalTerm::Quantity::kPosition ? end.p[place_[body]] : end.v[place_[body]];
  }

 private:
  std::vector<int> place_;  // of each disc among the others
  std::optional<Flight> flight_;
  double fastest_ = 0;
  bool known_ = true;
};

class LeastLosses {
 public:
  LeastLosses(const Scene& scene, const std::vector<bool>& pushed)
      : scene_(scene), pushed_(pushed), own_(scene, pushed) {}

  bool known() const { return own_.known(); }

  double BoundWithoutImpact() const {
    double loss = 0;
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      if (pushed_[i]) loss += FreeOptimum(i);
    }
    for (const TerminalTerm& term : scene_.objective.terminal) {
      if (!pushed_[term.body]) {
        loss += term.weight * (own_.End(term.body, term.quantity) - term.target).squaredNorm();
      }
    }
    return loss;
  }

  double BoundWithFirstImpact(const Candidate& pair) const { return BoundWithMinimumEffort(EffortToTouch(pair)); }

 private:
  // The least loss of a pushed disc that flies alone: over what it deviates from its drift at the end, in position and
  // velocity, effort is a quadratic form (event_phases.h) and so are the terms.
  double FreeOptimum(int body) const {
    if (scene_.steps == 1) return 0;  // one force cannot have both; of no use to anyone
    const Body& disc = scene_.bodies[body];
    const double s = scene_.duration, n = scene_.steps;
    const double spread = s * s * s / 12 * (1 - 1 / (n * n));
    const double price = scene_.objective.effort * disc.mass * disc.mass;
    Eigen::Matrix2d effort;
    effort << 1 / spread, -s / (2 * spread), -s / (2 * spread), 1 / s + s * s / (4 * spread);
    double loss = 0;
    for (int axis = 0; axis < 2; ++axis) {
      Eigen::Matrix2d matrix = price * effort;
      Eigen::Vector2d side = Eigen::Vector2d::Zero();
      double constant = 0;
      for (const TerminalTerm& term : scene_.objective.terminal) {
        if (term.body != body) continue;
        const bool position = term.quantity == TerminalTerm::Quantity::kPosition;
        const double drift = position ? Drift(body, s)[axis] : disc.velocity[axis] + s * scene_.gravity[axis];
        const double miss = term.target[axis] - drift;
        matrix(position ? 0 : 1, position ? 0 : 1) += term.weight;
        side[position ? 0 : 1] += term.weight * miss;
        constant += term.weight * miss * miss;
      }
      loss += constant - side.dot(matrix.inverse() * side);
    }
    return std::max(0.0, loss);
  }

  Vec2d Drift(int body, double t) const {
    const Body& disc = scene_.bodies[body];
    return disc.position + t * disc.velocity + 0.5 * t * t * scene_.gravity;
  }
  Vec2d PositionAt(int body, double t) const {
    if (pushed_[body]) return Drift(body, t);
    return scene_.bodies[body].fixed ? scene_.bodies[body].position : own_.Position(body, t);
  }
  // The largest on the way to the first touch.
  double FastestOf(int body) const {
    if (!pushed_[body]) return scene_.bodies[body].fixed ? 0.0 : own_.fastest();
    const Vec2d& v = scene_.bodies[body].velocity;
    return std::max(v.norm(), (v + scene_.duration * scene_.gravity).norm());
  }

  // Returns the distance of a pair that drifts from a touch at time t, m.
  double DistanceAt(const Candidate& c, double t) const {
    const double radius = scene_.bodies[c.a].radius;
    if (c.plane) return Separate<double>(PositionAt(c.a, t), MakeHalfPlane(scene_.planes[c.b])).distance - radius;
    return (PositionAt(c.a, t) - PositionAt(c.b, t)).norm() - radius - scene_.bodies[c.b].radius;
  }

  // A lower bound of effort * integral of |u|^2 until the pair touches.
  double EffortToTouch(const Candidate& c) const {
    constexpr int kMostParts = 400;
    constexpr double kClose = 1e-3;  // relative: between the bound and a value
    double k = 0;
    for (const int body : {c.a, c.plane ? -1 : c.b}) {
      if (body >= 0 && pushed_[body]) k += 1 / (scene_.bodies[body].mass * scene_.bodies[body].mass);
    }
    const double speed = FastestOf(c.a) + (c.plane ? 0.0 : FastestOf(c.b));
    const auto price = [&](double distance, double t) {
      return distance <= 0 ? 0.0 : 3 * scene_.objective.effort * distance * distance / (k * t * t * t);
    };
    struct Part {
      double bound, begin, end;
      bool operator<(const Part& other) const { return bound > other.bound; }
    };
    double value = price(DistanceAt(c, scene_.duration), scene_.duration);
    const auto enclose = [&](double begin, double end) {
      const double distance = DistanceAt(c, 0.5 * (begin + end));
      value = std::min(value, price(distance, 0.5 * (begin + end)));
      return Part{price(distance - 0.5 * (end - begin) * speed, end), begin, end};
    };
    std::priority_queue<Part> parts;
    parts.push(enclose(0, scene_.duration));
    for (int i = 0; i < kMostParts && parts.top().bound < (1 - kClose) * value; ++i) {
      const Part part = parts.top();
      parts.pop();
      const double middle = 0.5 * (part.begin + part.end);
      parts.push(enclose(part.begin, middle));
      parts.push(enclose(middle, part.end));
    }
    return parts.top().bound;
  }

  // The least of E + what terms miss at the reach that effort E >= `least` gives, over E: convex in sqrt(E).
  double BoundWithMinimumEffort(double least) const {
    const double t = scene_.duration;
    double energy = 0, mass = 0, lightest = std::numeric_limits<double>::infinity();
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      const Body& disc = scene_.bodies[i];
      if (disc.fixed) continue;
      energy += disc.mass * disc.velocity.squaredNorm();
      mass += disc.mass;
      if (pushed_[i]) lightest = std::min(lightest, disc.mass);
    }
    // The square root of twice the kinetic energy at time t is at most start + fall t + push sqrt(t E).
    const double start = std::sqrt(energy), fall = scene_.gravity.norm() * std::sqrt(mass);
    const double push = 1 / std::sqrt(lightest * scene_.objective.effort);
    const auto loss = [&](double root) {
      double sum = root * root;
      for (const TerminalTerm& term : scene_.objective.terminal) {
        const Body& disc = scene_.bodies[term.body];
        const bool position = term.quantity == TerminalTerm::Quantity::kPosition;
        const double gain = position ? t * (start + t * (fall / 2) + push * root * std::sqrt(t) * 2 / 3)
                                     : start + t * fall + push * root * std::sqrt(t);
        const double reach = disc.fixed ? 0 : gain / std::sqrt(disc.mass);
        const double away = position ? (term.target - disc.position).norm() : term.target.norm();
        const double miss = std::max(0.0, away - reach);
        sum += term.weight * miss * miss;
      }
      return sum;
    };
    double low = std::sqrt(std::max(0.0, least)), high = low + std::sqrt(loss(low));  // beyond, E alone is more
    for (int i = 0; i < 200; ++i) {
      const double third = (high - low) / 3;
      if (loss(low + third) < loss(high - third)) {
        high -= third;
      } else {
        low += third;
      }
    }
    return loss(0.5 * (low + high));
  }

  const Scene& scene_;
  const std::vector<bool>& pushed_;
  UncollidedMotion own_;
};

}  // namespace

LossBound::LossBound(const Scene& scene) : pushed_(scene.num_bodies(), false) {
  for (const int body : scene.control.bodies) pushed_[body] = true;
  const LeastLosses bounds(scene, pushed_);
  if (!bounds.known()) return;  // a sum of squares is not negative
  lowest_ = without_impact_ = (1 - kRounding) * bounds.BoundWithoutImpact();
  for (const Candidate& pair : AllPairs(scene)) {
    if (!pushed_[pair.a] && (pair.plane || !pushed_[pair.b])) continue;
    first_.push_back({pair, (1 - kRounding) * bounds.BoundWithFirstImpact(pair)});
    lowest_ = std::min(lowest_, first_.back().loss);
  }
}

double LossBound::BoundAlongSequence(const ContactSequence& sequence) const {
  for (const Candidate& pair : sequence) {
    const auto first =
        std::find_if(first_.begin(), first_.end(), [&](const First& known) { return known.pair == pair; });
    if (first != first_.end()) return first->loss;
    if (pushed_[pair.a] || (!pair.plane && pushed_[pair.b])) return 0;  // nothing is known
  }
  return without_impact_;
}

}  // namespace saltus
