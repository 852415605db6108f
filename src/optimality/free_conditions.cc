// The conditions of optimality for forces without bounds and a loss of terminal terms and effort.
#include <algorithm>
#include <array>
#include <cmath>

#include "base/time_grid.h"
#include "optimality/optimality_conditions.h"
#include "simulate/costate_sweep.h"

namespace saltus {
namespace {

constexpr int kMostFunctionals = 1000;  // of the control, by which the motion knows it: dense matrices of that size

using Thetas = std::vector<std::optional<double>>;  // by impact

// A pushed disc between two of its impacts, with the straight line through its forces.
struct Arc {
  double begin = 0, end = 0;  // s
  double middle = 0;          // s, where the force is `mean`
  Vec2d mean = Vec2d::Zero(), slope = Vec2d::Zero();
  double deviation = 0;  // N, of a force from the line
  Vec2d Force(double t) const { return mean + (t - middle) * slope; }
};

class Certifier {
 public:
  explicit Certifier(const ControlledMotion& motion)
      : motion_(motion),
        scene_(motion.scene),
        control_(motion.control),
        flight_(motion.flight),
        lengths_(motion.lengths) {
    pushed_.assign(scene_.num_bodies(), -1);
    for (int c = 0; c < scene_.num_controlled(); ++c) pushed_[scene_.control.bodies[c]] = c;
    arcs_.resize(scene_.num_controlled());
  }

  Certificate Run() {
    for (int c = 0; c < scene_.num_controlled(); ++c) FitArcs(c);
    Certificate result = WithImpactsOf(motion_);
    Transversality(&result);
    next_hamiltonian_ = PhaseHamiltonian(num_hits());
    for (int k = num_hits() - 1; k >= 0; --k) CertifyImpact(k, &result.impacts[k]);
    Scale(&result);
    GridGradients(&result);
    Judge(&result);
    if (result.IsStationary()) {
      Thetas held(num_hits());
      if (result.verdict == Certificate::Verdict::kStationaryOnGrid) {
        for (int k = 0; k < num_hits(); ++k) held[k] = result.impacts[k].theta;
      }
      result.curvature = FindCurvature(CondensedLoss(scene_, flight_, control_, lengths_, std::move(held)));
      Judge(&result);
    }
    return result;
  }

 private:
  int num_hits() const { return static_cast<int>(flight_.hits().size()); }
  double effort() const { return scene_.objective.effort; }
  bool IsPushed(int body) const { return pushed_[body] >= 0; }
  static bool TakesPart(const Candidate& c, int body) { return c.a == body || (!c.plane && c.b == body); }
  Vec2d Force(int c, int interval) const {
    const double* u = &control_[scene_.ForceIndex(interval, c)];
    return {u[0], u[1]};
  }

  // Returns the pieces of phase j, which lies before impact j.
  std::pair<int, int> PiecesOf(int j) const {
    const int begin = j > 0 ? flight_.hits()[j - 1].next_piece : 0;
    const int end = j < num_hits() ? flight_.hits()[j].next_piece : static_cast<int>(flight_.pieces().size());
    return {begin, end};
  }

  void FitArcs(int c) {
    const int body = scene_.control.bodies[c];
    int begin = 0;
    double start = 0;
    for (const Flight::Hit& hit : flight_.hits()) {
      if (!TakesPart(hit.contact, body)) continue;
      arcs_[c].push_back(FitArc(c, start, begin, hit.next_piece));
      begin = hit.next_piece;
      start = hit.time;
    }
    arcs_[c].push_back(FitArc(c, start, begin, static_cast<int>(flight_.pieces().size())));
  }

  // Fits the least-squares line to the forces on pieces [begin, end) from time `start` on; those of one interval are
  // taken together. Intervals that an impact of the disc cuts serve both of its sides, and count only if there are
  // hardly any others.
  Arc FitArc(int c, double start, int begin, int end) const {
    struct Sample {
      double start, length;
      Vec2d force;
      bool whole;
    };
    std::vector<Sample> samples;
    for (int i = begin; i < end; ++i) {
      const Flight::Piece& piece = flight_.pieces()[i];
      if (i > begin && piece.interval == flight_.pieces()[i - 1].interval) {
        samples.back().length += piece.duration;
      } else {
        samples.push_back({piece.start, piece.duration, Force(c, piece.interval), false});
      }
      samples.back().whole = samples.back().length > (1 - kNodeMargin) * lengths_[piece.interval];
    }
    Arc arc{.begin = start, .end = start};
    if (samples.empty()) return arc;
    arc.begin = samples.front().start;
    arc.end = samples.back().start + samples.back().length;
    const auto whole = [](const Sample& sample) { return sample.whole; };
    const bool all = std::count_if(samples.begin(), samples.end(), whole) < 2;
    double length = 0, spread = 0;
    for (const Sample& s : samples) {
      if (!all && !s.whole) continue;
      length += s.length;
      arc.middle += s.length * (s.start + 0.5 * s.length);
      arc.mean += s.length * s.force;
    }
    arc.middle /= length;
    arc.mean /= length;
    for (const Sample& s : samples) {
      if (!all && !s.whole) continue;
      const double t = s.start + 0.5 * s.length - arc.middle;
      spread += s.length * t * t;
      arc.slope += s.length * t * (s.force - arc.mean);
    }
    if (samples.size() > 1) arc.slope /= spread;
    for (const Sample& s : samples) {
      arc.deviation = std::max(arc.deviation, (s.force - arc.Force(s.start + 0.5 * s.length)).norm());
    }
    return arc;
  }

  Costate<double> ArcCostate(int c, const Arc& arc, double t) {
    const double scale = 2 * effort() * scene_.bodies[scene_.control.bodies[c]].mass;
    return {t, scale * arc.slope, -scale * arc.Force(t)};
  }
  const Arc& ArcAt(int c, double t) const {
    const auto at = std::ranges::upper_bound(arcs_[c], t, {}, &Arc::end);
    return at == arcs_[c].end() ? arcs_[c].back() : *at;
  }
  // Returns the arc that ends with (starts at) the impact at `time`.
  const Arc& ArcBefore(int c, double time) const {
    const std::vector<Arc>& arcs = arcs_[c];
    auto nearest = std::ranges::lower_bound(arcs, time, {}, &Arc::end);
    if (nearest == arcs.end() || (nearest != arcs.begin() && time - (nearest - 1)->end <= nearest->end - time)) {
      // The first of the arcs that end together counts: the others have no forces.
      nearest = std::ranges::lower_bound(arcs, (nearest - 1)->end, {}, &Arc::end);
    }
    return *nearest;
  }
  const Arc& ArcAfter(int c, double time) const { return *(&ArcBefore(c, time) + 1); }

  void Note(const Costate<double>& costate) {
    largest_position_ = std::max(largest_position_, costate.position.norm());
    largest_velocity_ = std::max(largest_velocity_, costate.velocity.norm());
  }

  void Transversality(Certificate* result) {
    for (int i = 0; i < scene_.num_bodies(); ++i) now_.push_back(FinalCostate(scene_, flight_.end(), i));
    for (int c = 0; c < scene_.num_controlled(); ++c) {
      const int body = scene_.control.bodies[c];
      const Costate<double> from_force = ArcCostate(c, arcs_[c].back(), scene_.duration);
      Note(now_[body]);
      transversality_[0] = std::max(transversality_[0], (from_force.position - now_[body].position).norm());
      transversality_[1] = std::max(transversality_[1], (from_force.velocity - now_[body].velocity).norm());
      for (const Arc& arc : arcs_[c]) {
        Note(ArcCostate(c, arc, arc.begin));
        Note(ArcCostate(c, arc, arc.end));
        result->stationarity = std::max(result->stationarity, 2 * effort() * scene_.bodies[body].mass * arc.deviation);
      }
    }
    for (const Costate<double>& costate : now_) Note(costate);
  }

  // Returns the costate of a disc after an impact. Costates of spin do not follow from forces: they come from the end.
  Costate<double> CostateAfter(int body, double time) {
    const int c = pushed_[body];
    const Costate<double> carried = now_[body].At(time);
    if (c < 0) return carried;
    Costate<double> costate = ArcCostate(c, ArcAfter(c, time), time);
    costate.angle = carried.angle;
    costate.angular_velocity = carried.angular_velocity;
    return costate;
  }

  // Returns the Hamiltonian on one piece, where it is constant because the force is.
  double PieceHamiltonian(const Flight::Piece& piece) {
    const double t = piece.start + 0.5 * piece.duration;
    double sum = 0;
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      if (scene_.bodies[i].fixed) continue;
      const Costate<double> costate = IsPushed(i) ? ArcCostate(pushed_[i], ArcAt(pushed_[i], t), t) : now_[i].At(t);
      const Vec2d velocity = piece.at_start.v[i] + 0.5 * piece.duration * piece.acceleration[i];
      const double kinetic = costate.position.dot(velocity), push = costate.velocity.dot(piece.acceleration[i]);
      double running = 0;
      if (IsPushed(i)) running = effort() * Force(pushed_[i], piece.interval).squaredNorm();
      sum += running + kinetic + push;
      if (now_[i].angle != 0) sum += now_[i].angle * piece.at_start.spin[i];
      largest_hamiltonian_ = std::max(largest_hamiltonian_, std::abs(running) + std::abs(kinetic) + std::abs(push));
    }
    return sum;
  }

  // Returns the mean of the Hamiltonian over phase j.
  double PhaseHamiltonian(int j) {
    const auto [begin, end] = PiecesOf(j);
    double sum = 0, length = 0;
    for (int i = begin; i < end; ++i) {
      const Flight::Piece& piece = flight_.pieces()[i];
      sum += piece.duration * PieceHamiltonian(piece);
      length += piece.duration;
    }
    return length > 0 ? sum / length : next_hamiltonian_;
  }

  void CertifyImpact(int k, ImpactCertificate* out) {
    const Flight::Hit& hit = flight_.hits()[k];
    const std::array<int, 2> body = {hit.contact.a, hit.contact.plane ? -1 : hit.contact.b};
    std::array<Costate<double>, 2> after;
    for (int side = 0; side < 2; ++side) {
      if (body[side] >= 0) after[side] = CostateAfter(body[side], hit.time);
    }
    const ImpactJump jump = MakeImpactJump(scene_, hit, after);

    // The costates of pushed discs before the impact are known from their forces.
    std::array<Costate<double>, 2> known;
    std::array<bool, 2> is_known = {false, false};
    int count = 0;
    for (int side = 0; side < 2; ++side) {
      if (body[side] < 0 || !IsPushed(body[side])) continue;
      const int c = pushed_[body[side]];
      known[side] = ArcCostate(c, ArcBefore(c, hit.time), hit.time);
      is_known[side] = true;
      ++count;
      const double sign = side == 0 ? 1 : -1;
      out->multiplier += sign * hit.impact.normal.dot(known[side].position - jump.before[side].position);
    }
    for (int side = 0; side < 2; ++side) {
      if (jump.body[side] >= 0) now_[body[side]] = jump.before[side];
    }
    if (count > 0) {
      out->multiplier /= count;
    } else {
      out->multiplier = UnpushedMultiplier(k, jump);
    }
    for (int side = 0; side < 2; ++side) {
      if (jump.body[side] < 0) continue;
      const Vec2d push = (side == 0 ? 1 : -1) * out->multiplier * hit.impact.normal;
      if (is_known[side]) {
        const Costate<double>& before = jump.before[side];
        jump_position_.push_back((known[side].position - before.position - push).norm());
        jump_velocity_.push_back((known[side].velocity - before.velocity).norm());
        jump_impact_.push_back(k);
      } else {
        now_[body[side]].position += push;
        Note(now_[body[side]]);
      }
    }
    const double before = PhaseHamiltonian(k);
    out->hamiltonian = count == 0 && !hit.on_node ? 0.0 : next_hamiltonian_ - before;
    next_hamiltonian_ = before;
    if (count > 0 && hit.on_node) AddKink(k, jump);
  }

  // Returns the multiplier of an impact between discs that are not pushed: the one that keeps the Hamiltonian, in the
  // mean over the phases if their lengths could be chosen.
  double UnpushedMultiplier(int k, const ImpactJump& jump) {
    const Flight::Hit& hit = flight_.hits()[k];
    if (hit.on_node) return (next_hamiltonian_ - PhaseHamiltonian(k)) / hit.impact.speed;
    return jump.MultiplierAt(flight_.pieces()[hit.next_piece], hit.impact.speed);
  }

  // Adds the one-sided multipliers: early (late) has the forces just before (after) the impact on both of its sides.
  void AddKink(int k, const ImpactJump& jump) {
    const Flight::Hit& hit = flight_.hits()[k];
    const int next = std::min<int>(hit.next_piece, static_cast<int>(flight_.pieces().size()) - 1);
    const int last = std::max(hit.next_piece - 1, 0);
    kinks_.push_back({k,
                      jump.MultiplierAt(flight_.pieces()[last], hit.impact.speed),
                      jump.MultiplierAt(flight_.pieces()[next], hit.impact.speed)});
  }

  void GridGradients(Certificate* result) const {
    Thetas early(num_hits()), late = early, combined = early;
    bool any = false;
    for (int k = 0; k < num_hits(); ++k) {
      if (!result->impacts[k].theta) continue;
      any = true;
      early[k] = 1;
      late[k] = 0;
      combined[k] = result->impacts[k].theta;
    }
    const auto gradient = [&](Thetas thetas) {
      return CondensedLoss(scene_, flight_, control_, lengths_, std::move(thetas)).Gradient();
    };
    const Eigen::VectorXd of_combined = gradient(std::move(combined));
    result->gradient = RelativeGradient(of_combined);
    if (!any) return;
    result->gradient_early = gradient(std::move(early)).lpNorm<Eigen::Infinity>();
    result->gradient_late = gradient(std::move(late)).lpNorm<Eigen::Infinity>();
    result->gradient_combined = of_combined.lpNorm<Eigen::Infinity>();
  }

  // The largest costates of either kind, over all discs; over the whole time one kind makes the other.
  double PositionScale() const { return std::max(largest_position_, largest_velocity_ / scene_.duration); }
  double VelocityScale() const { return PositionScale() * scene_.duration; }

  // Returns the largest residual of 2 effort m u + lambda_v (mean over an interval), given the gradient by forces.
  double RelativeGradient(const Eigen::VectorXd& gradient) const {
    double largest = 0;
    const int width = scene_.control_width();
    for (Eigen::Index i = 0; i < gradient.size(); ++i) {
      const double mass = scene_.bodies[scene_.control.bodies[i % width / 2]].mass;
      largest = std::max(largest, mass / lengths_[i / width] * std::abs(gradient[i]));
    }
    return largest > 0 ? largest / VelocityScale() : 0.0;
  }

  // Divides absolute residuals by their scales.
  void Scale(Certificate* result) const {
    for (const Kink& kink : kinks_) {
      ImpactCertificate* impact = &result->impacts[kink.impact];
      SetTheta(kink.early, kink.late, impact->multiplier, VelocityScale(), impact);
    }
    const auto ratio = [](double residual, double scale) { return residual == 0 ? 0.0 : residual / scale; };
    result->stationarity = ratio(result->stationarity, VelocityScale());
    result->transversality =
        std::max(ratio(transversality_[0], PositionScale()), ratio(transversality_[1], VelocityScale()));
    for (size_t i = 0; i < jump_impact_.size(); ++i) {
      double* jump = &result->impacts[jump_impact_[i]].jump;
      *jump = std::max({*jump, ratio(jump_position_[i], PositionScale()), ratio(jump_velocity_[i], VelocityScale())});
    }
    for (ImpactCertificate& impact : result->impacts) {
      impact.hamiltonian = ratio(impact.hamiltonian, largest_hamiltonian_);
      result->costate_jump = std::max(result->costate_jump, impact.jump);
      result->hamiltonian = std::max(result->hamiltonian, std::abs(impact.hamiltonian));
    }
  }

  const ControlledMotion& motion_;
  const Scene& scene_;
  const std::vector<double>& control_;
  const Flight& flight_;
  const std::vector<double>& lengths_;  // of the control intervals, s
  std::vector<int> pushed_;             // by body: its place among the pushed ones, or -1
  std::vector<std::vector<Arc>> arcs_;  // of each pushed disc, in order of time
  std::vector<Costate<double>> now_;    // of every disc, carried backwards; used for those that are not pushed
  double next_hamiltonian_ = 0;         // of the phase after the impact at hand
  double largest_position_ = 0, largest_velocity_ = 0, largest_hamiltonian_ = 0;
  std::array<double, 2> transversality_ = {0, 0};  // of position and velocity costates
  std::vector<double> jump_position_, jump_velocity_;
  std::vector<int> jump_impact_;
  struct Kink {
    int impact;
    double early, late;  // multipliers
  };
  std::vector<Kink> kinks_;
};

}  // namespace

Curvature WithKind(const CurvatureRange& found, double rounding) {
  constexpr double kNearlyZero = 1e-6;
  const double flat = kNearlyZero + rounding * found.largest;
  using enum Curvature::Kind;
  Curvature curvature;
  curvature.kind = found.smallest > flat ? kMinimum : found.smallest < -flat ? kSaddle : kFlat;
  curvature.smallest = found.smallest;
  curvature.direction.assign(found.direction.begin(), found.direction.end());
  return curvature;
}

std::optional<Curvature> FindCurvature(const CondensedLoss& loss) {
  constexpr double kRounding = 1e-10;
  if (loss.num_functionals() > kMostFunctionals) return std::nullopt;
  return WithKind(loss.SmallestCurvature(), kRounding);
}

Certificate FreeConditions(const ControlledMotion& motion) { return Certifier(motion).Run(); }

}  // namespace saltus
