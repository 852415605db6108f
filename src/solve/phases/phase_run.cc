#include "solve/phases/phase_run.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <utility>

#include "base/time_grid.h"
#include "control/control_bounds.h"
#include "saltus/scene/materials.h"
#include "scene/units.h"
#include "simulate/impact.h"
#include "solve/phases/phase_solution.h"

namespace saltus {
namespace {

constexpr double kMissWeight = 1e3;   // of hard constraints beside the loss, in natural units
constexpr double kNearBorder = 1e-2;  // of the sliding velocity between slip and stick

// Returns the name of a plan without its first impacts.
std::string NameFrom(const Scene& scene, const PhasePlan& plan, size_t first) {
  const ContactSequence sequence = plan.Sequence();
  std::string text = ContactSequenceToString(scene, {sequence.begin() + first, sequence.end()});
  if (plan.HasTies()) text += plan.tied.back() ? " (at the final time)" : " (some at the same time)";
  for (size_t k = 0; k < plan.cuts.size(); ++k) {
    if (!plan.regimes[k]) continue;
    text += ", " + ContactSequenceToString(scene, {*plan.cuts[k]});
    text += *plan.regimes[k] == static_cast<int>(ContactMode::kSlip) ? " slips" : " sticks";
  }
  for (const Candidate& pair : plan.apart) text += ", " + ContactSequenceToString(scene, {pair}) + " apart";
  return text;
}

// Whether the scene forbids the pair to touch.
bool IsForbidden(const Scene& scene, const Candidate& c) {
  return std::find(scene.no_contact.begin(), scene.no_contact.end(), NoContact{c.a, c.b, c.plane}) !=
         scene.no_contact.end();
}

// The constraint on a state that is missed most, and by how much in the scene's units.
struct Miss {
  double size = 0;
  int body = 0;
  TerminalTerm::Quantity quantity = TerminalTerm::Quantity::kPosition;
};

// Returns the value of a quantity of a disc; that of an angle or angular velocity is the first entry.
Vec2d ValueOf(const DiscStates& x, int body, TerminalTerm::Quantity quantity) {
  if (quantity == TerminalTerm::Quantity::kAngle) return {x.angle[body], 0.0};
  if (quantity == TerminalTerm::Quantity::kAngularVelocity) return {x.spin[body], 0.0};
  return quantity == TerminalTerm::Quantity::kPosition ? x.p[body] : x.v[body];
}

Miss LargestMiss(const Scene& scene, const Trial& trial) {
  Miss largest;
  const Flight flight = FlightOf(scene, trial);
  const auto consider = [&](double size, int body, TerminalTerm::Quantity quantity) {
    if (size > largest.size) largest = {size, body, quantity};
  };
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (!term.hard) continue;
    const Vec2d q = ValueOf(flight.end(), term.body, term.quantity);
    consider((q - term.Goal().Nearest(q)).norm(), term.body, term.quantity);
  }
  for (const ViaTerm& term : scene.objective.via) {
    if (!term.hard) continue;
    const Vec2d q = ValueOf(flight.StatesBefore(term.time), term.body, term.quantity);
    consider((q - term.target).norm(), term.body, term.quantity);
  }
  for (const SpeedLimit& limit : scene.objective.limits) {
    const auto exceed = [&](const Vec2d& velocity) {
      consider(velocity.norm() - limit.max, limit.body, TerminalTerm::Quantity::kVelocity);
    };
    exceed(flight.end().v[limit.body]);
    if (limit.at == SpeedLimit::Timing::kEnd) continue;
    for (const Flight::Piece& piece : flight.pieces()) {
      exceed(piece.at_start.v[limit.body]);
      exceed(piece.StateAfter(limit.body, piece.duration).v);
    }
  }
  return largest;
}

double ViolationOf(const Scene& scene, const Trial& trial) {
  if (!trial.exact.ok || !trial.exact.only_impacts) return std::numeric_limits<double>::infinity();
  const ContactSequence& met = trial.exact.contacts;
  if (std::any_of(met.begin(), met.end(), [&](const Candidate& c) { return IsForbidden(scene, c); })) {
    return std::numeric_limits<double>::infinity();
  }
  return scene.objective.HasConstraints() ? LargestMiss(scene, trial).size : 0.0;
}

// Returns the largest violation, that of the bounds of the control included; 0 if the scene states no constraints,
// whatever the motion.
double ViolationOfAll(const Scene& scene, const Trial& trial) {
  const bool any = scene.objective.HasConstraints() || !scene.no_contact.empty();
  double largest = any ? ViolationOf(scene, trial) : 0;
  std::vector<double> within = trial.control;
  MoveWithinBounds(scene, within);
  for (size_t i = 0; i < within.size(); ++i) largest = std::max(largest, std::abs(trial.control[i] - within[i]));
  return largest;
}

}  // namespace

double DiscMotions::ViolationOf(const Trial& trial) const { return saltus::ViolationOf(*scene_, trial); }

double DiscMotions::NodeMargin(const Trial& trial) const {
  return kNodeMargin * *std::min_element(trial.durations.begin(), trial.durations.end());
}

PhaseRun::PhaseRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options)
    : PhaseRun(solver, request, options, GuessTrial(request.scene, options.guess)) {}

PhaseRun::PhaseRun(std::string_view solver, const SolveRequest& request, const SolverOptions& options, Trial start)
    : SequenceRun(solver, options), DiscMotions(request.scene), scene_(request.scene), guess_(std::move(start)) {
  report_.contact = request.contact.name();
  if (guess_.exact.ok) Record(guess_.exact.loss);
}

std::optional<SolveReport> PhaseRun::MotionFailure() {
  if (!guess_.exact.ok) return Refuse(Termination::kFailed, guess_.exact.reason);
  return std::nullopt;
}

std::optional<SolveReport> PhaseRun::StartFailure() {
  if (auto refused = MotionFailure()) return refused;
  if (!guess_.exact.only_impacts) {
    const Objective& objective = scene_.objective;
    const bool has_path_costs = !objective.running.empty() || !objective.via.empty() || objective.duration;
    return Refuse(Termination::kNotApplicable,
                  "in the motion of the guess discs rest on or graze each other or a plane; this solver supports "
                  "impacts only: start from a guess without such contacts" +
                      (has_path_costs ? "" : ", or " + WayByRollouts(scene_)));
  }
  return std::nullopt;
}

std::optional<SolveReport> PhaseRun::SequenceFailure(const ContactSequence& sequence) {
  if (auto refused = StartFailure()) return refused;
  if (sequence.empty()) {
    return Refuse(Termination::kNotApplicable, "there is no contact in the sequence; give one with --sequence");
  }
  return std::nullopt;
}

double PhaseRun::MeritOf(const Trial& trial) const {
  if (!trial.exact.ok || !trial.exact.only_impacts) return std::numeric_limits<double>::infinity();
  const double violation = ViolationOf(trial);
  return trial.exact.loss + kMissWeight * violation * violation;
}

void PhaseRun::MoveWithin(Trial* trial) const { MoveWithinBounds(scene_, trial->control); }

Trial PhaseRun::ClampToBounds(Trial trial) const {
  const std::vector<double> control = trial.control;
  MoveWithin(&trial);
  if (trial.control != control) Simulate(&trial);
  return trial;
}

void PhaseRun::BlendStart(const Trial& to, const Trial& from, double part, Trial* between) const {
  for (size_t j = 0; j < to.initial.size(); ++j) {
    between->initial[j] = part * to.initial[j] + (1 - part) * InitialOf(scene_, from)[j];
  }
}

void PhaseRun::PlanAlong(ContactSequence sequence, const Trial& trial, PhasePlan* plan,
                         std::vector<double>* times) const {
  std::erase_if(sequence, [&](const Candidate& c) { return IsForbidden(scene_, c); });
  Scene scene = scene_;
  scene.duration = DurationOf(trial);
  const std::vector<double> impacts = GuessFrom(scene, FlightOf(scene, trial), sequence).times;
  const std::vector<double> instants = WaypointsOf(scene_);
  for (size_t k = 0, i = 0; k < impacts.size() || i < instants.size();) {
    const bool impact = i == instants.size() || (k < impacts.size() && impacts[k] < instants[i]);
    times->push_back(impact ? impacts[k] : instants[i]);
    plan->cuts.push_back(impact ? std::optional(sequence[k]) : std::nullopt);
    ++(impact ? k : i);
  }
}

std::vector<std::pair<size_t, int>> PhaseRun::RegimesAtBorders(const PhasePlan& plan, const Trial& trial) const {
  std::vector<std::pair<size_t, int>> regimes;
  if (!HasFriction(scene_)) return regimes;
  const Flight flight = FlightOf(scene_, trial);
  auto hit = flight.hits().begin();
  for (size_t k = 0; k < plan.cuts.size(); ++k) {
    if (!plan.cuts[k]) continue;
    const Impact<double>& impact = (hit++)->impact;
    const double most = MakeImpactConstants(scene_, *plan.cuts[k]).MaxStickRatio() * std::abs(impact.speed);
    if (plan.regimes[k] || std::abs(std::abs(impact.sliding) - most) > kNearBorder * most) continue;
    for (const ContactMode mode : {ContactMode::kStick, ContactMode::kSlip}) {
      regimes.emplace_back(k, static_cast<int>(mode));
    }
  }
  return regimes;
}

bool PhaseRun::HasCertificate() const {
  return scene_.optimize == Optimize::kControl && (scene_.objective.effort > 0 || scene_.control.IsBounded());
}

const Certificate& PhaseRun::Certify(const Trial& trial) {
  if (!certified_ || certified_->control != trial.control || certified_->durations != trial.durations) {
    certified_ = {trial.control, trial.durations, CertifyTrial(scene_, trial)};
  }
  return certified_->certificate;
}

std::string PhaseRun::NameOf(const PhasePlan& plan) const { return NameFrom(scene_, plan, 0); }

std::string PhaseRun::NamesOf(const std::vector<PhasePlan>& plans) const {
  constexpr size_t kLong = 8;  // impacts, of which those are left out that the sequence before has too
  std::string text;
  for (size_t i = 0; i < plans.size(); ++i) {
    const ContactSequence sequence = plans[i].Sequence();
    size_t same = 0;
    if (i > 0 && sequence.size() > kLong) {
      const ContactSequence before = plans[i - 1].Sequence();
      const auto [mine, other] = std::mismatch(sequence.begin(), sequence.end(), before.begin(), before.end());
      same = std::min<size_t>(mine - sequence.begin(), sequence.size() - 1);
    }
    text += i > 0 ? "; " : "";
    if (same > 0) text += "(" + std::to_string(same) + " the same) ";
    text += NameFrom(scene_, plans[i], same);
  }
  return text;
}

std::string PhaseRun::KinksOf(const PhasePlan& plan) const {
  std::string text;
  const auto add = [&](const std::string& what) { text += (text.empty() ? "" : ", ") + what; };
  for (const Candidate& pair : plan.apart) add(ContactSequenceToString(scene_, {pair}) + " just touch");
  if (plan.HasTies()) add(plan.tied.back() ? "an impact is at the final time" : "impacts are at the same time");
  if (plan.HasRegimes()) add("an impact is between slip and stick");
  return text;
}

std::string PhaseRun::DescribeMiss(const Trial& trial) const {
  const Miss miss = LargestMiss(scene_, trial);
  constexpr const char* kUnits[] = {" m", " m/s", " rad", " rad/s"};  // by quantity
  char text[40];
  std::snprintf(text, sizeof text, "%.6g", miss.size * UnitFactors(scene_.units, {}).of(miss.quantity));
  return std::string(text) + kUnits[static_cast<int>(miss.quantity)] + ", by " + scene_.bodies[miss.body].name;
}

SolveReport PhaseRun::Finish(const Trial& trial, double loss, Termination termination, std::string reason) {
  FinishReport(loss, termination, std::move(reason));
  report_.guess.violation = ViolationOfAll(scene_, guess_);
  report_.solution.violation = ViolationOfAll(scene_, trial);
  report_.solution.initial_state = InitialOf(scene_, trial);
  report_.solution.control = trial.control;
  report_.solution.durations = trial.durations;
  return std::move(report_);
}

PhaseRun::Transcriber::Transcriber(const PhaseRun& run, const PhasePlan& plan, const PlanStart& start)
    : DiscMotions(scene_), scene_(run.scene()) {
  if (scene_.objective.duration) scene_.duration = DurationOf(start.trial);
  if (plan.only_violation) AimAtConstraints(start.trial);
  for (const NoContact& pair : scene_.no_contact) apart_.push_back({pair.a, pair.b, pair.plane});
  apart_.insert(apart_.end(), plan.apart.begin(), plan.apart.end());
  phases_.emplace(scene_, plan, WaypointsOf(run.scene()), apart_);
}

// In natural units, a force that matters costs far less than the violations that it removes. The target of a region is
// the nearest of its points. Limits remain constraints.
void PhaseRun::Transcriber::AimAtConstraints(const Trial& start) {
  constexpr double kEffort = 1e-6;
  Objective only;
  only.effort = kEffort * std::pow(scene_.duration, 3);
  const DiscStates end = FlightOf(scene_, start).end();
  for (TerminalTerm term : scene_.objective.terminal) {
    if (!term.hard) continue;
    if (term.region) term.target = term.region->Nearest(ValueOf(end, term.body, term.quantity));
    term.region.reset();
    term.hard = false;
    term.weight = 1;
    only.terminal.push_back(term);
  }
  for (ViaTerm term : scene_.objective.via) {
    if (!term.hard) continue;
    term.hard = false;
    term.weight = 1;
    only.via.push_back(term);
  }
  only.limits = scene_.objective.limits;
  only.duration = scene_.objective.duration;
  if (only.duration) only.duration->weight = 0;
  scene_.objective = only;
}

}  // namespace saltus
