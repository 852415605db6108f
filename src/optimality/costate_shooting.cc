#include "optimality/costate_shooting.h"

#include <ceres/jet.h>
#include <glog/logging.h>

#include <algorithm>
#include <type_traits>

#include "control/control_bounds.h"

namespace saltus {
namespace {

using Quantity = TerminalTerm::Quantity;

constexpr int kOrder = 18;  // of Taylor's series
constexpr int kPieces = 8;  // of a flight, each with a series or a quadrature of its own
// Nodes of the quadrature of Gauss and Legendre on [0, 1].
constexpr std::array<double, 8> kNodes = {0.019855071751231884,
                                          0.10166676129318664,
                                          0.23723379504183550,
                                          0.40828267875217510,
                                          0.59171732124782490,
                                          0.76276620495816450,
                                          0.89833323870681340,
                                          0.98014492824876812};
constexpr std::array<double, 8> kWeights = {0.050614268145188130,
                                            0.11119051722668724,
                                            0.15685332293894364,
                                            0.18134189168918100,
                                            0.18134189168918100,
                                            0.15685332293894364,
                                            0.11119051722668724,
                                            0.050614268145188130};

std::array<int, 2> BodiesOf(const Candidate& c) { return {c.a, c.plane ? -1 : c.b}; }

}  // namespace

CostateShooting::CostateShooting(const Scene& scene, std::vector<Candidate> sequence, bool moving_end)
    : scene_(scene),
      sequence_(std::move(sequence)),
      place_(scene.bodies.size(), -1),
      index_(scene.bodies.size(), -1),
      turns_(scene.bodies.size()) {
  for (int c = 0; c < scene.num_controlled(); ++c) place_[scene.control.bodies[c]] = c;
  std::vector<bool> matters(scene.bodies.size(), false);
  for (int body : scene.control.bodies) matters[body] = true;
  for (const Candidate& c : sequence_) {
    for (int body : BodiesOf(c)) {
      if (body >= 0) matters[body] = true;
    }
  }
  int num_hard = 0;
  const auto count = [&](const auto& terms) {
    for (const auto& term : terms) {
      matters[term.body] = true;
      num_hard += term.hard;
    }
  };
  count(scene.objective.terminal);
  count(scene.objective.via);
  for (const RunningTerm& term : scene.objective.running) {
    matters[term.body] = true;
    std::vector<double>& turns = turns_[term.body];
    turns.insert(turns.end(), term.times.begin(), term.times.end());
    std::sort(turns.begin(), turns.end());
  }
  for (size_t i = 0; i < scene.bodies.size(); ++i) {
    if (!matters[i] || scene.bodies[i].fixed) continue;
    index_[i] = num_unknowns_;
    num_unknowns_ += 4;
    sizes_.terminal += 4;
  }
  for (const Candidate& c : sequence_) {
    impact_index_.push_back(num_unknowns_);
    num_unknowns_ += 2;
    for (int body : BodiesOf(c)) {
      if (body < 0 || !HasCostate(body)) continue;
      num_unknowns_ += 4;
      sizes_.jumps += 4;
    }
  }
  sizes_.hamiltonians = static_cast<int>(sequence_.size()) + moving_end;
  hard_index_ = num_unknowns_;
  num_unknowns_ += 2 * num_hard;
  sizes_.gaps = static_cast<int>(sequence_.size()) + 2 * num_hard;
  if (moving_end) end_index_ = num_unknowns_++;
  CHECK_EQ(num_unknowns_, sizes_.Sum());
}

std::string CostateShooting::ReasonNotSupported(const Scene& scene) {
  if (scene.objective.effort == 0) {
    return "without a cost of effort the optimal forces are at their bounds and do not follow from the costates";
  }
  if (!scene.no_contact.empty()) return "pairs that must not touch (no_contact) are not supported; use ceres_phases";
  if (std::ranges::any_of(scene.objective.terminal, [](const TerminalTerm& term) { return term.region.has_value(); })) {
    return "goal regions are not supported; use ceres_phases";
  }
  if (!scene.objective.limits.empty()) return "limits of the speed are not supported; use ceres_phases";
  const bool bounded = scene.control.IsBounded();
  for (const RunningTerm& term : scene.objective.running) {
    const auto& pushed = scene.control.bodies;
    if (bounded && std::find(pushed.begin(), pushed.end(), term.body) != pushed.end()) {
      return "running costs of a disc with a bounded force are not supported; use ceres_phases";
    }
  }
  return "";
}

std::vector<double> CostateShooting::Unknowns(const std::vector<Costate<double>>& start,
                                              const std::vector<std::vector<Costate<double>>>& after_impact,
                                              const std::vector<double>& times, const std::vector<double>& multipliers,
                                              const std::vector<Vec2d>& hard, double end) const {
  std::vector<double> y(num_unknowns_);
  const auto put = [](const Costate<double>& costate, double* at) {
    std::copy_n(costate.velocity.data(), 2, std::copy_n(costate.position.data(), 2, at));
  };
  for (size_t i = 0; i < index_.size(); ++i) {
    if (index_[i] >= 0) put(start[i], &y[index_[i]]);
  }
  for (size_t k = 0; k < sequence_.size(); ++k) {
    double* at = &y[impact_index_[k]];
    *at++ = times[k];
    *at++ = multipliers[k];
    for (int body : BodiesOf(sequence_[k])) {
      if (body < 0 || !HasCostate(body)) continue;
      put(after_impact[k][body], at);
      at += 4;
    }
  }
  for (size_t i = 0; i < hard.size(); ++i) std::copy_n(hard[i].data(), 2, &y[hard_index_ + 2 * i]);
  if (end_index_ >= 0) y[end_index_] = end;
  return y;
}

template <typename T>
Vec2<T> CostateShooting::ForceOf(int body, const Vec2<T>& lambda_v) const {
  const int c = place_[body];
  if (c < 0) return Vec2<T>(T(0.0), T(0.0));
  const Vec2<T> free = Scale(-1 / (2 * scene_.objective.effort * scene_.bodies[body].mass), lambda_v);
  return NearestWithinBounds<T>(scene_.control, c, free);
}

template <typename T>
T CostateShooting::Running(int body, const T& time, const Flying<T>& x, bool of_velocity_only) const {
  T sum(0.0);
  for (const RunningTerm& term : scene_.objective.running) {
    if (term.body != body || (of_velocity_only && term.quantity != Quantity::kVelocity)) continue;
    const Vec2<T> miss = (term.quantity == Quantity::kPosition ? x.p : x.v) - TargetAt(term, time);
    sum += term.weight * Dot(miss, miss);
  }
  return sum;
}

template <typename T>
T CostateShooting::Hamiltonian(int body, const T& time, const Flying<T>& x, bool of_velocity_only) const {
  const Vec2<T> u = ForceOf(body, x.w);
  const Vec2<T> a = Scale(1 / scene_.bodies[body].mass, u) + scene_.gravity.cast<T>();
  return T(Dot(x.q, x.v) + Dot(x.w, a) + scene_.objective.effort * Dot(u, u) +
           Running(body, time, x, of_velocity_only));
}

// Flies a disc whose force follows from the costates without bounds.
template <typename T>
void CostateShooting::FlyBySeries(int body, const T& from, const T& length, Flying<T>* x, T* loss) const {
  const double mass = scene_.bodies[body].mass, effort = scene_.objective.effort;
  const double gain = place_[body] >= 0 ? -1 / (2 * effort * mass * mass) : 0.0;
  const T h = length / double(kPieces);
  for (int piece = 0; piece < kPieces; ++piece) {
    const T begin = from + h * double(piece);
    std::vector<Flying<T>> terms = {*x};
    for (int n = 0; n < kOrder; ++n) {
      const Flying<T>& last = terms.back();
      const T by = h / double(n + 1);
      Flying<T> next;
      next.p = Scale(by, last.v);
      Vec2<T> a = Scale(gain, last.w);
      if (n == 0) a += scene_.gravity.cast<T>();
      next.v = Scale(by, a);
      Vec2<T> q(T(0.0), T(0.0)), w = -last.q;
      for (const RunningTerm& term : scene_.objective.running) {
        if (term.body != body) continue;
        const bool of_position = term.quantity == Quantity::kPosition;
        Vec2<T> miss = of_position ? last.p : last.v;
        if (n == 0) miss -= TargetAt(term, begin);
        if (n == 1) miss -= Scale(2.0, Vec2<T>(TargetAt(term, T(begin + 0.5 * h)) - TargetAt(term, begin)));
        (of_position ? q : w) -= Scale(2 * term.weight, miss);
      }
      next.q = Scale(by, q);
      next.w = Scale(by, w);
      terms.push_back(next);
    }
    const auto at = [&](double s) {
      Flying<T> y = terms.back();
      for (int n = kOrder - 1; n >= 0; --n) {
        y.p = terms[n].p + Scale(s, y.p);
        y.v = terms[n].v + Scale(s, y.v);
        y.q = terms[n].q + Scale(s, y.q);
        y.w = terms[n].w + Scale(s, y.w);
      }
      return y;
    };
    for (size_t i = 0; i < kNodes.size() && loss != nullptr; ++i) {
      const Flying<T> there = at(kNodes[i]);
      const Vec2<T> u = ForceOf(body, there.w);
      const T rate = effort * Dot(u, u) + Running(body, T(begin + kNodes[i] * h), there, false);
      *loss += kWeights[i] * h * rate;
    }
    *x = at(1);
  }
}

// Returns the times, rising, at which a force reaches its bounds or leaves them, in (0, length).
std::vector<double> CostateShooting::Switches(int body, const Vec2d& lambda_q, const Vec2d& lambda_v,
                                              double length) const {
  const double scale = -1 / (2 * scene_.objective.effort * scene_.bodies[body].mass);
  const Vec2d start = scale * lambda_v, slope = -scale * lambda_q;
  std::vector<double> times;
  const auto add = [&](double t) {
    if (t > 0 && t < length) times.push_back(t);
  };
  const int c = place_[body];
  for (int d = 0; d < 2 && !scene_.control.max.empty(); ++d) {
    for (double bound : {-scene_.control.max[c], scene_.control.max[c]}) {
      if (slope[d] != 0) add((bound - start[d]) / slope[d]);
    }
  }
  if (!scene_.control.max_norm.empty() && slope.squaredNorm() > 0) {
    const double most = scene_.control.max_norm[c];
    const double a = slope.squaredNorm(), b = start.dot(slope), k = start.squaredNorm() - most * most;
    const double root = b * b - a * k;
    if (root > 0) {
      add((-b - std::sqrt(root)) / a);
      add((-b + std::sqrt(root)) / a);
    }
  }
  std::sort(times.begin(), times.end());
  return times;
}

template <typename T>
void CostateShooting::FlyAtBounds(int body, const T& length, Flying<T>* x, T* loss) const {
  const Vec2d q(Value(x->q[0]), Value(x->q[1])), w(Value(x->w[0]), Value(x->w[1]));
  std::vector<T> cuts = {T(0.0)};
  for (double t : Switches(body, q, w, Value(length))) cuts.push_back(T(t));
  cuts.push_back(length);
  Vec2<T> gain(T(0.0), T(0.0)), way = gain;
  const double inverse_mass = 1 / scene_.bodies[body].mass;
  for (size_t k = 0; k + 1 < cuts.size(); ++k) {
    for (int piece = 0; piece < kPieces; ++piece) {
      const T h = (cuts[k + 1] - cuts[k]) / double(kPieces), begin = cuts[k] + h * double(piece);
      for (size_t i = 0; i < kNodes.size(); ++i) {
        const T t = begin + kNodes[i] * h, part = kWeights[i] * h;
        const Vec2<T> u = ForceOf(body, Vec2<T>(x->w - Scale(t, x->q)));
        gain += Scale(T(inverse_mass * part), u);
        way += Scale(T(inverse_mass * part * (length - t)), u);
        if (loss != nullptr) *loss += scene_.objective.effort * part * Dot(u, u);
      }
    }
  }
  const Vec2<T> fall = Scale(length, scene_.gravity);
  x->p += Scale(length, Vec2<T>(x->v + Scale(T(0.5), fall))) + way;
  x->v += fall + gain;
  x->w -= Scale(length, x->q);
}

template <typename T>
void CostateShooting::Fly(int body, const T& from, const T& length, Flying<T>* x, T* loss) const {
  const bool bounded = scene_.control.IsBounded();
  if (bounded && place_[body] >= 0) {
    FlyAtBounds(body, length, x, loss);
    return;
  }
  T begin = from;
  for (double turn : turns_[body]) {
    if (turn <= Value(begin) || turn >= Value(from) + Value(length)) continue;
    FlyBySeries(body, begin, T(turn - begin), x, loss);
    begin = T(turn);
  }
  FlyBySeries(body, begin, T(from + length - begin), x, loss);
}

template <typename T>
bool CostateShooting::Evaluate(const T* y, T* residuals, T* loss, std::vector<Leg>* legs,
                               std::vector<double>* speeds) const {
  const T duration = end_index_ < 0 ? T(scene_.duration) : y[end_index_];
  T* jump = residuals;
  T* hamiltonian = jump + sizes_.jumps;
  T* gap = hamiltonian + sizes_.hamiltonians;
  T* terminal = gap + sizes_.gaps;
  if (loss != nullptr) *loss = T(0.0);

  std::vector<Flying<T>> now(scene_.num_bodies());
  std::vector<T> since(scene_.num_bodies(), T(0.0));
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    const Body& body = scene_.bodies[i];
    now[i].p = body.position.cast<T>();
    now[i].v = body.velocity.cast<T>();
    now[i].q = now[i].w = Vec2<T>(T(0.0), T(0.0));
    if (!HasCostate(i)) continue;
    now[i].q = {y[index_[i]], y[index_[i] + 1]};
    now[i].w = {y[index_[i] + 2], y[index_[i] + 3]};
  }
  const auto fly_to = [&](int body, const T& time) {
    if (!HasCostate(body)) return;
    if constexpr (std::is_same_v<T, double>) {
      if (legs != nullptr) legs->push_back({body, since[body], now[body]});
    }
    if (Value(time) > Value(since[body])) Fly(body, since[body], T(time - since[body]), &now[body], loss);
    since[body] = time;
  };

  // Via terms are in order of time; an impact at the same time comes after them.
  std::vector<size_t> vias;
  for (size_t i = 0; i < scene_.objective.via.size(); ++i) vias.push_back(i);
  std::stable_sort(vias.begin(), vias.end(), [&](size_t a, size_t b) {
    return scene_.objective.via[a].time < scene_.objective.via[b].time;
  });
  const std::vector<TerminalTerm>& terms = scene_.objective.terminal;
  const auto hard_terms = std::count_if(terms.begin(), terms.end(), [](const TerminalTerm& term) { return term.hard; });
  const auto hard = [&](int i) { return Vec2<T>(y[hard_index_ + 2 * i], y[hard_index_ + 2 * i + 1]); };
  size_t next_via = 0;
  const auto pass_vias = [&](double until) {
    for (; next_via < vias.size() && scene_.objective.via[vias[next_via]].time <= until; ++next_via) {
      const ViaTerm& term = scene_.objective.via[vias[next_via]];
      if (!HasCostate(term.body)) continue;
      fly_to(term.body, T(term.time));
      Flying<T>& x = now[term.body];
      const bool of_position = term.quantity == Quantity::kPosition;
      const Vec2<T> miss = (of_position ? x.p : x.v) - term.target.cast<T>();
      Vec2<T>& costate = of_position ? x.q : x.w;
      if (term.hard) {
        const auto before = std::count_if(scene_.objective.via.begin(),
                                          scene_.objective.via.begin() + vias[next_via],
                                          [](const ViaTerm& other) { return other.hard; });
        costate -= hard(static_cast<int>(hard_terms + before));
        for (int d = 0; d < 2; ++d) *gap++ = miss[d];
      } else {
        costate -= Scale(2 * term.weight, miss);
        if (loss != nullptr) *loss += term.weight * Dot(miss, miss);
      }
    }
  };

  double last = 0;
  for (size_t k = 0; k < sequence_.size(); ++k) {
    const Candidate& c = sequence_[k];
    const T* at = y + impact_index_[k];
    const T time = at[0], nu = at[1];
    at += 2;
    if (!(Value(time) >= last) || !(Value(time) <= Value(duration))) return false;
    last = Value(time);
    pass_vias(last);
    const ImpactConstants law = MakeImpactConstants(scene_, c);
    const std::array<int, 2> body = BodiesOf(c);
    std::array<Flying<T>, 2> before, after;
    Vec2<T> gain_of(T(0.0), T(0.0));
    for (int side = 0; side < 2; ++side) {
      before[side].v = Vec2<T>(T(0.0), T(0.0));
      if (body[side] < 0) continue;
      fly_to(body[side], time);
      before[side] = now[body[side]];
    }
    const Separation<T> apart =
        c.plane ? Separate<T>(before[0].p, MakeHalfPlane(scene_.planes[c.b])) : Separate<T>(before[0].p, before[1].p);
    const Impact<T> impact = MakeImpact<T>(law, apart.normal, Vec2<T>(before[0].v - before[1].v));
    if (!(Value(impact.speed) < 0)) return false;
    if (speeds != nullptr) speeds->push_back(-Value(impact.speed));
    *gap++ = apart.distance - law.contact_distance;
    T gained(0.0);
    for (int side = 0; side < 2; ++side) {
      if (body[side] < 0 || !HasCostate(body[side])) continue;
      after[side] = before[side];
      const double inverse_mass = side == 0 ? law.inverse_mass_a : -law.inverse_mass_b;
      after[side].v += Scale(inverse_mass, impact.impulse);
      after[side].q = {at[0], at[1]};
      after[side].w = {at[2], at[3]};
      at += 4;
      gain_of += Scale(inverse_mass, after[side].w);
      gained += Hamiltonian(body[side], time, after[side], true) - Hamiltonian(body[side], time, before[side], true);
      now[body[side]] = after[side];
    }
    *hamiltonian++ = gained;
    const CostateGain<T> gain = ImpactAdjoint(law, impact, gain_of);
    for (int side = 0; side < 2; ++side) {
      if (body[side] < 0 || !HasCostate(body[side])) continue;
      const double sign = side == 0 ? 1 : -1;
      const Vec2<T> q = after[side].q + Scale(sign, Vec2<T>(gain.position + Scale(nu, impact.normal)));
      const Vec2<T> w = after[side].w + Scale(sign, gain.velocity);
      for (int d = 0; d < 2; ++d) *jump++ = before[side].q[d] - q[d];
      for (int d = 0; d < 2; ++d) *jump++ = before[side].w[d] - w[d];
    }
  }
  pass_vias(Value(duration));

  T at_end(0.0);
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    fly_to(i, duration);
    if (!HasCostate(i)) continue;
    at_end += Hamiltonian(i, duration, now[i], false);
    Vec2<T> q = now[i].q, w = now[i].w;
    int index = 0;
    for (const TerminalTerm& term : terms) {
      const bool of_position = term.quantity == Quantity::kPosition;
      const int number = index;
      index += term.hard;
      if (term.body != i) continue;
      const Vec2<T> miss = (of_position ? now[i].p : now[i].v) - term.target.cast<T>();
      (of_position ? q : w) -= term.hard ? hard(number) : Scale(2 * term.weight, miss);
      if (loss != nullptr && !term.hard) *loss += term.weight * Dot(miss, miss);
    }
    for (int d = 0; d < 2; ++d) *terminal++ = q[d];
    for (int d = 0; d < 2; ++d) *terminal++ = w[d];
  }
  for (const TerminalTerm& term : terms) {
    if (!term.hard) continue;
    const Flying<T>& x = now[term.body];
    const Vec2<T> miss = (term.quantity == Quantity::kPosition ? x.p : x.v) - term.target.cast<T>();
    for (int d = 0; d < 2; ++d) *gap++ = miss[d];
  }
  if (scene_.objective.duration) {
    if (loss != nullptr) *loss += scene_.objective.duration->weight * duration;
    if (end_index_ >= 0) *hamiltonian++ = at_end + scene_.objective.duration->weight;
  }
  return true;
}

Vec2d CostateShooting::ForceAt(const std::vector<Leg>& legs, int c, double time) const {
  const int body = scene_.control.bodies[c];
  const Leg* leg = nullptr;
  for (const Leg& other : legs) {
    if (other.body == body && (leg == nullptr || other.begin <= time)) leg = &other;
  }
  Flying<double> x = leg->start;
  if (time > leg->begin) Fly<double>(body, leg->begin, time - leg->begin, &x, nullptr);
  return ForceOf(body, x.w);
}

using ShootingJet = ceres::Jet<double, kCostateShootingStride>;
template bool CostateShooting::Evaluate(const double*, double*, double*, std::vector<Leg>*, std::vector<double>*) const;
template bool CostateShooting::Evaluate(const ShootingJet*, ShootingJet*, ShootingJet*, std::vector<Leg>*,
                                        std::vector<double>*) const;

}  // namespace saltus
