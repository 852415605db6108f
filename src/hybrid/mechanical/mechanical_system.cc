#include "saltus/hybrid/mechanical_system.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/number_text.h"
#include "base/random.h"
#include "hybrid/mechanical/mechanical_hybrid.h"

namespace saltus {
namespace {

constexpr double kGain = 1e-10;  // of the kinetic energy before an impact: what is less is rounding
constexpr int kMostSequential = 100;

// Whether a gap has one value at the coordinates q and at others that are near, apart and far.
bool IsConstant(const MechanicalFunctions& functions, int contact, const double* q, const double* p) {
  const double gap = functions.Gap(contact, q, p);
  std::vector<double> moved(functions.layout().num_coordinates);
  NormalStream random(1);
  for (const double distance : {0.01, 1.0, -1.0, 100.0}) {
    for (std::size_t i = 0; i < moved.size(); ++i) moved[i] = q[i] + distance * (1 + std::abs(q[i])) * random.Next();
    if (functions.Gap(contact, moved.data(), p) != gap) return false;
  }
  return true;
}

// The impulses of impacts of the contacts one after the other, beginning with `first`, until none approaches. Newton's
// law of each contact by itself.
Eigen::VectorXd SequentialImpulses(const ContactProblem& problem, const std::vector<double>& restitution, int first) {
  Eigen::VectorXd impulse = Eigen::VectorXd::Zero(problem.given.size());
  const double at_rest = 1e-14 * problem.given.cwiseAbs().maxCoeff();
  int contact = first;
  for (int count = 0; count < kMostSequential && contact >= 0; ++count) {
    Eigen::VectorXd speeds = problem.given + problem.W * impulse;
    ContactProblem single{.W = problem.W.block<2, 2>(2 * contact, 2 * contact),
                          .given = speeds.segment<2>(2 * contact),
                          .friction = {problem.friction[contact]},
                          .has_friction = {problem.has_friction[contact]},
                          .sliding = {0}};
    single.given[0] *= 1 + restitution[contact];
    const std::vector<ContactSolution> solution = SolveContactProblem(single);
    if (solution.size() != 1) break;
    impulse.segment<2>(2 * contact) += solution[0].force;
    speeds = problem.given + problem.W * impulse;
    const int last = contact;
    contact = -1;
    for (int i = 1; i <= problem.size() && contact < 0; ++i) {
      const int other = (last + i) % problem.size();
      if (speeds[2 * other] < -at_rest) contact = other;
    }
  }
  return impulse;
}

}  // namespace

MechanicalSystem::MechanicalSystem(std::shared_ptr<const MechanicalFunctions> functions, MechanicalOptions options)
    : modes_(std::make_shared<MechanicalHybrid>(std::move(functions), options)), hybrid_(modes_) {}

const MechanicalFunctions& MechanicalSystem::functions() const { return modes_->mechanics(); }
const MechanicalOptions& MechanicalSystem::options() const { return modes_->options(); }

int MechanicalSystem::Mode(const std::string& status) const { return modes_->ModeOf(status); }

bool MechanicalSystem::IsStatus(const std::string& status) const { return modes_->IsStatus(status); }

std::string MechanicalSystem::ValidateAt(std::span<const double> x, std::span<const double> p) const {
  const int n = functions().layout().num_coordinates;
  Eigen::MatrixXd mass(n, n);
  functions().Mass(x.data(), p.data(), mass.data());
  if (std::string wrong = DescribeAsymmetry(mass, functions().layout()); !wrong.empty()) return wrong;
  if (!mass.allFinite() || mass.llt().info() != Eigen::Success) {
    return "mass: found a matrix that is not positive definite at the initial state, expected one that is";
  }
  for (int i = 0; i < functions().layout().num_contacts; ++i) {
    const std::string contact = "contact '" + modes_->ContactName(i) + "': ";
    const double e = functions().Restitution(i, p.data()), mu = functions().Friction(i, p.data());
    if (IsConstant(functions(), i, x.data(), p.data())) {
      return contact +
             "found a gap that depends on no coordinate, expected one that does; a contact acts along its gradient";
    }
    if (!(e >= 0 && e <= 1)) return contact + "found a restitution of " + ToText(e, 6) + ", expected 0 to 1";
    if (!(mu >= 0) || std::isinf(mu)) {
      return contact + "found a friction coefficient of " + ToText(mu, 6) + ", expected a finite number >= 0";
    }
  }
  return "";
}

MechanicalSystem::Start MechanicalSystem::FindMode(std::span<const double> x, std::span<const double> u,
                                                   std::span<const double> p, double t) const {
  const MechanicalHybrid::Point at = modes_->PointAt(t, x.data(), u.data(), p.data());
  Start start{.mode = -1, .reason = ValidateAt(x, p)};
  if (!start.reason.empty()) return start;
  const MechanicalHybrid::Closing closing = modes_->Touching(at, &start.reason);
  if (!start.reason.empty()) return start;
  const std::string status =
      modes_->Close(std::string(functions().layout().num_contacts, 'o'), closing, at, &start.reason);
  if (start.reason.empty()) start.mode = modes_->ModeOf(status);
  return start;
}

std::vector<ContactForces> MechanicalSystem::ClosedContacts(std::span<const double> x, std::span<const double> u,
                                                            std::span<const double> p, double t) const {
  const MechanicalHybrid::Point at = modes_->PointAt(t, x.data(), u.data(), p.data());
  std::string why;
  const MechanicalHybrid::Closing closing = modes_->Touching(at, &why);
  const int count = functions().layout().num_contacts;
  std::vector<ContactForces> all;
  if (closing.contacts.empty()) {
    all.push_back({std::string(count, 'o'), std::vector<double>(count), std::vector<double>(count)});
    return all;
  }
  for (const ContactSolution& solution : modes_->SolveAccelerations(closing, at)) {
    ContactForces forces{std::string(count, 'o'), std::vector<double>(count), std::vector<double>(count)};
    for (std::size_t i = 0; i < closing.contacts.size(); ++i) {
      const int contact = closing.contacts[i];
      forces.status[contact] = solution.status[i];
      forces.normal[contact] = solution.force[2 * static_cast<Eigen::Index>(i)];
      forces.tangential[contact] = solution.force[2 * static_cast<Eigen::Index>(i) + 1];
    }
    all.push_back(std::move(forces));
  }
  return all;
}

MechanicalSystem::Motion MechanicalSystem::MotionIn(int mode, std::span<const double> x, std::span<const double> u,
                                                    std::span<const double> p, double t) const {
  const MechanicalHybrid::Point at = modes_->PointAt(t, x.data(), u.data(), p.data());
  const MechanicalHybrid::Mode& of = modes_->ModeAt(mode);
  const MechanicalHybrid::ClosedMotion found = modes_->ForcedMotion(of, at);
  const Eigen::VectorXd &a = found.a, &force = found.force;
  Motion motion;
  motion.acceleration.assign(a.data(), a.data() + a.size());
  motion.normal.assign(of.status.size(), 0.0);
  motion.tangential.assign(of.status.size(), 0.0);
  auto sticking = static_cast<Eigen::Index>(of.closed.size());
  for (std::size_t i = 0; i < of.closed.size(); ++i) {
    const ClosedContact& contact = of.closed[i];
    const double normal = motion.normal[contact.contact] = force[static_cast<Eigen::Index>(i)];
    if (contact.status == 's') {
      motion.tangential[contact.contact] = force[sticking++];
    } else if (contact.status != 'n') {
      motion.tangential[contact.contact] =
          -SlidingSign(contact.status) * functions().Friction(contact.contact, p.data()) * normal;
    }
  }
  return motion;
}

MechanicalImpact MechanicalSystem::ImpactAt(int mode, int contact, std::span<const double> x, std::span<const double> u,
                                            std::span<const double> p, double t) const {
  const MechanicalHybrid::Mode& of = modes_->ModeAt(mode);
  const MechanicalHybrid::ProjectedPoint on = modes_->Projected(of, modes_->PointAt(t, x.data(), u.data(), p.data()));
  const MechanicalHybrid::Point& at = on.at;
  const MechanicalHybrid::Impact hit = modes_->SolveImpact(of, contact, at);
  MechanicalImpact impact;
  impact.time = t;
  if (hit.v_plus.size() == 0) return impact;
  const Eigen::VectorXd after = hit.VelocityAfter();
  impact.ends_bouncing = hit.ends_bouncing;
  if (hit.ends_bouncing) impact.accumulates_at = t;
  int hits = 0;
  ContactProblem problem{.W = hit.W, .given = hit.before, .friction = {}, .has_friction = {}, .sliding = {}};
  std::vector<double> restitution;
  for (std::size_t i = 0; i < hit.contacts.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(2 * i);
    const char status = hit.status[i] == 'P'   ? '+'
                        : hit.status[i] == 'M' ? '-'
                        : hit.status[i] == 'S' ? 's'
                                               : hit.status[i];
    impact.contacts.push_back({hit.contacts[i],
                               status,
                               hit.before[row],
                               after[row],
                               hit.before[row + 1],
                               after[row + 1],
                               hit.impulse[row],
                               hit.impulse[row + 1]});
    hits += hit.hits[i] != 0 ? 1 : 0;
    if (hit.ends_bouncing && hit.hits[i] != 0) {
      // The time of the bounces, 2 v / (|a_n| (1 - e)), after the impact that leaves v.
      MechanicalHybrid::Point then = at;
      then.v = hit.v_plus.data();
      const MechanicalEquations& equations = modes_->equations();
      const Eigen::VectorXd a = equations.Assemble({}, then).mass.Solve(equations.Force(then));
      const double falls = -equations.SecondAlong({hit.contacts[i], false}, then.q, then.v, a.data(), then.p);
      const double e = functions().Restitution(hit.contacts[i], p.data());
      if (falls > 0) {
        impact.accumulates_at = std::max(impact.accumulates_at, t - 2 * e * hit.before[row] / (falls * (1 - e)));
      }
    }
    problem.friction.push_back(functions().Friction(hit.contacts[i], p.data()));
    problem.has_friction.push_back(functions().layout().has_friction[hit.contacts[i]]);
    restitution.push_back(hit.hits[i] != 0 ? functions().Restitution(hit.contacts[i], p.data()) : 0.0);
  }
  impact.energy = 0.5 * hit.impulse.dot(hit.before + after);
  impact.simultaneous = hits > 1;
  if (!impact.simultaneous) return impact;
  const auto after_impulse = [&](const Eigen::VectorXd& impulse) {
    const Eigen::VectorXd v_plus = modes_->Moved(hit.contacts, impulse, at);
    return std::vector<double>(v_plus.data(), v_plus.data() + v_plus.size());
  };
  impact.v_simultaneous = after_impulse(hit.impulse);
  if (problem.size() != 2) return impact;
  impact.v_first_then_second = after_impulse(SequentialImpulses(problem, restitution, 0));
  impact.v_second_then_first = after_impulse(SequentialImpulses(problem, restitution, 1));
  impact.coupling = std::abs(hit.W(0, 2)) / std::sqrt(hit.W(0, 0) * hit.W(2, 2));
  return impact;
}

MechanicalReport MechanicalSystem::Examine(const HybridSimulator& simulator, const HybridInput& input) const {
  MechanicalReport report;
  report.slowest_impact = std::numeric_limits<double>::infinity();
  const int n = functions().layout().num_coordinates, num_controls = functions().layout().num_controls;
  const std::vector<double> zeros(num_controls, 0.0);
  for (const HybridEvent& event : simulator.events()) {
    const MechanicalHybrid::GuardId& guarded = modes_->ModeAt(event.mode).guards[event.guard];
    if (guarded.kind != MechanicalHybrid::GuardId::Kind::kHit) continue;
    const int interval =
        std::clamp(static_cast<int>(event.time / input.duration * input.num_intervals), 0, input.num_intervals - 1);
    std::span<const double> u = zeros;
    if (!input.control.empty()) u = std::span(input.control).subspan(interval * num_controls, num_controls);
    const auto number = static_cast<int>(report.impacts.size());
    report.impacts.push_back(ImpactAt(event.mode, guarded.contact, event.before, u, input.parameters, event.time));
    const MechanicalImpact& impact = report.impacts.back();
    for (const MechanicalImpact::Contact& contact : impact.contacts) {
      if (modes_->ModeAt(event.mode).status[contact.contact] != 'o') continue;
      report.slowest_impact = std::min(report.slowest_impact, std::abs(contact.normal_before));
    }
    Eigen::MatrixXd mass(n, n);
    functions().Mass(event.before.data(), input.parameters.data(), mass.data());
    const Eigen::Map<const Eigen::VectorXd> v(event.before.data() + n, n);
    report.largest_gain = std::max(report.largest_gain, impact.energy);
    if (impact.energy > kGain * 0.5 * v.dot(mass * v)) report.energy_gains.push_back(number);
    if (impact.ends_bouncing) report.accumulations.push_back(number);
  }
  return report;
}

}  // namespace saltus
