// The conditions of optimality with bounds on the forces, hard terms, running and via terms and a free final time.
//
// Along a given motion the costates are affine in the multipliers of impacts and of active constraints on states,
// theta, and so are what is left of the conditions:
//
//   force          2 effort m u + lambda_v, in the mean over an interval, is opposite to a normal of the bounds at u;
//                  so is, of a torque with f = torque / radius, 2 effort (I/r^2) f + lambda_w / r
//   impact time    moving an impact, and the intervals on both sides with it, does not change the loss
//   final time     nor does moving that; at its bounds the loss may fall towards outside
//   constraints    multipliers of inequalities are not negative.
//
// ConeConditions finds the theta that meets them best. On a grid that does not move, the impacts on nodes
// have multipliers between those of the two one-sided gradients instead, and the other impacts those that keep the
// Hamiltonian.

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "control/control_bounds.h"
#include "optimality/cone_conditions.h"
#include "optimality/optimality_conditions.h"
#include "simulate/costate_sweep.h"

namespace saltus {
namespace {

constexpr double kAtBound = 1e-6;       // of a bound: a force so near is at it
constexpr double kNoMultiplier = 1e-7;  // of the largest costate, below which a multiplier is zero
constexpr double kNoInterval = 1e-9;    // of the horizon: of an interval so short nothing is asked

// Relative to the contact distance: pairs that must not touch and are further apart are inactive constraints.
constexpr double kApart = 2e-4;

class ConstrainedCertifier {
 public:
  explicit ConstrainedCertifier(const ControlledMotion& motion)
      : motion_(motion), scene_(motion.scene), sweep_(scene_, motion.flight) {
    for (int k = 0; k < num_hits(); ++k) boundaries_.push_back(sweep_.SegmentAfter(k));
    for (int i = 0; i < sweep_.num_via(); ++i) boundaries_.push_back(sweep_.SegmentAfterVia(i));
    boundaries_.insert(boundaries_.end(), {0, num_segments()});
    std::sort(boundaries_.begin(), boundaries_.end());
    boundaries_.erase(std::unique(boundaries_.begin(), boundaries_.end()), boundaries_.end());
    AddConstraints();
  }

  Certificate Run() {
    Certificate result = WithImpactsOf(motion_);
    if (limit_inside_interval_) {
      result.reason =
          "a limit of the speed is active at an impact inside a control interval, and the conditions have "
          "no multiplier for it";
      return result;
    }
    StationarityOnMovingGrid(&result);
    Judge(&result);
    if (result.verdict != Certificate::Verdict::kStationary) {
      StationarityOnFixedGrid(&result);
      Judge(&result);
    }
    if (!result.IsStationary()) return result;
    result.reason = WhyNoCurvature(result);
    if (!result.reason.empty()) return result;
    AddCurvature(&result);
    if (result.curvature) {
      Judge(&result);
    } else {
      result.reason = "its second derivative is not computed: the matrices would be too large";
    }
    return result;
  }

 private:
  using Result = CostateSweep::Result;

  int num_hits() const { return static_cast<int>(motion_.flight.hits().size()); }
  int num_intervals() const { return static_cast<int>(motion_.lengths.size()); }
  int num_segments() const { return static_cast<int>(sweep_.segments().size()); }
  double effort() const { return scene_.objective.effort; }
  double Mass(int c) const { return scene_.bodies[scene_.control.bodies[c]].mass; }
  Vec2d Force(int interval, int c) const {
    const double* u = &motion_.control[scene_.ForceIndex(interval, c)];
    return {u[0], u[1]};
  }
  double EffortRate(int interval) const {
    double sum = 0;
    for (int c = 0; c < scene_.num_controlled(); ++c) sum += effort() * Force(interval, c).squaredNorm();
    for (int t = 0; t < scene_.num_turned(); ++t) sum += effort() * Turn(interval, t) * Turn(interval, t);
    return sum;
  }

  const Body& Turned(int t) const { return scene_.bodies[scene_.control.turned[t]]; }
  double Turn(int interval, int t) const { return motion_.control[scene_.TurnIndex(interval, t)]; }

  // Adds the constraints on states, and the rows of those that are active.
  void AddConstraints() {
    rows_ = RowsOfHardTerms(scene_);
    const auto add = [&](const auto& term) {
      if (term.hard) constraints_.push_back({scene_.bodies[term.body].name, term.quantity});
    };
    for (const TerminalTerm& term : scene_.objective.terminal) {
      if (!term.region) add(term);
    }
    for (const ViaTerm& term : scene_.objective.via) add(term);
    for (const TerminalTerm& term : scene_.objective.terminal) {
      if (!term.region) continue;
      add(term);
      AddRegion(term);
    }
    for (const SpeedLimit& limit : scene_.objective.limits) {
      if (limit.at == SpeedLimit::At::kEnd) AddLimit(limit, motion_.flight.end().v[limit.body], {});
    }
    for (const SpeedLimit& limit : scene_.objective.limits) {
      if (limit.at == SpeedLimit::At::kAlways) AddLimitOfMotion(limit);
    }
  }

  // Adds the rows of the bounds of a goal region that the final state is at.
  void AddRegion(const TerminalTerm& term) {
    const TerminalTerm::Region& region = *term.region;
    const DiscStates& end = motion_.flight.end();
    Vec2d q(0, 0);
    if (term.quantity == TerminalTerm::Quantity::kPosition) q = end.p[term.body];
    if (term.quantity == TerminalTerm::Quantity::kVelocity) q = end.v[term.body];
    if (term.quantity == TerminalTerm::Quantity::kAngle) q[0] = end.angle[term.body];
    if (term.quantity == TerminalTerm::Quantity::kAngularVelocity) q[0] = end.spin[term.body];
    for (int j = 0; j < 2; ++j) {
      const auto push = [&](double sign) {
        rows_.push_back({.owner = static_cast<int>(constraints_.size()) - 1,
                         .body = term.body,
                         .quantity = term.quantity,
                         .normal = sign * Vec2d::Unit(j),
                         .inequality = region.min[j] < region.max[j]});
      };
      if (q[j] >= region.max[j] - kAtBound) {
        push(1);
      } else if (q[j] <= region.min[j] + kAtBound) {
        push(-1);
      }
    }
  }

  // Adds a limit of the speed, and its row if it is active; one that always holds, only then. `place` has its time.
  void AddLimit(const SpeedLimit& limit, const Vec2d& velocity, ConstraintRow place, std::optional<double> time = {}) {
    const bool active = velocity.norm() >= (1 - kAtBound) * limit.max;
    if (!active && time) return;
    constraints_.push_back({.body = scene_.bodies[limit.body].name,
                            .quantity = TerminalTerm::Quantity::kVelocity,
                            .speed_limit = limit.max,
                            .time = time});
    if (!active) return;
    place.owner = static_cast<int>(constraints_.size()) - 1;
    place.body = limit.body;
    place.quantity = TerminalTerm::Quantity::kVelocity;
    place.bend = 1 / limit.max;
    place.normal = place.bend * velocity;
    place.inequality = true;
    rows_.push_back(place);
  }

  // Adds a limit that always holds where the motion is at it. Under a constant force the speed is largest at the ends
  // of the interval, and impacts, which cut intervals, change it.
  void AddLimitOfMotion(const SpeedLimit& limit) {
    const std::vector<Flight::Piece>& pieces = motion_.flight.pieces();
    int segment = 0;
    for (size_t i = 0; i < pieces.size(); ++i) {
      while (segment < num_segments() && sweep_.segments()[segment].original <= static_cast<int>(i)) ++segment;
      const bool last = i + 1 == pieces.size();
      const double time = pieces[i].start + pieces[i].duration;
      const Vec2d before = pieces[i].After(limit.body, pieces[i].duration).v;
      const Vec2d after = last ? motion_.flight.end().v[limit.body] : pieces[i + 1].at_start.v[limit.body];
      const size_t rows = rows_.size();
      if ((after - before).norm() > kAtBound * limit.max) {
        AddLimit(limit, before, {.segment = segment, .before = true}, time);
      }
      AddLimit(limit, after, {.segment = segment}, time);
      for (const Flight::Hit& hit : motion_.flight.hits()) {
        const bool here = hit.next_piece == static_cast<int>(i) + 1 && !hit.on_node && !last;
        limit_inside_interval_ = limit_inside_interval_ || (here && rows_.size() > rows);
      }
    }
  }

  // Returns the rows with the multipliers in theta, which has them last.
  std::vector<ConstraintRow> RowsAt(const Eigen::VectorXd& theta) const {
    std::vector<ConstraintRow> rows = rows_;
    const Eigen::Index first = theta.size() - static_cast<Eigen::Index>(rows.size());
    for (size_t i = 0; i < rows.size(); ++i) rows[i].multiplier = theta[first + static_cast<Eigen::Index>(i)];
    return rows;
  }

  // Adds the condition that multipliers of inequalities are not negative.
  void AddSigns(const std::vector<Result>& sweeps, ConeConditions* conditions) const {
    const auto unknowns = static_cast<Eigen::Index>(sweeps.size()) - 1;
    const Eigen::Index first = unknowns - static_cast<Eigen::Index>(rows_.size());
    for (size_t i = 0; i < rows_.size(); ++i) {
      if (!rows_[i].inequality) continue;
      conditions->AddNumber(0, Eigen::RowVectorXd::Unit(unknowns, first + static_cast<Eigen::Index>(i)), 1);
    }
  }

  // Returns the largest multiplier of a wrong sign, relative to the largest costate.
  double WrongSign(const std::vector<ConstraintRow>& rows) const {
    double largest = 0;
    for (const ConstraintRow& row : rows) {
      const double time = row.quantity == TerminalTerm::Quantity::kVelocity ? scene_.duration : 1.0;
      if (row.inequality) largest = std::max(largest, -row.multiplier / time);
    }
    return largest == 0 ? 0.0 : largest / position_scale_;
  }

  // Returns the sweep of the objective alone, then of each unknown: of impacts k for which `unknown[k]`, then of rows
  // of constraints. The multipliers of other impacts keep the Hamiltonian continuous.
  std::vector<Result> Sweeps(const std::vector<bool>& unknown) const {
    std::vector<Result> sweeps;
    const auto add = [&](const CostateSweep::Source& source, int impact) {
      sweeps.push_back(sweep_.Sweep(source, [&](int k, const ImpactJump& jump, double gain) {
        return unknown[k] ? double(k == impact) : sweep_.Late(k, jump, gain);
      }));
    };
    add({}, -1);
    for (int k = 0; k < num_hits(); ++k) {
      if (unknown[k]) add({.objective = false}, k);
    }
    for (const ConstraintRow& row : rows_) add({.objective = false, .constraints = {&row, 1}}, -1);
    return sweeps;
  }

  // Returns the linear combination of all sweeps at theta: sizes, and the multipliers.
  Result Combined(const std::vector<bool>& unknown, const Eigen::VectorXd& theta) const {
    std::vector<double> nu(num_hits());
    Eigen::Index next = 0;
    for (int k = 0; k < num_hits(); ++k) {
      if (unknown[k]) nu[k] = theta[next++];
    }
    const std::vector<ConstraintRow> rows = RowsAt(theta);
    return sweep_.Sweep({.constraints = rows}, [&](int k, const ImpactJump& jump, double gain) {
      return unknown[k] ? nu[k] : sweep_.Late(k, jump, gain);
    });
  }

  bool IsAtNorm(int interval, int c) const {
    const std::vector<double>& norms = scene_.control.max_norm;
    return !norms.empty() && Force(interval, c).norm() >= (1 - kAtBound) * norms[c];
  }

  // Returns the outward normals of the bounds that a force is at.
  std::vector<Vec2d> NormalsAt(int interval, int c) const {
    std::vector<Vec2d> normals;
    const Vec2d u = Force(interval, c);
    const std::vector<double>& max = scene_.control.max;
    for (int d = 0; d < 2 && !max.empty(); ++d) {
      if (std::abs(u[d]) >= (1 - kAtBound) * max[c]) normals.push_back((u[d] > 0 ? 1.0 : -1.0) * Vec2d::Unit(d));
    }
    if (IsAtNorm(interval, c)) normals.push_back(u.normalized());
    return normals;
  }

  std::vector<Vec2d> TurnNormalsAt(int interval, int t) const {
    const double turn = Turn(interval, t), most = MostTurn(scene_, t);
    if (std::abs(turn) >= (1 - kAtBound) * most) return {Vec2d(turn > 0 ? 1 : -1, 0)};
    return {};
  }

  bool HasCondition(int interval) const { return motion_.lengths[interval] > kNoInterval * scene_.duration; }

  void AddForces(const std::vector<Result>& sweeps, ConeConditions* conditions) const {
    const int n = static_cast<int>(sweeps.size()) - 1;
    const int pushed = scene_.num_controlled();
    std::vector<Eigen::Matrix2Xd> mean(num_intervals() * pushed, Eigen::Matrix2Xd::Zero(2, n + 1));
    for (int i = 0; i < num_segments(); ++i) {
      const int interval = sweep_.segments()[i].piece.interval;
      for (int c = 0; c < pushed; ++c) {
        for (int j = 0; j <= n; ++j) {
          mean[interval * pushed + c].col(j) += sweeps[j].push[i][c] / motion_.lengths[interval];
        }
      }
    }
    for (int k = 0; k < num_intervals(); ++k) {
      if (!HasCondition(k)) continue;
      for (int c = 0; c < pushed; ++c) {
        const Eigen::Matrix2Xd& of = mean[k * pushed + c];
        conditions->AddForce(of.col(0) + 2 * effort() * Mass(c) * Force(k, c), of.rightCols(n), NormalsAt(k, c));
      }
    }
    for (int t = 0; t < scene_.num_turned(); ++t) AddTorques(t, sweeps, conditions);
  }

  // Adds the conditions of one torque, as forces with a second component that is always 0.
  void AddTorques(int t, const std::vector<Result>& sweeps, ConeConditions* conditions) const {
    const int n = static_cast<int>(sweeps.size()) - 1;
    const double radius = Turned(t).radius, mass = Turned(t).MomentOfInertia() / (radius * radius);
    std::vector<Eigen::Matrix2Xd> mean(num_intervals(), Eigen::Matrix2Xd::Zero(2, n + 1));
    for (int i = 0; i < num_segments(); ++i) {
      const int interval = sweep_.segments()[i].piece.interval;
      for (int j = 0; j <= n; ++j) mean[interval](0, j) += sweeps[j].turn[i][t] / (radius * motion_.lengths[interval]);
    }
    for (int k = 0; k < num_intervals(); ++k) {
      if (!HasCondition(k)) continue;
      const Vec2d own(2 * effort() * mass * Turn(k, t), 0);
      conditions->AddForce(mean[k].col(0) + own, mean[k].rightCols(n), TurnNormalsAt(k, t));
    }
  }

  struct Phase {
    int begin = 0, end = 0;  // segments
  };
  // Returns the phase that ends (begins) at a boundary; an empty one at the initial (final) time.
  Phase PhaseBefore(int boundary) const {
    const auto at = std::lower_bound(boundaries_.begin(), boundaries_.end(), boundary);
    return at == boundaries_.begin() ? Phase{} : Phase{*(at - 1), boundary};
  }
  Phase PhaseAfter(int boundary) const {
    const auto at = std::upper_bound(boundaries_.begin(), boundaries_.end(), boundary);
    return at == boundaries_.end() ? Phase{} : Phase{boundary, *at};
  }

  // Returns the derivative of the loss when the end (or else the beginning) of a phase moves, with its intervals.
  double MovedBy(const Phase& phase, bool end, const Result& sweep, bool of_objective) const {
    const std::vector<CostateSweep::Segment>& segments = sweep_.segments();
    const double begin = segments[phase.begin].piece.start;
    double length = 0, hamiltonian = 0, drift = 0, moment = 0;
    for (int i = phase.begin; i < phase.end; ++i) {
      const Flight::Piece& piece = segments[i].piece;
      length += piece.duration;
      hamiltonian += sweep.hamiltonian[i];
      if (of_objective) hamiltonian += piece.duration * EffortRate(piece.interval);
      drift += sweep.drift[i];
      moment += sweep.drift_moment[i] + (piece.start - begin) * sweep.drift[i];
    }
    const double stretched = (hamiltonian + moment) / length;
    return end ? stretched : drift - stretched;
  }

  // Returns the Hamiltonian just after impact k, where no phase follows but another impact or the final time.
  double JustAfter(int k, const Result& sweep, bool of_objective) const {
    const int last = std::max(sweep_.SegmentAfter(k) - 1, 0);
    const Flight::Piece& piece = sweep_.segments()[last].piece;
    const DiscStates& x = k + 1 < num_hits() ? motion_.flight.hits()[k + 1].before : motion_.flight.end();
    double sum = of_objective ? EffortRate(piece.interval) : 0.0;
    for (int i = 0; i < scene_.num_bodies(); ++i) {
      const Costate<double>& costate = sweep.after_impact[k][i];
      sum += costate.position.dot(x.v[i]) + costate.velocity.dot(piece.acceleration[i]);
      if (costate.angle != 0) sum += costate.angle * x.spin[i];
      if (!piece.turning.empty()) sum += costate.angular_velocity * piece.turning[i];
    }
    return sum;
  }

  // Returns the derivative of the loss by the time of impact k.
  double ByImpactTime(int k, const Result& sweep, bool of_objective) const {
    const auto follows = [&](int i) {
      return i >= 0 && i + 1 < num_hits() && sweep_.SegmentAfter(i) == sweep_.SegmentAfter(i + 1);
    };
    const int at = sweep_.SegmentAfter(k);
    const Phase before = PhaseBefore(at), after = PhaseAfter(at);
    double sum = 0;
    if (follows(k - 1)) {
      sum += JustAfter(k - 1, sweep, of_objective);
    } else if (before.end > before.begin) {
      sum += MovedBy(before, true, sweep, of_objective);
    }
    if (follows(k) || after.end == after.begin) {
      sum -= JustAfter(k, sweep, of_objective);
    } else {
      sum += MovedBy(after, false, sweep, of_objective);
    }
    return sum;
  }

  bool IsAtEnd(int k) const { return sweep_.SegmentAfter(k) == num_segments(); }

  template <typename Of>
  static void Add(const std::vector<Result>& sweeps, const Of& of, double constant, int allowed,
                  ConeConditions* conditions) {
    Eigen::RowVectorXd columns(sweeps.size() - 1);
    for (size_t j = 1; j < sweeps.size(); ++j) columns[j - 1] = of(sweeps[j], false);
    conditions->AddNumber(constant + of(sweeps[0], true), columns, allowed);
  }

  // Returns the sign that the derivative of the loss by the final time may have at its bounds; 0 inside.
  int SignByDuration() const {
    const FreeDuration& free = *scene_.objective.duration;
    if (scene_.duration <= free.min * (1 + kAtBound)) return 1;
    return scene_.duration >= free.max * (1 - kAtBound) ? -1 : 0;
  }

  void SetSizes(const Result& sweep) {
    position_scale_ = std::max(sweep.largest_position, sweep.largest_velocity / scene_.duration);
    hamiltonian_scale_ = sweep.largest_hamiltonian;
    for (int k = 0; k < num_intervals(); ++k) hamiltonian_scale_ = std::max(hamiltonian_scale_, EffortRate(k));
  }
  double RelativeForce(const ConeConditions& conditions) const {
    const double force = conditions.LargestForce();
    return force == 0 ? 0.0 : force / (position_scale_ * scene_.duration);
  }
  double RelativeHamiltonian(double left) const { return left == 0 ? 0.0 : left / hamiltonian_scale_; }

  void StationarityOnMovingGrid(Certificate* result) {
    const std::vector<bool> unknown(num_hits(), true);
    const std::vector<Result> sweeps = Sweeps(unknown);
    ConeConditions conditions(static_cast<int>(sweeps.size()) - 1);
    AddForces(sweeps, &conditions);
    for (int k = 0; k < num_hits(); ++k) {
      // An impact at the final time may only be bounded from being later.
      const auto by_time = [&](const Result& sweep, bool whole) { return ByImpactTime(k, sweep, whole); };
      Add(sweeps, by_time, 0, IsAtEnd(k) ? -1 : 0, &conditions);
    }
    if (scene_.objective.duration) {
      const Phase last = PhaseBefore(num_segments());
      const auto by_end = [&](const Result& sweep, bool whole) { return MovedBy(last, true, sweep, whole); };
      Add(sweeps, by_end, scene_.objective.duration->weight, SignByDuration(), &conditions);
    }
    AddSigns(sweeps, &conditions);
    conditions.Solve();
    const Result found = Combined(unknown, conditions.theta());
    SetSizes(found);
    result->stationarity = RelativeForce(conditions);
    SetRestrictions(conditions);
    for (int k = 0; k < num_hits(); ++k) {
      result->impacts[k].multiplier = found.multipliers[k];
      result->impacts[k].hamiltonian = RelativeHamiltonian(conditions.Number(k));
      result->hamiltonian = std::max(result->hamiltonian, std::abs(result->impacts[k].hamiltonian));
    }
    if (scene_.objective.duration) {
      result->final_time = RelativeHamiltonian(conditions.Number(num_hits()));
      result->hamiltonian = std::max(result->hamiltonian, std::abs(*result->final_time));
    }
    const std::vector<ConstraintRow> rows = RowsAt(conditions.theta());
    result->transversality = WrongSign(rows);
    result->constraints = constraints_;
    for (const ConstraintRow& row : rows) {
      ConstraintCertificate& constraint = result->constraints[row.owner];
      constraint.multiplier += row.bend > 0 ? Vec2d(row.multiplier, 0) : Vec2d(row.multiplier * row.normal);
    }
  }

  void StationarityOnFixedGrid(Certificate* result) {
    std::vector<bool> unknown;
    for (const Flight::Hit& hit : motion_.flight.hits()) unknown.push_back(hit.on_node);
    const std::vector<Result> sweeps = Sweeps(unknown);
    ConeConditions conditions(static_cast<int>(sweeps.size()) - 1);
    AddForces(sweeps, &conditions);
    if (scene_.objective.duration) {  // all intervals scale with it
      const auto by_scale = [&](const Result& sweep, bool whole) {
        return MovedBy({0, num_segments()}, true, sweep, whole) - sweep.clock / scene_.duration;
      };
      Add(sweeps, by_scale, scene_.objective.duration->weight, SignByDuration(), &conditions);
    }
    AddSigns(sweeps, &conditions);
    conditions.Solve();
    const Result found = Combined(unknown, conditions.theta());
    SetSizes(found);
    const std::vector<ConstraintRow> rows = RowsAt(conditions.theta());
    result->gradient = std::max(RelativeForce(conditions), WrongSign(rows));
    SetRestrictions(conditions);
    if (scene_.objective.duration) {
      result->gradient = std::max(*result->gradient, std::abs(RelativeHamiltonian(conditions.Number(0))));
    }
    // Finds where the multipliers of impacts on nodes are between the one-sided ones.
    sweep_.Sweep({.constraints = rows}, [&](int k, const ImpactJump& jump, double gain) {
      const double late = sweep_.Late(k, jump, gain);
      if (!unknown[k]) return late;
      const double early = sweep_.Early(k, jump, gain);
      SetTheta(early, late, found.multipliers[k], position_scale_ * scene_.duration, &result->impacts[k]);
      return found.multipliers[k];
    });
  }

  std::string WhyNoCurvature(const Certificate& result) const {
    // The condition of Legendre and Clebsch: where H_uu is zero, the second variation is not positive definite.
    if (scene_.objective.effort == 0) {
      return "without a cost of effort the Hamiltonian is linear in the forces, and no condition of second order "
             "proves a minimum";
    }
    for (int k = 0; k < num_hits(); ++k) {
      if (IsAtEnd(k)) return "an impact is at the final time, where the loss has a kink and no second derivative";
    }
    for (const ConstraintRow& row : restrictions_.rows) {
      if (row.segment >= 0) return "its second derivative is not computed where a limit is active before the end";
      if (row.inequality && !(row.multiplier > kNoMultiplier * position_scale_)) {
        return "a bound is active with a multiplier of zero, where the second derivative differs from side to side";
      }
    }
    if (IsDurationFree() && result.verdict == Certificate::Verdict::kStationaryOnGrid) {
      return "its second derivative is not computed where all intervals scale with the final time";
    }
    return "";
  }
  bool IsDurationFree() const { return scene_.objective.duration && SignByDuration() == 0; }

  void AddCurvature(Certificate* result) const {
    std::vector<std::optional<double>> held(num_hits());
    if (result->verdict == Certificate::Verdict::kStationaryOnGrid) {
      for (int k = 0; k < num_hits(); ++k) held[k] = result->impacts[k].theta;
    }
    result->curvature = FindCurvature(
        CondensedLoss(scene_, motion_.flight, motion_.control, motion_.lengths, std::move(held), restrictions_));
  }

  // Sets the restrictions of the second-order condition, at the multipliers found.
  void SetRestrictions(const ConeConditions& conditions) {
    restrictions_.rows = RowsAt(conditions.theta());
    restrictions_.duration = IsDurationFree();
    restrictions_.turns.clear();
    for (int k = 0; k < num_intervals(); ++k) {
      for (int t = 0; t < scene_.num_turned(); ++t) restrictions_.turns.push_back(TurnNormalsAt(k, t).empty());
    }
    const int pushed = scene_.num_controlled();
    restrictions_.forces.assign(num_intervals() * pushed, {});
    size_t next = 0;
    for (int i = 0; i < num_intervals() * pushed; ++i) {
      const int interval = i / pushed, c = i % pushed;
      const Vec2d left = HasCondition(interval) ? conditions.Force(next++) : Vec2d(0, 0);
      Restrictions::Force& force = restrictions_.forces[i];
      for (const Vec2d& normal : NormalsAt(interval, c)) {
        const Vec2d along = force.free * normal;
        if (along.norm() > 1e-9) force.free -= along * along.transpose() / along.squaredNorm();
      }
      if (IsAtNorm(interval, c) && effort() > 0) {
        const Vec2d u = Force(interval, c);
        force.bend = std::max(0.0, -left.dot(u) / (2 * effort() * Mass(c) * u.squaredNorm()));
      }
    }
  }

  const ControlledMotion& motion_;
  const Scene& scene_;
  CostateSweep sweep_;
  std::vector<ConstraintCertificate> constraints_;  // without multipliers
  std::vector<ConstraintRow> rows_;                 // of active constraints
  bool limit_inside_interval_ = false;
  std::vector<int> boundaries_;  // of phases: segments, 0 and their number included
  double position_scale_ = 0, hamiltonian_scale_ = 0;
  Restrictions restrictions_;
};

}  // namespace

Certificate ConstrainedConditions(const ControlledMotion& motion) { return ConstrainedCertifier(motion).Run(); }

NearestPass NearestPassOf(const Scene& scene, const Flight& flight, const Candidate& pair) {
  constexpr int kSamples = 4;  // of a piece
  constexpr int kRefinements = 60;
  constexpr double kGolden = 0.6180339887498949;
  const double contact_distance = MakeImpactConstants(scene, pair).contact_distance;
  const auto gap = [&](double time) {
    return SeparationOf(scene, pair, flight.Before(time).p).distance / contact_distance - 1;
  };
  NearestPass best{0, std::numeric_limits<double>::infinity()};
  double width = 0;
  for (const Flight::Piece& piece : flight.pieces()) {
    for (int i = 0; i <= kSamples; ++i) {
      const double time = piece.start + piece.duration * i / kSamples, here = gap(time);
      if (!(here < best.gap)) continue;
      best = {time, here};
      width = piece.duration / kSamples;
    }
  }
  double begin = std::max(best.time - width, 0.0), end = std::min(best.time + width, scene.duration);
  for (int i = 0; i < kRefinements; ++i) {
    const double left = end - kGolden * (end - begin), right = begin + kGolden * (end - begin);
    (gap(left) < gap(right) ? end : begin) = gap(left) < gap(right) ? right : left;
  }
  const double time = 0.5 * (begin + end);
  return {time, gap(time)};
}

std::string WhyNotConstrainedConditions(const Scene& scene, const Flight& flight) {
  for (const NoContact& pair : scene.no_contact) {
    if (NearestPassOf(scene, flight, {pair.a, pair.b, pair.plane}).gap > kApart) continue;
    return "a pair that must not touch is at its limit, and the conditions have no multiplier for it";
  }
  return "";
}

}  // namespace saltus
