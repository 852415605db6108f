// Event phases: the third transcription. The collision sequence is given; its impacts cut time into phases of free
// duration, and the control is eliminated.
//
// Between two of its own impacts a pushed disc flies from (p0, v0) to (p1, v1) in time S under the force of least
// effort. With W = v1 - v0 - g S and D = p1 - p0 - v0 S - g S^2/2 that is, in time t since the start of the arc,
//
//   u(t) = m (a + b (t - S/2)),   a = W/S,   b = (W S/2 - D)/V,   integral of |u|^2 dt = m^2 (S |a|^2 + V |b|^2),
//
// with V = S^3/12. The same holds for the best force that is constant on intervals, n_j equal ones in each phase of
// length s_j that the arc spans, if u is taken at their middles and V = S^3/12 - sum_j s_j^3 / (12 n_j^2). Either way
// the loss is a sum of squares of a handful of variables: impact times, the states of pushed discs before their impacts
// and at the end. Their positions are written so that they touch; only impacts without a pushed disc leave a gap to
// be closed. Their velocities are written relative to the other side, along the normal and along the tangent.
//
// A disc that nothing pushes, or that has done its work (no term of the objective, no impact to come), flies freely.
#pragma once

#include <ceres/jet.h>

#include <array>
#include <cmath>
#include <span>
#include <vector>

#include "saltus/scene/scene.h"
#include "simulate/impact.h"

namespace saltus {

template <typename T>
struct Knot {
  T time;
  Vec2<T> p, v;
  int phase = 0;  // that starts here
};

// The motion of a pushed disc between two of its knots.
template <typename T>
struct Arc {
  int body = 0;
  Knot<T> from;
  int last_phase = 0;
  T length;             // S
  T spread;             // V
  Vec2<T> mean, slope;  // a and b: acceleration by the force, its rate
  Vec2<T> AccelerationAtStart() const { return mean - Scale(T(length * 0.5), slope); }
  Vec2<T> AccelerationAtEnd() const { return mean + Scale(T(length * 0.5), slope); }
};

template <typename T>
struct PhaseImpact {
  T time;
  T gap;  // m; 0 by construction if a pushed disc takes part
  Impact<T> impact;
  std::array<Vec2<T>, 2> before, after;                            // velocities of a and b
  std::array<int, 2> arc_before = {-1, -1}, arc_after = {-1, -1};  // of a and b in Path::arcs; -1: flies freely
};

template <typename T>
struct Path {
  std::vector<PhaseImpact<T>> impacts;
  std::vector<Arc<T>> arcs;
  std::vector<Knot<T>> end;   // of every disc, at the final time
  std::vector<int> last_arc;  // of every disc; -1: flies freely to the end
};

class EventPhases {
 public:
  // `intervals` are the control intervals of each phase, sequence.size() + 1 numbers; none: a control in continuous
  // time. Preconditions: effort > 0, indices in range, no pair of two fixed bodies.
  EventPhases(const Scene& scene, std::vector<Candidate> sequence, std::vector<int> intervals = {});

  const Scene& scene() const { return scene_; }
  const std::vector<Candidate>& sequence() const { return sequence_; }
  const ImpactConstants& law(int k) const { return laws_[k]; }
  const HalfPlane<double>& plane(int i) const { return planes_[i]; }
  int num_impacts() const { return static_cast<int>(sequence_.size()); }
  int num_variables() const { return num_variables_; }
  int num_effort_residuals() const { return 4 * num_arcs_; }
  bool IsPushed(int body) const { return pushed_[body]; }
  // Whether impact k has a pushed disc, so that its gap is closed by construction.
  bool IsSteered(int k) const { return IsPushed(sequence_[k].a) || PushesB(k); }
  // The impacts that are not steered.
  int num_gaps() const { return num_gaps_; }
  // Whether a disc is pushed after its last impact.
  bool IsAimed(int body) const { return aim_index_[body] >= 0; }
  // The variable that is the time of impact k.
  int TimeIndex(int k) const { return index_[k]; }
  // The variable that is the relative velocity along the normal at impact k, negative if closing. Precondition:
  // IsSteered(k).
  int SpeedIndex(int k) const { return index_[k] + 2; }

  // Sets the path of variables z; returns false if an impact is not later than the one before.
  template <typename T>
  bool Unroll(const T* z, Path<T>* path) const;

  // Sets the residuals whose squares are effort (4 an arc) and terminal terms (2 each).
  template <typename T>
  void LossResiduals(const Path<T>& path, T* residuals) const;
  double Loss(const Path<double>& path) const;
  int num_loss_residuals() const {
    return num_effort_residuals() + 2 * static_cast<int>(scene_.objective.terminal.size());
  }

  // Returns the contribution of intervals of finite length to the mean Hamiltonian of phase j (costate.h).
  template <typename T>
  T GridHamiltonian(const Path<T>& path, int j) const;

  // Returns the variables of a path that is at `before(time)` just before each of `times`, and at `end`.
  struct State {
    std::vector<Vec2d> p, v;  // of every disc
  };
  std::vector<double> Variables(std::span<const double> times, std::span<const State> before, const State& end) const;

  // The control of a path: one row a control interval, of all pushed discs, and their durations.
  // Precondition: constructed with intervals.
  void Control(const Path<double>& path, std::vector<double>* control, std::vector<double>* durations) const;

 private:
  bool PushesB(int k) const { return !sequence_[k].plane && pushed_[sequence_[k].b]; }
  template <typename T>
  T Spread(const std::vector<T>& times, int first_phase, int last_phase) const;
  template <typename T>
  int AddArc(const std::vector<T>& times, int body, const Knot<T>& from, const Knot<T>& to, Path<T>* path) const;
  template <typename T>
  Knot<T> Drift(const Knot<T>& knot, int body, const T& time) const;
  template <typename T>
  void PlaceSteered(int k, const T* z, const Knot<T>& other, std::array<Knot<T>, 2>* knots) const;

  Scene scene_;
  std::vector<Candidate> sequence_;
  std::vector<int> intervals_;
  std::vector<ImpactConstants> laws_;
  std::vector<HalfPlane<double>> planes_;
  std::vector<bool> pushed_;    // by body
  std::vector<int> aim_index_;  // by body: of its final state among the variables; -1 if it has none
  std::vector<int> index_;      // by impact: of its variables
  int num_variables_ = 0;
  int num_arcs_ = 0;
  int num_gaps_ = 0;
};

// Scene::steps control intervals for phases that begin at 0 and at `times`: one where nobody is pushed with effect, the
// rest by the lengths of the phases, but at least two each. Empty if there are too few.
std::vector<int> DistributeIntervals(const Scene& scene, const std::vector<Candidate>& sequence,
                                     std::span<const double> times);

// ---------------------------------------------------------------------------------------------------- implementation

template <typename T>
T EventPhases::Spread(const std::vector<T>& times, int first_phase, int last_phase) const {
  const T length = times[last_phase + 1] - times[first_phase];
  T spread = length * length * length;
  if (!intervals_.empty()) {
    for (int j = first_phase; j <= last_phase; ++j) {
      const T s = times[j + 1] - times[j];
      spread -= s * s * s / (1.0 * intervals_[j] * intervals_[j]);
    }
  }
  return spread / 12.0;
}

template <typename T>
int EventPhases::AddArc(const std::vector<T>& times, int body, const Knot<T>& from, const Knot<T>& to,
                        Path<T>* path) const {
  Arc<T> arc;
  arc.body = body;
  arc.from = from;
  arc.last_phase = to.phase - 1;
  arc.length = to.time - from.time;
  arc.spread = Spread(times, from.phase, arc.last_phase);
  const T& s = arc.length;
  const Vec2<T> gain = to.v - from.v - Scale(s, scene_.gravity);
  const Vec2<T> way = to.p - from.p - Scale(s, Vec2<T>(from.v + Scale(T(s * 0.5), scene_.gravity)));
  arc.mean = Scale(T(1.0 / s), gain);
  arc.slope = Scale(T(1.0 / arc.spread), Vec2<T>(Scale(T(s * 0.5), gain) - way));
  path->arcs.push_back(arc);
  return static_cast<int>(path->arcs.size()) - 1;
}

template <typename T>
Knot<T> EventPhases::Drift(const Knot<T>& knot, int body, const T& time) const {
  if (scene_.bodies[body].fixed) return {time, knot.p, knot.v, knot.phase};
  const T s = time - knot.time;
  const Vec2<T> gain = Scale(s, scene_.gravity);
  return {time, knot.p + Scale(s, Vec2<T>(knot.v + Scale(T(0.5), gain))), knot.v + gain, knot.phase};
}

// Sets the states of the pushed discs of impact k just before it, from their variables; `other` is the state of b if it
// is not pushed, and of a if only b is.
template <typename T>
void EventPhases::PlaceSteered(int k, const T* z, const Knot<T>& other, std::array<Knot<T>, 2>* knots) const {
  using std::cos;
  using std::sin;
  const Candidate& c = sequence_[k];
  const double contact_distance = laws_[k].contact_distance;
  const T* at = z + index_[k] + 1;
  Knot<T>&a = (*knots)[0], &b = (*knots)[1];
  if (c.plane) {
    const HalfPlane<double>& plane = planes_[c.b];
    const Vec2d along = Perpendicular(plane.normal);
    a.p = (plane.normal * (plane.offset + contact_distance)).template cast<T>() + Scale(at[0], along);
    a.v = Scale(at[1], plane.normal) + Scale(at[2], along);
    return;
  }
  const Vec2<T> normal(cos(at[0]), sin(at[0]));
  const Vec2<T> w = Scale(at[1], normal) + Scale(at[2], Perpendicular(normal));  // of a relative to b
  if (!IsPushed(c.a)) {
    b.p = other.p - Scale(contact_distance, normal);
    b.v = other.v - w;
    return;
  }
  if (IsPushed(c.b)) {
    b.p = {at[3], at[4]};
    b.v = {at[5], at[6]};
  } else {
    b.p = other.p;
    b.v = other.v;
  }
  a.p = b.p + Scale(contact_distance, normal);
  a.v = b.v + w;
}

template <typename T>
bool EventPhases::Unroll(const T* z, Path<T>* path) const {
  const int bodies = scene_.num_bodies();
  path->impacts.clear();
  path->arcs.clear();
  path->arcs.reserve(num_arcs_);
  std::vector<T> times = {T(0.0)};
  for (int k = 0; k < num_impacts(); ++k) times.push_back(z[index_[k]]);
  times.push_back(T(scene_.duration));
  for (size_t j = 1; j < times.size(); ++j) {
    if (!(Value(times[j]) > Value(times[j - 1]))) return false;
  }

  std::vector<Knot<T>> now(bodies);
  std::vector<int> arc_from(bodies, -1);  // impact of the last knot, participant: 2 k + side
  for (int i = 0; i < bodies; ++i) {
    const Body& body = scene_.bodies[i];
    now[i] = {T(0.0), body.position.template cast<T>(), body.velocity.template cast<T>(), 0};
  }
  for (int k = 0; k < num_impacts(); ++k) {
    const Candidate& c = sequence_[k];
    PhaseImpact<T> event;
    event.time = times[k + 1];
    const std::array<int, 2> body = {c.a, c.plane ? -1 : c.b};
    std::array<Knot<T>, 2> knots;
    Knot<T> other{};
    for (int side = 0; side < 2; ++side) {
      knots[side] = {event.time, Vec2<T>::Zero(), Vec2<T>::Zero(), k + 1};
      if (body[side] < 0 || IsPushed(body[side])) continue;
      knots[side] = Drift(now[body[side]], body[side], event.time);
      other = knots[side];
    }
    if (IsSteered(k)) PlaceSteered(k, z, other, &knots);
    for (int side = 0; side < 2; ++side) {
      if (body[side] < 0 || !IsPushed(body[side])) continue;
      knots[side].phase = k + 1;
      event.arc_before[side] = AddArc(times, body[side], now[body[side]], knots[side], path);
      if (arc_from[body[side]] >= 0) {
        path->impacts[arc_from[body[side]] / 2].arc_after[arc_from[body[side]] % 2] = event.arc_before[side];
      }
      arc_from[body[side]] = 2 * k + side;
    }
    const Separation<T> at = c.plane ? Separate<T>(knots[0].p, planes_[c.b]) : Separate<T>(knots[0].p, knots[1].p);
    event.gap = at.distance - laws_[k].contact_distance;
    event.impact = MakeImpact<T>(laws_[k], at.normal, Vec2<T>(knots[0].v - knots[1].v));
    event.before = {knots[0].v, knots[1].v};
    event.after = {knots[0].v + Scale(laws_[k].inverse_mass_a, event.impact.impulse),
                   knots[1].v - Scale(laws_[k].inverse_mass_b, event.impact.impulse)};
    for (int side = 0; side < 2; ++side) {
      if (body[side] >= 0) now[body[side]] = {event.time, knots[side].p, event.after[side], k + 1};
    }
    path->impacts.push_back(event);
  }

  path->end.resize(bodies);
  path->last_arc.assign(bodies, -1);
  for (int i = 0; i < bodies; ++i) {
    if (!IsAimed(i)) {
      path->end[i] = Drift(now[i], i, T(scene_.duration));
      continue;
    }
    const T* at = z + aim_index_[i];
    path->end[i] = {T(scene_.duration), {at[0], at[1]}, {at[2], at[3]}, num_impacts() + 1};
    path->last_arc[i] = AddArc(times, i, now[i], path->end[i], path);
    if (arc_from[i] >= 0) path->impacts[arc_from[i] / 2].arc_after[arc_from[i] % 2] = path->last_arc[i];
  }
  return true;
}

template <typename T>
T EventPhases::GridHamiltonian(const Path<T>& path, int j) const {
  T sum(0.0);
  if (intervals_.empty()) return sum;
  const T begin = j > 0 ? path.impacts[j - 1].time : T(0.0);
  const T end = j < num_impacts() ? path.impacts[j].time : T(scene_.duration);
  const T h = (end - begin) / (1.0 * intervals_[j]);
  for (const Arc<T>& arc : path.arcs) {
    if (j < arc.from.phase || j > arc.last_phase) continue;
    const double mass = scene_.bodies[arc.body].mass;
    sum += 0.25 * scene_.objective.effort * mass * mass * h * h * Dot(arc.slope, arc.slope);
  }
  return sum;
}

template <typename T>
void EventPhases::LossResiduals(const Path<T>& path, T* residuals) const {
  using std::sqrt;
  for (const Arc<T>& arc : path.arcs) {
    const double scale = std::sqrt(scene_.objective.effort) * scene_.bodies[arc.body].mass;
    const T a = scale * sqrt(arc.length), b = scale * sqrt(arc.spread);
    for (int j = 0; j < 2; ++j) *residuals++ = a * arc.mean[j];
    for (int j = 0; j < 2; ++j) *residuals++ = b * arc.slope[j];
  }
  for (const TerminalTerm& term : scene_.objective.terminal) {
    const Knot<T>& end = path.end[term.body];
    const Vec2<T>& q = term.quantity == TerminalTerm::Quantity::kPosition ? end.p : end.v;
    for (int j = 0; j < 2; ++j) *residuals++ = std::sqrt(term.weight) * (q[j] - term.target[j]);
  }
}

}  // namespace saltus
