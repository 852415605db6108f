#include "optimality/condensed.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "base/linear_algebra.h"
#include "base/time_grid.h"
#include "simulate/costate_sweep.h"

namespace saltus {

CondensedLoss::CondensedLoss(const Scene& scene, const Flight& flight, std::span<const double> control,
                             std::span<const double> lengths, std::vector<std::optional<double>> theta,
                             Restrictions restrictions)
    : scene_(scene),
      flight_(flight),
      control_(control),
      lengths_(lengths),
      theta_(std::move(theta)),
      restrictions_(std::move(restrictions)),
      soft_(scene.objective),
      width_(scene.control_width()) {
  std::erase_if(soft_.terminal, [](const TerminalTerm& term) { return term.hard; });
  num_held_ = static_cast<int>(restrictions_.rows.size());
  const std::vector<Flight::Hit>& hits = flight.hits();
  theta_.resize(hits.size());
  pushed_.assign(scene.num_bodies(), -1);
  for (int c = 0; c < scene.num_controlled(); ++c) pushed_[scene.control.bodies[c]] = c;
  turned_.assign(scene.num_bodies(), -1);
  for (int t = 0; t < scene.num_turned(); ++t) turned_[scene.control.turned[t]] = t;
  nodes_ = {0.0};
  for (double length : lengths) nodes_.push_back(nodes_.back() + length);
  nodes_.back() = scene.duration;
  for (const Flight::Hit& hit : hits) {
    const bool at_end = hit.next_piece == static_cast<int>(flight.pieces().size());
    interval_at_.push_back(at_end ? static_cast<int>(lengths.size()) - 1 : flight.pieces()[hit.next_piece].interval);
  }

  sides_.resize(hits.size());
  std::vector<int> last_hit(scene.num_bodies(), -1);
  first_arc_.assign(scene.num_bodies(), -1);
  last_arc_ = first_arc_;
  const auto add_arc = [&](int body, int to_hit) {
    last_arc_[body] = AddArc(body, last_hit[body], to_hit);
    if (first_arc_[body] < 0) first_arc_[body] = last_arc_[body];
    if (last_hit[body] >= 0) {
      for (Side& side : sides_[last_hit[body]]) {
        if (side.body == body) side.arc_after = last_arc_[body];
      }
    }
    last_hit[body] = to_hit;
  };
  for (int k = 0; k < static_cast<int>(hits.size()); ++k) {
    const Candidate& c = hits[k].contact;
    const std::array<int, 2> bodies = {c.a, c.plane ? -1 : c.b};
    const auto [before, after] = IntervalsAt(k);
    num_held_ += theta_[k].has_value();
    for (int i = 0; i < 2; ++i) {
      if (bodies[i] < 0 || scene.bodies[bodies[i]].fixed) continue;
      Side& side = sides_[k][i];
      side.body = bodies[i];
      add_arc(side.body, k);
      side.arc_before = last_arc_[side.body];
      side.before = AddForce(side.body, before);
      side.after = after == before ? side.before : AddForce(side.body, after);
    }
  }
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (!scene.bodies[i].fixed) add_arc(i, -1);
  }
  if (scene.objective.duration && restrictions_.duration) {
    const int last = static_cast<int>(lengths.size()) - 1;
    for (int i = 0; i < scene.num_bodies(); ++i) last_.push_back(AddForce(i, last));
    by_duration_ = static_cast<int>(functionals_.size());
    functionals_.emplace_back();
  }

  for (const Functional& f : functionals_) {
    double value = 0;
    for (size_t i = 0; i < f.weights.size(); ++i) value += f.weights[i] * control_[(f.first + i) * width_ + f.column];
    values_.push_back(value);
  }
}

// Returns the intervals whose forces act just before and just after an impact.
std::pair<int, int> CondensedLoss::IntervalsAt(int hit) const {
  const int at = interval_at_[hit];
  return {flight_.hits()[hit].on_node && at > 0 ? at - 1 : at, at};
}

int CondensedLoss::AddArc(int body, int from_hit, int to_hit) {
  Arc arc{static_cast<int>(legs_.size())};
  double begin = from_hit >= 0 ? flight_.hits()[from_hit].time : 0.0;
  const double end = to_hit >= 0 ? flight_.hits()[to_hit].time : scene_.duration;
  int first = from_hit >= 0 ? IntervalsAt(from_hit).second : 0;
  const int last = to_hit >= 0 ? IntervalsAt(to_hit).first : static_cast<int>(lengths_.size()) - 1;
  // Cuts of an arc: waypoints, and for discs with running terms also nodes and times at which targets turn.
  struct Cut {
    double time;
    int interval;  // that starts there, or that it lies in
    int via;
  };
  std::vector<Cut> cuts;
  const auto cut_at = [&](double time, int via) {
    int interval = first;
    while (interval < last && nodes_[interval + 1] <= time + kNodeMargin * lengths_[interval + 1]) ++interval;
    const double margin = kNodeMargin * lengths_[interval];
    if (time > begin + margin && time < end - (via < 0 ? margin : -margin)) cuts.push_back({time, interval, via});
  };
  for (size_t i = 0; i < scene_.objective.via.size(); ++i) {
    if (scene_.objective.via[i].body == body) cut_at(scene_.objective.via[i].time, static_cast<int>(i));
  }
  if (IsTracked(body)) {
    for (int i = first + 1; i <= last && pushed_[body] >= 0; ++i) cut_at(nodes_[i], -1);
    for (const RunningTerm& term : scene_.objective.running) {
      for (double time : term.times) {
        if (term.body == body) cut_at(time, -1);
      }
    }
  }
  std::ranges::sort(cuts, {}, &Cut::time);
  for (const Cut& cut : cuts) {
    const bool at_node = std::abs(cut.time - nodes_[cut.interval]) <= kNodeMargin * lengths_[cut.interval];
    AddLeg(body, begin, cut.time, first, std::max(first, cut.interval - at_node), cut.via);
    begin = cut.time;
    first = cut.interval;
  }
  if (begin < end || cuts.empty()) AddLeg(body, begin, end, first, last, -1);
  arc.end = static_cast<int>(legs_.size());
  arcs_.push_back(arc);
  return static_cast<int>(arcs_.size()) - 1;
}

void CondensedLoss::AddLeg(int body, double begin, double end, int first, int last, int via) {
  Leg leg{.body = body, .begin = begin, .end = end, .tracked = IsTracked(body), .via = via};
  if (leg.tracked) {
    const double length = end - begin;
    leg.gain = leg.way = AddForce(body, first);
    leg.by_gain = length / scene_.bodies[body].mass;
    leg.by_way = 0.5 * length * leg.by_gain;
    leg.by_turn = length * RateOfTurn(body);
    leg.by_turned = 0.5 * length * leg.by_turn;
  } else if (pushed_[body] >= 0) {
    const double inverse_mass = 1 / scene_.bodies[body].mass;
    std::vector<double> gain, way;
    for (int i = first; i <= last; ++i) {
      const double from = i == first ? begin : nodes_[i], to = i == last ? end : nodes_[i + 1];
      gain.push_back(inverse_mass * (to - from));
      way.push_back(gain.back() * (end - 0.5 * (from + to)));
    }
    leg.gain = AddFunctionals(body, first, gain);
    leg.way = AddFunctionals(body, first, way);
    leg.by_turn = leg.by_turned = scene_.bodies[body].mass * RateOfTurn(body);
  }
  legs_.push_back(leg);
}

CondensedLoss::Push CondensedLoss::AddForce(int body, int interval) {
  if (pushed_[body] < 0) return {};
  if (!IsTracked(body)) return AddFunctionals(body, interval, {1.0});
  // Several legs share the functionals of one force.
  const int at = static_cast<int>(scene_.ForceIndex(interval, pushed_[body]));
  if (const auto known = forces_.find(at); known != forces_.end()) {
    return {known->second, turned_[body] < 0 ? -1 : known->second + 2};
  }
  const Push push = AddFunctionals(body, interval, {1.0});
  forces_[at] = push.force;
  return push;
}

CondensedLoss::Push CondensedLoss::AddFunctionals(int body, int first, const std::vector<double>& weights) {
  Push push{static_cast<int>(functionals_.size())};
  for (int axis = 0; axis < 2; ++axis) functionals_.push_back({2 * pushed_[body] + axis, first, weights});
  if (turned_[body] >= 0) {
    push.turn = static_cast<int>(functionals_.size());
    functionals_.push_back({2 * scene_.num_controlled() + turned_[body], first, weights});
  }
  return push;
}

double CondensedLoss::RateOfTurn(int body) const {
  return turned_[body] < 0 ? 0.0 : scene_.bodies[body].radius / scene_.bodies[body].MomentOfInertia();
}

bool CondensedLoss::IsTracked(int body) const {
  return std::ranges::any_of(scene_.objective.running, [&](const RunningTerm& term) { return term.body == body; });
}

template <typename T>
void CondensedLoss::Sweep(const T* s, T* gradient, T* gaps) const {
  struct Motion {
    Vec2<T> p, v;
    T angle = T(0.0), spin = T(0.0);
  };
  // Data of an impact for the backward sweep, at its time, which is dt after that of the flight.
  struct PassedImpact {
    T dt;
    Impact<T> impact;
    std::array<Vec2<T>, 2> position, before, after;  // velocities
    std::array<T, 2> spin;                           // angular velocities before
  };
  const auto at = [&](int functional) { return Vec2<T>(s[functional], s[functional + 1]); };
  const auto add = [&](int functional, const Vec2<T>& by) {
    for (int axis = 0; axis < 2; ++axis) gradient[functional + axis] += by[axis];
  };
  const auto acceleration = [&](int body, const Push& push) -> Vec2<T> {
    Vec2<T> a = scene_.gravity.template cast<T>();
    if (push.force >= 0) a += Scale(1 / scene_.bodies[body].mass, at(push.force));
    return a;
  };
  const auto turning = [&](int body, const Push& push) {
    return push.turn < 0 ? T(0.0) : T(RateOfTurn(body) * s[push.turn]);
  };
  using Quantity = TerminalTerm::Quantity;
  const auto value_of = [](const ConstraintRow& row, const Motion& x) -> T {
    if (row.quantity == Quantity::kAngle) return T(row.normal[0] * x.angle);
    if (row.quantity == Quantity::kAngularVelocity) return T(row.normal[0] * x.spin);
    return Dot(Vec2<T>(row.normal.cast<T>()), row.quantity == Quantity::kPosition ? x.p : x.v);
  };
  const auto add_row = [](const ConstraintRow& row, const Motion& x, Costate<T>* costate) {
    if (row.quantity == Quantity::kAngle || row.quantity == Quantity::kAngularVelocity) {
      costate->CostateOfSpin(row.quantity) += row.multiplier * row.normal[0];
    } else if (row.bend > 0) {
      costate->velocity += Scale(row.multiplier * row.bend, x.v);
    } else {
      (row.quantity == Quantity::kPosition ? costate->position : costate->velocity) +=
          (row.multiplier * row.normal).template cast<T>();
    }
  };
  const bool spins = scene_.Spins();
  std::vector<Motion> at_leg(legs_.size()), at_via(scene_.objective.via.size());
  const auto fly = [&](const Arc& arc, Motion* x) {
    for (int i = arc.first; i < arc.end; ++i) {
      const Leg& leg = legs_[i];
      if (leg.tracked) at_leg[i] = *x;
      const double length = leg.end - leg.begin;
      if (spins) x->angle += length * x->spin;
      x->p += Scale(length, x->v) + (0.5 * length * length * scene_.gravity).template cast<T>();
      x->v += (length * scene_.gravity).template cast<T>();
      if (leg.gain.force >= 0) {
        x->v += Scale(leg.by_gain, at(leg.gain.force));
        x->p += Scale(leg.by_way, at(leg.way.force));
      }
      if (leg.gain.turn >= 0) {
        x->spin += leg.by_turn * s[leg.gain.turn];
        x->angle += leg.by_turned * s[leg.way.turn];
      }
      if (leg.via < 0) continue;
      at_via[leg.via] = *x;
      for (const ConstraintRow& row : restrictions_.rows) {
        if (row.via == leg.via && gaps != nullptr) *gaps++ = value_of(row, *x);
      }
    }
  };
  // Derivatives of the rate of the running terms by position and velocity; the rate, and its part from velocities.
  struct Rate {
    Vec2<T> by_position = Vec2<T>(T(0.0), T(0.0)), by_velocity = by_position;
    T of_velocity = T(0.0), all = T(0.0);
  };
  const auto running = [&](int body, const T& time, const Vec2<T>& p, const Vec2<T>& v) {
    Rate rate;
    for (const RunningTerm& term : scene_.objective.running) {
      if (term.body != body) continue;
      const bool of_position = term.quantity == TerminalTerm::Quantity::kPosition;
      const Vec2<T> miss = (of_position ? p : v) - TargetAt(term, time);
      (of_position ? rate.by_position : rate.by_velocity) += Scale(2 * term.weight, miss);
      const T value = term.weight * Dot(miss, miss);
      rate.all += value;
      if (!of_position) rate.of_velocity += value;
    }
    return rate;
  };

  std::vector<Motion> now;
  const DiscStates& start = flight_.pieces().front().at_start;
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    now.push_back({start.p[i].template cast<T>(), start.v[i].template cast<T>()});
    if (!spins) continue;
    now[i].angle = T(start.angle[i]);
    now[i].spin = T(start.spin[i]);
  }
  const int num_hits = static_cast<int>(flight_.hits().size());
  std::vector<PassedImpact> passed(num_hits);
  for (int k = 0; k < num_hits; ++k) {
    const Candidate& c = flight_.hits()[k].contact;
    const ImpactConstants law = MakeImpactConstants(scene_, c);
    const auto separation = [&] {
      return c.plane ? Separate<T>(now[c.a].p, MakeHalfPlane(scene_.planes[c.b])) : Separate<T>(now[c.a].p, now[c.b].p);
    };
    const auto relative = [&]() -> Vec2<T> { return c.plane ? now[c.a].v : Vec2<T>(now[c.a].v - now[c.b].v); };
    PassedImpact& out = passed[k];
    for (const Side& side : sides_[k]) {
      if (side.body >= 0) fly(arcs_[side.arc_before], &now[side.body]);
    }
    const Separation<T> met = separation();
    const T gap = met.distance - law.contact_distance;
    if (theta_[k]) {
      out.dt = T(0.0);
      if (gaps != nullptr) *gaps++ = gap;
    } else {
      out.dt = (Value(gap) - gap) / Value(Dot(met.normal, relative()));
    }
    for (const Side& side : sides_[k]) {
      if (side.body < 0) continue;
      Motion& x = now[side.body];
      x.p += Scale(out.dt, x.v);
      x.v += Scale(out.dt, acceleration(side.body, side.before));
      if (spins) x.angle += out.dt * x.spin;
      if (side.before.turn >= 0) x.spin += out.dt * turning(side.body, side.before);
    }
    out.spin = {now[c.a].spin, c.plane ? T(0.0) : now[c.b].spin};
    out.impact = MakeImpact<T>(law, separation().normal, relative(), out.spin);
    for (int i = 0; i < 2; ++i) {
      const Side& side = sides_[k][i];
      if (side.body < 0) continue;
      Motion& x = now[side.body];
      out.position[i] = x.p;
      out.before[i] = x.v;
      x.v += Scale(i == 0 ? law.inverse_mass_a : -law.inverse_mass_b, out.impact.impulse);
      out.after[i] = x.v;
      x.p -= Scale(out.dt, x.v);
      x.v -= Scale(out.dt, acceleration(side.body, side.after));
      if (!spins) continue;
      x.spin += SpinGain(law, i, out.impact);
      x.angle -= out.dt * x.spin;
      if (side.after.turn >= 0) x.spin -= out.dt * turning(side.body, side.after);
    }
  }

  std::fill(gradient, gradient + num_functionals(), T(0.0));
  std::vector<Costate<T>> costates;
  const T end = by_duration_ < 0 ? T(scene_.duration) : T(scene_.duration + s[by_duration_]);
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    Motion& x = now[i];
    if (last_arc_[i] >= 0) fly(arcs_[last_arc_[i]], &x);
    if (by_duration_ >= 0 && last_arc_[i] >= 0) {
      const T& later = s[by_duration_];
      x.p += Scale(later, x.v);
      x.v += Scale(later, acceleration(i, last_[i]));
      x.angle += later * x.spin;
      x.spin += later * turning(i, last_[i]);
    }
    costates.push_back(TerminalCostate<T>(soft_, i, end, x.p, x.v, x.angle, x.spin));
  }
  for (const ConstraintRow& row : restrictions_.rows) {
    if (!row.IsAtEnd()) continue;
    add_row(row, now[row.body], &costates[row.body]);
    if (gaps != nullptr) *gaps++ = value_of(row, now[row.body]);
  }
  const double effort = scene_.objective.effort;
  const auto fly_back = [&](const Arc& arc) {
    for (int i = arc.end - 1; i >= arc.first; --i) {
      const Leg& leg = legs_[i];
      Costate<T>& costate = costates[leg.body];
      if (leg.via >= 0) {
        const ViaTerm& term = scene_.objective.via[leg.via];
        for (const ConstraintRow& row : restrictions_.rows) {
          if (row.via == leg.via) add_row(row, at_via[leg.via], &costate);
        }
        if (!term.hard) {
          const bool of_position = term.quantity == Quantity::kPosition;
          const Vec2<T>& q = of_position ? at_via[leg.via].p : at_via[leg.via].v;
          (of_position ? costate.position : costate.velocity) +=
              Scale(2 * term.weight, Vec2<T>(q - term.target.template cast<T>()));
        }
      }
      if (leg.gain.force >= 0) {
        add(leg.gain.force, Scale(leg.by_gain, costate.velocity));
        add(leg.way.force, Scale(leg.by_way, costate.position));
      }
      if (leg.gain.turn >= 0) {
        gradient[leg.gain.turn] += leg.by_turn * costate.angular_velocity;
        gradient[leg.way.turn] += leg.by_turned * costate.angle;
      }
      const double length = leg.end - leg.begin;
      costate.velocity += Scale(length, costate.position);
      if (spins) costate.angular_velocity += length * costate.angle;
      if (!leg.tracked) continue;
      const Motion& x = at_leg[i];
      const Vec2<T> a = acceleration(leg.body, leg.gain);
      for (size_t g = 0; g < kGaussNodes.size(); ++g) {
        const double after = kGaussNodes[g] * length;
        const Vec2<T> v = x.v + Scale(after, a), p = x.p + Scale(after, Vec2<T>(x.v + Scale(0.5 * after, a)));
        const Rate rate = running(leg.body, T(leg.begin + after), p, v);
        const double weight = kGaussWeights[g] * length;
        const Vec2<T> by_v = Scale(weight, Vec2<T>(rate.by_velocity + Scale(after, rate.by_position)));
        costate.position += Scale(weight, rate.by_position);
        costate.velocity += by_v;
        if (leg.gain.force < 0) continue;
        const Vec2<T> by_a = Scale(after, Vec2<T>(by_v - Scale(0.5 * weight * after, rate.by_position)));
        add(leg.gain.force, Scale(1 / scene_.bodies[leg.body].mass, by_a));
      }
    }
  };
  // Returns the contribution of a disc to the Hamiltonian, without the running terms of its position.
  const auto kinetic = [&](int body, const Vec2<T>& velocity, const Push& push) {
    const Costate<T>& costate = costates[body];
    T sum = Dot(costate.position, velocity) + Dot(costate.velocity, acceleration(body, push));
    if (push.turn >= 0) sum += costate.angular_velocity * turning(body, push);
    return sum;
  };
  const auto effort_of = [&](const Push& push) {
    T sum(0.0);
    if (push.force >= 0) sum += effort * Dot(at(push.force), at(push.force));
    if (push.turn >= 0) sum += effort * s[push.turn] * s[push.turn];
    return sum;
  };
  // Adds the derivatives by the forces when these act for dt longer.
  const auto lengthen = [&](int body, const Push& push, const T& dt) {
    if (push.force < 0) return;
    const Vec2<T> slope = Scale(1 / scene_.bodies[body].mass, costates[body].velocity);
    add(push.force, Scale(dt, Vec2<T>(slope + Scale(2 * effort, at(push.force)))));
    if (push.turn < 0) return;
    gradient[push.turn] += dt * (RateOfTurn(body) * costates[body].angular_velocity + 2 * effort * s[push.turn]);
  };
  if (by_duration_ >= 0) {
    const T& later = s[by_duration_];
    T power(scene_.objective.duration->weight);
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      if (last_arc_[i] < 0) continue;
      const Motion& x = now[i];
      const Rate rate = running(i, end, x.p, x.v);
      power += kinetic(i, x.v, last_[i]) + effort_of(last_[i]) + rate.all + costates[i].angle * x.spin;
      Costate<T>& costate = costates[i];
      lengthen(i, last_[i], later);
      costate.position += Scale(later, rate.by_position);
      costate.velocity += Scale(later, Vec2<T>(costate.position + rate.by_velocity));
      costate.angular_velocity += later * costate.angle;
    }
    gradient[by_duration_] = power;
  }
  for (int k = num_hits - 1; k >= 0; --k) {
    const Candidate& c = flight_.hits()[k].contact;
    const ImpactConstants law = MakeImpactConstants(scene_, c);
    const PassedImpact& at_impact = passed[k];
    T power(0.0), early(0.0), late(0.0);  // what the Hamiltonian gains: with the forces there are, or one on both sides
    const T time = flight_.hits()[k].time + at_impact.dt;
    const auto count = [&](const Side& side, const Rate& rate, const Vec2<T>& velocity, const Push& push, double sign) {
      power += sign * kinetic(side.body, velocity, push);
      if (push.force >= 0) power += sign * effort_of(push);
      early += sign * kinetic(side.body, velocity, side.before);
      late += sign * kinetic(side.body, velocity, side.after);
      for (T* sum : {&power, &early, &late}) *sum += sign * rate.of_velocity;
    };
    Vec2<T> y(T(0.0), T(0.0));
    std::array<T, 2> of_spin = {T(0.0), T(0.0)};  // costates of the angular velocities
    for (int i = 0; i < 2; ++i) {
      const Side& side = sides_[k][i];
      if (side.body < 0) continue;
      fly_back(arcs_[side.arc_after]);
      Costate<T>& costate = costates[side.body];
      costate.velocity -= Scale(at_impact.dt, costate.position);
      const Rate rate = running(side.body, time, at_impact.position[i], at_impact.after[i]);
      costate.position -= Scale(at_impact.dt, rate.by_position);
      costate.velocity -= Scale(at_impact.dt, rate.by_velocity);
      if (spins) {
        costate.angular_velocity -= at_impact.dt * costate.angle;
        of_spin[i] = costate.angular_velocity;
        for (T* sum : {&power, &early, &late}) *sum += costate.angle * SpinGain(law, i, at_impact.impact);
      }
      lengthen(side.body, side.after, -at_impact.dt);
      count(side, rate, at_impact.after[i], side.after, 1);
      y += Scale(i == 0 ? law.inverse_mass_a : -law.inverse_mass_b, costate.velocity);
    }
    const CostateGain<T> gain = ImpactAdjoint<T>(law, at_impact.impact, y, at_impact.spin, of_spin);
    for (int i = 0; i < 2; ++i) {
      const Side& side = sides_[k][i];
      if (side.body < 0) continue;
      costates[side.body].position += Scale(i == 0 ? 1.0 : -1.0, gain.position);
      costates[side.body].velocity += Scale(i == 0 ? 1.0 : -1.0, gain.velocity);
      costates[side.body].angular_velocity += law.radius[i] * gain.spin;
      const Rate rate = running(side.body, time, at_impact.position[i], at_impact.before[i]);
      count(side, rate, at_impact.before[i], side.before, -1);
    }
    T multiplier = power / at_impact.impact.speed;
    if (theta_[k]) {
      const double mean = *theta_[k] * Value(early) + (1 - *theta_[k]) * Value(late);
      multiplier = T(mean / Value(at_impact.impact.speed));
    }
    for (int i = 0; i < 2; ++i) {
      const Side& side = sides_[k][i];
      if (side.body < 0) continue;
      Costate<T>& costate = costates[side.body];
      costate.position += Scale(T((i == 0 ? 1.0 : -1.0) * multiplier), at_impact.impact.normal);
      lengthen(side.body, side.before, at_impact.dt);
      const Rate rate = running(side.body, time, at_impact.position[i], at_impact.before[i]);
      costate.position += Scale(at_impact.dt, rate.by_position);
      costate.velocity += Scale(at_impact.dt, Vec2<T>(costate.position + rate.by_velocity));
      if (spins) costate.angular_velocity += at_impact.dt * costate.angle;
    }
  }
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    if (first_arc_[i] >= 0) fly_back(arcs_[first_arc_[i]]);
  }
}

Eigen::VectorXd CondensedLoss::Transposed(const Eigen::VectorXd& s) const {
  Eigen::VectorXd u = Eigen::VectorXd::Zero(control_.size());
  for (int j = 0; j < num_functionals(); ++j) {
    const Functional& f = functionals_[j];
    for (size_t i = 0; i < f.weights.size(); ++i) u[(f.first + i) * width_ + f.column] += s[j] * f.weights[i];
  }
  return u;
}

Eigen::VectorXd CondensedLoss::Gradient() const {
  Eigen::VectorXd by_functionals(num_functionals());
  Sweep<double>(values_.data(), by_functionals.data(), nullptr);
  Eigen::VectorXd gradient = Transposed(by_functionals);
  for (Eigen::Index i = 0; i < gradient.size(); ++i) {
    gradient[i] += 2 * scene_.objective.effort * Length(i) * control_[i];
  }
  return gradient;
}

void CondensedLoss::SecondDerivatives(Eigen::MatrixXd* hessian, Eigen::MatrixXd* gaps) const {
  using Jet = StepJet<double>;
  const int n = num_functionals();
  hessian->resize(n, n);
  gaps->resize(num_held_, n);
  std::vector<Jet> s(values_.begin(), values_.end()), gradient(n), gap(num_held_);
  for (int first = 0; first < n; first += kJetWidth) {
    const int width = std::min(kJetWidth, n - first);
    for (int i = 0; i < width; ++i) s[first + i].v[i] = 1;
    Sweep(s.data(), gradient.data(), gap.data());
    for (int i = 0; i < width; ++i) {
      for (int j = 0; j < n; ++j) (*hessian)(j, first + i) = gradient[j].v[i];
      for (int j = 0; j < num_held_; ++j) (*gaps)(j, first + i) = gap[j].v[i];
      s[first + i].v[i] = 0;
    }
  }
  *hessian = (0.5 * (*hessian + hessian->transpose())).eval();
}

Eigen::MatrixXd CondensedLoss::Gram() const {
  const int n = num_functionals();
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(n, n);
  for (int j = 0; j < n; ++j) {
    const Functional& a = functionals_[j];
    for (int k = j; k < n; ++k) {
      const Functional& b = functionals_[k];
      const int c = a.column / 2;
      const bool turns = a.column >= 2 * scene_.num_controlled();
      if (turns ? a.column != b.column : c != b.column / 2) continue;
      const int begin = std::max(a.first, b.first);
      const int end =
          std::min(a.first + static_cast<int>(a.weights.size()), b.first + static_cast<int>(b.weights.size()));
      for (int i = begin; i < end; ++i) {
        double share = 1;
        if (turns) {
          share = IsFreeTurn(i, a.column - 2 * scene_.num_controlled());
        } else {
          const Restrictions::Force& force = ForceAt(i, c);
          share = force.free(a.column % 2, b.column % 2) / (1 + force.bend);
        }
        gram(j, k) += share * a.weights[i - a.first] * b.weights[i - b.first] / lengths_[i];
      }
      gram(k, j) = gram(j, k);
    }
  }
  return gram;
}

void CondensedLoss::DivideByWeights(Eigen::VectorXd* x) const {
  for (size_t k = 0; k < lengths_.size(); ++k) {
    for (int c = 0; c < scene_.num_controlled(); ++c) {
      const Restrictions::Force& force = ForceAt(k, c);
      auto at = x->segment<2>(static_cast<Eigen::Index>(scene_.ForceIndex(k, c)));
      at = (force.free * at / ((1 + force.bend) * lengths_[k])).eval();
    }
    for (int t = 0; t < scene_.num_turned(); ++t) {
      (*x)[static_cast<Eigen::Index>(scene_.TurnIndex(k, t))] *= IsFreeTurn(k, t) / lengths_[k];
    }
  }
}

Eigen::Index CondensedLoss::NumFree() const {
  double sum = by_duration_ >= 0;
  for (size_t k = 0; k < lengths_.size(); ++k) {
    for (int c = 0; c < scene_.num_controlled(); ++c) sum += ForceAt(k, c).free.trace();
    for (int t = 0; t < scene_.num_turned(); ++t) sum += IsFreeTurn(k, t);
  }
  return std::lround(sum);
}

LeastCurvature FindLeastCurvature(const Eigen::MatrixXd& gram, const Eigen::MatrixXd& hessian,
                                  const Eigen::MatrixXd& held, double unit) {
  constexpr double kRank = 1e-10;
  // Directions M^-1 F^T S p with S scaling each functional to one; p = Q w, orthonormal to integral |d|^2 dt.
  Eigen::VectorXd scale(gram.rows());
  for (Eigen::Index i = 0; i < scale.size(); ++i) scale[i] = gram(i, i) > 0 ? 1 / std::sqrt(gram(i, i)) : 0.0;
  const SymmetricEigen metric = EigenOf(scale.asDiagonal() * gram * scale.asDiagonal());
  const Eigen::VectorXd& sizes = metric.values;  // rising
  Eigen::Index first = 0;
  while (first < sizes.size() && sizes[first] <= kRank * sizes[sizes.size() - 1]) ++first;
  LeastCurvature result;
  result.rank = sizes.size() - first;
  // F d for the columns d of an orthonormal basis, and the functionals that make those columns.
  const Eigen::MatrixXd vectors = metric.vectors.rightCols(result.rank);
  const Eigen::VectorXd roots = sizes.tail(result.rank).cwiseSqrt();
  Eigen::MatrixXd image = scale.cwiseInverse().asDiagonal() * vectors * roots.asDiagonal();
  for (Eigen::Index i = 0; i < scale.size(); ++i) {
    if (scale[i] == 0) image.row(i).setZero();
  }
  Eigen::MatrixXd source = scale.asDiagonal() * vectors * roots.cwiseInverse().asDiagonal();
  if (held.rows() > 0) {
    Eigen::MatrixXd rows = Multiply(held, image);
    for (Eigen::Index i = 0; i < rows.rows(); ++i) rows.row(i) /= std::max(rows.row(i).norm(), 1e-300);
    const Eigen::MatrixXd kept = NullSpace(rows);
    image = Multiply(image, kept);
    source = Multiply(source, kept);
  }
  const Eigen::Index last = image.cols() - 1;
  if (last < 0) return result;
  const Eigen::MatrixXd reduced = Multiply(MultiplyTransposed(image, hessian), image) / unit;
  const SymmetricEigen curvature = EigenOf(reduced);
  result.smallest = curvature.values[0];
  result.largest = curvature.values[last];
  result.source = source * curvature.vectors.col(0);
  return result;
}

CurvatureRange CondensedLoss::SmallestCurvature() const {
  CHECK_GT(scene_.objective.effort, 0);
  Eigen::MatrixXd hessian, gaps;  // held are impacts on their nodes, and hard terms
  SecondDerivatives(&hessian, &gaps);
  const double unit = 2 * scene_.objective.effort;
  Eigen::MatrixXd gram = Gram();
  if (by_duration_ >= 0) {
    // The final time has no effort: it is measured by its own second derivative.
    double& own = hessian(by_duration_, by_duration_);
    const double size = own != 0 ? std::abs(own) : unit;
    gram(by_duration_, by_duration_) = unit / size;
    own -= size;
  }
  const LeastCurvature least = FindLeastCurvature(gram, hessian, gaps, unit);
  CurvatureRange result;
  result.direction = Eigen::VectorXd::Zero(control_.size());
  const bool others = least.rank < NumFree();  // directions that the motion does not notice
  if (least.source.size() == 0) return result;
  result.smallest = 1 + least.smallest;
  result.largest = 1 + least.largest;
  result.direction = Transposed(least.source);
  DivideByWeights(&result.direction);
  if (!restrictions_.forces.empty() || by_duration_ >= 0) {  // orthonormal to another measure
    double square = 0;
    for (Eigen::Index i = 0; i < result.direction.size(); ++i) square += Length(i) * std::pow(result.direction[i], 2);
    if (square > 0) result.direction /= std::sqrt(square);
  }
  Eigen::Index most = 0;
  result.direction.cwiseAbs().maxCoeff(&most);
  if (result.direction[most] < 0) result.direction = -result.direction;
  if (others) {
    result.smallest = std::min(result.smallest, 1.0);
    result.largest = std::max(result.largest, 1.0);
  }
  return result;
}

// With q = G' + G'' F d + A^T lambda and A the derivatives of what is held, the conditions 2 effort M (u + d) + F^T q =
// 0 and A F d = 0 are equations for q and lambda, whose number does not grow with the intervals.
std::optional<Eigen::VectorXd> CondensedLoss::NewtonStep() const {
  Eigen::MatrixXd hessian, held;
  SecondDerivatives(&hessian, &held);
  const int n = num_functionals(), m = num_held_;
  const Eigen::Map<const Eigen::VectorXd> values(values_.data(), n);
  Eigen::VectorXd slope(n);
  Sweep<double>(values_.data(), slope.data(), nullptr);
  const Eigen::MatrixXd gram = Gram() / (2 * scene_.objective.effort);
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(n + m, n + m);
  Eigen::MatrixXd corner = Eigen::MatrixXd::Identity(n, n);
  AddProduct(hessian, gram, &corner);
  matrix.topLeftCorner(n, n) = corner;
  matrix.topRightCorner(n, m) = -held.transpose();
  matrix.bottomLeftCorner(m, n) = Multiply(held, gram);
  Eigen::VectorXd right(n + m);
  right << slope - hessian * values, -(held * values);
  const Eigen::VectorXd found = SolveFullPivotLu(matrix, right);
  Eigen::VectorXd control = Transposed(found.head(n)) / (-2 * scene_.objective.effort);
  DivideByWeights(&control);
  if (!control.allFinite()) return std::nullopt;
  return control;
}

Eigen::MatrixXd CondensedLoss::DenseHessian() const {
  Eigen::MatrixXd by_functionals, gaps;
  SecondDerivatives(&by_functionals, &gaps);
  const Eigen::Index size = static_cast<Eigen::Index>(control_.size()) + (by_duration_ >= 0);
  Eigen::MatrixXd f = Eigen::MatrixXd::Zero(num_functionals(), size);
  for (int j = 0; j < num_functionals(); ++j) {
    f.row(j).head(static_cast<Eigen::Index>(control_.size())) =
        Transposed(Eigen::VectorXd::Unit(num_functionals(), j)).transpose();
  }
  if (by_duration_ >= 0) f(by_duration_, size - 1) = 1;
  Eigen::MatrixXd hessian = Multiply(MultiplyTransposed(f, by_functionals), f);
  for (Eigen::Index i = 0; i < static_cast<Eigen::Index>(control_.size()); ++i) {
    hessian(i, i) += 2 * scene_.objective.effort * Length(i);
  }
  return hessian;
}

}  // namespace saltus
