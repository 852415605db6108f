#include "hybrid/mechanical/mechanical_hybrid.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <mutex>
#include <numeric>
#include <optional>
#include <utility>

#include "base/linear_algebra.h"
#include "base/number_text.h"

namespace saltus {
namespace {

constexpr double kAtZero = 1e-11;     // of a gap that another contact's impact finds at zero, of the size of its terms
constexpr double kTouches = 1e-9;     // of gaps and speeds at the start, likewise
constexpr double kUncoupled = 1e-12;  // |W_ij| / sqrt(W_ii W_jj) that is rounding
constexpr double kRests = 1e-10;      // speeds that are zero, of the size of their terms
constexpr double kMostHeld = 10;      // speeds of contacts that close together, of rest_speed
constexpr double kStill = 1e-6;       // likewise: speeds that need no impulse
constexpr double kNearly = 1e-9;      // distance to another branch of an impact that is none, relative
constexpr double kPast = 1e6;         // of the tolerance of a force: where it is looked at past its limit

constexpr std::size_t kWidth = MechanicalEquations::kWidth;

using Kind = MechanicalHybrid::GuardId::Kind;

HybridLayout LayoutOf(const MechanicalLayout& mechanical) {
  HybridLayout layout{.num_controls = mechanical.num_controls, .num_parameters = mechanical.num_parameters};
  layout.state_sizes = {2 * mechanical.num_coordinates};
  layout.num_guards = {std::max(4 * mechanical.num_contacts, 1)};
  for (const std::string& name : mechanical.coordinate_names) layout.state_names.push_back(name);
  for (const std::string& name : mechanical.coordinate_names) layout.state_names.push_back("d" + name);
  layout.control_names = mechanical.control_names;
  layout.parameter_names = mechanical.parameter_names;
  return layout;
}

std::string Text(double value) { return ToText(value, 6); }

std::string TooLarge(std::size_t contacts) {
  return "too many contacts: the forces of " + std::to_string(contacts) +
         " that touch at once are a complementarity problem beyond the largest that is solved; use fewer bodies, or "
         "let them touch less";
}

// Returns the groups of contacts that are coupled by W.
std::vector<std::vector<int>> GroupsOf(const Eigen::MatrixXd& W) {
  const int k = static_cast<int>(W.rows()) / 2;
  std::vector<int> group(k);
  std::iota(group.begin(), group.end(), 0);
  for (int i = 0; i < k; ++i) {
    for (int j = 0; j < i; ++j) {
      bool coupled = false;
      for (int a = 0; a < 2; ++a) {
        for (int b = 0; b < 2; ++b) {
          const int row = 2 * i + a, column = 2 * j + b;
          coupled = coupled || std::abs(W(row, column)) > kUncoupled * std::sqrt(W(row, row) * W(column, column));
        }
      }
      if (!coupled || group[i] == group[j]) continue;
      std::replace(group.begin(), group.end(), group[i], group[j]);
    }
  }
  std::vector<std::vector<int>> groups;
  for (int number = 0; number < k; ++number) {
    std::vector<int> members;
    for (int i = 0; i < k; ++i) {
      if (group[i] == number) members.push_back(i);
    }
    if (!members.empty()) groups.push_back(std::move(members));
  }
  return groups;
}

// The problem of some of the contacts.
ContactProblem Restricted(const ContactProblem& problem, const std::vector<int>& members) {
  const auto k = static_cast<Eigen::Index>(members.size());
  ContactProblem out;
  out.W.resize(2 * k, 2 * k);
  out.given.resize(2 * k);
  out.terms.resize(2 * k);
  for (Eigen::Index i = 0; i < k; ++i) {
    for (Eigen::Index j = 0; j < k; ++j) {
      out.W.block<2, 2>(2 * i, 2 * j) = problem.W.block<2, 2>(2 * members[i], 2 * members[j]);
    }
    out.given.segment<2>(2 * i) = problem.given.segment<2>(2 * members[i]);
    out.terms.segment<2>(2 * i) = problem.terms.segment<2>(2 * members[i]);
    out.friction.push_back(problem.friction[members[i]]);
    out.has_friction.push_back(problem.has_friction[members[i]]);
    out.sliding.push_back(problem.sliding[members[i]]);
    if (!problem.floor.empty()) out.floor.push_back(problem.floor[members[i]]);
  }
  return out;
}

std::vector<ClosedContact> ClosedIn(const std::string& status) {
  std::vector<ClosedContact> closed;
  for (std::size_t i = 0; i < status.size(); ++i) {
    if (status[i] != 'o') closed.push_back({static_cast<int>(i), status[i]});
  }
  return closed;
}

std::vector<char> FrictionOf(const MechanicalLayout& layout, const std::vector<char>& smooth) {
  std::vector<char> has(layout.has_friction.begin(), layout.has_friction.end());
  for (std::size_t i = 0; i < smooth.size(); ++i) {
    if (smooth[i] != 0) has[i] = 0;
  }
  return has;
}

}  // namespace

MechanicalHybrid::MechanicalHybrid(std::shared_ptr<const MechanicalFunctions> functions, MechanicalOptions options,
                                   std::vector<char> smooth)
    : HybridFunctions(LayoutOf(functions->layout())),
      functions_(std::move(functions)),
      options_(options),
      equations_(*functions_),
      no_control_(functions_->layout().num_controls, 0.0),
      has_friction_(FrictionOf(functions_->layout(), smooth)) {
  ModeOf(std::string(functions_->layout().num_contacts, 'o'));
}

// ---------------------------------------------------------------------------------------------------------------------
// Modes.

int MechanicalHybrid::num_modes() const {
  std::shared_lock lock(mutex_);
  return static_cast<int>(modes_.size());
}

const MechanicalHybrid::Mode& MechanicalHybrid::ModeAt(int mode) const {
  std::shared_lock lock(mutex_);
  return modes_[mode];
}

bool MechanicalHybrid::IsStatus(const std::string& status) const {
  if (static_cast<int>(status.size()) != functions_->layout().num_contacts) return false;
  for (std::size_t i = 0; i < status.size(); ++i) {
    const std::string can = HasFriction(static_cast<int>(i)) ? "on+-s" : "on";
    if (can.find(status[i]) == std::string::npos) return false;
  }
  return true;
}

int MechanicalHybrid::ModeOf(const std::string& status) const {
  {
    std::shared_lock lock(mutex_);
    if (const auto found = known_.find(status); found != known_.end()) return found->second;
  }
  CHECK(IsStatus(status)) << "no contacts of this system have the status '" << status << "'";
  Mode mode{.status = status, .closed = ClosedIn(status), .guards = {}};
  for (int i = 0; i < static_cast<int>(status.size()); ++i) {
    const std::vector<char>& has_reach = functions_->layout().has_reach;
    if (status[i] != 'o' && !has_reach.empty() && has_reach[i] != 0) mode.guards.push_back({Kind::kEnd, i});
    switch (status[i]) {
      case 'o':
        mode.guards.push_back({Kind::kHit, i});
        break;
      case 's':
        mode.guards.push_back({Kind::kOff, i});
        mode.guards.push_back({Kind::kBreakBack, i});
        mode.guards.push_back({Kind::kBreakOn, i});
        break;
      default:
        mode.guards.push_back({Kind::kOff, i});
        if (status[i] == 'n') {
          if (HasFriction(i)) mode.guards.push_back({Kind::kGrip, i});
          break;
        }
        mode.guards.push_back({Kind::kStop, i});
        mode.guards.push_back({Kind::kJam, i});
    }
  }
  std::unique_lock lock(mutex_);
  const auto [place, is_new] = known_.emplace(status, static_cast<int>(modes_.size()));
  if (is_new) modes_.push_back(std::move(mode));
  return place->second;
}

std::shared_ptr<const HybridFunctions> MechanicalHybrid::RemoveIdleEvents(const double* p,
                                                                          std::span<const int> free) const {
  const MechanicalLayout& layout = functions_->layout();
  const auto depends = [&](int contact, int parameter) {
    std::vector<Jet> of(p, p + layout.num_parameters);
    of[parameter].v[0] = 1;
    return !(functions_->Friction(contact, of.data()).v[0] == 0);
  };
  std::vector<char> smooth(layout.num_contacts);
  for (int i = 0; i < layout.num_contacts; ++i) {
    smooth[i] = HasFriction(i) && !CanStick(i, p) && std::ranges::none_of(free, [&](int j) { return depends(i, j); });
  }
  if (std::ranges::count(smooth, 1) == 0) return nullptr;
  return std::make_shared<MechanicalHybrid>(functions_, options_, std::move(smooth));
}

int MechanicalHybrid::EquivalentMode(const std::string& name) const {
  std::string status = name;
  for (std::size_t i = 0; i < status.size(); ++i) {
    if (status[i] != 'o' && !HasFriction(static_cast<int>(i))) status[i] = 'n';
  }
  return ModeOf(status);
}

std::string MechanicalHybrid::ContactName(int contact) const {
  const std::vector<std::string>& names = functions_->layout().contact_names;
  return names.empty() ? "contact " + std::to_string(contact) : names[contact];
}

std::string MechanicalHybrid::GuardName(int mode, int guard) const {
  constexpr const char* kNames[] = {"hit", "off", "stop", "break-", "break+", "end", "jam", "grip"};
  const GuardId& guarded = ModeAt(mode).guards[guard];
  return kNames[static_cast<int>(guarded.kind)] + (" " + ContactName(guarded.contact));
}

// ---------------------------------------------------------------------------------------------------------------------
// Problems of contacts.

ContactProblem MechanicalHybrid::ProblemOf(const std::vector<int>& contacts, const Point& at) const {
  ContactProblem problem;
  const auto k = static_cast<Eigen::Index>(contacts.size());
  const int n = equations_.n();
  Eigen::MatrixXd rows = Eigen::MatrixXd::Zero(2 * k, n);
  for (Eigen::Index i = 0; i < k; ++i) {
    rows.row(2 * i) = equations_.RowAt({contacts[i], false}, at);
    const bool frictional = HasFriction(contacts[i]);
    if (frictional) rows.row(2 * i + 1) = equations_.RowAt({contacts[i], true}, at);
    problem.friction.push_back(frictional ? functions_->Friction(contacts[i], at.p) : 0.0);
    problem.has_friction.push_back(frictional);
    problem.sliding.push_back(0);
  }
  const MechanicalEquations::System system = equations_.Assemble({}, at);
  problem.W = Multiply(rows, system.mass.Solve(rows.transpose()));
  const Eigen::Map<const Eigen::VectorXd> v(at.v, n);
  problem.given = rows * v;
  problem.terms = rows.cwiseAbs() * v.cwiseAbs();
  return problem;
}

std::vector<ContactSolution> MechanicalHybrid::SolveAccelerations(const Closing& closing, const Point& at) const {
  const auto k = static_cast<Eigen::Index>(closing.contacts.size());
  ContactProblem problem = ProblemOf(closing.contacts, at);
  problem.sliding = closing.sliding;
  const MechanicalEquations::System system = equations_.Assemble({}, at);
  const Eigen::VectorXd a = system.mass.Solve(equations_.Force(at));
  for (Eigen::Index i = 0; i < 2 * k; ++i) {
    const MechanicalEquations::Row row{closing.contacts[i / 2], i % 2 == 1};
    if (row.tangential && !problem.has_friction[i / 2]) continue;
    problem.given[i] = equations_.SecondAlong(row, at.q, at.v, a.data(), at.p);
    problem.terms[i] = equations_.RowAt(row, at).cwiseAbs().dot(a.cwiseAbs());
  }
  std::vector<ContactSolution> all = {{std::string(closing.contacts.size(), 'o'), Eigen::VectorXd::Zero(2 * k)}};
  for (const std::vector<int>& group : GroupsOf(problem.W)) {
    std::vector<ContactSolution> joined;
    for (const ContactSolution& solution : SolveContactProblem(Restricted(problem, group))) {
      for (ContactSolution other : all) {
        for (std::size_t i = 0; i < group.size(); ++i) {
          other.status[group[i]] = solution.status[i];
          other.force.segment<2>(2 * group[i]) = solution.force.segment<2>(2 * static_cast<Eigen::Index>(i));
        }
        joined.push_back(std::move(other));
      }
    }
    all = std::move(joined);
  }
  return all;
}

std::string MechanicalHybrid::Close(const std::string& before, const Closing& closing, const Point& at,
                                    std::string* why) const {
  std::string status = before;
  if (closing.contacts.empty()) return status;
  const std::vector<ContactSolution> all = SolveAccelerations(closing, at);
  if (all.size() == 1) {
    for (std::size_t i = 0; i < closing.contacts.size(); ++i) status[closing.contacts[i]] = all[0].status[i];
    return status;
  }
  if (all.empty() && IsTooLarge(ProblemOf(closing.contacts, at))) {
    *why = TooLarge(closing.contacts.size());
    return "";
  }
  if (all.empty() && closing.contacts.size() > kMostTriedContacts) {
    *why = "no accelerations were found that satisfy the conditions of the " + std::to_string(closing.contacts.size()) +
           " contacts that touch: the search may fail where forces are not unique. Use fewer bodies, or let them touch "
           "less";
    return "";
  }
  *why = all.empty() ? "painleve_inconsistent: no accelerations satisfy the conditions of "
                     : "painleve_indeterminate: " + std::to_string(all.size()) + " accelerations satisfy those of ";
  for (std::size_t i = 0; i < closing.contacts.size(); ++i) {
    *why += (i > 0 ? ", '" : "'") + ContactName(closing.contacts[i]) + "'";
  }
  if (closing.contacts.size() == 1 && closing.sliding[0] != 0) {
    const ClosedContact contact{closing.contacts[0], closing.sliding[0] > 0 ? '+' : '-'};
    const MechanicalEquations::System system = equations_.Assemble({contact}, at);
    const Eigen::VectorXd a = equations_.Assemble({}, at).mass.Solve(equations_.Force(at));
    *why += "; A = " + Text((system.G * system.mobile_F)(0, 0)) +
            ", b = " + Text(equations_.SecondAlong({contact.contact, false}, at.q, at.v, a.data(), at.p));
  }
  for (const ContactSolution& solution : all) {
    *why += "; '" + solution.status + "' with normal force";
    for (Eigen::Index i = 0; i < solution.force.size(); i += 2) *why += " " + Text(solution.force[i]);
  }
  return "";
}

MechanicalHybrid::Closing MechanicalHybrid::Touching(const Point& at, std::string* why) const {
  Closing closing;
  const Eigen::Map<const Eigen::RowVectorXd> v(at.v, equations_.n());
  for (int i = 0; i < functions_->layout().num_contacts; ++i) {
    const double gap = equations_.Gap(i, at), at_zero = kTouches * equations_.GapScale(i, at);
    if (gap > at_zero) continue;
    if (gap < -at_zero) {
      *why = "contact '" + ContactName(i) + "' penetrates, its gap is " + Text(gap);
      continue;
    }
    const Eigen::RowVectorXd normal = equations_.RowAt({i, false}, at);
    if (std::abs(normal.dot(v)) > kTouches * normal.cwiseAbs().dot(v.cwiseAbs())) continue;
    closing.contacts.push_back(i);
    closing.sliding.push_back(HasFriction(i) ? SlipSign(i, at, kTouches) : 0);
  }
  return closing;
}

int MechanicalHybrid::SlipSign(int contact, const Point& at, double zero) const {
  const Eigen::Map<const Eigen::RowVectorXd> v(at.v, equations_.n());
  const Eigen::RowVectorXd tangent = equations_.RowAt({contact, true}, at);
  const double speed = tangent.dot(v);
  if (std::abs(speed) <= zero * tangent.cwiseAbs().dot(v.cwiseAbs())) return 0;
  return speed > 0 ? 1 : -1;
}

MechanicalHybrid::Closing MechanicalHybrid::ClosedOf(const Mode& mode, const Point& at) const {
  Closing closing;
  for (const auto& [contact, status] : mode.closed) {
    closing.contacts.push_back(contact);
    closing.sliding.push_back(status == 'n' && HasFriction(contact) ? SlipSign(contact, at, kTouches)
                                                                    : SlidingSign(status));
  }
  return closing;
}

// ---------------------------------------------------------------------------------------------------------------------
// Impacts.

MechanicalHybrid::Impact MechanicalHybrid::SolveImpact(const Mode& mode, int contact, const Point& at) const {
  Impact impact = SolveImpactWith(mode, contact, at, Restitution::kOwn);
  if (!impact.why.empty()) return impact;
  // Checks for bounces that accumulate.
  bool fast = false;
  std::vector<char> slow(impact.contacts.size());
  const Eigen::VectorXd after = impact.VelocityAfter();
  for (std::size_t i = 0; i < impact.contacts.size(); ++i) {
    // One that the impact of another opens, as where a body rocks, is slow as well.
    if (impact.next[impact.contacts[i]] != 'o') continue;
    const double speed = after[2 * static_cast<Eigen::Index>(i)];
    slow[i] = speed > 0 && speed < options_.rest_speed;
    fast = fast || (impact.rebounds[i] && !slow[i]);
  }
  if (fast || std::ranges::count(slow, 1) == 0) return impact;
  // Where contacts are hit in turn, an impact of one parts the others: all of them close together.
  for (const Restitution restitution : {Restitution::kNone, Restitution::kNoneAndHeld}) {
    Impact plastic = SolveImpactWith(mode, contact, at, restitution);
    if (!plastic.why.empty()) continue;
    bool closes = true;
    for (std::size_t i = 0; closes && i < impact.contacts.size(); ++i) {
      if (slow[i]) closes = plastic.next[impact.contacts[i]] != 'o';
    }
    // No contact is left that separates too slowly.
    const Eigen::VectorXd then = plastic.VelocityAfter();
    for (std::size_t i = 0; closes && restitution == Restitution::kNone && i < plastic.contacts.size(); ++i) {
      const double speed = then[2 * static_cast<Eigen::Index>(i)];
      closes = plastic.next[plastic.contacts[i]] != 'o' || speed <= 0 || speed >= options_.rest_speed;
    }
    if (!closes) continue;
    plastic.ends_bouncing = true;
    return plastic;
  }
  return impact;
}

Eigen::VectorXd MechanicalHybrid::Moved(const std::vector<int>& contacts, const Eigen::VectorXd& impulse,
                                        const Point& at) const {
  const int n = equations_.n();
  Eigen::VectorXd momentum = Eigen::VectorXd::Zero(n);
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(2 * i);
    momentum += impulse[row] * equations_.RowAt({contacts[i], false}, at).transpose();
    if (HasFriction(contacts[i])) {
      momentum += impulse[row + 1] * equations_.RowAt({contacts[i], true}, at).transpose();
    }
  }
  const Eigen::VectorXd change = equations_.Assemble({}, at).mass.Solve(momentum);
  Eigen::VectorXd v = Eigen::Map<const Eigen::VectorXd>(at.v, n);
  AddChange(change, change.cwiseAbs(), v);
  return v;
}

MechanicalHybrid::Impact MechanicalHybrid::SolveImpactWith(const Mode& mode, int contact, const Point& at,
                                                           Restitution law) const {
  const bool plastic = law != Restitution::kOwn;
  // Candidates are the contacts that are closed, and those that hit as well.
  std::vector<int> candidates = {contact};
  for (int i = 0; i < functions_->layout().num_contacts; ++i) {
    if (i == contact) continue;
    if (mode.status[i] == 'o') {
      if (std::abs(equations_.Gap(i, at)) > kAtZero * equations_.GapScale(i, at)) continue;
      // Where bounces accumulate, contacts that part too slowly to leave close as well.
      if (!(equations_.RateAlong({i, false}, at.q, at.v, at.p) < (plastic ? options_.rest_speed : 0))) continue;
    }
    candidates.push_back(i);
  }
  std::sort(candidates.begin(), candidates.end());
  ContactProblem problem = ProblemOf(candidates, at);
  Impact impact;
  std::vector<int> members;
  for (const std::vector<int>& group : GroupsOf(problem.W)) {
    const bool hit = std::any_of(group.begin(), group.end(), [&](int i) { return candidates[i] == contact; });
    if (hit) members = group;
  }
  for (const int member : members) impact.contacts.push_back(candidates[member]);
  problem = Restricted(problem, members);
  const auto k = static_cast<Eigen::Index>(members.size());
  impact.W = problem.W;
  impact.before = problem.given;
  std::vector<double> restitution;
  for (Eigen::Index i = 0; i < k; ++i) {
    const bool hits = mode.status[impact.contacts[i]] == 'o';
    impact.hits.push_back(hits);
    impact.restores.push_back(hits && !plastic);
    restitution.push_back(hits && !plastic ? functions_->Restitution(impact.contacts[i], at.p) : 0.0);
  }
  const bool poisson = options_.law == MechanicalOptions::Law::kPoisson;
  if (!poisson) {
    for (Eigen::Index i = 0; i < k; ++i) problem.given[2 * i] *= 1 + restitution[i];
  }
  std::vector<ContactSolution> solutions;
  if (law == Restitution::kNoneAndHeld) {
    const double slow = kMostHeld * options_.rest_speed;
    if (!(impact.before(Eigen::seq(0, Eigen::last, 2)).cwiseAbs().maxCoeff() < slow)) {
      impact.why = "faster than what is held";
      return impact;
    }
    std::vector<char> sticks;
    for (Eigen::Index i = 0; i < k; ++i) {
      sticks.push_back(CanStick(impact.contacts[i], at.p) && std::abs(impact.before[2 * i + 1]) < slow);
    }
    std::optional<ContactSolution> held = HoldContacts(problem, sticks, kStill * options_.rest_speed);
    if (held) solutions.push_back(std::move(*held));
    impact.held = true;
  } else {
    solutions = SolveContactProblem(problem);
  }
  const auto refuse = [&]() {
    if (solutions.empty() && IsTooLarge(problem)) {
      impact.why = TooLarge(impact.contacts.size());
      return impact;
    }
    impact.why = solutions.empty() ? "no_solution: no impulses satisfy the law of impact of"
                                   : "several_solutions: impulses that differ satisfy the law of impact of";
    for (const int i : impact.contacts) impact.why += " '" + ContactName(i) + "'";
    for (const ContactSolution& solution : solutions) impact.why += "; '" + solution.status + "'";
    return impact;
  };
  if (solutions.size() != 1) return refuse();
  impact.status = solutions[0].status;
  impact.impulse = solutions[0].force;
  impact.v_plus = Moved(impact.contacts, impact.impulse, at);
  if (poisson && std::any_of(restitution.begin(), restitution.end(), [](double e) { return e > 0; })) {
    if (k > kMostTriedContacts) {
      impact.why =
          "Poisson's law is not supported for more than " + std::to_string(kMostTriedContacts) + " coupled contacts";
      return impact;
    }
    impact.compressed = impact.status;
    impact.compression = impact.impulse;
    impact.v_compressed = impact.v_plus;
    problem.given = impact.before + impact.W * impact.compression;
    for (Eigen::Index i = 0; i < k; ++i) problem.floor.push_back(restitution[i] * impact.compression[2 * i]);
    solutions = SolveContactProblem(problem);
    if (solutions.size() != 1) return refuse();
    impact.status = solutions[0].status;
    impact.impulse += solutions[0].force;
    impact.v_plus = Moved(impact.contacts, impact.impulse, at);
  }
  // Finds the contacts that close.
  impact.next = mode.status;
  const Eigen::VectorXd after = impact.VelocityAfter();
  Closing closing;
  std::vector<char> takes_part(mode.status.size(), 0);
  for (Eigen::Index i = 0; i < k; ++i) {
    const int number = impact.contacts[i];
    takes_part[number] = 1;
    impact.next[number] = 'o';
    const double speed = impact.W.row(2 * i).cwiseAbs().dot(impact.impulse.cwiseAbs()) +
                         equations_.RowAt({number, false}, at).cwiseAbs().dot(impact.v_plus.cwiseAbs().transpose());
    // One that touches without speed, as where a box slides onto a flush table, does not rebound.
    const bool parts = after[2 * i] > kRests * speed;
    impact.rebounds.push_back(restitution[i] > 0 && impact.status[i] != 'o' && parts);
    if (impact.status[i] == 'o' ? parts : impact.rebounds[i] != 0) continue;
    closing.contacts.push_back(number);
    int sign = SlidingSign(impact.status[i]);
    if ((impact.status[i] == 'o' || impact.status[i] == 'n') && problem.has_friction[i]) {
      const double slip = after[2 * i + 1];
      const double size = impact.W.row(2 * i + 1).cwiseAbs().dot(impact.impulse.cwiseAbs()) + problem.terms[2 * i + 1];
      sign = std::abs(slip) <= kRests * size ? 0 : slip > 0 ? 1 : -1;
    }
    closing.sliding.push_back(sign);
  }
  const Closing closed = ClosedOf(mode, at);
  for (std::size_t i = 0; i < closed.contacts.size(); ++i) {
    if (takes_part[closed.contacts[i]] != 0) continue;
    closing.contacts.push_back(closed.contacts[i]);
    closing.sliding.push_back(closed.sliding[i]);
  }
  Point then = at;
  then.v = impact.v_plus.data();
  impact.next = Close(impact.next, closing, then, &impact.why);
  return impact;
}

// ---------------------------------------------------------------------------------------------------------------------
// The functions of a hybrid system.

void MechanicalHybrid::Flow(const ModePoint& from, double* xdot) const {
  const Point at = PointAt(from);
  const ClosedMotion motion = MotionOf(ModeAt(from.mode), at);
  const int n = equations_.n();
  std::copy_n(at.v, n, xdot);
  std::copy_n(motion.a.data(), n, xdot + n);
}

void MechanicalHybrid::FlowJacobian(const ModePoint& from, double* xdot, double* jacobian) const {
  const Point at = PointAt(from);
  const Mode& of = ModeAt(from.mode);
  const int n = equations_.n(), all = equations_.num_columns(true);
  const std::vector<int> columns = equations_.Columns(from.by_parameters, true);
  const ClosedMotion motion = MotionOf(of, at, equations_.SeedColumns(at, columns));
  std::copy_n(at.v, n, xdot);
  std::copy_n(motion.a.data(), n, xdot + n);
  std::fill_n(jacobian, 2 * n * all, 0.0);
  for (int i = 0; i < n; ++i) jacobian[i * all + n + i] = 1;
  for (std::size_t k = 0; k < columns.size(); ++k) {
    const auto by = motion.derivatives[k / kWidth].motion.col(static_cast<Eigen::Index>(k % kWidth));
    for (int i = 0; i < n; ++i) jacobian[(n + i) * all + columns[k]] = by[i];
  }
}

bool MechanicalHybrid::NeedsForces(const GuardId& guarded) {
  return guarded.kind == Kind::kOff || guarded.kind == Kind::kBreakBack || guarded.kind == Kind::kBreakOn;
}

MechanicalHybrid::ClosedMotion MechanicalHybrid::MotionOf(const Mode& mode, const Point& at,
                                                          std::span<const MechanicalEquations::Seeds> passes) const {
  const MechanicalEquations::System system = equations_.Assemble(mode.closed, at, !passes.empty());
  ClosedMotion motion;
  equations_.Accelerate(system, at, &motion.a, &motion.force);
  for (const MechanicalEquations::Seeds& seeds : passes) {
    motion.derivatives.push_back(equations_.AccelerationDerivative(system, mode.closed, seeds, motion.a, motion.force));
  }
  return motion;
}

Eigen::MatrixXd MechanicalHybrid::StressesOf(const Eigen::MatrixXd& matrix) const {
  if (matrix.rows() <= kMostSmallRows) return InternalStresses(matrix);
  {
    const std::shared_lock lock(mutex_);
    const Eigen::MatrixXd& last = last_stresses_.first;
    if (last.rows() == matrix.rows() && last == matrix) return last_stresses_.second;
  }
  Eigen::MatrixXd stresses = InternalStresses(matrix);
  const std::unique_lock lock(mutex_);
  last_stresses_ = {matrix, stresses};
  return stresses;
}

MechanicalHybrid::ClosedMotion MechanicalHybrid::ForcedMotion(
    const Mode& mode, const Point& at, std::span<const MechanicalEquations::Seeds> passes) const {
  const MechanicalEquations::System system = equations_.Assemble(mode.closed, at, !passes.empty());
  ClosedMotion motion;
  Eigen::VectorXd terms;
  equations_.Accelerate(system, at, &motion.a, &motion.force, &terms);
  const Eigen::Index size = motion.force.size();
  motion.stresses.resize(size, 0);
  const Eigen::MatrixXd matrix = Multiply(system.G, system.mobile_F);
  ForceLimits limits;
  ForceSplit split;
  // Limits of the forces, and their derivatives by the seeds while the forces are held.
  std::vector<UnknownForces> unknown;
  Eigen::Index sticking = static_cast<Eigen::Index>(mode.closed.size());
  for (const ClosedContact& contact : mode.closed) {
    const bool sticks = contact.status == 's';
    unknown.push_back({.normal = static_cast<Eigen::Index>(unknown.size()),
                       .tangent = sticks ? sticking++ : -1,
                       .friction = sticks ? functions_->Friction(contact.contact, at.p) : 0.0});
  }
  if (mode.closed.size() > 1) motion.stresses = StressesOf(matrix);
  if (motion.stresses.cols() > 0) {
    limits = LimitsOf(unknown, size);
    split = SplitForces(motion.force, motion.stresses, unknown);
    motion.force = split.force;
  }
  motion.tolerance = ForceTolerances(matrix, motion.force, terms);
  if (!split.groups.empty()) motion.at_limit.resize(mode.closed.size());
  for (const ForceSplit::Group& group : split.groups) {
    const Eigen::Index limit = *std::ranges::max_element(group.tight);
    if (limit < 0) continue;
    const double smallest = limits.rows.row(limit).dot(motion.force);
    for (const std::size_t i : group.contacts) {
      motion.at_limit[i] = std::abs(smallest) <= motion.tolerance[static_cast<Eigen::Index>(i)];
    }
  }
  for (const MechanicalEquations::Seeds& seeds : passes) {
    motion.derivatives.push_back(equations_.AccelerationDerivative(system, mode.closed, seeds, motion.a, motion.force));
    if (split.groups.empty()) continue;
    Block by_limits = limits.rows * motion.derivatives.back().force;
    Eigen::Index row = 0;
    for (std::size_t i = 0; i < unknown.size(); ++i) {
      ++row;
      if (unknown[i].tangent < 0) continue;
      const Jet friction = functions_->Friction(mode.closed[i].contact, seeds.p.data());
      for (int side = 0; side < 2; ++side) {
        by_limits.row(row++) += motion.force[unknown[i].normal] * friction.v.transpose();
      }
    }
    for (const ForceSplit::Group& group : split.groups) {
      const auto count = static_cast<Eigen::Index>(group.tight.size());
      Eigen::MatrixXd right = Eigen::MatrixXd::Zero(count, by_limits.cols());
      for (Eigen::Index i = 0; i < count; ++i) {
        if (group.tight[i] >= 0) right.row(i) = -by_limits.row(group.tight[i]);
      }
      motion.derivatives.back().force +=
          motion.stresses(Eigen::all, group.stresses) * SolveLuColumns(group.by_stress, right).topRows(count - 1);
    }
  }
  return motion;
}

MechanicalHybrid::Jet MechanicalHybrid::GuardJet(const Mode& mode, const GuardId& guarded, const Point& at,
                                                 const MechanicalEquations::Seeds& seeds, const ClosedMotion& motion,
                                                 std::size_t pass) const {
  const int contact = guarded.contact;
  const auto force = [&](std::size_t row) {
    Jet jet(motion.force[static_cast<Eigen::Index>(row)]);
    if (!motion.derivatives.empty())
      jet.v = motion.derivatives[pass].force.row(static_cast<Eigen::Index>(row)).transpose();
    return jet;
  };
  // Rows of the contact among those of the closed ones.
  std::size_t normal = 0, tangential = mode.closed.size();
  for (std::size_t i = 0; i < mode.closed.size(); ++i) {
    if (mode.closed[i].contact == contact) {
      normal = i;
      break;
    }
    if (mode.closed[i].status == 's') ++tangential;
  }
  // A force that is at its limit up to rounding is at it, on both sides.
  const auto limit = [&](Jet left) {
    double tolerance = motion.tolerance[static_cast<Eigen::Index>(normal)];
    if (mode.status[contact] == 's') {
      tolerance = std::max(tolerance, motion.tolerance[static_cast<Eigen::Index>(tangential)]);
    }
    if (std::abs(left.a) <= tolerance || (!motion.at_limit.empty() && motion.at_limit[normal] != 0)) left.a = 0;
    return left;
  };
  switch (guarded.kind) {
    case Kind::kHit:
      return functions_->Gap(contact, seeds.q.data(), seeds.p.data());
    case Kind::kOff:
      return limit(force(normal));
    case Kind::kStop:
      return static_cast<double>(SlidingSign(mode.status[contact])) *
             equations_.RateAlong({contact, true}, seeds.q.data(), seeds.v.data(), seeds.p.data());
    case Kind::kEnd:
      return functions_->Reach(contact, seeds.q.data(), seeds.p.data());
    case Kind::kBreakBack:
      return limit(functions_->Friction(contact, seeds.p.data()) * force(normal) - force(tangential));
    case Kind::kBreakOn:
      return limit(functions_->Friction(contact, seeds.p.data()) * force(normal) + force(tangential));
    case Kind::kGrip:
      return -functions_->Friction(contact, seeds.p.data());
    default:
      return equations_.Pressability(mode.closed[normal], seeds, at);
  }
}

// Guards are evaluated, and resets begin, at the state that is on the equations of the mode: errors of the integration
// lead away from these within a step.
MechanicalHybrid::ProjectedPoint MechanicalHybrid::Projected(const Mode& mode, const Point& at,
                                                             std::span<const int> columns) const {
  ProjectedPoint on{.at = at, .x = {}, .passes = equations_.SeedColumns(at, columns)};
  if (mode.closed.empty()) return on;
  const int n = equations_.n();
  on.x.assign(at.q, at.q + n);
  on.x.insert(on.x.end(), at.v, at.v + n);
  equations_.Project(mode.closed, on.x.data(), on.x.data() + n, at.p, on.passes);
  on.at = PointAt(at.t, on.x.data(), at.u, at.p);
  return on;
}

double MechanicalHybrid::Guard(const ModePoint& from, int guard) const {
  const Mode& of = ModeAt(from.mode);
  const GuardId& guarded = of.guards[guard];
  const ProjectedPoint on = Projected(of, PointAt(from));
  if (guarded.kind == GuardId::Kind::kHit) return equations_.Gap(guarded.contact, on.at);
  ClosedMotion motion;
  if (NeedsForces(guarded)) motion = ForcedMotion(of, on.at);
  return GuardJet(of, guarded, on.at, equations_.UnseededPass(on.at), motion, 0).a;
}

GuardValue MechanicalHybrid::GuardAlong(const Mode& mode, const GuardId& guarded, const Point& at,
                                        const MechanicalEquations::TimePath<double>& path,
                                        const MechanicalEquations::Seeds& seeds, const ClosedMotion& motion) const {
  if (guarded.kind == GuardId::Kind::kHit) {
    return {equations_.Gap(guarded.contact, at), equations_.GapRate(guarded.contact, path)};
  }
  const Jet value = GuardJet(mode, guarded, at, seeds, motion, 0);
  return {value.a, value.v[0]};
}

double MechanicalHybrid::GuardRate(const ModePoint& from, int guard, const double* xdot, double* rate) const {
  const Mode& of = ModeAt(from.mode);
  const GuardId& guarded = of.guards[guard];
  const ProjectedPoint on = Projected(of, PointAt(from));
  MechanicalEquations::Seeds seeds;
  ClosedMotion motion;
  if (guarded.kind != GuardId::Kind::kHit) seeds = equations_.SeedDirection(on.at, xdot);
  if (NeedsForces(guarded)) motion = ForcedMotion(of, on.at, {&seeds, 1});
  const GuardValue found = GuardAlong(of, guarded, on.at, equations_.PathAlong(on.at.q, xdot, on.at.p), seeds, motion);
  *rate = found.rate;
  return found.value;
}

void MechanicalHybrid::GuardRates(const ModePoint& from, const double* xdot, GuardValue* all) const {
  const Mode& of = ModeAt(from.mode);
  const ProjectedPoint on = Projected(of, PointAt(from));
  MechanicalEquations::Seeds seeds;
  ClosedMotion motion;
  if (!of.closed.empty()) {
    seeds = equations_.SeedDirection(on.at, xdot);
    motion = ForcedMotion(of, on.at, {&seeds, 1});
  }
  const MechanicalEquations::TimePath<double> path = equations_.PathAlong(on.at.q, xdot, on.at.p);
  for (const GuardId& guarded : of.guards) *all++ = GuardAlong(of, guarded, on.at, path, seeds, motion);
}

double MechanicalHybrid::GuardGradient(const ModePoint& from, int guard, double* gradient) const {
  const Mode& of = ModeAt(from.mode);
  double value = 0;
  GuardGradients(of, {&of.guards[guard], 1}, from, &value, gradient);
  return value;
}

void MechanicalHybrid::GuardGradients(const ModePoint& from, double* values, double* gradients) const {
  const Mode& of = ModeAt(from.mode);
  GuardGradients(of, of.guards, from, values, gradients);
}

void MechanicalHybrid::GuardGradients(const Mode& mode, std::span<const GuardId> guards, const ModePoint& from,
                                      double* values, double* gradients) const {
  const int all = equations_.num_columns(true);
  std::fill_n(gradients, guards.size() * all, 0.0);
  const Point at = PointAt(from);
  if (mode.closed.empty()) {
    // All guards are gaps, which depend on q and p only.
    for (const GuardId& guarded : guards) {
      double* by_p = from.by_parameters ? gradients + 2 * equations_.n() + 1 : nullptr;
      *values++ = equations_.GapGradient(guarded.contact, at, gradients, by_p);
      gradients += all;
    }
    return;
  }
  const std::vector<int> columns = equations_.Columns(from.by_parameters, true);
  const ProjectedPoint on = Projected(mode, at, columns);
  ClosedMotion motion;
  if (std::any_of(guards.begin(), guards.end(), NeedsForces)) motion = ForcedMotion(mode, on.at, on.passes);
  for (std::size_t pass = 0; pass < on.passes.size(); ++pass) {
    const auto of_pass = std::span(columns).subspan(pass * kWidth);
    for (std::size_t guard = 0; guard < guards.size(); ++guard) {
      const Jet jet = GuardJet(mode, guards[guard], on.at, on.passes[pass], motion, pass);
      values[guard] = jet.a;
      for (std::size_t j = 0; j < std::min(kWidth, of_pass.size()); ++j) {
        gradients[guard * all + of_pass[j]] = jet.v[static_cast<Eigen::Index>(j)];
      }
    }
  }
}

void MechanicalHybrid::AppendTermsOf(const Mode& mode, std::span<const GuardId> guards, const ModePoint& from,
                                     std::vector<GuardTerm>* terms, std::vector<std::size_t>* ends) const {
  const int n = equations_.n(), columns = equations_.num_columns(true),
            parameters = functions_->layout().num_parameters;
  const auto is_gap = [](const GuardId& guarded) { return guarded.kind == Kind::kHit; };
  std::vector<GuardId> others;
  std::ranges::remove_copy_if(guards, std::back_inserter(others), is_gap);
  std::vector<double> values(others.size()), gradients(others.size() * columns), by_q(n), by_p(parameters);
  if (!others.empty()) GuardGradients(mode, others, from, values.data(), gradients.data());
  const double* row = gradients.data();
  const ProjectedPoint on = Projected(mode, PointAt(from));
  for (const GuardId& guarded : guards) {
    if (is_gap(guarded)) {
      equations_.GapGradient(guarded.contact, on.at, by_q.data(), by_p.data());
      for (const int i : equations_.CoordinatesOf(guarded.contact)) {
        if (by_q[i] != 0) terms->push_back({i, by_q[i]});
      }
      for (int i = 0; i < parameters; ++i) {
        if (by_p[i] != 0) terms->push_back({2 * n + 1 + i, by_p[i]});
      }
    } else {
      AppendTerms(row, 2 * n, columns, terms);
      row += columns;
    }
    ends->push_back(terms->size());
  }
}

// The closed contacts when one of them stops. Others may stop with it: by chance, or as the corners of one body must,
// of which no speed is left to compare.
MechanicalHybrid::Closing MechanicalHybrid::Stopping(const Mode& mode, const GuardId& guarded, const Point& at) const {
  Closing closing = ClosedOf(mode, at);
  std::vector<ClosedContact> stopped = mode.closed;
  for (ClosedContact& other : stopped) {
    if (other.contact == guarded.contact) {
      other.status = 's';
    } else if (SlidingSign(other.status) != 0) {
      other.status = 'n';
    }
  }
  const MechanicalEquations::System system = equations_.Assemble(stopped, at);
  const Eigen::Map<const Eigen::VectorXd> v(at.v, equations_.n());
  for (std::size_t i = 0; i < closing.contacts.size(); ++i) {
    if (closing.sliding[i] == 0) continue;
    const Eigen::RowVectorXd tangent = equations_.RowAt({closing.contacts[i], true}, at);
    Eigen::VectorXd parts = tangent * system.mobile_F;
    system.contact->Solve(parts, parts);
    const double left = (tangent - parts.transpose() * system.G).cwiseAbs().maxCoeff();
    const bool stops = left <= kRests * tangent.cwiseAbs().maxCoeff() ||
                       std::abs(tangent.dot(v)) <= kRests * tangent.cwiseAbs().dot(v.cwiseAbs());
    if (stops) closing.sliding[i] = 0;
  }
  return closing;
}

// The closed contacts when one of them stops: 's' for all that are at rest then, 'n' for the others.
std::vector<ClosedContact> MechanicalHybrid::Stopped(const Mode& mode, const GuardId& guarded, const Point& at) const {
  const Closing stopping = Stopping(mode, guarded, at);
  std::vector<ClosedContact> stopped = mode.closed;
  for (std::size_t i = 0; i < stopped.size(); ++i) {
    stopped[i].status = stopping.sliding[i] == 0 && HasFriction(stopped[i].contact) ? 's' : 'n';
  }
  return stopped;
}

// The status of all contacts after an event; empty if there is none, and then `why` is the reason.
std::string MechanicalHybrid::NextStatus(const Mode& mode, const GuardId& guarded, const Point& at, Impact* impact,
                                         std::string* why) const {
  std::string next = mode.status;
  switch (guarded.kind) {
    case Kind::kHit:
      *impact = SolveImpact(mode, guarded.contact, at);
      *why = impact->why;
      return impact->next;
    case Kind::kEnd:
      next[guarded.contact] = 'o';
      return next;
    case Kind::kOff:
    case Kind::kBreakBack:
    case Kind::kBreakOn:
      return StatusPastLimit(mode, guarded, at, why);
    case Kind::kGrip:
      return Close(next, ClosedOf(mode, at), at, why);
    case Kind::kStop:
      return Close(next, Stopping(mode, guarded, at), at, why);
    default:
      *why = "jammed: the acceleration under a normal force at contact '" + ContactName(guarded.contact) +
             "', which slides, is zero (Painleve)";
      return "";
  }
}

// The status after a force has reached its limit. Where forces are unique the contact opens or slides; where they are
// not, several reach their limits at once, and the problem of accelerations shortly after determines which contacts do.
std::string MechanicalHybrid::StatusPastLimit(const Mode& mode, const GuardId& guarded, const Point& at,
                                              std::string* why) const {
  const int n = equations_.n();
  std::vector<double> xdot(at.v, at.v + n);
  const ClosedMotion now = ForcedMotion(mode, at);
  xdot.insert(xdot.end(), now.a.data(), now.a.data() + n);
  if (now.stresses.cols() > 0) {
    const MechanicalEquations::Seeds seeds = equations_.SeedDirection(at, xdot.data());
    const Jet left = GuardJet(mode, guarded, at, seeds, ForcedMotion(mode, at, {&seeds, 1}), 0);
    if (left.v[0] < 0) {
      const double later = kPast * now.tolerance.maxCoeff() / -left.v[0];
      std::vector<double> x(at.q, at.q + n);
      x.insert(x.end(), at.v, at.v + n);
      for (int i = 0; i < 2 * n; ++i) x[i] += later * xdot[i];
      return Close(mode.status, ClosedOf(mode, at), PointAt(at.t + later, x.data(), at.u, at.p), why);
    }
  }
  std::string next = mode.status;
  next[guarded.contact] = guarded.kind == Kind::kOff ? 'o' : guarded.kind == Kind::kBreakBack ? '-' : '+';
  return next;
}

// Forces that are not unique may reach limits of several contacts at once, of which the status of some stays.
int MechanicalHybrid::CauseOf(const ModePoint& from, int guard) const {
  const Mode& of = ModeAt(from.mode);
  const GuardId& guarded = of.guards[guard];
  if (!NeedsForces(guarded)) return guard;
  const ProjectedPoint on = Projected(of, PointAt(from));
  std::string why;
  const std::string next = StatusPastLimit(of, guarded, on.at, &why);
  if (next.empty() || next[guarded.contact] != of.status[guarded.contact]) return guard;
  const ClosedMotion motion = ForcedMotion(of, on.at);
  const double zero = kNearly * motion.force.cwiseAbs().maxCoeff();
  const MechanicalEquations::Seeds seeds = equations_.UnseededPass(on.at);
  for (std::size_t i = 0; i < of.guards.size(); ++i) {
    const GuardId& other = of.guards[i];
    const char after = next[other.contact];
    const bool leads_there = (other.kind == Kind::kOff && after == 'o') ||
                             (other.kind == Kind::kBreakBack && after == '-') ||
                             (other.kind == Kind::kBreakOn && after == '+');
    if (leads_there && after != of.status[other.contact] && GuardJet(of, other, on.at, seeds, motion, 0).a <= zero) {
      return static_cast<int>(i);
    }
  }
  return guard;
}

int MechanicalHybrid::Reset(const ModePoint& from, int guard, double* x_plus) const {
  const Mode& of = ModeAt(from.mode);
  Impact impact;
  return ResetOn(of, of.guards[guard], Projected(of, PointAt(from)).at, &impact, x_plus);
}

// The reset of a state that is on the equations of its mode. What it has no state after the reset for is left as it is.
int MechanicalHybrid::ResetOn(const Mode& mode, const GuardId& guarded, const Point& at, Impact* impact,
                              double* x_plus) const {
  const int n = equations_.n();
  std::string why;
  const std::string next = NextStatus(mode, guarded, at, impact, &why);
  const bool strikes = impact->v_plus.size() > 0;
  // Forces grow without bounds towards a jam, and steps that are too long find a jam where there is none.
  if (!why.empty() && !strikes) return guarded.kind == Kind::kJam ? -2 : -1;
  std::copy_n(at.q, n, x_plus);
  std::copy_n(strikes ? impact->v_plus.data() : at.v, n, x_plus + n);
  // A speed that reaches zero is set to zero, as the rest is rounding.
  if (guarded.kind == Kind::kStop) equations_.Project(Stopped(mode, guarded, at), x_plus, x_plus + n, at.p);
  return why.empty() ? ModeOf(next) : -1;
}

int MechanicalHybrid::ResetJacobian(const ModePoint& from, int guard, double* x_plus, double* jacobian) const {
  const Mode& of = ModeAt(from.mode);
  const std::vector<int> columns = equations_.Columns(from.by_parameters, false);
  ProjectedPoint on = Projected(of, PointAt(from), columns);
  Impact impact;
  const int next = ResetOn(of, of.guards[guard], on.at, &impact, x_plus);
  if (next < 0 && impact.v_plus.size() == 0) return -1;
  if (of.guards[guard].kind == Kind::kStop) {
    const int n = equations_.n();
    std::copy_n(on.at.q, n, x_plus);
    std::copy_n(on.at.v, n, x_plus + n);
    equations_.Project(Stopped(of, of.guards[guard], on.at), x_plus, x_plus + n, on.at.p, on.passes);
  }
  if (impact.v_plus.size() > 0) {
    for (MechanicalEquations::Seeds& seeds : on.passes) {
      const Block by = ImpactDerivative(impact, seeds, on.at);
      for (int i = 0; i < equations_.n(); ++i) seeds.v[i].v = by.row(i).transpose();
    }
  }
  CopyColumns(on, columns, jacobian);
  return next;
}

// Copies the derivatives of a state, which are those of its seeds, to columns of a Jacobian by [x t p].
void MechanicalHybrid::CopyColumns(const ProjectedPoint& on, std::span<const int> columns, double* jacobian) const {
  const int n = equations_.n(), all = equations_.num_columns(false);
  std::fill_n(jacobian, 2 * n * all, 0.0);
  for (std::size_t k = 0; k < columns.size(); ++k) {
    const MechanicalEquations::Seeds& seeds = on.passes[k / kWidth];
    const auto j = static_cast<Eigen::Index>(k % kWidth);
    for (int i = 0; i < n; ++i) {
      jacobian[i * all + columns[k]] = seeds.q[i].v[j];
      jacobian[(n + i) * all + columns[k]] = seeds.v[i].v[j];
    }
  }
}

// The derivative of v+.
MechanicalHybrid::Block MechanicalHybrid::ImpactDerivative(const Impact& impact,
                                                           const MechanicalEquations::Seeds& seeds,
                                                           const Point& at) const {
  const bool poisson = impact.v_compressed.size() > 0;
  // One stage of an impact: the contacts with unknown impulses, these impulses, and the known ones.
  struct Stage {
    std::vector<ClosedContact> closed;
    std::vector<char> has_restitution;
    std::vector<MechanicalEquations::KnownImpulse> known;
    Eigen::VectorXd force;
  };
  const auto stage_of =
      [&](const std::string& status, const Eigen::VectorXd& impulse, bool restitution, const std::vector<Jet>& floors) {
        Stage stage;
        std::vector<double> normals, tangents;
        for (std::size_t i = 0; i < status.size(); ++i) {
          const double p_n = impulse[2 * static_cast<Eigen::Index>(i)],
                       p_t = impulse[2 * static_cast<Eigen::Index>(i) + 1];
          const int contact = impact.contacts[i];
          const bool at_floor = IsAtFloor(status[i]);
          if (at_floor && !floors.empty()) stage.known.push_back({contact, floors[i], TangentSign(status[i])});
          if (at_floor && status[i] != 'S') continue;
          stage.closed.push_back({contact, status[i]});
          if (!at_floor) {
            normals.push_back(p_n);
            stage.has_restitution.push_back(restitution && impact.restores[i] != 0);
          }
          if (status[i] == 's' || status[i] == 'S') tangents.push_back(p_t);
        }
        normals.insert(normals.end(), tangents.begin(), tangents.end());
        stage.force = Eigen::Map<const Eigen::VectorXd>(normals.data(), static_cast<Eigen::Index>(normals.size()));
        return stage;
      };
  const auto derivative_of =
      [&](const Stage& stage, const MechanicalEquations::Seeds& before, const Eigen::VectorXd& v_plus) {
        return equations_.ImpactDerivative(equations_.Assemble(stage.closed, at, /*for_derivatives=*/true),
                                           stage.closed,
                                           before,
                                           v_plus,
                                           stage.force,
                                           stage.has_restitution,
                                           stage.known);
      };
  if (!poisson) {
    return derivative_of(stage_of(impact.status, impact.impulse, true, {}), seeds, impact.v_plus).motion;
  }
  const Stage compression = stage_of(impact.compressed, impact.compression, false, {});
  const MechanicalEquations::Derivative compressed = derivative_of(compression, seeds, impact.v_compressed);
  MechanicalEquations::Seeds between = seeds;
  for (int i = 0; i < equations_.n(); ++i) {
    between.v[i] = Jet(impact.v_compressed[i]);
    between.v[i].v = compressed.motion.row(i).transpose();
  }
  std::vector<Jet> floors;
  Eigen::Index normal = 0;
  for (std::size_t i = 0; i < impact.contacts.size(); ++i) {
    Jet impulse(0.0);
    if (impact.compressed[i] != 'o') {
      impulse = Jet(compression.force[normal]);
      impulse.v = compressed.force.row(normal++).transpose();
    }
    floors.push_back(impact.restores[i] != 0 ? impulse * functions_->Restitution(impact.contacts[i], seeds.p.data())
                                             : Jet(0.0));
  }
  return derivative_of(
             stage_of(impact.status, impact.impulse - impact.compression, false, floors), between, impact.v_plus)
      .motion;
}

std::string MechanicalHybrid::ReasonNoMode(const ModePoint& from, int guard) const {
  const Mode& of = ModeAt(from.mode);
  const ProjectedPoint on = Projected(of, PointAt(from));
  std::string why;
  if (guard < 0) {
    Close(of.status, ClosedOf(of, on.at), on.at, &why);
  } else {
    Impact impact;
    NextStatus(of, of.guards[guard], on.at, &impact, &why);
  }
  return why;
}

std::string MechanicalHybrid::ForcesAtLimits(const Mode& mode, const Point& at) const {
  if (std::ranges::none_of(mode.guards, NeedsForces)) return "";
  const ClosedMotion motion = ForcedMotion(mode, at);
  const MechanicalEquations::Seeds seeds = equations_.UnseededPass(at);
  std::string why;
  for (const GuardId& guarded : mode.guards) {
    if (!NeedsForces(guarded) || GuardJet(mode, guarded, at, seeds, motion, 0).a != 0) continue;
    why += (why.empty() ? "the force of contact '" : "; the force of contact '") + ContactName(guarded.contact) +
           (guarded.kind == Kind::kOff ? "' is zero" : "' is at the limit of friction") + " at t = " + Text(at.t);
  }
  return why;
}

std::string MechanicalHybrid::ReasonNoDerivative(const ModePoint& from, int guard) const {
  const Mode& of = ModeAt(from.mode);
  if (guard < 0) return ForcesAtLimits(of, PointAt(from));
  if (of.guards[guard].kind != GuardId::Kind::kHit) return "";
  const ProjectedPoint on = Projected(of, PointAt(from));
  const Impact impact = SolveImpact(of, of.guards[guard].contact, on.at);
  if (!impact.why.empty()) return "";
  std::string names, touching, boundary;
  int hits = 0;
  const Eigen::VectorXd after = impact.VelocityAfter();
  // Whether a contact that is closed before has no force then, so that it might as well be a little open.
  const auto touches = [&](int contact) {
    const auto closed = std::ranges::find(of.closed, contact, &ClosedContact::contact);
    const double force = MotionOf(of, on.at).force[closed - of.closed.begin()];
    return std::abs(force) <= kRests * equations_.Force(on.at).cwiseAbs().maxCoeff();
  };
  for (std::size_t i = 0; i < impact.contacts.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(2 * i);
    if (impact.hits[i] != 0) {
      ++hits;
      names += (names.empty() ? "'" : ", '") + ContactName(impact.contacts[i]) + "'";
    } else if (impact.impulse[row] > kNearly * impact.impulse.maxCoeff() && touches(impact.contacts[i])) {
      touching += (touching.empty() ? "'" : ", '") + ContactName(impact.contacts[i]) + "'";
    }
    // Measures how far the end of the impact is from another branch, unless the contact has none: it is held, or
    // nothing moves it along its normal.
    const double pressing = impact.W.row(row).cwiseAbs().dot(impact.impulse.cwiseAbs());
    if (impact.held || pressing <= kNearly * impact.W(row, row) * impact.impulse.maxCoeff()) continue;
    const double speeds = impact.W.row(row + 1).cwiseAbs().dot(impact.impulse.cwiseAbs());
    const double bound = functions_->Friction(impact.contacts[i], from.p) * impact.impulse[row];
    const bool at_bound =
        impact.status[i] == 's' && bound - std::abs(impact.impulse[row + 1]) <= kNearly * std::abs(impact.impulse[row]);
    const bool at_rest = SlidingSign(impact.status[i]) != 0 && std::abs(after[row + 1]) <= kNearly * speeds;
    if (at_bound || at_rest) {
      boundary += (boundary.empty() ? "" : "; ") + ("the impact of '" + ContactName(impact.contacts[i])) +
                  "' is at the boundary between sticking and sliding";
    }
  }
  if (!touching.empty()) {
    boundary += std::string(boundary.empty() ? "" : "; ") + "contacts " + touching + " touch without a force where " +
                names + " hits: the order of their impacts matters";
  }
  if (hits > 1) {
    boundary += std::string(boundary.empty() ? "" : "; ") + "contacts " + names +
                " hit at the same instant and are coupled (simultaneous)";
  }
  return boundary;
}

// A reset changes the contact of the guard alone; a jump of the control changes one closed contact.
std::vector<int> MechanicalHybrid::NextModes(int mode, int guard, const double* p) const {
  const Mode of = ModeAt(mode);
  std::vector<int> next;
  const auto add = [&](int contact, std::string_view letters) {
    std::string status = of.status;
    for (const char letter : letters) {
      status[contact] = letter;
      if (letter != of.status[contact]) next.push_back(ModeOf(status));
    }
  };
  if (guard < 0) {
    for (const ClosedContact& closed : of.closed) add(closed.contact, closed.status == 's' ? "o+-" : "o");
    return next;
  }
  const int contact = of.guards[guard].contact;
  switch (of.guards[guard].kind) {
    case Kind::kHit:
      if (functions_->Restitution(contact, p) > 0) return {mode};
      add(contact, CanStick(contact, p) ? "s+-" : HasFriction(contact) ? "n+-" : "n");
      break;
    case Kind::kOff:
    case Kind::kEnd:
      add(contact, "o");
      break;
    case Kind::kStop:
      add(contact, CanStick(contact, p) ? "s" : "n");
      add(contact, of.status[contact] == '+' ? "-" : "+");
      break;
    case Kind::kBreakBack:
      add(contact, "-");
      break;
    case Kind::kBreakOn:
      add(contact, "+");
      break;
    case Kind::kGrip:
      add(contact, "s+-o");
      break;
    case Kind::kJam:
      break;
  }
  return next;
}

int MechanicalHybrid::ModeAfterControlJump(const ModePoint& from) const {
  const Mode& of = ModeAt(from.mode);
  if (of.closed.empty()) return from.mode;
  std::string why;
  const Point at = PointAt(from);
  const std::string next = Close(of.status, ClosedOf(of, at), at, &why);
  return why.empty() ? ModeOf(next) : -1;
}

void MechanicalHybrid::Project(int mode, const double* x, const double* p, double* x_plus) const {
  const int n = equations_.n();
  std::copy_n(x, 2 * n, x_plus);
  equations_.Project(ModeAt(mode).closed, x_plus, x_plus + n, p);
}

void MechanicalHybrid::ProjectJacobian(const ModePoint& from, double* x_plus, double* jacobian) const {
  const std::vector<int> columns = equations_.Columns(from.by_parameters, false);
  const ProjectedPoint on = Projected(ModeAt(from.mode), PointAt(from), columns);
  std::copy_n(on.at.q, equations_.n(), x_plus);
  std::copy_n(on.at.v, equations_.n(), x_plus + equations_.n());
  CopyColumns(on, columns, jacobian);
}

}  // namespace saltus
