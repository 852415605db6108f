#include "saltus/optimality/certificate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <string>

#include "optimality/design_gradient.h"
#include "optimality/optimality_conditions.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/control/objective.h"
#include "saltus/simulate/exact_run.h"
#include "scene/units.h"

namespace saltus {
namespace {

std::string WhyNotCertify(const Scene& scene, const ExactRun& exact) {
  if (scene.optimize != Optimize::kControl || scene.control.bodies.empty()) return "no control is optimized";
  if (scene.objective.effort == 0 && !scene.control.IsBounded()) {
    return "without a cost of effort forces and costates are not related";
  }
  if (!exact.ok) return exact.reason;
  if (const std::string beyond = BeyondPlanes(scene); !beyond.empty()) {
    return "the scene has " + beyond + "; the conditions are those of impacts of discs and planes";
  }
  if (!exact.only_impacts) return "discs rest on or graze each other or a plane; the conditions are those of impacts";
  return "";
}

Certificate CertifyControl(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                           const std::vector<double>& durations, const StopRequest& stop) {
  Certificate certificate;
  const ExactRun exact = SimulateExactly(scene, initial, control, durations, stop);
  certificate.reason = WhyNotCertify(scene, exact);
  if (!certificate.reason.empty()) return certificate;
  JudgeTies(exact.ambiguous, &certificate);
  if (certificate.verdict == Certificate::Verdict::kAmbiguous) return certificate;
  const std::vector<double> lengths = IntervalLengths(scene, control, durations);
  Scene whole = scene;
  if (std::optional<FreeDuration>& free = whole.objective.duration) {
    whole.duration = std::accumulate(lengths.begin(), lengths.end(), 0.0);
    if (free->min == free->max) free.reset();  // nothing is asked of a time that cannot be another
  }
  const Flight flight(whole, initial, control, lengths, exact);
  const ControlledMotion motion{whole, control, lengths, flight, exact};
  if (BeyondTerminalCost(whole).empty() && scene.num_turned() == 0) return FreeConditions(motion);
  certificate.reason = WhyNotConstrainedConditions(whole, flight);
  return certificate.reason.empty() ? ConstrainedConditions(motion) : certificate;
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

// Adds the conditions of the scene's design parameters to those of its control.
void CertifyParameters(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                       const std::vector<double>& durations, const StopRequest& stop, Certificate* certificate) {
  using enum Certificate::Verdict;
  const bool controls = scene.optimize == Optimize::kControl;
  if (certificate->verdict == kAmbiguous || (controls && certificate->verdict == kNotApplicable)) return;
  const auto refuse = [&](const std::string& why) {
    *certificate = {};
    certificate->reason = why;
  };
  const auto one_sided = [](const ImpactCertificate& impact) { return impact.theta.has_value(); };
  if (durations.empty() && std::ranges::any_of(certificate->impacts, one_sided)) {
    return refuse("an impact is on a node of the grid, where the derivatives by parameters are one-sided");
  }
  const DesignGradient gradient = GradientByDesign(scene, initial, control, durations, certificate->constraints, stop);
  if (!gradient.ok()) {
    refuse(gradient.reason);
    return JudgeTies(gradient.ambiguous, certificate);
  }
  if (!controls) {
    *certificate = {};
    certificate->verdict = kStationary;
    certificate->initial = gradient.initial.empty() ? 0.0 : LargestOfFree(scene, gradient.initial) / gradient.costate;
  }
  JudgeParameters(scene, gradient.by, gradient.costate, certificate);
}

}  // namespace

Certificate Certify(const Scene& scene, const std::vector<double>& initial, const std::vector<double>& control,
                    const std::vector<double>& durations, const StopRequest& stop) {
  if (!scene.units.natural) {
    const Scene natural = InNaturalUnits(scene);
    const UnitFactors by(scene.units, natural.units);
    return InUnits(Certify(natural,
                           ConvertInitial(initial, scene.num_bodies(), scene.units, natural.units),
                           Multiplied(control, by.force),
                           Multiplied(durations, by.time),
                           stop),
                   natural.units,
                   scene.units);
  }
  Certificate certificate = CertifyControl(scene, initial, control, durations, stop);
  if (!scene.design.empty()) CertifyParameters(scene, initial, control, durations, stop, &certificate);
  return certificate;
}

Certificate InUnits(Certificate certificate, const Units& from, const Units& to) {
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
  const ExactRun exact = SimulateExactly(scene, initial, control, durations);
  if (!WhyNotCertify(scene, exact).empty() || !BeyondTerminalCost(scene).empty() || scene.num_turned() > 0) {
    return std::nullopt;
  }
  const std::vector<double> lengths = IntervalLengths(scene, control, durations);
  const Flight flight(scene, initial, control, lengths, exact);
  return FindCurvature(CondensedLoss(scene, flight, control, lengths));
}

std::vector<double> IntervalLengths(const Scene& scene, const std::vector<double>& control,
                                    const std::vector<double>& durations) {
  if (!durations.empty()) return durations;
  const size_t intervals = control.size() / scene.control_width();
  return std::vector<double>(intervals, scene.duration / intervals);
}

Certificate WithImpactsOf(const ControlledMotion& motion) {
  Certificate certificate;
  for (size_t k = 0; k < motion.flight.hits().size(); ++k) {
    const Flight::Hit& hit = motion.flight.hits()[k];
    ImpactCertificate& impact = certificate.impacts.emplace_back();
    impact.time = hit.time;
    impact.a = motion.exact.events[k].a;
    impact.b = motion.exact.events[k].b;
    impact.speed = -hit.impact.speed;
    impact.on_node = hit.on_node;
  }
  return certificate;
}

void SetTheta(double early, double late, double multiplier, double scale, ImpactCertificate* impact) {
  constexpr double kFar = 1e9;
  const double kink = early - late;
  const auto counts = [&](double change) { return change * impact->time > kCertificateTolerance * scale; };
  if (!(std::abs(kink) > 1e-9 * (std::abs(early) + std::abs(late)))) {
    // Without a kink the multiplier of a minimum is that of both sides, and no other is between them.
    if (counts(std::abs(multiplier - late))) impact->theta = multiplier > late ? kFar : -kFar;
    return;
  }
  const double theta = (multiplier - late) / kink, between = std::clamp(theta, 0.0, 1.0);
  impact->theta = counts(std::abs((theta - between) * kink)) ? theta : between;
  impact->concave = counts(kink);
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

const char* ScopeToString(Certificate::Scope scope) {
  return scope == Certificate::Scope::kBestOfSearched ? "best_of_searched" : "local";
}

}  // namespace saltus
