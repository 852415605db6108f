#include "solve/phases/phase_plan.h"

#include <algorithm>
#include <cstdio>
#include <limits>
#include <numeric>

#include "control/control_bounds.h"
#include "saltus/control/objective.h"

namespace saltus {
namespace {

// Of a plan without its first impacts.
std::string NameFrom(const Scene& scene, const PhasePlan& plan, size_t first) {
  const ContactSequence sequence = plan.Sequence();
  std::string text = ContactSequenceToString(scene, {sequence.begin() + first, sequence.end()});
  if (plan.HasTies()) text += plan.tied.back() ? " (at the final time)" : " (some at the same time)";
  for (size_t k = 0; k < plan.cuts.size(); ++k) {
    if (!plan.modes[k]) continue;
    text += ", " + ContactSequenceToString(scene, {*plan.cuts[k]});
    text += *plan.modes[k] == ContactMode::kSlip ? " slips" : " sticks";
  }
  for (const Candidate& pair : plan.apart) text += ", " + ContactSequenceToString(scene, {pair}) + " apart";
  return text;
}

}  // namespace

bool IsForbidden(const Scene& scene, const Candidate& c) {
  return std::find(scene.no_contact.begin(), scene.no_contact.end(), NoContact{c.a, c.b, c.plane}) !=
         scene.no_contact.end();
}

ContactSequence PhasePlan::Sequence() const {
  ContactSequence sequence;
  for (const auto& cut : cuts) {
    if (cut) sequence.push_back(*cut);
  }
  return sequence;
}

bool PhasePlan::HasTies() const { return std::find(tied.begin(), tied.end(), true) != tied.end(); }

bool PhasePlan::HasModes() const {
  return std::any_of(modes.begin(), modes.end(), [](const auto& mode) { return mode.has_value(); });
}

bool PlanAttempt::feasible() const { return realized && violation <= kFeasible; }

double DurationOf(const Trial& trial) { return std::accumulate(trial.durations.begin(), trial.durations.end(), 0.0); }

std::function<double(int entry, double t)> ForcesOf(const Scene& scene, const Trial& trial) {
  std::vector<double> ends(trial.durations.size());
  std::partial_sum(trial.durations.begin(), trial.durations.end(), ends.begin());
  return [&scene, &trial, ends = std::move(ends)](int entry, double t) {
    const size_t last = ends.size() - 1;
    const size_t k = std::min<size_t>(std::upper_bound(ends.begin(), ends.end(), t) - ends.begin(), last);
    return trial.control[scene.ForceIndex(k, 0) + entry];
  };
}

Miss LargestMiss(const Scene& scene, const Trial& trial) {
  Miss largest;
  const Flight flight = FlightOf(scene, trial);
  const auto consider = [&](const DiscStates& x, const auto& term) {
    if constexpr (requires { term.IsOfSpin(); }) {
      if (term.IsOfSpin()) {
        const bool angle = term.quantity == TerminalTerm::Quantity::kAngle;
        const double size = std::abs((angle ? x.angle : x.spin)[term.body] - term.target[0]);
        if (size > largest.size) largest = {size, term.body, term.quantity};
        return;
      }
    }
    const Vec2d& q = term.quantity == TerminalTerm::Quantity::kPosition ? x.p[term.body] : x.v[term.body];
    const double size = (q - term.target).norm();
    if (size > largest.size) largest = {size, term.body, term.quantity};
  };
  for (const TerminalTerm& term : scene.objective.terminal) {
    if (term.hard) consider(flight.end(), term);
  }
  for (const ViaTerm& term : scene.objective.via) {
    if (term.hard) consider(flight.Before(term.time), term);
  }
  return largest;
}

double ViolationOf(const Scene& scene, const Trial& trial) {
  if (!trial.exact.ok || !trial.exact.only_impacts) return std::numeric_limits<double>::infinity();
  const ContactSequence& met = trial.exact.contacts;
  if (std::any_of(met.begin(), met.end(), [&](const Candidate& c) { return IsForbidden(scene, c); })) {
    return std::numeric_limits<double>::infinity();
  }
  return std::max(trial.own.violation, scene.objective.HasConstraints() ? LargestMiss(scene, trial).size : 0.0);
}

double ViolationOfAll(const Scene& scene, const Trial& trial) {
  const bool any = scene.objective.HasConstraints() || !scene.no_contact.empty() || trial.own.violation > 0;
  double largest = any ? ViolationOf(scene, trial) : 0;
  std::vector<double> within = trial.control;
  MoveWithinBounds(scene, within);
  for (size_t i = 0; i < within.size(); ++i) largest = std::max(largest, std::abs(trial.control[i] - within[i]));
  return largest;
}

std::string NameOf(const Scene& scene, const PhasePlan& plan) { return NameFrom(scene, plan, 0); }

std::string NamesOf(const Scene& scene, const std::vector<PhasePlan>& plans) {
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
    text += NameFrom(scene, plans[i], same);
  }
  return text;
}

std::string KinksOf(const Scene& scene, const PhasePlan& plan) {
  std::string text;
  const auto add = [&](const std::string& what) { text += (text.empty() ? "" : ", ") + what; };
  for (const Candidate& pair : plan.apart) add(ContactSequenceToString(scene, {pair}) + " just touch");
  if (plan.HasTies()) add(plan.tied.back() ? "an impact is at the final time" : "impacts are at the same time");
  if (plan.HasModes()) add("an impact is between slip and stick");
  return text;
}

std::string DescribeMiss(const Scene& scene, const Trial& trial) {
  const Miss miss = LargestMiss(scene, trial);
  if (trial.own.violation > miss.size) {
    char part[40];
    std::snprintf(part, sizeof part, "%.6g", trial.own.violation);
    return std::string(part) + " of its scale, by " + trial.own.worst;
  }
  struct Unit {
    double size;
    const char* name;
  };
  const Unit units[] = {// by quantity
                        {scene.units.length, " m"},
                        {scene.units.speed(), " m/s"},
                        {1, " rad"},
                        {1 / scene.units.time, " rad/s"}};
  const Unit& unit = units[static_cast<int>(miss.quantity)];
  char text[40];
  std::snprintf(text, sizeof text, "%.6g", miss.size * unit.size);
  return std::string(text) + unit.name + ", by " + scene.bodies[miss.body].name;
}

}  // namespace saltus
