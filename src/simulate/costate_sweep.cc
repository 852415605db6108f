#include "simulate/costate_sweep.h"

#include <algorithm>
#include <cmath>

#include "base/time_grid.h"

namespace saltus {
namespace {

using Quantity = TerminalTerm::Quantity;

Vec2d& Part(Costate<double>* costate, Quantity quantity) {
  return quantity == Quantity::kPosition ? costate->position : costate->velocity;
}

// Returns q - target of a running term, `s` seconds after the start of a piece.
Vec2d RunningResidual(const RunningTerm& term, const Flight::Piece& piece, double s) {
  return piece.StateAfter(term.body, s).Get(term.quantity) - TargetAt(term, piece.start + s);
}

// Returns the rate of the target of a running term. Precondition: the target does not turn within the piece.
Vec2d TargetRate(const RunningTerm& term, const Flight::Piece& piece) {
  const double from = piece.start + kGaussNodes.front() * piece.duration;
  const double to = piece.start + kGaussNodes.back() * piece.duration;
  return to > from ? Vec2d((TargetAt(term, to) - TargetAt(term, from)) / (to - from)) : Vec2d(0, 0);
}

}  // namespace

double ImpactJump::MultiplierAt(const Flight::Piece& piece, double speed, double gain) const {
  double power = gain;
  for (int side = 0; side < 2; ++side) {
    if (body[side] < 0) continue;
    const Vec2d& a = piece.acceleration[body[side]];
    power += after[side].position.dot(velocity_after[side]) + after[side].velocity.dot(a) -
             before[side].position.dot(velocity_before[side]) - before[side].velocity.dot(a);
    if (spin_gain[side] != 0) power += after[side].angle * spin_gain[side];
    if (!piece.turning.empty()) {
      power += (after[side].angular_velocity - before[side].angular_velocity) * piece.turning[body[side]];
    }
  }
  return power / speed;
}

Costate<double> FinalCostate(const Scene& scene, const DiscStates& end, int body) {
  const double angle = end.angle.empty() ? 0.0 : end.angle[body], spin = end.spin.empty() ? 0.0 : end.spin[body];
  return TerminalCostate<double>(scene.objective, body, scene.duration, end.p[body], end.v[body], angle, spin);
}

ImpactJump MakeImpactJump(const Scene& scene, const Flight::Hit& hit, const std::array<Costate<double>, 2>& after) {
  const Candidate& c = hit.contact;
  const ImpactConstants law = MakeImpactConstants(scene, c);
  const std::array<double, 2> inverse_mass = {law.inverse_mass_a, law.inverse_mass_b};
  ImpactJump jump;
  jump.after = after;
  Vec2d y(0, 0);
  for (int side = 0; side < 2; ++side) {
    const int body = side == 0 ? c.a : c.plane ? -1 : c.b;
    if (inverse_mass[side] == 0) continue;
    const double sign = side == 0 ? 1 : -1;
    jump.body[side] = body;
    jump.velocity_before[side] = hit.before.v[body];
    jump.velocity_after[side] = hit.before.v[body] + sign * inverse_mass[side] * hit.impact.impulse;
    y += sign * inverse_mass[side] * after[side].velocity;
  }
  const CostateGain<double> gain =
      ImpactAdjoint(law, hit.impact, y, hit.before.SpinsOf(c), {after[0].angular_velocity, after[1].angular_velocity});
  for (int side = 0; side < 2; ++side) {
    const double sign = side == 0 ? 1 : -1;
    jump.before[side] = {hit.time,
                         after[side].position + sign * gain.position,
                         after[side].velocity + sign * gain.velocity,
                         after[side].angle,
                         after[side].angular_velocity + law.radius[side] * gain.spin};
    if (law.inverse_inertia[side] > 0) jump.spin_gain[side] = SpinGain(law, side, hit.impact);
  }
  return jump;
}

std::vector<ConstraintRow> RowsOfHardTerms(const Scene& scene) {
  std::vector<ConstraintRow> rows;
  int owner = 0;
  const auto add = [&](const auto& term, int components, int via) {
    for (int j = 0; j < components; ++j) {
      rows.push_back(
          {.owner = owner, .body = term.body, .quantity = term.quantity, .normal = Vec2d::Unit(j), .via = via});
    }
    ++owner;
  };
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (term.hard && !term.region) add(term, term.IsRotational() ? 1 : 2, -1);
  }
  for (size_t v = 0; v < scene.objective.via.size(); ++v) {
    if (scene.objective.via[v].hard) add(scene.objective.via[v], 2, static_cast<int>(v));
  }
  return rows;
}

CostateSweep::CostateSweep(const Scene& scene, const Flight& flight)
    : scene_(scene), flight_(flight), place_(scene.bodies.size(), -1) {
  for (int c = 0; c < scene.num_controlled(); ++c) place_[scene.control.bodies[c]] = c;
  std::vector<double> cuts;
  for (const ViaTerm& term : scene.objective.via) cuts.push_back(term.time);
  for (const RunningTerm& term : scene.objective.running) {
    cuts.insert(cuts.end(), term.times.begin(), term.times.end());
  }
  std::sort(cuts.begin(), cuts.end());
  std::vector<int> first;  // segment of each piece
  for (const Flight::Piece& whole : flight.pieces()) {
    first.push_back(static_cast<int>(segments_.size()));
    const double margin = kNodeMargin * whole.duration;
    Flight::Piece part = whole;
    const double end = whole.start + whole.duration;
    const auto add = [&](double to) {
      part.duration = to - part.start;
      segments_.push_back(part);
      part.at_start = whole.StateAfter(to - whole.start);
      part.start = to;
    };
    for (double cut : cuts) {
      if (cut > part.start + margin && cut < end - margin) add(cut);
    }
    add(end);
  }
  first.push_back(static_cast<int>(segments_.size()));
  for (const Flight::Hit& hit : flight.hits()) segment_after_.push_back(first[hit.next_piece]);
  for (const ViaTerm& term : scene.objective.via) {
    const auto starts = [&](const Flight::Piece& s) { return s.start < term.time - kNodeMargin * s.duration; };
    const auto after = std::partition_point(segments_.begin(), segments_.end(), starts);
    via_after_.push_back(std::max(1, static_cast<int>(after - segments_.begin())));
  }
}

double CostateSweep::LateMultiplier(int k, const ImpactJump& jump, double gain) const {
  const int next = std::min<int>(segment_after_[k], static_cast<int>(segments_.size()) - 1);
  return jump.MultiplierAt(segments_[next], flight_.hits()[k].impact.speed, gain);
}

void CostateSweep::CrossFlight(const Flight::Piece& piece, double length, RunningTerms terms,
                               std::vector<Costate<double>>* now, std::vector<Vec2d>* push,
                               std::vector<double>* turn) const {
  for (int t = 0; t < scene_.num_torques(); ++t) {
    const Costate<double>& costate = (*now)[scene_.control.torque_bodies[t]];
    (*turn)[t] += length * (0.5 * length * costate.angle + costate.angular_velocity);
  }
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    if (scene_.bodies[i].fixed) continue;
    Costate<double>& costate = (*now)[i];
    Vec2d integral = length * (0.5 * length * costate.position + costate.velocity);
    costate.velocity += length * costate.position;
    costate.angular_velocity += length * costate.angle;
    costate.time = piece.start;
    for (const RunningTerm& term : terms) {
      if (term.body != i) continue;
      for (size_t g = 0; g < kGaussNodes.size(); ++g) {
        const double s = kGaussNodes[g] * length;
        const Vec2d by = (2 * term.weight * kGaussWeights[g] * length) * RunningResidual(term, piece, s);
        if (term.quantity == Quantity::kPosition) {
          costate.position += by;
          costate.velocity += s * by;
          integral += (0.5 * s * s) * by;
        } else {
          costate.velocity += by;
          integral += s * by;
        }
      }
    }
    if (place_[i] >= 0) (*push)[place_[i]] += integral;
  }
}

double CostateSweep::StretchOf(const Flight::Piece& piece, double h, RunningTerms terms,
                               const std::vector<Costate<double>>& end) const {
  double at_end = 0, drift = 0;
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    if (scene_.bodies[i].fixed) continue;
    at_end += end[i].position.dot(piece.StateAfter(i, h).v) + end[i].velocity.dot(piece.acceleration[i]);
    if (end[i].angle == 0 && piece.turning.empty()) continue;
    const double rate = piece.TurningOf(i);
    at_end += end[i].angle * (piece.at_start.spin[i] + h * rate) + end[i].angular_velocity * rate;
  }
  for (const RunningTerm& term : terms) {
    const Vec2d rate = TargetRate(term, piece);
    at_end += term.weight * RunningResidual(term, piece, h).squaredNorm();
    for (size_t g = 0; g < kGaussNodes.size(); ++g) {
      const double s = kGaussNodes[g] * h;
      drift -= 2 * term.weight * kGaussWeights[g] * h * RunningResidual(term, piece, s).dot(rate);
    }
  }
  return h * at_end + piece.start * drift;
}

void CostateSweep::CrossImpact(int k, RunningTerms terms, const MultiplierOf& multiplier,
                               std::vector<Costate<double>>* now) const {
  const Flight::Hit& hit = flight_.hits()[k];
  const std::array<int, 2> body = {hit.contact.a, hit.contact.plane ? -1 : hit.contact.b};
  std::array<Costate<double>, 2> after;
  for (int side = 0; side < 2; ++side) {
    after[side] = body[side] < 0 ? Costate<double>{hit.time, Vec2d(0, 0), Vec2d(0, 0)} : (*now)[body[side]];
  }
  const ImpactJump jump = MakeImpactJump(scene_, hit, after);
  double gain = 0;
  for (const RunningTerm& term : terms) {
    if (term.quantity != Quantity::kVelocity) continue;
    const Vec2d target = TargetAt(term, hit.time);
    for (int side = 0; side < 2; ++side) {
      if (jump.body[side] != term.body) continue;
      gain += term.weight * ((jump.velocity_after[side] - target).squaredNorm() -
                             (jump.velocity_before[side] - target).squaredNorm());
    }
  }
  const double nu = multiplier(k, jump, gain);
  for (int side = 0; side < 2; ++side) {
    if (jump.body[side] < 0) continue;
    Costate<double>& costate = (*now)[jump.body[side]];
    costate = jump.before[side];
    costate.position += (side == 0 ? nu : -nu) * hit.impact.normal;
  }
}

void CostateSweep::CrossVia(size_t index, const Vec2d& derivative, std::vector<Costate<double>>* now,
                            Result* result) const {
  const ViaTerm& term = scene_.objective.via[index];
  const bool of_position = term.quantity == Quantity::kPosition;
  const Vec2d rate =
      of_position ? flight_.StatesBefore(term.time).v[term.body] : AccelerationBefore(via_after_[index])[term.body];
  result->by_duration -= term.time * derivative.dot(rate) / scene_.duration;
  Part(&(*now)[term.body], term.quantity) += derivative;
}

std::vector<Costate<double>> CostateSweep::CostatesAtEnd(std::span<const ConstraintRow> constraints) const {
  std::vector<Costate<double>> costates;
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    costates.push_back({scene_.duration, Vec2d(0, 0), Vec2d(0, 0)});
    if (!scene_.bodies[i].fixed) costates.back() = FinalCostate(scene_, flight_.end(), i);
  }
  for (const ConstraintRow& row : constraints) {
    if (row.via < 0) AddRow(row, &costates);
  }
  return costates;
}

void CostateSweep::AddRow(const ConstraintRow& row, std::vector<Costate<double>>* now) {
  Costate<double>& costate = (*now)[row.body];
  if (row.quantity == Quantity::kAngle || row.quantity == Quantity::kAngularVelocity) {
    costate.CostateOfSpin(row.quantity) += row.multiplier * row.normal[0];
  } else {
    Part(&costate, row.quantity) += row.multiplier * row.normal;
  }
}

CostateSweep::Result CostateSweep::Sweep(std::span<const ConstraintRow> constraints,
                                         const MultiplierOf& multiplier) const {
  Result result;
  std::vector<Costate<double>> now = CostatesAtEnd(constraints);
  const int count = static_cast<int>(segments_.size());
  result.push.assign(count, std::vector<Vec2d>(scene_.num_controlled(), Vec2d(0, 0)));
  result.turn.assign(count, std::vector<double>(scene_.num_torques(), 0.0));
  result.after_impact.resize(flight_.hits().size());
  const auto note = [&] {
    for (const Costate<double>& costate : now) {
      result.largest_position = std::max(result.largest_position, costate.position.norm());
      result.largest_velocity = std::max(result.largest_velocity, costate.velocity.norm());
    }
    for (const int body : scene_.control.torque_bodies) {  // as of the rim
      const Costate<double>& costate = now[body];
      const double radius = scene_.bodies[body].radius;
      result.largest_position = std::max(result.largest_position, std::abs(costate.angle) / radius);
      result.largest_velocity = std::max(result.largest_velocity, std::abs(costate.angular_velocity) / radius);
    }
  };
  const RunningTerms terms = scene_.objective.running;
  int hit = static_cast<int>(flight_.hits().size()) - 1;
  for (int i = count;; --i) {
    note();
    for (; hit >= 0 && segment_after_[hit] == i; --hit) {
      result.after_impact[hit] = now;
      CrossImpact(hit, terms, multiplier, &now);
      note();
    }
    for (size_t v = scene_.objective.via.size(); v-- > 0;) {
      const ViaTerm& term = scene_.objective.via[v];
      if (via_after_[v] != i) continue;
      for (const ConstraintRow& row : constraints) {
        if (row.via == static_cast<int>(v)) CrossVia(v, row.multiplier * row.normal, &now, &result);
      }
      if (!term.hard) {
        const DiscStates x = flight_.StatesBefore(term.time);
        const Vec2d& q = term.quantity == Quantity::kPosition ? x.p[term.body] : x.v[term.body];
        CrossVia(v, 2 * term.weight * (q - term.target), &now, &result);
      }
    }
    if (i == 0) break;
    const Flight::Piece& piece = segments_[i - 1];
    result.by_duration += StretchOf(piece, piece.duration, terms, now) / scene_.duration;
    CrossFlight(piece, piece.duration, terms, &now, &result.push[i - 1], &result.turn[i - 1]);
  }
  note();
  result.start = std::move(now);
  return result;
}

void CostateSweep::AddByControl(int interval, const std::vector<Vec2d>& push, const std::vector<double>& turn,
                                std::span<double> gradient) const {
  for (int t = 0; t < scene_.num_torques(); ++t) {
    const Body& body = scene_.bodies[scene_.control.torque_bodies[t]];
    gradient[scene_.TorqueIndex(interval, t)] += body.radius / body.MomentOfInertia() * turn[t];
  }
  for (int c = 0; c < scene_.num_controlled(); ++c) {
    const double inverse_mass = 1 / scene_.bodies[scene_.control.bodies[c]].mass;
    double* g = gradient.data() + scene_.ForceIndex(interval, c);
    for (int d = 0; d < 2; ++d) g[d] += inverse_mass * push[c][d];
  }
}

CostateSweep::Derivatives CostateSweep::DerivativesOfPoint(int segment, double offset, int body, bool of_position,
                                                           int axis, double scale, std::span<double> gradient) const {
  std::vector<Costate<double>> now(scene_.num_bodies(), {0.0, Vec2d(0, 0), Vec2d(0, 0)});
  if (!scene_.bodies[body].fixed) (of_position ? now[body].position : now[body].velocity)[axis] = scale;
  const bool at_end = segment + 1 == static_cast<int>(segments_.size()) && offset >= segments_[segment].duration;
  for (int k = static_cast<int>(flight_.hits().size()) - 1; at_end && k >= 0 && segment_after_[k] > segment; --k) {
    CrossImpact(
        k, {}, [&](int, const ImpactJump& jump, double gain) { return LateMultiplier(k, jump, gain); }, &now);
  }
  return PullBack(segment, offset, {}, 0, std::move(now), gradient);
}

CostateSweep::Derivatives CostateSweep::DerivativesOfIntegral(const RunningTerm& term, int first, int end, double scale,
                                                              std::span<double> gradient) const {
  RunningTerm scaled = term;
  scaled.weight *= scale;
  std::vector<Costate<double>> now(scene_.num_bodies(), {0.0, Vec2d(0, 0), Vec2d(0, 0)});
  return PullBack(end - 1, segments_[end - 1].duration, {&scaled, 1}, first, std::move(now), gradient);
}

CostateSweep::Derivatives CostateSweep::PullBack(int segment, double offset, RunningTerms terms, int first,
                                                 std::vector<Costate<double>> now, std::span<double> gradient) const {
  Derivatives result;
  std::vector<Vec2d> push(scene_.num_controlled());
  std::vector<double> turn(scene_.num_torques());
  const MultiplierOf late = [&](int k, const ImpactJump& jump, double gain) { return LateMultiplier(k, jump, gain); };
  int hit = static_cast<int>(flight_.hits().size()) - 1;
  while (hit >= 0 && segment_after_[hit] > segment) --hit;
  for (int i = segment; i >= 0; --i) {
    const Flight::Piece& piece = segments_[i];
    const double length = i == segment ? offset : piece.duration;
    const RunningTerms here = i >= first ? terms : RunningTerms();
    result.by_duration += StretchOf(piece, length, here, now) / scene_.duration;
    std::fill(push.begin(), push.end(), Vec2d(0, 0));
    std::fill(turn.begin(), turn.end(), 0.0);
    CrossFlight(piece, length, here, &now, &push, &turn);
    AddByControl(piece.interval, push, turn, gradient);
    for (; hit >= 0 && segment_after_[hit] == i; --hit)
      CrossImpact(hit, i > first ? terms : RunningTerms(), late, &now);
  }
  result.start = std::move(now);
  return result;
}

}  // namespace saltus
