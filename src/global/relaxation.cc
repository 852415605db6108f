#include "global/relaxation.h"

#include <ceres/jet.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <type_traits>
#include <utility>

#include "global/interval.h"
#include "global/taylor_model.h"
#include "saltus/scene/materials.h"

namespace saltus::global {
namespace {

constexpr int kMostMultipliers = 48;
constexpr int kWeightRounds = 6;
constexpr int kBoundedRounds = 30;  // where forces are bounded
constexpr int kSideRounds = 3;
constexpr int kWorstRounds = 3;
constexpr int kSpreadRounds = 2;
constexpr int kRobustRounds = 12;
constexpr int kLowestPoints = 3;  // where a dual function is least, for which multipliers are improved
constexpr double kBlunt = 4;      // sharpness of the first smooth minimum, times the known loss
constexpr double kSharper = 2;    // its factor after a full step
constexpr double kBlunter = 0.5;  // its factor after a smaller step
constexpr double kAmple = 1.5;    // of the known loss: multipliers need no larger dual function at points
constexpr double kSmallestStep = 0.05;
constexpr double kLeastPart = 1e-9;
constexpr double kSlow = 0.01;             // of the known loss: a full step that gains less is the last one
constexpr int kRobustWeights = 4;          // rounds after which weights are improved
constexpr int kCornersOf = 3;              // parameters: boxes of more have too many corners
constexpr int kMostParts = 32;             // into which a box is divided to enclose a dual function
constexpr double kPoor = 0.9;              // of the dual function at the worst point: a lower bound gets more work
constexpr double kEnough = 2;              // of the known loss: a box needs no larger bound at its worst point
constexpr double kNarrow = 0.3;            // of the widest parameter: a box is not divided in narrower ones
constexpr double kViolated = 1e-9;         // of the distance of a wall from the origin: as far must a disc be behind it
constexpr double kLeastShare = 0.03;       // a smaller one has too large an error in a box
constexpr double kRegularization = 1e-11;  // relative to the curvature of the dual
using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMostMultipliers, 1>;
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostMultipliers, kMostMultipliers>;

template <typename S>
struct Pair {
  S x = S(0), y = S(0);
  Pair& operator+=(const Pair& b) {
    x += b.x;
    y += b.y;
    return *this;
  }
  Pair& operator-=(const Pair& b) {
    x -= b.x;
    y -= b.y;
    return *this;
  }
  friend Pair operator+(Pair a, const Pair& b) { return a += b; }
  template <typename F>
  friend Pair operator*(const F& f, const Pair& a) {
    return {f * a.x, f * a.y};
  }
};
template <typename A, typename B>
auto Dot(const Pair<A>& a, const Pair<B>& b) {
  return a.x * b.x + a.y * b.y;
}

Interval Positive(const Interval& a) { return boost::numeric::max(a, Interval(0.0)); }
double Positive(double a) { return std::max(a, 0.0); }
Interval SquareRoot(const Interval& a) { return boost::numeric::sqrt(a); }
double SquareRoot(double a) { return std::sqrt(a); }

// The numbers of a scene, with quotients and roots of them enclosed if B is an interval.
template <typename B>
struct Numbers {
  struct Disc {
    bool pushed = false, fixed = false;
    Pair<B> position, velocity;
    B mass;
    B price;           // 1 / (4 effort m^2)
    B largest = B(0);  // force, of its length or of each component; 0 if it is not bounded
    bool is_length = false;
  };
  struct Touch {
    Candidate pair;
    bool b_fixed = false;  // a wall, or a fixed disc
    B distance;      // of the centres of two discs, or of the centre from the line through the origin along the wall
    Pair<B> normal;  // of a wall
    Pair<B> place;   // of a fixed disc b
    B share_a, share_b;  // (1 + restitution) times the other's part of the mass
    B fall;              // the largest acceleration with which gravity brings the two together
  };
  struct Term {
    int body = 0;
    bool position = true;
    Pair<B> target;
    B inverse;  // 1 / (4 weight)
  };
  B duration, effort, lightest, total_mass;
  B first_root;  // of the sum of m |v_i|^2 at the start, without the conserved part of the momentum
  bool has_gravity = false, starts = false;  // starts: discs move or fall by themselves
  Pair<B> gravity;
  std::vector<Pair<B>> conserved;  // directions of unit length, in which no impact changes the momentum of all discs
  B gravity_beyond;                // the length of gravity in the other directions
  std::vector<Disc> discs;
  std::vector<Touch> touches;
  std::vector<Term> terms;

  static Pair<B> ToPair(const Vec2d& a) { return {B(a[0]), B(a[1])}; }

  explicit Numbers(const Scene& scene)
      : duration(scene.duration),
        effort(scene.objective.effort),
        lightest(0),
        total_mass(0),
        first_root(0),
        has_gravity(scene.gravity != Vec2d::Zero()),
        gravity(ToPair(scene.gravity)) {
    double lightest_mass = std::numeric_limits<double>::infinity();
    B energy(0);
    Pair<B> momentum;
    for (int i = 0; i < scene.num_bodies(); ++i) {
      const Body& body = scene.bodies[i];
      const std::vector<int>& pushed = scene.control.bodies;
      Disc disc{std::find(pushed.begin(), pushed.end(), i) != pushed.end(),
                body.fixed,
                ToPair(body.position),
                ToPair(body.velocity),
                B(body.mass),
                B(0)};
      const B& mass = disc.mass;
      if (disc.pushed) {
        disc.price = B(1) / (B(4) * effort * mass * mass);
        lightest_mass = std::min(lightest_mass, body.mass);
        const size_t at = std::find(pushed.begin(), pushed.end(), i) - pushed.begin();
        const auto& max = scene.control.max;
        const auto& max_norm = scene.control.max_norm;
        disc.is_length = !max_norm.empty() && (max.empty() || max_norm[at] <= max[at]);
        if (max.size() + max_norm.size() > 0) disc.largest = B((disc.is_length ? max_norm : max)[at]);
      }
      if (!body.fixed) {
        total_mass += mass;
        energy += mass * (Square(disc.velocity.x) + Square(disc.velocity.y));
        momentum += mass * disc.velocity;
      }
      discs.push_back(disc);
    }
    lightest = B(lightest_mass);
    starts = has_gravity || std::any_of(scene.bodies.begin(), scene.bodies.end(), [](const Body& body) {
               return body.velocity != Vec2d::Zero();
             });
    for (const Candidate& pair : AllPairs(scene)) touches.push_back(TouchOf(scene, pair));
    FindConserved(scene);
    B gravity_square = Square(gravity.x) + Square(gravity.y);
    for (const Pair<B>& direction : conserved) {
      energy -= Square(Dot(direction, momentum)) / total_mass;
      gravity_square -= Square(Dot(direction, gravity));
    }
    first_root = SquareRoot(Positive(energy));
    gravity_beyond = SquareRoot(Positive(gravity_square));
    for (const TerminalTerm& term : scene.objective.terminal) {
      if (term.weight == 0) continue;
      terms.push_back({term.body,
                       term.quantity == TerminalTerm::Quantity::kPosition,
                       ToPair(term.target),
                       B(1) / (B(4) * B(term.weight))});
    }
  }

  // All directions without walls and fixed discs; the one along the walls, if they are parallel.
  void FindConserved(const Scene& scene) {
    conserved = {{B(1), B(0)}, {B(0), B(1)}};
    std::optional<Vec2d> wall;
    for (const Touch& touch : touches) {
      if (!touch.b_fixed) continue;
      const Vec2d normal = touch.pair.plane ? scene.planes[touch.pair.b].normal : Vec2d::Zero();
      const bool is_parallel = touch.pair.plane && (!wall || normal == *wall || normal == -*wall);
      conserved = {{B(-1) * touch.normal.y, touch.normal.x}};
      if (!is_parallel) return conserved.clear();
      wall = normal;
    }
  }

  static Touch TouchOf(const Scene& scene, const Candidate& pair) {
    const Body& a = scene.bodies[pair.a];
    const int other = pair.plane ? scene.planes[pair.b].material : scene.bodies[pair.b].material;
    const B bounce = B(1) + B(ContactBetween(scene, a.material, other).restitution);
    Touch touch{pair, true, B(a.radius), {}, {}, bounce, B(0), B(0)};
    const Pair<B> gravity = ToPair(scene.gravity);
    if (pair.plane) {
      const Plane& plane = scene.planes[pair.b];
      const Pair<B> normal = ToPair(plane.normal);
      const B length = SquareRoot(Square(normal.x) + Square(normal.y));
      touch.normal = {normal.x / length, normal.y / length};
      touch.distance += Dot(touch.normal, ToPair(plane.point));
      touch.fall = Positive(-Dot(touch.normal, gravity));
      return touch;
    }
    const Body& b = scene.bodies[pair.b];
    touch.distance += B(b.radius);
    if (a.fixed || b.fixed) {
      touch.place = ToPair(a.fixed ? a.position : b.position);
      touch.fall = SquareRoot(Square(gravity.x) + Square(gravity.y));
      if (a.fixed) std::swap(touch.pair.a, touch.pair.b);
      return touch;
    }
    touch.b_fixed = false;
    const B mass = B(a.mass) + B(b.mass);
    touch.share_a = bounce * B(b.mass) / mass;
    touch.share_b = bounce * B(a.mass) / mass;
    return touch;
  }

  const Touch& Find(const Candidate& pair) const {
    return *std::find_if(touches.begin(), touches.end(), [&](const Touch& touch) {
      return touch.pair == pair ||
             (!pair.plane && !touch.pair.plane && touch.pair.a == pair.b && touch.pair.b == pair.a);
    });
  }
};

// A disc is on its side of a wall at the time of an impact, or at the end.
struct Side {
  int impact = 0;  // the number of impacts at the end
  int body = 0;
  int touch = 0;  // among Numbers::touches

  bool operator==(const Side&) const = default;
};

// How multipliers are numbered: two of each term, then those of each impact: two of a place (one at a wall), then one
// of the approach; then one of each side. Those of approaches and sides must not be negative. A last touch whose normal
// is free has no approach.
struct Layout {
  int terms = 0;
  std::vector<int> place, approach;  // by impact; -1 if there is none
  std::vector<Side> sides;
  int first_side = 0;
  std::vector<int> not_negative;
  int size = 0;

  Layout(int num_terms, const ImpactBox& box, std::vector<Side> all_sides = {})
      : terms(num_terms), sides(std::move(all_sides)), size(2 * num_terms) {
    for (size_t i = 0; i < box.sequence.size(); ++i) {
      place.push_back(size);
      size += box.sequence[i].plane ? 1 : 2;
      if (!box.IsFree(static_cast<int>(i))) not_negative.push_back(size);
      approach.push_back(box.IsFree(static_cast<int>(i)) ? -1 : size++);
    }
    first_side = size;
    for (size_t i = 0; i < sides.size(); ++i) not_negative.push_back(size++);
  }
};

// Numbers by which the dual function is a quadratic one, whatever they are: the bound holds for any, and is best for
// one.
//
// After an open sequence discs get further with more effort E: their reach enters as the least of E - G * push * root
// of E, of which effort is shared out (see EnergyAtEnd): a part `share` to the forces before, the rest to the reach.
// Only the effort is shared that can add to the energy at the end of the sequence (see EnergyAtEnd).
struct Weights {
  double share = 1;  // in (0, 1]; of 1 there are no terms in an open sequence
  double reach = 1;  // > 0: about G
  double place = 1;  // > 0: about the length of the place's multipliers of a last touch whose normal is free
  // The shares of the effort of each of the two discs of repeated impacts: that of the disc's costate, and that of both
  // costates through repeated impacts. Each > 0, with a sum below 1.
  std::vector<std::array<std::array<double, 2>, 2>> parts = {};
  // Multipliers of the bound on the mean square of a force, >= 0, by flight from the last one and disc, of each
  // component. They add to the effort. Empty if no force is bounded.
  std::vector<std::array<double, 2>> held = {};
  std::vector<double> fall = {};  // > 0: about the length of the costates of velocity of repeated impacts under gravity
};

// Parts of the dual function at given multipliers, by which weights are improved.
struct Record {
  double factor = 1;  // of what is added
  double spent = 0;   // square of the share, times the derivative by it of what effort before the end subtracts
  std::vector<std::array<std::array<double, 2>, 2>> parts;  // integrals of squares
  std::vector<double> lengths, durations;                   // integrals of squares, and times, of repeated impacts
  struct Push {
    std::array<double, 2> squares = {0, 0};  // integrals of the squares of a costate of velocity
    double duration = 0, effort = 0;
  };
  std::vector<Push> pushes;  // as Weights::held
};

// A quadratic function of the multipliers: constant + linear . z - z . curvature z / 2.
struct Quadratic {
  double constant = 0;
  Vector linear;
  Matrix curvature;

  explicit Quadratic(int size) : linear(Vector::Zero(size)), curvature(Matrix::Zero(size, size)) {}
  double At(const Vector& z) const { return constant + linear.dot(z) - 0.5 * z.dot(curvature * z); }
};

// A linear function of the multipliers.
struct Linear {
  Vector by;

  Linear& operator+=(const Linear& b) {
    by += b.by;
    return *this;
  }
  Linear& operator-=(const Linear& b) {
    by -= b.by;
    return *this;
  }
  friend Linear operator+(Linear a, const Linear& b) { return a += b; }
  friend Linear operator*(double factor, Linear a) {
    a.by *= factor;
    return a;
  }
};

// Add factor, factor * a and factor * a^2 to the dual function.
void AddConstant(double factor, Quadratic* dual) { dual->constant += factor; }
void Add(double factor, const Linear& a, Quadratic* dual) { dual->linear += factor * a.by; }
void AddSquare(double factor, const Linear& a, Quadratic* dual) {
  for (int i = 0; i < a.by.size(); ++i) {
    if (a.by[i] != 0) dual->curvature.col(i) -= (2 * factor * a.by[i]) * a.by;
  }
}
template <typename P, typename S>
void AddConstant(const P& factor, S* dual) {
  *dual += factor;
}
template <typename P, typename S>
void Add(const P& factor, const S& a, S* dual) {
  *dual += factor * a;
}
template <typename P, typename S>
void AddSquare(const P& factor, const S& a, S* dual) {
  *dual += factor * Square(a);
}

// The normal of an impact between discs, towards the first of its pair.
template <typename B, typename P>
Pair<P> NormalAt(const P& tau, int quarter) {
  const P scale = Reciprocal(P(B(1)) + Square(tau));
  const P along = B(2) * scale - P(B(1)), across = B(2) * (tau * scale);
  const P minus_along = B(-1) * along, minus_across = B(-1) * across;
  switch (quarter) {
    case 0:
      return {along, across};
    case 1:
      return {minus_across, along};
    case 2:
      return {minus_along, minus_across};
    default:
      return {across, minus_along};
  }
}

// Reach. An open sequence ends at time t, with r = T - t left. No impact changes the momentum of all discs in the
// directions of Numbers::conserved, so that in these the displacement D of their centre of mass M is linear in the
// control; and |v|, the root of the sum of m |v_i|^2 less |conserved momentum|^2 / M, does not grow at impacts: those
// of discs that matter later are all in the sequence, and after its last one each disc flies on. With costates a_i of
// the positions at the end, their sum a in conserved directions, and G^2 = sum of |a_i|^2 / m_i - |a|^2 / M, the
// displacements d_i after time t have
//
//   sum of a_i . d_i >= a . D - G r |v(t)| - (G times what forces and gravity after t add to |v|, integrated).
//
// Forces after t enter D and |v| together: with |x y + z w|^2 <= (x^2 + z^2) (y^2 + w^2), they take at most
// (|a|^2 / M + G^2) r^3 / (12 e m), with m the lightest pushed disc. |v(t)| is bounded by effort before t.
//
// |v(t)|^2 as a quadratic form of the velocities of all discs at an earlier time, if no force follows. It is computed
// backwards in time. With the linear map W_f from the velocities after flight f to those at time t, and J_f the change
// of velocity by forces in that flight, |v(t)| <= |v(0)| + sum over flights of |W_f J_f| (and the integral of gravity).
// J_f depends on the mean force of the flight only, and not on how the force varies around that mean.
//
// This does not hold for a pair that may touch again during the flight at unknown normals: there |J_f| is replaced by
// the integral of |u| / root of m, and W_f by the identity, which is Reset.
template <typename B, typename P>
class EnergyAtEnd {
 public:
  explicit EnergyAtEnd(const Numbers<B>& numbers)
      : numbers_(numbers), form_(4 * numbers.discs.size() * numbers.discs.size()) {
    Reset();
  }

  // Replaces the form by the energy at this time, which is no smaller.
  void Reset() {
    std::fill(form_.begin(), form_.end(), P(B(0)));
    for (int k = 0; k < size(); ++k) {
      const auto& a = numbers_.discs[k / 2];
      if (a.fixed) continue;
      At(k, k) = P(a.mass);
      for (int l = 0; l < size(); ++l) {
        const auto& b = numbers_.discs[l / 2];
        if (b.fixed) continue;
        for (const auto& [x, y] : numbers_.conserved) {
          At(k, l) -= P(a.mass * b.mass / numbers_.total_mass * ((k % 2 == 0 ? x : y) * (l % 2 == 0 ? x : y)));
        }
      }
    }
  }

  // Goes back over an impact, v -> v - c (d . v) with the gradient d of the approach: the form Q becomes
  // Q - d h' - h d' with h = Q c - (c' Q c / 2) d.
  void GoBack(const typename Numbers<B>::Touch& touch, const Pair<P>& normal) {
    std::vector<int> touching = {2 * touch.pair.a, 2 * touch.pair.a + 1};  // components of velocities
    std::vector<P> d = {normal.x, normal.y}, c = {touch.share_a * normal.x, touch.share_a * normal.y};
    if (!touch.b_fixed) {
      touching.insert(touching.end(), {2 * touch.pair.b, 2 * touch.pair.b + 1});
      d.insert(d.end(), {B(-1) * normal.x, B(-1) * normal.y});
      c.insert(c.end(), {B(-1) * touch.share_b * normal.x, B(-1) * touch.share_b * normal.y});
    }
    std::vector<P> h(size(), P(B(0)));
    for (int k = 0; k < size(); ++k) {
      for (size_t i = 0; i < touching.size(); ++i) h[k] += At(k, touching[i]) * c[i];
    }
    P square(B(0));
    for (size_t i = 0; i < touching.size(); ++i) square += c[i] * h[touching[i]];
    for (size_t i = 0; i < touching.size(); ++i) h[touching[i]] -= B(0.5) * square * d[i];
    for (int k = 0; k < size(); ++k) {
      for (size_t i = 0; i < touching.size(); ++i) {
        At(k, touching[i]) -= h[k] * d[i];
        At(touching[i], k) -= d[i] * h[k];
      }
    }
  }

  // Returns the coefficient of two components of momenta. As a form of one disc it is at most 1 / mass.
  P Between(int k, int l) const {
    const B inverse = B(1) / (numbers_.discs[k / 2].mass * numbers_.discs[l / 2].mass);
    return inverse * form_[k * size() + l];
  }

 private:
  int size() const { return 2 * static_cast<int>(numbers_.discs.size()); }
  P& At(int k, int l) { return form_[k * size() + l]; }

  const Numbers<B>& numbers_;
  std::vector<P> form_;  // row by row
};

// An impact of the pair with the approach speed 1 changes the Lagrangian by at most the length of this, as the impulses
// on the two discs are opposite.
template <typename Touch, typename S>
Pair<S> Apart(const Touch& touch, const std::vector<Pair<S>>& of_velocity) {
  Pair<S> apart = touch.share_a * of_velocity[touch.pair.a];
  if (!touch.b_fixed) apart -= touch.share_b * of_velocity[touch.pair.b];
  return apart;
}

// The Lagrangian, minimised over all controls: a lower bound of the loss at impacts with parameters `theta` for any
// multipliers z whose approaches are not negative. It is a concave quadratic function of z.
//
// Repeated impacts. After an impact of a pair its discs part: |r|' >= 0, with r between the discs. In flight
// |r|'' >= n.w, with w their relative acceleration. So if the next impact is h later, the integral of t |w| over that
// time is at least h times the speed of approach, by which the impact changes the Lagrangian by up to the length of
// Apart. With |w| <= sum of |u| / m over the pushed ones of the two (and gravity at what is fixed), and effort
// quadratic in u, all later impacts together enter the Lagrangian by no more than a third of the largest square of
// Apart from t on: the mean of (t / h)^2 is 1 / 3, that of t / h 1 / 2. At a plane the velocity changes along its
// normal only.
template <typename B, typename P, typename S, typename D>
void AddDualFunction(const Numbers<B>& n, const ImpactBox& box, const Layout& layout, const P* theta, const S* z,
                     const S& zero, const Weights& weights, D* dual, Record* record = nullptr) {
  const int impacts = static_cast<int>(box.sequence.size());
  const size_t discs = n.discs.size();
  std::vector<Pair<S>> of_position(discs, {zero, zero}), of_velocity(discs, {zero, zero});
  std::vector<char> active(discs, false), has_velocity(discs, false);
  struct Repeated {
    int impact;
    const typename Numbers<B>::Touch* touch;
    Pair<S> end;  // of the costates of velocity where it ends
    bool has_end;
  };
  std::vector<Repeated> running;
  std::optional<EnergyAtEnd<B, P>> energy;
  if (box.open && weights.share < 1) energy.emplace(n);
  // Begins, backwards in time, the repetitions of the impacts that end before impact `next`.
  const auto begin_before = [&](int next) {
    for (int j = 0; j < impacts; ++j) {
      if (!box.repeated[j] || box.EndOfRepetition(j) != next) continue;
      const auto& touch = n.Find(box.sequence[j]);
      if (energy) energy->Reset();
      const int a = touch.pair.a, b = touch.b_fixed ? a : touch.pair.b;
      running.push_back({j, &touch, Apart(touch, of_velocity), has_velocity[a] || has_velocity[b]});
    }
  };
  P end(n.duration);
  if (box.open) end = impacts > 0 ? theta[box.TimeIndex(impacts - 1)] : P(B(0));
  // The initial velocities and gravity add this to the integral of |v|.
  const P rest = P(n.duration) - end, mean_time = B(0.5) * (P(n.duration) + end);
  const P start = n.first_root * rest + (n.gravity_beyond * SquareRoot(n.total_mass)) * (rest * mean_time);
  for (size_t i = 0; i < n.terms.size(); ++i) {
    const auto& term = n.terms[i];
    if (box.open && (!term.position || weights.share == 1)) continue;
    const Pair<S> alpha{z[2 * i], z[2 * i + 1]};
    Add(P(-term.target.x), alpha.x, dual);
    Add(P(-term.target.y), alpha.y, dual);
    AddSquare(P(-term.inverse), alpha.x, dual);
    AddSquare(P(-term.inverse), alpha.y, dual);
    (term.position ? of_position : of_velocity)[term.body] += alpha;
    active[term.body] = true;
    if (!term.position) has_velocity[term.body] = true;
  }
  const auto add_sides = [&](int impact) {
    for (size_t i = 0; i < layout.sides.size(); ++i) {
      const Side& side = layout.sides[i];
      if (side.impact != impact) continue;
      const auto& touch = n.touches[side.touch];
      const S& kappa = z[layout.first_side + i];
      Add(P(touch.distance), kappa, dual);
      of_position[side.body] -= {P(touch.normal.x) * kappa, P(touch.normal.y) * kappa};
      active[side.body] = true;
    }
  };
  if (!box.open || weights.share < 1) add_sides(impacts);
  if (box.open && weights.share < 1) {
    const P square = Reciprocal(B(4) * n.effort * n.lightest) * Square(rest);
    P before = Reciprocal(B(1) - B(weights.share)) * (square * end);
    if (n.starts) {
      before += (B(0.5) / B(weights.reach)) * start;
      AddConstant(B(-0.5) * B(weights.reach) * start, dual);
    }
    const P all = before + (B(1) / B(3)) * (square * rest);
    Pair<S> sum{zero, zero};
    for (size_t i = 0; i < discs; ++i) {
      if (!active[i]) continue;
      AddSquare((B(-1) / n.discs[i].mass) * all, of_position[i].x, dual);
      AddSquare((B(-1) / n.discs[i].mass) * all, of_position[i].y, dual);
      sum += of_position[i];
    }
    for (const Pair<B>& direction : n.conserved) {
      const S along = P(direction.x) * sum.x + P(direction.y) * sum.y;
      AddSquare((B(1) / n.total_mass) * before, along, dual);
      if (n.has_gravity) Add((B(0.5) * Dot(direction, n.gravity)) * Square(rest), along, dual);
      for (size_t i = 0; i < discs; ++i) {
        if (n.discs[i].fixed) continue;
        const P part = (n.discs[i].mass / n.total_mass) * rest;
        of_velocity[i] += {(part * P(direction.x)) * along, (part * P(direction.y)) * along};
        active[i] = has_velocity[i] = true;
      }
    }
  }
  begin_before(impacts);

  const auto spend = [&](const P& factor, const S& a) {
    AddSquare(B(-1) / B(weights.share) * factor, a, dual);
    if constexpr (std::is_same_v<S, double>) {
      if (record != nullptr) record->spent += record->factor * factor * a * a;
    }
  };
  int flight = 0;
  // Minimises over the forces of a flight, in which the costates of velocity have these means and gains.
  const auto push = [&](const P& duration, const std::vector<Pair<S>>& mean, const std::vector<Pair<S>>& gain) {
    const bool by_mean = energy && running.empty();  // otherwise all of a force may add to the energy
    std::vector<int> pushed;
    std::vector<B> efforts;  // of each component, with the multiplier of its bound
    for (size_t i = 0; i < discs; ++i) {
      const auto& disc = n.discs[i];
      if (!disc.pushed || !(active[i] || by_mean)) continue;
      const auto square = [](const auto& v) { return Square(v.x) + Square(v.y); };
      double own = 1;  // a disc is in one of the running repetitions at most
      for (const Repeated& repeated : running) {
        const bool is_a = repeated.touch->pair.a == static_cast<int>(i);
        if (!is_a && (repeated.touch->b_fixed || repeated.touch->pair.b != static_cast<int>(i))) continue;
        own = weights.parts[repeated.impact][is_a ? 0 : 1][0];
        if constexpr (std::is_same_v<S, double>) {
          if (record == nullptr) continue;
          record->parts[repeated.impact][is_a ? 0 : 1][0] +=
              record->factor * duration * (square(mean[i]) + square(gain[i]) / 12);
        }
      }
      const B effort = n.effort * B(own), by_square = Reciprocal(B(4) * Square(disc.mass));
      const B varying = energy && !by_mean ? B(weights.share) * effort : effort;  // of the force around its mean
      const auto held = weights.held.empty() ? std::array<double, 2>{0, 0} : weights.held[flight * discs + i];
      for (const int k : {0, 1}) {
        const P factor = (B(-1) * by_square / (varying + B(held[k]))) * duration;
        AddSquare((B(1) / B(12)) * factor, k == 0 ? gain[i].x : gain[i].y, dual);
        if (!by_mean) AddSquare(factor, k == 0 ? mean[i].x : mean[i].y, dual);
        if (held[k] > 0 && !(disc.is_length && k == 1)) {
          AddConstant((B(-held[k]) * Square(disc.largest)) * duration, dual);
        }
        efforts.push_back(effort + B(held[k]));
      }
      pushed.push_back(static_cast<int>(i));
      if constexpr (std::is_same_v<S, double>) {
        if (record == nullptr) continue;
        if (!by_mean) {
          record->spent += record->factor * duration * by_square / effort * (square(mean[i]) + square(gain[i]) / 12);
        }
        if (weights.held.empty()) continue;
        Record::Push& out = record->pushes[flight * discs + i];
        out.squares[0] += record->factor * duration * (Square(mean[i].x) + Square(gain[i].x) / 12);
        out.squares[1] += record->factor * duration * (Square(mean[i].y) + Square(gain[i].y) / 12);
        out.duration += record->factor * duration;
        out.effort = weights.share * effort;
      }
    }
    if (!by_mean) return;
    // Over the mean forces u of all discs: the effort less what is shared out of it is a quadratic form of u.
    const B given = (B(1) - B(weights.share)) * n.effort * n.lightest;
    const int size = static_cast<int>(efforts.size());
    const auto component = [&](int k) { return 2 * pushed[k / 2] + k % 2; };
    std::vector<P> matrix(size * size), inverse(size);  // the upper triangle
    std::vector<S> side;
    for (int k = 0; k < size; ++k) {
      const Pair<S>& of = mean[pushed[k / 2]];
      side.push_back(P(B(1) / n.discs[pushed[k / 2]].mass) * (k % 2 == 0 ? of.x : of.y));
      for (int l = k; l < size; ++l) {
        matrix[k * size + l] = (B(-1) * given) * energy->Between(component(k), component(l));
      }
      matrix[k * size + k] += P(efforts[k]);
    }
    for (int k = 0; k < size; ++k) {
      inverse[k] = Reciprocal(matrix[k * size + k]);
      AddSquare(B(-0.25) * (inverse[k] * duration), side[k], dual);
      for (int l = k + 1; l < size; ++l) {
        const P ratio = matrix[k * size + l] * inverse[k];
        side[l] -= ratio * side[k];
        for (int m = l; m < size; ++m) matrix[l * size + m] -= ratio * matrix[k * size + m];
      }
    }
    if constexpr (std::is_same_v<S, double>) {
      if (record == nullptr) return;
      double square = 0;
      for (int k = size - 1; k >= 0; --k) {  // `side` becomes twice the force
        for (int l = k + 1; l < size; ++l) side[k] -= matrix[k * size + l] * side[l];
        side[k] *= inverse[k];
        for (int l = k; l < size; ++l) {
          square += (l > k ? 2 : 1) * energy->Between(component(k), component(l)) * side[k] * side[l];
        }
      }
      record->spent += record->factor * Square(weights.share) / (1 - weights.share) * 0.25 * duration * given * square;
    }
  };
  const auto fly = [&](const P& duration) {
    const P twelfth = B(1) / B(12) * duration;
    std::vector<Pair<S>> gain(discs, {zero, zero}), mean(discs, {zero, zero});
    for (size_t i = 0; i < discs; ++i) {
      if (!active[i] || n.discs[i].fixed) continue;
      gain[i] = duration * of_position[i];
      mean[i] = of_velocity[i] + B(0.5) * gain[i];
      if (n.has_gravity) {
        Add(n.gravity.x * duration, mean[i].x, dual);
        Add(n.gravity.y * duration, mean[i].y, dual);
      }
    }
    push(duration, mean, gain);
    for (const Repeated& repeated : running) {
      const auto& touch = *repeated.touch;
      const auto apart = [&](const std::vector<Pair<S>>& v) { return Apart(touch, v); };
      // Calls use(factor, a) for squares a^2 whose sum, with factors, is an integral of the largest square from t on.
      const auto for_squares = [&](const auto& use) {
        const auto of = [&](const P& factor, const Pair<S>& v) {
          if (touch.pair.plane) {  // only along the normal
            use(factor, P(touch.normal.x) * v.x + P(touch.normal.y) * v.y);
          } else {
            use(factor, v.x);
            use(factor, v.y);
          }
        };
        of(duration, apart(mean));
        of(twelfth, apart(gain));
        if (repeated.has_end) of(duration, repeated.end);
      };
      for (const int source : {0, 1}) {  // the disc that is pushed
        if (source == 1 && touch.b_fixed) continue;
        const auto& disc = n.discs[source == 0 ? touch.pair.a : touch.pair.b];
        if (!disc.pushed) continue;
        const B price = disc.price / (B(3) * B(weights.parts[repeated.impact][source][1]));
        for_squares([&](const P& factor, const S& a) { spend(price * factor, a); });
        if constexpr (std::is_same_v<S, double>) {
          if (record != nullptr) {
            for_squares([&](double factor, double a) {
              record->parts[repeated.impact][source][1] += record->factor / 3 * factor * a * a;
            });
          }
        }
      }
      if (n.has_gravity && touch.b_fixed) {
        const B half = B(0.25) * touch.fall;
        for_squares([&](const P& factor, const S& a) {
          AddSquare(B(-1) * half / B(weights.fall[repeated.impact]) * factor, a, dual);
        });
        AddConstant(B(-1) * half * B(weights.fall[repeated.impact]) * duration, dual);
        if constexpr (std::is_same_v<S, double>) {
          if (record != nullptr) {
            for_squares(
                [&](double factor, double a) { record->lengths[repeated.impact] += record->factor * factor * a * a; });
            record->durations[repeated.impact] += record->factor * duration;
          }
        }
      }
    }
    for (size_t i = 0; i < discs; ++i) {
      if (!active[i] || n.discs[i].fixed) continue;
      of_velocity[i] += gain[i];
      has_velocity[i] = true;
    }
    ++flight;
  };

  for (int i = impacts - 1; i >= 0; --i) {
    const int at = box.TimeIndex(i);
    if (i + 1 < impacts || !box.open) fly(end - theta[at]);
    end = theta[at];
    add_sides(i);
    const auto& touch = n.Find(box.sequence[i]);
    const int a = touch.pair.a, b = touch.pair.b;
    std::erase_if(running, [&](const Repeated& repeated) { return repeated.impact == i; });
    active[a] = has_velocity[a] = true;
    if (!touch.b_fixed) active[b] = has_velocity[b] = true;
    const S* mu = z + layout.place[i];
    if (touch.pair.plane) {
      const Pair<P> normal{P(touch.normal.x), P(touch.normal.y)};
      of_position[a] += {normal.x * mu[0], normal.y * mu[0]};
      Add(P(-touch.distance), mu[0], dual);
    } else {
      const Pair<S> force{mu[0], mu[1]};
      of_position[a] += force;
      if (touch.b_fixed) {
        Add(P(-touch.place.x), force.x, dual);
        Add(P(-touch.place.y), force.y, dual);
      } else {
        of_position[b] -= force;
      }
      if (layout.approach[i] < 0) {  // the discs are no further apart
        const B by_square = B(-0.5) * touch.distance / B(weights.place);
        AddSquare(P(by_square), force.x, dual);
        AddSquare(P(by_square), force.y, dual);
        AddConstant(P(B(-0.5) * touch.distance * B(weights.place)), dual);
        begin_before(i);
        continue;
      }
    }
    Pair<P> normal{P(touch.normal.x), P(touch.normal.y)};
    if (!touch.pair.plane) {
      normal = NormalAt<B, P>(theta[at + 1], box.quarters[i]);
      const B distance = a == box.sequence[i].a ? touch.distance : -touch.distance;  // towards the first of the pair
      Add(-distance * normal.x, mu[0], dual);
      Add(-distance * normal.y, mu[1], dual);
      if (a != box.sequence[i].a) normal = B(-1) * normal;
    }
    if (energy) energy->GoBack(touch, normal);
    // The impact and its approach, seen by the velocities before.
    S jump = touch.share_a * (normal.x * of_velocity[a].x + normal.y * of_velocity[a].y);
    if (!touch.b_fixed) jump -= touch.share_b * (normal.x * of_velocity[b].x + normal.y * of_velocity[b].y);
    jump -= z[layout.approach[i]];
    const Pair<S> kick{normal.x * jump, normal.y * jump};
    of_velocity[a] -= kick;
    if (!touch.b_fixed) of_velocity[b] += kick;
    begin_before(i);
  }
  fly(end);
  for (size_t i = 0; i < discs; ++i) {
    if (!active[i]) continue;
    const auto& disc = n.discs[i];
    Add(P(disc.position.x), of_position[i].x, dual);
    Add(P(disc.position.y), of_position[i].y, dual);
    if (disc.fixed) continue;
    Add(P(disc.velocity.x), of_velocity[i].x, dual);
    Add(P(disc.velocity.y), of_velocity[i].y, dual);
  }
}

}  // namespace

int ImpactBox::TimeIndex(int i) const {
  int index = 0;
  for (int j = 0; j < i; ++j) index += sequence[j].plane ? 1 : 2;
  return index;
}

int ImpactBox::EndOfRepetition(int i) const {
  const int impacts = static_cast<int>(sequence.size());
  const Candidate& pair = sequence[i];
  for (int j = i + 1; j < impacts; ++j) {
    const Candidate& later = sequence[j];
    const auto has = [&](int body) { return later.a == body || (!later.plane && later.b == body); };
    if (has(pair.a) || (!pair.plane && has(pair.b))) return j;
  }
  return impacts;
}

struct DualTerms {
  std::vector<Side> sides;
  Weights weights;
};

class Relaxation::Impl {
 public:
  explicit Impl(const Scene& scene) : plain_(scene), rounded_(MakeRounded(scene)) {}

  BoxBound Bound(const ImpactBox& box, double upper, const Multipliers* known) const {
    switch (box.num_parameters()) {
      case 0:
      case 1:
        return BoundOf<1>(box, upper, known);
      case 2:
        return BoundOf<2>(box, upper, known);
      case 3:
        return BoundOf<3>(box, upper, known);
      case 4:
        return BoundOf<4>(box, upper, known);
      case 5:
      case 6:
        return BoundOf<6>(box, upper, known);
      case 7:
      case 8:
        return BoundOf<8>(box, upper, known);
      default:
        return BoundOf<kMostParameters>(box, upper, known);
    }
  }

 private:
  static Numbers<Interval> MakeRounded(const Scene& scene) {
    const RoundUpward rounding;
    return RoundedNumbers(scene);
  }
  [[gnu::noinline]] static Numbers<Interval> RoundedNumbers(const Scene& scene) { return Numbers<Interval>(scene); }

  // The best multipliers and weights at a point of the box.
  struct Solution {
    Layout layout;
    Weights weights = {};
    Quadratic quadratic{0};
    Vector z = {};
    double value = 0;  // of the dual function
  };

  // Divides a box in its widest parameter instead, where cuts have made it much narrower in the other one.
  void Balance(const ImpactBox& box, BoxBound* bound) const {
    std::vector<double> widths;  // of the whole range
    for (int j = 0; j < box.num_parameters(); ++j)
      widths.push_back((bound->high[j] - bound->low[j]) / (2 * kLargestTau));
    for (size_t i = 0; i < box.sequence.size(); ++i) {
      widths[box.TimeIndex(static_cast<int>(i))] *= 2 * kLargestTau / plain_.duration;
    }
    const auto widest = std::max_element(widths.begin(), widths.end());
    if (widest != widths.end() && (bound->split < 0 || widths[bound->split] < kNarrow * *widest))
      bound->split = static_cast<int>(widest - widths.begin());
  }

  // Returns the middle of the box and its corners, or the ends in each parameter if these are many.
  static std::vector<std::vector<double>> PointsOf(const ImpactBox& box, const std::vector<double>& middle) {
    const int parameters = box.num_parameters();
    std::vector<std::vector<double>> points = {middle};
    for (int corner = 0; parameters <= kCornersOf && corner < 1 << parameters; ++corner) {
      std::vector<double>& point = points.emplace_back(box.low);
      for (int j = 0; j < parameters; ++j) {
        if ((corner >> j & 1) != 0) point[j] = box.high[j];
      }
    }
    if (parameters > kCornersOf) {
      points.push_back(box.low);
      points.push_back(box.high);
      for (int j = 0; j < parameters; ++j) {
        points.emplace_back(middle)[j] = box.low[j];
        points.emplace_back(middle)[j] = box.high[j];
      }
    }
    for (std::vector<double>& point : points) KeepInOrder(box, &point);
    return points;
  }

  // Delays impacts of a point of the box that are not in the order of time.
  static void KeepInOrder(const ImpactBox& box, std::vector<double>* point) {
    double last = 0;
    for (size_t i = 0; i < box.sequence.size(); ++i) {
      double& time = (*point)[box.TimeIndex(static_cast<int>(i))];
      last = time = std::max(last, time);
    }
  }

  // Solves at a point. The weights and sides in the solution are the start.
  void Solve(const ImpactBox& box, const std::vector<Side>& sides, const std::vector<double>& point,
             Solution* solution) const {
    const bool bounded = !solution->weights.held.empty();
    const bool weighted = bounded || box.open || std::count(box.repeated.begin(), box.repeated.end(), true) > 0;
    if (box.open) solution->weights.share = 0.5;
    const int rounds = !weighted ? 0 : bounded ? kBoundedRounds : kWeightRounds;
    const auto maximize = [&] {
      solution->quadratic = QuadraticAt(box, solution->layout, point, solution->weights);
      solution->z = Maximize(solution->quadratic, solution->layout, solution->weights, box.open);
    };
    for (int side_round = 0;; ++side_round) {
      maximize();
      for (int k = 0; k < rounds; ++k) {
        if (!Improve(box, solution->layout, {point}, solution->z, &solution->weights)) break;
        maximize();
      }
      if (side_round == kSideRounds ||
          !AddViolated(sides, box, point, solution->z, solution->weights, &solution->layout))
        break;
    }
    solution->value = solution->quadratic.At(solution->z);
  }

  // Returns the solution where the dual function at its best multipliers is about least in the box, or is below
  // `upper`. `at_middle` is the solution at the middle. By parameter, the derivative tells on which side the least is.
  template <int N>
  Solution Worst(const ImpactBox& box, const std::vector<Side>& sides, const std::vector<double>& middle,
                 const Solution& at_middle, double upper) const {
    using S = ceres::Jet<double, N>;
    std::vector<double> low = box.low, high = box.high, point = middle;
    Solution worst = at_middle, now = at_middle;
    for (int k = 0; k < kWorstRounds && worst.value >= upper; ++k) {
      std::vector<S> theta(point.begin(), point.end()), z(now.z.begin(), now.z.end());
      for (size_t j = 0; j < point.size(); ++j) theta[j].v[j] = 1;
      S dual;
      AddDualFunction<double>(plain_, box, now.layout, theta.data(), z.data(), S(), now.weights, &dual);
      bool moves = false;
      for (size_t j = 0; j < point.size(); ++j) {
        (dual.v[j] > 0 ? high : low)[j] = point[j];
        const double next = k > 0 ? 0.5 * (low[j] + high[j]) : dual.v[j] > 0 ? low[j] : high[j];
        moves = moves || next != point[j];
        point[j] = next;
      }
      KeepInOrder(box, &point);
      if (!moves) break;
      Solve(box, sides, point, &now);
      if (now.value < worst.value) worst = now;
    }
    return worst;
  }

  template <int N>
  BoxBound BoundOf(const ImpactBox& box, double upper, const Multipliers* known) const {
    const int parameters = box.num_parameters();
    std::vector<double> middle(parameters);
    for (int j = 0; j < parameters; ++j)
      middle[j] = std::clamp(0.5 * (box.low[j] + box.high[j]), box.low[j], box.high[j]);

    BoxBound bound;
    bound.lower = -std::numeric_limits<double>::infinity();
    bound.low = box.low;
    bound.high = box.high;
    std::vector<double> lowest = middle;
    const auto enclose = [&](const Layout& layout, const Vector& z, const Weights& weights) {
      const double before = bound.lower;
      Enclose<N>(box, layout, middle, z, weights, upper, &bound, &lowest);
      if (bound.lower > before) {
        bound.multipliers = std::make_shared<Multipliers>(
            Multipliers{std::make_shared<DualTerms>(DualTerms{layout.sides, weights}), {z.begin(), z.end()}});
      }
    };
    if (known != nullptr) {
      const Layout layout(static_cast<int>(plain_.terms.size()), box, known->terms->sides);
      enclose(layout, Vector::Map(known->values.data(), layout.size), known->terms->weights);
      if (bound.lower >= upper) return bound;
    }
    Solution at_middle{Layout(static_cast<int>(plain_.terms.size()), box)};
    Weights& weights = at_middle.weights;
    weights.parts.assign(box.sequence.size(), {{{0.5, 0.5}, {0.5, 0.5}}});
    weights.fall.assign(box.sequence.size(), 1.0);
    if (std::any_of(plain_.discs.begin(), plain_.discs.end(), [](const auto& disc) { return disc.largest > 0; }))
      weights.held.assign((box.sequence.size() + 1) * plain_.discs.size(), {0, 0});
    const std::vector<Side> sides = SidesOf(box);
    Solve(box, sides, middle, &at_middle);
    const Solution worst = Worst<N>(box, sides, middle, at_middle, upper);

    bound.at_middle = at_middle.value;
    bound.least = std::min(at_middle.value, worst.value);
    std::vector<std::vector<double>> points = PointsOf(box, middle);
    const auto keep = [&](const Solution& solution, const Vector& z) {
      enclose(solution.layout, z, Spread(box, solution.layout, points, z, solution.weights));
    };
    const double enough = kEnough * upper;
    keep(worst, Part(box, worst, middle, enough) * worst.z);
    const double poor = std::min(upper, kPoor * worst.value);
    if (bound.lower < poor) {
      Solution robust = at_middle;
      robust.z.setZero();  // the dual function is about zero in the whole box
      for (int k = 0; k < kLowestPoints && bound.lower < poor; ++k) {
        if (k > 0) points.push_back(lowest);
        robust = Robust(box, points, robust, upper);
        if (robust.value <= bound.lower) break;
        keep(robust, robust.z);
      }
    }
    Balance(box, &bound);
    for (int j = 0; j < parameters; ++j) {  // no motion is in both parts that two of the bounds leave
      if (bound.low[j] > bound.high[j]) bound.lower = std::max(bound.lower, upper);
    }
    return bound;
  }

  // Returns which part of the multipliers of a solution makes the dual function `enough` at the middle of the box: a
  // smaller part is better elsewhere. Weights follow the multipliers, so that the dual function is
  // least + a s - b s^2 at the part s of them.
  double Part(const ImpactBox& box, const Solution& solution, const std::vector<double>& middle, double enough) const {
    if (!(solution.value > enough)) return 1;
    const auto at = [&](double part) {
      const Vector some = part * solution.z;
      const Weights scaled = Spread(box, solution.layout, {middle}, some, solution.weights);
      double dual = 0;
      AddDualFunction<double>(plain_, box, solution.layout, middle.data(), some.data(), 0.0, scaled, &dual);
      return dual;
    };
    const double least = at(0), half = at(0.5), all = at(1);
    const double a = 4 * half - all - 3 * least, b = 4 * half - 2 * all - 2 * least, c = enough - least;
    const double root = a * a - 4 * b * c;
    if (!(root >= 0 && c > 0 && a > 0)) return 1;
    return std::min(1.0, 2 * c / (a + std::sqrt(root)));
  }

  // Returns the sides of the discs of each impact at its time, and of discs with a term of position at the end.
  std::vector<Side> SidesOf(const ImpactBox& box) const {
    const int impacts = static_cast<int>(box.sequence.size());
    std::vector<Side> sides;
    for (int touch = 0; touch < static_cast<int>(plain_.touches.size()); ++touch) {
      const Candidate& wall = plain_.touches[touch].pair;
      if (!wall.plane || plain_.discs[wall.a].fixed) continue;
      for (int i = 0; i < impacts; ++i) {
        const Candidate& pair = box.sequence[i];
        if (wall != pair && (wall.a == pair.a || (!pair.plane && wall.a == pair.b)))
          sides.push_back({i, wall.a, touch});
      }
      const auto aims = [&](const auto& term) { return term.position && term.body == wall.a; };
      if (std::any_of(plain_.terms.begin(), plain_.terms.end(), aims)) sides.push_back({impacts, wall.a, touch});
    }
    return sides;
  }

  // Adds those of `sides` to the layout by whose multipliers the dual function increases. Returns false if there are
  // none.
  bool AddViolated(const std::vector<Side>& sides, const ImpactBox& box, const std::vector<double>& middle,
                   const Vector& z, const Weights& weights, Layout* layout) const {
    constexpr int kAtOnce = 8;
    using S = ceres::Jet<double, kAtOnce>;
    std::vector<Side> next = layout->sides;
    for (size_t first = 0; first < sides.size(); first += kAtOnce) {
      std::vector<Side> now = layout->sides;
      now.insert(now.end(), sides.begin() + first, sides.begin() + std::min(sides.size(), first + kAtOnce));
      const Layout all(layout->terms, box, now);
      std::vector<S> theta(middle.begin(), middle.end()), values(all.size);
      for (int i = 0; i < layout->size; ++i) values[i] = S(z[i]);
      for (int i = layout->size; i < all.size; ++i) values[i].v[i - layout->size] = 1;
      S dual;
      AddDualFunction<double>(plain_, box, all, theta.data(), values.data(), S(), weights, &dual);
      for (int i = layout->size; i < all.size; ++i) {
        const Side& side = now[i - layout->first_side];
        const double most = kViolated * std::abs(plain_.touches[side.touch].distance);
        if (dual.v[i - layout->size] > most && std::find(next.begin(), next.end(), side) == next.end() &&
            all.first_side + static_cast<int>(next.size()) < kMostMultipliers) {
          next.push_back(side);
        }
      }
    }
    if (next.size() == layout->sides.size()) return false;
    *layout = Layout(layout->terms, box, next);
    return true;
  }

  // Moves the weights to those that are best for z, on average over points of the box. Returns false if they are so
  // already.
  bool Improve(const ImpactBox& box, const Layout& layout, const std::vector<std::vector<double>>& points,
               const Vector& z, Weights* weights, const std::vector<double>* shares = nullptr) const {
    Weights next = *weights;
    bool changed = false;
    const auto move = [&](double* weight, double to) {
      changed = changed || std::abs(*weight - to) > 0.01 * *weight;
      *weight = to;
    };
    const size_t impacts = box.sequence.size();
    Record record{1,
                  0,
                  std::vector(impacts, std::array<std::array<double, 2>, 2>{}),
                  std::vector(impacts, 0.0),
                  std::vector(impacts, 0.0),
                  std::vector<Record::Push>(weights->held.size())};
    double dual = 0, reach = 0;
    for (size_t p = 0; p < points.size(); ++p) {
      const std::vector<double>& theta = points[p];
      record.factor = shares != nullptr ? (*shares)[p] : 1;
      AddDualFunction<double>(plain_, box, layout, theta.data(), z.data(), 0.0, *weights, &dual, &record);
      const double end = impacts == 0 ? 0 : theta[box.TimeIndex(static_cast<int>(impacts) - 1)];
      const double rest = plain_.duration - end;
      reach += record.factor * rest * rest * end / (4 * plain_.effort * plain_.lightest);
    }
    if (!layout.approach.empty() && layout.approach.back() < 0) {
      move(&next.place, std::max(1e-12, std::hypot(z[layout.place.back()], z[layout.place.back() + 1])));
    }
    if (weights->share < 1) {
      std::vector<Vec2d> of_end(plain_.discs.size(), Vec2d::Zero());  // costates of positions
      for (int i = 0; i < layout.terms; ++i) {
        if (plain_.terms[i].position) of_end[plain_.terms[i].body] += z.segment<2>(2 * i);
      }
      for (size_t i = 0; i < layout.sides.size(); ++i) {
        const auto& normal = plain_.touches[layout.sides[i].touch].normal;
        if (layout.sides[i].impact < static_cast<int>(impacts)) continue;
        of_end[layout.sides[i].body] -= z[layout.first_side + i] * Vec2d(normal.x, normal.y);
      }
      double square = 0;
      Vec2d sum = Vec2d::Zero();
      for (size_t i = 0; i < of_end.size(); ++i) {
        square += of_end[i].squaredNorm() / plain_.discs[i].mass;
        sum += of_end[i];
      }
      for (const Pair<double>& c : plain_.conserved) square -= Square(c.x * sum[0] + c.y * sum[1]) / plain_.total_mass;
      if (plain_.starts) move(&next.reach, std::max(1e-12, std::sqrt(square)));
      // The parts of the dual function that fall with 1 / share and 1 / (1 - share).
      const double after = std::sqrt(reach * square), before = std::sqrt(record.spent);
      double share = before + after > 0 ? before / (before + after) : 0.5;
      share = square > 0 ? std::clamp(share, kLeastShare, 1 - 1e-4) : 1;
      changed = changed || std::abs(share - weights->share) > 0.01 * (1 - weights->share);
      move(&next.share, share);
    }
    for (size_t i = 0; i < impacts; ++i) {
      if (!box.repeated[i]) continue;
      for (int source = 0; source < 2; ++source) {
        std::array<double, 2> roots;
        double sum = 0;
        for (int k = 0; k < 2; ++k) sum += roots[k] = std::sqrt(record.parts[i][source][k]);
        if (sum == 0) continue;
        double all = 0;
        for (double& root : roots) all += root = std::max(root / sum, 1e-5);
        for (int k = 0; k < 2; ++k) move(&next.parts[i][source][k], (1 - 1e-12) * roots[k] / all);
      }
      if (record.durations[i] > 0) {
        move(&next.fall[i], std::max(1e-9, std::sqrt(record.lengths[i] / record.durations[i])));
      }
    }
    for (size_t at = 0; at < weights->held.size(); ++at) {
      const auto& disc = plain_.discs[at % plain_.discs.size()];
      const Record::Push& pushed = record.pushes[at];
      if (!(pushed.duration > 0)) continue;
      for (const int k : {0, 1}) {
        const double square = disc.is_length ? pushed.squares[0] + pushed.squares[1] : pushed.squares[k];
        const double effort = std::sqrt(square / pushed.duration) / (2 * disc.mass * disc.largest);
        move(&next.held[at][k], std::max(0.0, effort - pushed.effort));
      }
    }
    if (changed) *weights = next;
    return changed;
  }

  // Returns the weights that are best for z on average over the box: those that are best in its middle may be far from
  // good elsewhere.
  Weights Spread(const ImpactBox& box, const Layout& layout, const std::vector<std::vector<double>>& points,
                 const Vector& z, Weights weights) const {
    for (int k = 0; k < kSpreadRounds; ++k) {
      if (!Improve(box, layout, points, z, &weights)) break;
    }
    return weights;
  }

  Quadratic QuadraticAt(const ImpactBox& box, const Layout& layout, const std::vector<double>& theta,
                        const Weights& weights) const {
    std::vector<Linear> z(layout.size, {Vector::Zero(layout.size)});
    const Linear zero = {Vector::Zero(layout.size)};
    for (int i = 0; i < layout.size; ++i) z[i].by[i] = 1;
    Quadratic out(layout.size);
    AddDualFunction<double>(plain_, box, layout, theta.data(), z.data(), zero, weights, &out);
    return out;
  }

  // The maximum over the multipliers in floating point, by an active set of the approaches.
  Vector Maximize(const Quadratic& q, const Layout& layout, const Weights& weights, bool open) const {
    const int m = layout.size;
    std::vector<char> free(m, true);
    for (int i = 0; i < layout.terms; ++i) {
      if (open && (weights.share == 1 || !plain_.terms[i].position)) free[2 * i] = free[2 * i + 1] = false;
    }
    for (const int i : layout.not_negative) free[i] = false;
    Vector z = Vector::Zero(m);
    for (int round = 0; round < 3 * m + 3; ++round) {
      z = SolveFree(q, free);
      int worst = -1;
      for (const int i : layout.not_negative) {
        if (z[i] < 0 && (worst < 0 || z[i] < z[worst])) worst = i;
      }
      if (worst >= 0) {
        free[worst] = false;
        z[worst] = 0;
        continue;
      }
      const Vector gradient = q.linear - q.curvature * z;
      for (const int i : layout.not_negative) {
        if (!free[i] && gradient[i] > 1e-9 * (1 + std::abs(q.linear[i])) &&
            (worst < 0 || gradient[i] > gradient[worst]))
          worst = i;
      }
      if (worst < 0 || round > 2 * m) break;
      free[worst] = true;
    }
    for (const int i : layout.not_negative) z[i] = std::max(0.0, z[i]);
    return z;
  }

  static Vector SolveFree(const Quadratic& q, const std::vector<char>& free) {
    const int m = static_cast<int>(q.linear.size());
    Matrix matrix = q.curvature;
    Vector right = q.linear;
    // Small weights make some curvatures very large, by which the others are not to be regularized.
    const double least = std::max(1e-300, 1e-6 * matrix.diagonal().maxCoeff());
    for (int i = 0; i < m; ++i) {
      matrix(i, i) += kRegularization * std::max(matrix(i, i), least);
      if (free[i]) continue;
      matrix.row(i).setZero();
      matrix.col(i).setZero();
      matrix(i, i) = 1;
      right[i] = 0;
    }
    const Vector z = matrix.ldlt().solve(right);
    return z.allFinite() ? z : Vector::Zero(m);
  }

  // Returns the solution whose multipliers and weights are about best for the least value of the dual function at some
  // points of the box: Newton's method maximises a smooth minimum, which becomes sharper.
  Solution Robust(const ImpactBox& box, const std::vector<std::vector<double>>& points, Solution start,
                  double upper) const {
    Solution best = start, now = start;
    best.value = -std::numeric_limits<double>::infinity();
    std::vector<double> shares(points.size());
    std::vector<Quadratic> at(points.size(), Quadratic(0));
    double sharpness = kBlunt / upper;
    // Returns the smooth minimum at z, and computes the least value and the shares of the points in the gradient.
    const auto smooth = [&](const Vector& z, double* least) {
      for (size_t p = 0; p < points.size(); ++p) shares[p] = at[p].At(z);
      *least = *std::min_element(shares.begin(), shares.end());
      double sum = 0;
      for (double& share : shares) sum += share = std::exp(-sharpness * (share - *least));
      for (double& share : shares) share /= sum;
      return *least - std::log(sum) / sharpness;
    };
    for (int k = 0; k < kRobustRounds; ++k) {
      if (k % kRobustWeights == 0) {
        if (k > 0) Improve(box, now.layout, points, now.z, &now.weights, &shares);
        for (size_t p = 0; p < points.size(); ++p) at[p] = QuadraticAt(box, now.layout, points[p], now.weights);
      }
      const double before = smooth(now.z, &now.value);
      if (now.value > best.value) best = now;
      if (best.value > kAmple * upper) break;
      Vector mean = Vector::Zero(now.layout.size);
      now.quadratic = Quadratic(now.layout.size);
      for (size_t p = 0; p < points.size(); ++p) {
        const Vector gradient = at[p].linear - at[p].curvature * now.z;
        mean += shares[p] * gradient;
        now.quadratic.curvature += shares[p] * (at[p].curvature + sharpness * gradient * gradient.transpose());
      }
      now.quadratic.curvature -= sharpness * mean * mean.transpose();
      now.quadratic.linear = mean + now.quadratic.curvature * now.z;
      const Vector step = Maximize(now.quadratic, now.layout, now.weights, box.open) - now.z;
      double part = 1, after = smooth(now.z + step, &now.value);
      for (; part > kSmallestStep && !(after > before); part *= 0.5)
        after = smooth(now.z + 0.5 * part * step, &now.value);
      const bool full = part == 1;
      while (after > kAmple * upper && part > kLeastPart &&
             smooth(now.z + 0.5 * part * step, &now.value) > kAmple * upper)
        part *= 0.5;
      if (after > before) now.z += part * step;
      if (full && after < before + kSlow * upper) break;
      sharpness *= full ? kSharper : kBlunter;
    }
    return best;
  }

  // Raises the rigorous bound over the box, and cuts off parts of the box where it is above `upper`. `lowest` becomes a
  // point where the dual function is about least.
  template <int N>
  void Enclose(const ImpactBox& box, const Layout& layout, const std::vector<double>& middle, const Vector& multipliers,
               const Weights& weights, double upper, BoxBound* bound, std::vector<double>* lowest) const {
    const RoundUpward rounding;
    EncloseRounded<N>(box, layout, middle, multipliers, weights, upper, bound, lowest);
  }

  // Called while the processor rounds upward. A function of its own, so that no operation is moved out of that time.
  template <int N>
  [[gnu::noinline]] void EncloseRounded(const ImpactBox& box, const Layout& layout, const std::vector<double>& middle,
                                        const Vector& multipliers, const Weights& weights, double upper,
                                        BoxBound* bound, std::vector<double>* lowest) const {
    for (const int i : layout.not_negative) {
      if (!(multipliers[i] >= 0)) return;
    }
    using S = TaylorModel<N>;
    const int parameters = box.num_parameters();
    std::vector<S> theta(N), z;
    for (int j = 0; j < parameters; ++j) theta[j] = S::Parameter(j, box.low[j], box.high[j]);
    for (const double multiplier : multipliers) z.emplace_back(Interval(multiplier));
    S dual;
    AddDualFunction<Interval>(rounded_, box, layout, theta.data(), z.data(), S(), weights, &dual);
    if (!(dual.error < std::numeric_limits<double>::infinity())) return;

    std::vector<WaitingTime<N>> order;  // those of consecutive impacts that may be negative in the box
    for (size_t i = 1; i < box.sequence.size(); ++i) {
      const int before = box.TimeIndex(static_cast<int>(i) - 1), at = box.TimeIndex(static_cast<int>(i));
      if (box.high[before] > box.low[at]) order.push_back({before, at, theta[at] - theta[before]});
    }
    // The part with the least bound is halved, until no part is left or this was done often enough.
    const auto is_worse = [](const BoxPart<N>& a, const BoxPart<N>& b) { return a.least > b.least; };
    std::vector<BoxPart<N>> parts;
    const auto keep = [&](BoxPart<N> part) {
      for (const auto& wait : order) {
        if (wait.EncloseDifference(part).upper() < 0) return;
      }
      BoundPart(dual, order, &part);
      parts.push_back(part);
      std::push_heap(parts.begin(), parts.end(), is_worse);
    };
    BoxPart<N> whole;
    whole.low.fill(-1);
    whole.high.fill(1);
    BoundPart(dual, order, &whole);
    parts.push_back(whole);
    for (int k = 1; k < kMostParts && !parts.empty() && parts.front().least < upper; ++k) {
      std::pop_heap(parts.begin(), parts.end(), is_worse);
      BoxPart<N> low = parts.back(), high = low;
      parts.pop_back();
      low.high[low.widest] = high.low[low.widest] = 0.5 * (low.low[low.widest] + low.high[low.widest]);
      keep(low);
      keep(high);
    }
    const double lower = parts.empty() ? upper : parts.front().least;
    for (int j = 0; j < parameters && lower < upper; ++j) {
      double least = box.high[j], most = box.low[j];  // of motions of a loss below `upper`
      for (const BoxPart<N>& part : parts) {
        if (part.least >= upper) {
          bound->lower_outside = std::min(bound->lower_outside, part.least);
          continue;
        }
        const Interval ends =
            Interval(theta[j].value) + Interval(theta[j].slope[j]) * Interval(part.low[j], part.high[j]);
        least = std::min(least, ends.lower());
        most = std::max(most, ends.upper());
      }
      bound->low[j] = std::max(bound->low[j], least);
      bound->high[j] = std::min(bound->high[j], most);
    }
    *lowest = middle;
    for (int j = 0; j < parameters && !parts.empty(); ++j) {
      const BoxPart<N>& part = parts.front();
      (*lowest)[j] = theta[j].value + 0.5 * theta[j].slope[j] * (part.low[j] + part.high[j]);
    }
    KeepInOrder(box, lowest);
    if (parameters > 0 && (lower > bound->lower || bound->split < 0)) bound->split = whole.widest;
    bound->lower = std::max(bound->lower, lower);
  }

  const Numbers<double> plain_;
  const Numbers<Interval> rounded_;
};

Relaxation::Relaxation(const Scene& scene) : impl_(std::make_unique<Impl>(scene)) {}
Relaxation::~Relaxation() = default;

BoxBound Relaxation::Bound(const ImpactBox& box, double upper, const Multipliers* known) const {
  return impl_->Bound(box, upper, known);
}

}  // namespace saltus::global
