#include "simulate/flight.h"

#include <glog/logging.h>

#include <algorithm>
#include <utility>

#include "base/time_grid.h"

namespace saltus {
namespace {

DiscArray<Vec2d> Accelerations(const Scene& scene, const double* forces) {
  DiscArray<Vec2d> acceleration;
  for (const Body& body : scene.bodies) acceleration.push_back(body.fixed ? Vec2d(0, 0) : scene.gravity);
  for (int c = 0; c < scene.num_controlled(); ++c) {
    const int body = scene.control.bodies[c];
    acceleration[body] += Vec2d(forces[2 * c], forces[2 * c + 1]) / scene.bodies[body].mass;
  }
  return acceleration;
}

// Returns the angular accelerations of all discs under one row of a control, rad/s^2.
DiscArray<double> Turnings(const Scene& scene, const double* row) {
  DiscArray<double> turning(scene.num_torques() > 0 ? scene.bodies.size() : 0, 0.0);
  for (int t = 0; t < scene.num_torques(); ++t) {
    const Body& body = scene.bodies[scene.control.torque_bodies[t]];
    turning[scene.control.torque_bodies[t]] = row[scene.TorqueIndex(0, t)] * body.radius / body.MomentOfInertia();
  }
  return turning;
}

// Replaces the states by those `s` seconds later.
void Advance(double s, const DiscArray<Vec2d>& acceleration, const DiscArray<double>& turning, DiscStates* x) {
  for (size_t i = 0; i < x->p.size(); ++i) {
    Vec2d &p = x->p[i], &v = x->v[i];
    const Vec2d& a = acceleration[i];
    p = p + s * (v + 0.5 * s * a);
    v = v + s * a;
  }
  for (size_t i = 0; i < x->spin.size(); ++i) x->angle[i] += s * x->spin[i];
  for (size_t i = 0; i < turning.size(); ++i) {
    x->angle[i] += 0.5 * s * s * turning[i];
    x->spin[i] += s * turning[i];
  }
}

// Returns the integral of |q - target|^2 over a piece.
double Integral(const Flight::Piece& piece, const RunningTerm& term) {
  double sum = 0;
  for (double begin = 0; begin < piece.duration;) {
    const auto turn = std::upper_bound(term.times.begin(), term.times.end(), piece.start + begin);
    double end = piece.duration;
    if (turn != term.times.end()) end = std::min(end, *turn - piece.start);
    if (!(end > begin)) end = piece.duration;  // a turn within rounding of here
    for (size_t i = 0; i < kGaussNodes.size(); ++i) {
      const double s = begin + kGaussNodes[i] * (end - begin);
      const Vec2d miss = piece.StateAfter(term.body, s).Get(term.quantity) - TargetAt(term, piece.start + s);
      sum += kGaussWeights[i] * (end - begin) * miss.squaredNorm();
    }
    begin = end;
  }
  return sum;
}

}  // namespace

DiscStates Flight::Piece::StateAfter(double s) const {
  DiscStates x = at_start;
  Advance(s, acceleration, turning, &x);
  return x;
}

Flight::Flight(const Scene& scene, std::span<const double> initial, std::span<const double> control,
               std::span<const double> durations, const ExactRun& run) {
  CHECK(run.ok);
  const size_t width = scene.control_width();
  CHECK_EQ(control.size(), durations.size() * width);
  DiscStates x;
  const size_t moves = 4 * scene.bodies.size();
  for (size_t i = 0; i < moves; i += 4) {
    x.p.push_back({initial[i], initial[i + 1]});
    x.v.push_back({initial[i + 2], initial[i + 3]});
  }
  for (size_t i = moves; i < initial.size(); i += kSpin) {
    x.angle.push_back(initial[i]);
    x.spin.push_back(initial[i + 1]);
  }
  pieces_.reserve(durations.size() + run.places.size());
  double start = 0;
  size_t next = 0;
  for (size_t k = 0; k < durations.size(); ++k) {
    const DiscArray<Vec2d> acceleration = Accelerations(scene, control.data() + k * width);
    const DiscArray<double> turning = Turnings(scene, control.data() + k * width);
    const double h = durations[k], margin = kNodeMargin * h;
    double now = 0;  // since the start of the interval
    const auto fly_to = [&](double to) {
      if (to - now > margin) {
        Piece& piece = pieces_.emplace_back();  // in place, as it is large
        piece.interval = static_cast<int>(k);
        piece.start = start + now;
        piece.duration = to - now;
        piece.at_start = x;
        piece.acceleration = acceleration;
        piece.turning = turning;
      }
      Advance(to - now, acceleration, turning, &x);
      now = to;
    };
    while (next < run.places.size() && run.places[next].interval == static_cast<int>(k)) {
      const Candidate& c = run.contacts[next];
      const double at = std::clamp(run.places[next].time, now, h);
      fly_to(at);
      const ImpactConstants law = MakeImpactConstants(scene, c);
      Hit hit{start + at, c, static_cast<int>(pieces_.size()), IsOnNode(at, h), x, {}};
      const Vec2d other = c.plane ? Vec2d(0, 0) : x.v[c.b];
      hit.impact = MakeImpact<double>(law, SeparationOf(scene, c, x.p).normal, x.v[c.a] - other, x.SpinsOf(c));
      x.v[c.a] += law.inverse_mass_a * hit.impact.impulse;
      if (!c.plane) x.v[c.b] -= law.inverse_mass_b * hit.impact.impulse;
      if (law.Spins()) {
        x.spin[c.a] += SpinGain(law, 0, hit.impact);
        if (!c.plane) x.spin[c.b] += SpinGain(law, 1, hit.impact);
      }
      hits_.push_back(std::move(hit));
      ++next;
    }
    fly_to(h);
    start += h;
  }
  end_ = std::move(x);
}

DiscStates Flight::StatesBefore(double time) const {
  const auto after = std::ranges::partition_point(pieces_, [&](const Piece& piece) { return piece.start < time; });
  const Piece& piece = after == pieces_.begin() ? *after : *(after - 1);
  return piece.StateAfter(std::min(time - piece.start, piece.duration));
}

Vec2d InitialAcceleration(const Scene& scene, int body) {
  if (scene.bodies[body].fixed) return Vec2d(0, 0);
  Vec2d acceleration = scene.gravity;
  for (int c = 0; c < scene.num_controlled(); ++c) {
    if (scene.control.bodies[c] == body) acceleration += scene.control.initial[c] / scene.bodies[body].mass;
  }
  return acceleration;
}

double RunningLoss(const Scene& scene, const Flight& flight) {
  double loss = 0;
  for (const RunningTerm& term : scene.objective.running) {
    for (const Flight::Piece& piece : flight.pieces()) loss += term.weight * Integral(piece, term);
  }
  for (const ViaTerm& term : scene.objective.via) {
    if (term.hard) continue;
    const DiscStates x = flight.StatesBefore(term.time);
    const Vec2d& q = term.quantity == TerminalTerm::Quantity::kPosition ? x.p[term.body] : x.v[term.body];
    loss += term.weight * (q - term.target).squaredNorm();
  }
  return loss;
}

}  // namespace saltus
