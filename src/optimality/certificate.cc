#include "saltus/optimality/certificate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <new>
#include <numeric>
#include <string>

#include "base/statistics.h"
#include "control/scene_constraints.h"
#include "optimality/hybrid_conditions.h"
#include "optimality/kink_conditions.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/control/objective.h"
#include "saltus/scene/scene_parameter.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"
#include "simulate/flight.h"
#include "simulate/impact.h"

namespace saltus {
namespace {

constexpr double kAtLimit = 1e-6;  // of a limit of the speed: a speed so near is at it

std::string UnsupportedByCertificate(const Scene& scene, const ExactRun& exact) {
  if (scene.optimize != Optimize::kControl || scene.control.bodies.empty()) return "no control is optimized";
  if (scene.objective.effort == 0 && !scene.control.IsBounded()) {
    return "without a cost of effort forces and costates are not related";
  }
  if (!exact.ok) return exact.reason;
  if (const std::string beyond = NonPlaneGeometry(scene); !beyond.empty()) {
    return "the scene has " + beyond + "; the conditions are those of impacts of discs and planes";
  }
  if (!exact.only_impacts) return "discs rest on or graze each other or a plane; the conditions are those of impacts";
  return "";
}

// The time at which two discs, or a disc and a plane, are nearest, s, and their gap then, in contact distances.
struct NearestPass {
  double time = 0, gap = 0;
};
NearestPass NearestPassOf(const Scene& scene, const Flight& flight, const Candidate& pair) {
  constexpr int kSamples = 4;  // of a piece
  constexpr int kRefinements = 60;
  constexpr double kGolden = 0.6180339887498949;
  const double contact_distance = MakeImpactConstants(scene, pair).contact_distance;
  const auto gap = [&](double time) {
    return SeparationOf(scene, pair, flight.StatesBefore(time).p).distance / contact_distance - 1;
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

// Returns why a motion has no conditions: it is at the limit of a pair that must not touch.
std::string ReasonAtContactLimit(const Scene& scene, const Flight& flight) {
  constexpr double kApart = 2e-4;  // of the contact distance
  for (const NoContact& pair : scene.no_contact) {
    if (NearestPassOf(scene, flight, {pair.a, pair.b, pair.plane}).gap > kApart) continue;
    return "a pair that must not touch is at its limit, and the conditions have no multiplier for it";
  }
  return "";
}

// Returns the multipliers of the constraints in the order of Certificate::constraints.
std::vector<ConstraintCertificate> ConstraintsOf(const Scene& scene, const std::vector<double>& lengths,
                                                 const std::vector<SceneConstraint>& constraints,
                                                 const std::vector<TermMultiplier>& multipliers) {
  std::vector<ConstraintCertificate> found;
  const auto add = [&](int body, TerminalTerm::Quantity quantity, const auto& is_of) {
    ConstraintCertificate& entry = found.emplace_back();
    entry.body = scene.bodies[body].name;
    entry.quantity = quantity;
    for (const SceneConstraint& constraint : constraints) {
      if (!is_of(constraint)) continue;
      for (const TermMultiplier& one : multipliers) {
        if (one.term == constraint.term) entry.multiplier += one.value * constraint.by[one.row];
      }
    }
  };
  const auto add_terminal = [&](bool region) {
    for (const TerminalTerm& term : scene.objective.terminal) {
      if (!term.hard || term.region.has_value() != region) continue;
      add(term.body, term.quantity, [&](const SceneConstraint& one) { return one.terminal == &term; });
    }
  };
  add_terminal(false);
  for (const ViaTerm& term : scene.objective.via) {
    if (term.hard) add(term.body, term.quantity, [&](const SceneConstraint& one) { return one.via == &term; });
  }
  add_terminal(true);
  for (const SpeedLimit& limit : scene.objective.limits) {
    if (limit.at != SpeedLimit::Timing::kEnd) continue;
    add(limit.body, TerminalTerm::Quantity::kVelocity, [&](const SceneConstraint& one) { return one.limit == &limit; });
    found.back().speed_limit = limit.max;
  }
  // A limit that always holds is active at the beginnings (row 0) and the ends (row 1) of intervals.
  std::vector<double> times = {0.0};
  for (const double length : lengths) times.push_back(times.back() + length);
  for (const SceneConstraint& constraint : constraints) {
    if (constraint.limit == nullptr || constraint.limit->at != SpeedLimit::Timing::kAlways) continue;
    std::map<int, Vec2d> at_node;
    for (const TermMultiplier& one : multipliers) {
      if (one.term != constraint.term) continue;
      const auto [sum, is_new] = at_node.try_emplace(one.interval + one.row, Vec2d::Zero());
      sum->second += one.value * constraint.by[one.row];
    }
    for (const auto& [node, multiplier] : at_node) {
      found.push_back({.body = scene.bodies[constraint.limit->body].name,
                       .quantity = TerminalTerm::Quantity::kVelocity,
                       .multiplier = multiplier,
                       .speed_limit = constraint.limit->max,
                       .time = times[node]});
    }
  }
  return found;
}

// The times of a motion in natural units, and the scene with its duration.
struct Motion {
  ExactRun exact;
  std::vector<double> lengths;  // of the control intervals, s
  Scene scene;
  bool grid_is_given = false;  // by equal intervals
};

// Simulates a control. Returns std::nullopt, with the reason, if there is nothing to certify.
std::optional<Motion> MotionOf(const Scene& scene, const std::vector<double>& initial,
                               const std::vector<double>& control, const std::vector<double>& durations,
                               const StopRequest& stop, std::string* reason) {
  Motion motion{SimulateExactly(scene, initial, control, durations, stop), durations, scene, durations.empty()};
  *reason = UnsupportedByCertificate(scene, motion.exact);
  if (!reason->empty()) return std::nullopt;
  if (durations.empty()) {
    const size_t intervals = control.size() / scene.control_width();
    motion.lengths.assign(intervals, scene.duration / static_cast<double>(intervals));
  }
  if (std::optional<FreeDuration>& free = motion.scene.objective.duration) {
    motion.scene.duration = std::accumulate(motion.lengths.begin(), motion.lengths.end(), 0.0);
    if (free->min == free->max) free.reset();  // nothing is asked of a time that cannot be another
  }
  return motion;
}

// Adds the derivative of the loss by a design parameter, which is relative to `size`; its residual is zero at a bound
// beyond which the loss would fall. A stationary verdict falls if it is too large.
void AddParameter(const Scene& scene, size_t i, double derivative, double size, Certificate* certificate) {
  const SceneParameter& parameter = scene.design[i].parameter;
  ParameterCertificate entry{parameter, NameOf(parameter, scene), ValueOf(scene.design[i], scene)};
  entry.derivative = derivative;
  const ParameterRange range = RangeOf(scene.design[i]);
  const bool held = (entry.value <= range.min && derivative > 0) || (entry.value >= range.max && derivative < 0);
  if (!held) entry.residual = std::abs(derivative) / size;
  if (!(entry.residual <= kCertificateTolerance) && certificate->IsStationary()) {
    certificate->verdict = Certificate::Verdict::kNotStationary;
    certificate->reason = "the derivative by " + entry.name + " does not vanish";
  }
  certificate->parameters.push_back(std::move(entry));
}

// Drops limits that always hold and are not active. They end intervals at events, which these need not do.
void DropSlackLimits(const Flight& flight, std::vector<SpeedLimit>* limits) {
  std::erase_if(*limits, [&](const SpeedLimit& limit) {
    const auto is_slow = [&](const Flight::Piece& piece) {
      const auto speed = [&](double t) { return piece.StateAfter(limit.body, t).v.norm(); };
      return std::max(speed(0), speed(piece.duration)) < (1 - kAtLimit) * limit.max;
    };
    return limit.at == SpeedLimit::Timing::kAlways && std::ranges::all_of(flight.pieces(), is_slow);
  });
}

// Certifies a motion by the conditions of the problem that the scene is as a hybrid system.
Certificate CertifyAsHybrid(Motion motion, const std::vector<double>& initial, const std::vector<double>& control,
                            ConditionsOptions options) {
  Scene& scene = motion.scene;
  Certificate certificate;
  if (const std::string beyond = NonBallisticForces(scene); beyond.empty()) {
    const Flight flight(scene, initial, control, motion.lengths, motion.exact);
    if (certificate.reason = ReasonAtContactLimit(scene, flight); !certificate.reason.empty()) return certificate;
    DropSlackLimits(flight, &scene.objective.limits);
  } else if (!scene.no_contact.empty()) {
    certificate.reason =
        "the scene has " + beyond + " and pairs that must not touch, whose distances are not known then";
    return certificate;
  }
  std::vector<SceneConstraint> constraints;
  HybridProblem problem = MakeHybridProblem(scene, &constraints);
  HybridProblem with_parameters = problem;
  problem.free.parameters.clear();  // whose derivatives are judged with the multipliers of the other conditions
  problem.free.parameters_min.clear();
  problem.free.parameters_max.clear();
  const HybridInput input = InputOf(problem, initial, control, motion.lengths);
  const ContactSequence pairs = AllPairs(scene);
  std::vector<TermMultiplier> multipliers;
  options.multipliers = &multipliers;
  std::vector<ParameterDerivative> by_parameters;
  options.parameters = &by_parameters;
  options.name = [&](int /*mode*/, int guard, ImpactCertificate* impact) {
    if (guard < static_cast<int>(pairs.size())) NamePair(scene, pairs[guard], impact);
  };
  certificate = CertifyConditions(problem, input, options);
  std::erase_if(certificate.impacts, [](const ImpactCertificate& one) { return one.b.starts_with("waypoint "); });
  if (certificate.verdict == Certificate::Verdict::kNotApplicable) return certificate;
  certificate.constraints = ConstraintsOf(scene, motion.lengths, constraints, multipliers);
  const auto one_sided = [](const ImpactCertificate& impact) { return impact.theta.has_value(); };
  if (motion.grid_is_given && !scene.design.empty() && std::ranges::any_of(certificate.impacts, one_sided)) {
    certificate = {};
    certificate.reason = "an impact is on a node of the grid, where the derivatives by parameters are one-sided";
    return certificate;
  }
  for (size_t i = 0; i < by_parameters.size(); ++i) {
    AddParameter(scene, i, by_parameters[i].value, by_parameters[i].size, &certificate);
  }
  if (certificate.curvature && !scene.design.empty() && !options.always_curvature) {
    // A minimum has a positive curvature along the parameters too.
    options.multipliers = nullptr;
    options.parameters = nullptr;
    options.least_parameter = 1;  // in natural units
    Certificate wider = CertifyConditions(with_parameters, input, options);
    certificate.curvature = std::move(wider.curvature);
    if (certificate.IsStationary() && wider.IsStationary()) certificate.reason = std::move(wider.reason);
  }
  if (!certificate.curvature) return certificate;
  // The condition of Legendre and Clebsch: where H_uu is zero, the second variation is not positive definite.
  if (scene.objective.effort == 0) {
    certificate.curvature.reset();
    certificate.reason =
        "without a cost of effort the Hamiltonian is linear in the forces, and no condition of second order proves a "
        "minimum";
    return certificate;
  }
  std::vector<double>& direction = certificate.curvature->direction;
  direction.resize(control.size());  // without the final time and the parameters
  if (!scene.design.empty()) return certificate;
  double square = 0;
  for (size_t i = 0; i < direction.size(); ++i) {
    square += motion.lengths[i / scene.control_width()] * direction[i] * direction[i];
  }
  for (double& force : direction) force /= square > 0 ? std::sqrt(square) : 1;
  return certificate;
}

Certificate CertifyControl(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                           const std::vector<double>& durations, const StopRequest& stop) {
  Certificate certificate;
  std::optional<Motion> motion = MotionOf(scene, initial, control, durations, stop, &certificate.reason);
  if (!motion) return certificate;
  JudgeTies(motion->exact.ambiguous, &certificate);
  if (certificate.verdict == Certificate::Verdict::kAmbiguous) return certificate;
  return CertifyAsHybrid(std::move(*motion), initial, control, {});
}

// Returns the largest derivative by the free part of the initial state (velocity or position).
double LargestOfFree(const Scene& scene, const std::vector<double>& initial) {
  double largest = 0;
  const int offset = scene.optimize == Optimize::kVelocity ? 2 : 0;
  for (const int body : scene.free) {
    for (int j = 0; j < 2; ++j) largest = std::max(largest, std::abs(initial[4 * body + offset + j]));
  }
  for (const int body : scene.free_spin) {
    largest = std::max(largest, std::abs(initial[4 * scene.num_bodies() + kSpin * body + 1]));
  }
  return largest;
}

// Certifies design parameters without a control, from the derivatives of the adjoint.
Certificate CertifyDesign(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                          const std::vector<double>& durations, const StopRequest& stop) {
  Certificate certificate;
  const auto refuse = [&](const std::string& why) {
    certificate.reason = why;
    return certificate;
  };
  if (!durations.empty() || scene.objective.HasConstraints() || !scene.objective.running.empty() ||
      !scene.objective.via.empty()) {
    return refuse(
        "beside constraints and path costs, conditions by parameters are those of a control, and none is free");
  }
  const ExactRun run = SimulateExactly(scene, initial, control, durations, stop);
  if (!run.ok) return refuse(run.reason);
  JudgeTies(run.ambiguous, &certificate);
  if (!run.ambiguous.empty()) return certificate;
  if (!run.only_impacts) return refuse("discs rest on or graze each other or a wall");
  const std::unique_ptr<Simulator> simulator = MakeSimulator(Contact(ExactModel()->name), scene, Precision::kDouble);
  const std::vector<double> end = ToState(run.end, scene.num_bodies());
  std::vector<double> costate(end.size());
  TerminalGradient(scene.objective, end, simulator->body_size(), costate);
  simulator->set_stop(stop);
  if (!simulator->Rollout(initial, control)) return refuse(simulator->FailureReason());
  Sensitivity all;
  simulator->Adjoint(costate, /*with_parameters=*/true, &all);
  // In natural units costates are about 1, but they vanish with a loss that reaches zero.
  const double size = std::max({1.0, Largest(costate), Largest(all.initial)});
  certificate.initial = LargestOfFree(scene, all.initial) / size;
  certificate.verdict = Certificate::Verdict::kStationary;
  if (!(*certificate.initial <= kCertificateTolerance)) {
    certificate.verdict = Certificate::Verdict::kNotStationary;
    certificate.reason = "the derivative by the initial state does not vanish";
  }
  for (size_t i = 0; i < scene.design.size(); ++i) {
    const double by = all.parameters.design[i];
    AddParameter(scene, i, by, size, &certificate);
  }
  return certificate;
}

}  // namespace

Certificate Certify(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                    const std::vector<double>& durations, const StopRequest& stop) {
  if (!scene.units.natural) {
    const Scene natural = ToNaturalUnits(scene);
    const UnitFactors by(scene.units, natural.units);
    return ToUnits(Certify(natural,
                           ConvertInitial(initial, scene.num_bodies(), scene.units, natural.units),
                           Multiplied(control, by.force),
                           Multiplied(durations, by.time),
                           stop),
                   natural.units,
                   scene.units);
  }
  Certificate certificate;
  try {
    const bool of_design = !scene.design.empty() && scene.optimize != Optimize::kControl;
    certificate = of_design ? CertifyDesign(scene, initial, control, durations, stop)
                            : CertifyControl(scene, initial, control, durations, stop);
  } catch (const std::bad_alloc&) {
    certificate.reason = "memory ran out";
  }
  return certificate;
}

Certificate ToUnits(Certificate certificate, const Units& from, const Units& to) {
  const UnitFactors by(from, to);
  for (ImpactCertificate& impact : certificate.impacts) {
    impact.time *= by.time;
    impact.speed *= by.speed;
    impact.multiplier *= by.loss / by.length;
  }
  for (ConstraintCertificate& constraint : certificate.constraints) {
    constraint.multiplier *= by.loss / by.of(constraint.quantity);
    if (constraint.speed_limit) *constraint.speed_limit *= by.speed;
    if (constraint.time) *constraint.time *= by.time;
  }
  for (ParameterCertificate& entry : certificate.parameters) {
    entry.value = ConvertParameter(entry.parameter, entry.value, from, to);
    entry.derivative *= by.loss / by.of(entry.parameter);
  }
  for (Tie& tie : certificate.ambiguous) tie.time *= by.time;
  for (std::optional<double>* gradient :
       {&certificate.gradient_early, &certificate.gradient_late, &certificate.gradient_combined}) {
    if (*gradient) **gradient *= by.loss / by.force;
  }
  // The square of the direction integrates to 1, whatever the unit of force.
  if (certificate.curvature) {
    for (double& force : certificate.curvature->direction) force /= std::sqrt(by.time);
  }
  return certificate;
}

std::optional<Curvature> CurvatureAt(const Scene& scene, const std::vector<double>& initial,
                                     const std::vector<double>& control, const std::vector<double>& durations) {
  std::string reason;
  std::optional<Motion> motion = MotionOf(scene, initial, control, durations, nullptr, &reason);
  if (!motion) return std::nullopt;
  return CertifyAsHybrid(std::move(*motion), initial, control, {.always_curvature = true}).curvature;
}

void NamePair(const Scene& scene, const Candidate& pair, ImpactCertificate* impact) {
  impact->a = scene.bodies[pair.a].name;
  impact->b = pair.plane ? scene.planes[pair.b].name : scene.bodies[pair.b].name;
}

void Judge(Certificate* certificate) {
  const std::array<std::pair<double, const char*>, 4> residuals = {{{certificate->stationarity, "stationarity"},
                                                                    {certificate->costate_jump, "the costate jump"},
                                                                    {certificate->transversality, "transversality"},
                                                                    {certificate->hamiltonian, "the Hamiltonian"}}};
  using enum Certificate::Verdict;
  certificate->verdict = kStationary;
  certificate->reason.clear();
  double worst = kCertificateTolerance;
  for (const auto& [residual, name] : residuals) {
    if (!std::isfinite(residual)) {
      certificate->verdict = kNotApplicable;
      certificate->reason = std::string("the residual of ") + name + " is not a finite number";
      return;
    }
    if (residual <= worst) continue;
    certificate->verdict = kNotStationary;
    certificate->reason = std::string("the largest residual is that of ") + name;
    worst = residual;
  }
  const auto jumping = std::ranges::find_if(certificate->impacts, &ImpactCertificate::jumps);
  if (jumping != certificate->impacts.end()) {
    certificate->verdict = kNotApplicable;
    certificate->reason = "the loss is not continuous as the impact " + jumping->a + "-" + jumping->b +
                          " leaves the end of its control interval, where a term reads the state or the control jumps";
    return;
  }
  const auto leaving = std::ranges::find_if(certificate->impacts, &ImpactCertificate::LeavesNode);
  if (leaving == certificate->impacts.end()) {
    if (certificate->verdict == kNotStationary && certificate->gradient &&
        *certificate->gradient <= kCertificateTolerance) {
      certificate->verdict = kStationaryOnGrid;
      certificate->reason.clear();
    }
  } else if (certificate->verdict == kStationary) {
    certificate->verdict = kNotStationary;
    certificate->reason =
        "stationary if the intervals move with the impacts; with the intervals as they are, the loss "
        "falls as the impact " +
        leaving->a + "-" + leaving->b + " leaves its node";
  }
  if (!certificate->IsStationary() || !certificate->curvature) return;
  if (certificate->IsSaddle()) {
    certificate->reason = "a saddle: the loss falls along the direction of the smallest curvature, both ways";
  } else if (certificate->curvature->kind == Curvature::Kind::kFlat) {
    certificate->reason = "the curvature is nearly zero along one direction: perhaps no minimum";
  }
}

void JudgeTies(const std::vector<Tie>& ambiguous, Certificate* certificate) {
  if (ambiguous.empty()) return;
  certificate->verdict = Certificate::Verdict::kAmbiguous;
  certificate->reason = TiesToString(ambiguous);
  certificate->ambiguous = ambiguous;
}

const char* VerdictToString(Certificate::Verdict verdict) {
  constexpr const char* kNames[] = {
      "stationary", "stationary_on_grid", "not_stationary", "ambiguous", "not_applicable", "global"};
  return kNames[static_cast<int>(verdict)];
}

const char* CurvatureToString(Curvature::Kind kind) {
  constexpr const char* kNames[] = {"minimum", "saddle", "flat"};
  return kNames[static_cast<int>(kind)];
}

std::string VerdictInWords(const Certificate& certificate) {
  const bool decided = certificate.curvature && certificate.curvature->kind != Curvature::Kind::kFlat;
  const std::string what = decided ? CurvatureToString(certificate.curvature->kind) : "stationary";
  const std::string words[] = {what, what + " on the grid", "not stationary", "ambiguous", "", "global minimum"};
  return words[static_cast<int>(certificate.verdict)];
}

namespace {

using enum Certificate::Verdict;

// Says what a stationary control means: the loss does not change to first order.
std::string MeaningOfStationary(const Certificate& certificate) {
  if (certificate.initial) return "to first order no change of what is optimized lowers the loss";
  const std::string which =
      std::string(certificate.verdict == kStationaryOnGrid ? "forces on these intervals" : "the control") +
      (certificate.parameters.empty() ? "" : " and the parameters");
  if (!certificate.curvature) {
    return "to first order no change of " + which + " lowers the loss; its curvature was not looked at";
  }
  const Curvature::Kind kind = certificate.curvature->kind;
  if (kind == Curvature::Kind::kMinimum) return "no small change of " + which + " lowers the loss";
  if (kind == Curvature::Kind::kSaddle)
    return "no minimum: along one change of " + which + " the loss falls, both ways";
  return "perhaps no minimum: along one change of " + which + " the loss hardly changes";
}

}  // namespace

std::optional<double> ResidualOf(const Certificate& certificate) {
  if (certificate.verdict == kStationaryOnGrid) return certificate.gradient;
  if (certificate.verdict == kAmbiguous || certificate.verdict == kNotApplicable) return std::nullopt;
  double residual = std::max({certificate.stationarity,
                              certificate.costate_jump,
                              std::abs(certificate.hamiltonian),
                              certificate.transversality,
                              certificate.initial.value_or(0)});
  for (const ParameterCertificate& entry : certificate.parameters) residual = std::max(residual, entry.residual);
  return residual;
}

std::string MeaningOf(const Certificate& certificate) {
  if (certificate.verdict == kNotStationary) {
    return std::string("small changes of ") + (certificate.initial ? "what is optimized" : "the control") +
           (certificate.parameters.empty() || certificate.initial ? "" : " or the parameters") +
           " lower the loss: " + certificate.reason;
  }
  if (certificate.verdict == kAmbiguous || certificate.verdict == kNotApplicable) return certificate.reason;
  if (certificate.verdict == kGlobal) {
    return certificate.reason.empty() ? "a lower bound proves that no control on as many intervals has a lower loss"
                                      : certificate.reason;
  }
  const std::string searched =
      certificate.scope == Certificate::Scope::kBestOfSearched
          ? "it is the best of " + std::to_string(certificate.sequences_searched) +
                (certificate.sequences_searched == 1 ? " sequence of impacts" : " sequences of impacts")
          : "other sequences of impacts may be better";
  return MeaningOfStationary(certificate) + "; " + searched;
}

const char* ScopeToString(Certificate::Scope scope) {
  return scope == Certificate::Scope::kBestOfSearched ? "best_of_searched" : "local";
}

}  // namespace saltus
