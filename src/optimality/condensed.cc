#include "optimality/condensed.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "base/linear_algebra.h"
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
  num_held_ = 2 * static_cast<int>(restrictions_.hard.size());
  const std::vector<Flight::Hit>& hits = flight.hits();
  theta_.resize(hits.size());
  pushed_.assign(scene.num_bodies(), -1);
  for (int c = 0; c < scene.num_controlled(); ++c) pushed_[scene.control.bodies[c]] = c;
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
      if (pushed_[side.body] < 0) continue;
      side.force_before = AddForce(side.body, before);
      side.force_after = after == before ? side.force_before : AddForce(side.body, after);
    }
  }
  for (int i = 0; i < scene.num_bodies(); ++i) {
    if (!scene.bodies[i].fixed) add_arc(i, -1);
  }

  for (const Functional& f : functionals_) {
    double value = 0;
    for (size_t i = 0; i < f.weights.size(); ++i) value += f.weights[i] * control_[(f.first + i) * width_ + f.column];
    values_.push_back(value);
  }
}

// The intervals whose forces act just before and just after an impact.
std::pair<int, int> CondensedLoss::IntervalsAt(int hit) const {
  const int at = interval_at_[hit];
  return {flight_.hits()[hit].on_node && at > 0 ? at - 1 : at, at};
}

int CondensedLoss::AddArc(int body, int from_hit, int to_hit) {
  Arc arc;
  arc.body = body;
  arc.begin = from_hit >= 0 ? flight_.hits()[from_hit].time : 0.0;
  arc.end = to_hit >= 0 ? flight_.hits()[to_hit].time : scene_.duration;
  if (pushed_[body] >= 0) {
    const int first = from_hit >= 0 ? IntervalsAt(from_hit).second : 0;
    const int last = to_hit >= 0 ? IntervalsAt(to_hit).first : static_cast<int>(lengths_.size()) - 1;
    const double inverse_mass = 1 / scene_.bodies[body].mass;
    std::vector<double> gain, way;
    for (int i = first; i <= last; ++i) {
      const double begin = i == first ? arc.begin : nodes_[i], end = i == last ? arc.end : nodes_[i + 1];
      gain.push_back(inverse_mass * (end - begin));
      way.push_back(gain.back() * (arc.end - 0.5 * (begin + end)));
    }
    arc.functional = static_cast<int>(functionals_.size());
    AddFunctionals(body, first, gain);
    AddFunctionals(body, first, way);
  }
  arcs_.push_back(arc);
  return static_cast<int>(arcs_.size()) - 1;
}

int CondensedLoss::AddForce(int body, int interval) {
  const int functional = static_cast<int>(functionals_.size());
  AddFunctionals(body, interval, {1.0});
  return functional;
}

void CondensedLoss::AddFunctionals(int body, int first, const std::vector<double>& weights) {
  for (int axis = 0; axis < 2; ++axis) functionals_.push_back({2 * pushed_[body] + axis, first, weights});
}

template <typename T>
void CondensedLoss::Sweep(const T* s, T* gradient, T* gaps) const {
  struct Motion {
    Vec2<T> p, v;
    T angle = T(0.0), spin = T(0.0);
  };
  // What the way back needs of an impact, at its time, which is dt after that of the flight.
  struct Passed {
    T dt;
    Impact<T> impact;
    std::array<Vec2<T>, 2> before, after;  // velocities
    std::array<T, 2> spin;                 // angular velocities before
  };
  const auto at = [&](int functional) { return Vec2<T>(s[functional], s[functional + 1]); };
  const auto add = [&](int functional, const Vec2<T>& by) {
    for (int axis = 0; axis < 2; ++axis) gradient[functional + axis] += by[axis];
  };
  const auto acceleration = [&](int body, int force) -> Vec2<T> {
    Vec2<T> a = scene_.gravity.template cast<T>();
    if (force >= 0) a += Scale(1 / scene_.bodies[body].mass, at(force));
    return a;
  };
  const bool spins = scene_.Spins();
  const auto fly = [&](const Arc& arc, Motion* x) {
    const double length = arc.end - arc.begin;
    if (spins) x->angle += length * x->spin;
    x->p += Scale(length, x->v) + (0.5 * length * length * scene_.gravity).template cast<T>();
    x->v += (length * scene_.gravity).template cast<T>();
    if (arc.functional < 0) return;
    x->v += at(arc.functional);
    x->p += at(arc.functional + 2);
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
  std::vector<Passed> passed(num_hits);
  for (int k = 0; k < num_hits; ++k) {
    const Candidate& c = flight_.hits()[k].contact;
    const ImpactConstants law = MakeImpactConstants(scene_, c);
    const auto separation = [&] {
      return c.plane ? Separate<T>(now[c.a].p, MakeHalfPlane(scene_.planes[c.b])) : Separate<T>(now[c.a].p, now[c.b].p);
    };
    const auto relative = [&]() -> Vec2<T> { return c.plane ? now[c.a].v : Vec2<T>(now[c.a].v - now[c.b].v); };
    Passed& out = passed[k];
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
      x.v += Scale(out.dt, acceleration(side.body, side.force_before));
      if (spins) x.angle += out.dt * x.spin;
    }
    out.spin = {now[c.a].spin, c.plane ? T(0.0) : now[c.b].spin};
    out.impact = MakeImpact<T>(law, separation().normal, relative(), out.spin);
    for (int i = 0; i < 2; ++i) {
      const Side& side = sides_[k][i];
      if (side.body < 0) continue;
      Motion& x = now[side.body];
      out.before[i] = x.v;
      x.v += Scale(i == 0 ? law.inverse_mass_a : -law.inverse_mass_b, out.impact.impulse);
      out.after[i] = x.v;
      x.p -= Scale(out.dt, x.v);
      x.v -= Scale(out.dt, acceleration(side.body, side.force_after));
      if (!spins) continue;
      x.spin += SpinGain(law, i, out.impact);
      x.angle -= out.dt * x.spin;
    }
  }

  std::fill(gradient, gradient + num_functionals(), T(0.0));
  std::vector<Costate<T>> costates;
  for (int i = 0; i < scene_.num_bodies(); ++i) {
    if (last_arc_[i] >= 0) fly(arcs_[last_arc_[i]], &now[i]);
    costates.push_back(TerminalCostate<T>(soft_, i, T(scene_.duration), now[i].p, now[i].v, now[i].angle, now[i].spin));
  }
  size_t hard = 0;
  for (const TerminalTerm& term : scene_.objective.terminal) {
    if (!term.hard || restrictions_.hard.empty()) continue;
    const bool of_position = term.quantity == TerminalTerm::Quantity::kPosition;
    Costate<T>& costate = costates[term.body];
    if (term.IsOfSpin()) {
      const bool angle = term.quantity == TerminalTerm::Quantity::kAngle;
      costate.OfSpin(term.quantity) += restrictions_.hard[hard++][0];
      if (gaps != nullptr) *gaps++ = angle ? now[term.body].angle : now[term.body].spin;
      if (gaps != nullptr) *gaps++ = T(0.0);
      continue;
    }
    (of_position ? costate.position : costate.velocity) += restrictions_.hard[hard++].template cast<T>();
    const Vec2<T>& held = of_position ? now[term.body].p : now[term.body].v;
    for (int axis = 0; axis < 2 && gaps != nullptr; ++axis) *gaps++ = held[axis];
  }
  const auto fly_back = [&](const Arc& arc) {
    Costate<T>& costate = costates[arc.body];
    if (arc.functional >= 0) {
      add(arc.functional, costate.velocity);
      add(arc.functional + 2, costate.position);
    }
    costate.velocity += Scale(arc.end - arc.begin, costate.position);
    if (spins) costate.angular_velocity += (arc.end - arc.begin) * costate.angle;
  };
  const double effort = scene_.objective.effort;
  for (int k = num_hits - 1; k >= 0; --k) {
    const Candidate& c = flight_.hits()[k].contact;
    const ImpactConstants law = MakeImpactConstants(scene_, c);
    const Passed& at_impact = passed[k];
    T power(0.0), early(0.0), late(0.0);  // what the Hamiltonian gains: with the forces there are, or one on both sides
    const auto count = [&](const Side& side, const Vec2<T>& velocity, int force, double sign) {
      const Costate<T>& costate = costates[side.body];
      const auto kinetic = [&](int f) {
        return T(Dot(costate.position, velocity) + Dot(costate.velocity, acceleration(side.body, f)));
      };
      power += sign * kinetic(force);
      if (force >= 0) power += sign * effort * Dot(at(force), at(force));
      early += sign * kinetic(side.force_before);
      late += sign * kinetic(side.force_after);
    };
    const auto lengthen = [&](const Side& side, int force, const T& dt) {
      if (force < 0) return;
      const Vec2<T> slope = Scale(1 / scene_.bodies[side.body].mass, costates[side.body].velocity);
      add(force, Scale(dt, Vec2<T>(slope + Scale(2 * effort, at(force)))));
    };
    Vec2<T> y(T(0.0), T(0.0));
    std::array<T, 2> turning = {T(0.0), T(0.0)};  // costates of the angular velocities
    for (int i = 0; i < 2; ++i) {
      const Side& side = sides_[k][i];
      if (side.body < 0) continue;
      fly_back(arcs_[side.arc_after]);
      Costate<T>& costate = costates[side.body];
      costate.velocity -= Scale(at_impact.dt, costate.position);
      if (spins) {
        costate.angular_velocity -= at_impact.dt * costate.angle;
        turning[i] = costate.angular_velocity;
        power += costate.angle * SpinGain(law, i, at_impact.impact);
        early += costate.angle * SpinGain(law, i, at_impact.impact);
        late += costate.angle * SpinGain(law, i, at_impact.impact);
      }
      lengthen(side, side.force_after, -at_impact.dt);
      count(side, at_impact.after[i], side.force_after, 1);
      y += Scale(i == 0 ? law.inverse_mass_a : -law.inverse_mass_b, costate.velocity);
    }
    const CostateGain<T> gain = ImpactAdjoint<T>(law, at_impact.impact, y, at_impact.spin, turning);
    for (int i = 0; i < 2; ++i) {
      const Side& side = sides_[k][i];
      if (side.body < 0) continue;
      costates[side.body].position += Scale(i == 0 ? 1.0 : -1.0, gain.position);
      costates[side.body].velocity += Scale(i == 0 ? 1.0 : -1.0, gain.velocity);
      costates[side.body].angular_velocity += law.radius[i] * gain.spin;
      count(side, at_impact.before[i], side.force_before, -1);
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
      lengthen(side, side.force_before, at_impact.dt);
      costate.velocity += Scale(at_impact.dt, costate.position);
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
      if (a.column / 2 != b.column / 2) continue;
      const int c = a.column / 2;
      const int begin = std::max(a.first, b.first);
      const int end =
          std::min(a.first + static_cast<int>(a.weights.size()), b.first + static_cast<int>(b.weights.size()));
      for (int i = begin; i < end; ++i) {
        const Restrictions::Force& force = ForceAt(i, c);
        const double share = force.free(a.column % 2, b.column % 2) / (1 + force.bend);
        gram(j, k) += share * a.weights[i - a.first] * b.weights[i - b.first] / lengths_[i];
      }
      gram(k, j) = gram(j, k);
    }
  }
  return gram;
}

void CondensedLoss::DivideByWeights(Eigen::VectorXd* x) const {
  for (Eigen::Index i = 0; i < x->size(); i += 2) {
    const Restrictions::Force& force = ForceAt(i / width_, static_cast<int>(i % width_ / 2));
    x->segment<2>(i) = (force.free * x->segment<2>(i) / ((1 + force.bend) * Length(i))).eval();
  }
}

Eigen::Index CondensedLoss::NumFree() const {
  double sum = 0;
  for (size_t k = 0; k < lengths_.size(); ++k) {
    for (int c = 0; c < width_ / 2; ++c) sum += ForceAt(k, c).free.trace();
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
  const LeastCurvature least = FindLeastCurvature(Gram(), hessian, gaps, 2 * scene_.objective.effort);
  CurvatureRange result;
  result.direction = Eigen::VectorXd::Zero(control_.size());
  const bool others = least.rank < NumFree();  // directions that the motion does not notice
  if (least.source.size() == 0) return result;
  result.smallest = 1 + least.smallest;
  result.largest = 1 + least.largest;
  result.direction = Transposed(least.source);
  DivideByWeights(&result.direction);
  if (!restrictions_.forces.empty()) {  // orthonormal to another measure
    double square = 0;
    for (Eigen::Index i = 0; i < result.direction.size(); ++i) square += Length(i) * std::pow(result.direction[i], 2);
    result.direction /= std::sqrt(square);
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

// With q = G' + G'' F d + A^T lambda, A the derivatives of what is held, 2 effort M (u + d) + F^T q vanishes and so
// does A F d: equations for q and lambda, whose number does not grow with the intervals.
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
  Eigen::MatrixXd f(num_functionals(), control_.size());
  for (int j = 0; j < num_functionals(); ++j) {
    f.row(j) = Transposed(Eigen::VectorXd::Unit(num_functionals(), j)).transpose();
  }
  Eigen::MatrixXd hessian = Multiply(MultiplyTransposed(f, by_functionals), f);
  for (Eigen::Index i = 0; i < hessian.rows(); ++i) hessian(i, i) += 2 * scene_.objective.effort * Length(i);
  return hessian;
}

}  // namespace saltus
