// Positions projected by a quadratic program, velocities from them (Liang, Lin, Koltun 2019; Qiao et al. 2020,
// "Scalable differentiable physics").
//
//   v_f = v + h (u/m + g),  x* = p + h v_f
//   x   = argmin 1/2 |x - x*|^2_M   s.t.   phi_c(x*) + n_c . (x - x*)_rel >= 0,  c in A;   normals at x*
//       = x* + M^-1 N^T l,          N M^-1 N^T l + phi(x*) >= 0  _|_  l >= 0                l in kg m
//   p'  = x,  v' = (x - p) / h of the discs that were moved
//
// A begins with the pairs that overlap at x*; those that overlap at x join it, and the program is solved again from the
// same x*, until none does. For discs the linear gap is at most the true one, so none is linearised twice. A disc that
// x* has carried through the centre of another is beyond the model: h |v| must stay below a radius.
//
// Impacts are plastic: what is projected away takes the approach with it. An extension is restitution, by another such
// program in velocities, over the contacts that push and approach, with v^ = (x - p) / h:
//   v'  = argmin 1/2 |w - v^|^2_M   s.t.   n_c . w_rel >= -e n_c . v_f,rel
//
// The derivative is that of the rows that push, by the implicit function theorem, normals included; those of the
// released program are constant (normal_gradient=0, which is wrong unless impacts are head-on). Nothing of the normal
// position survives a projection: this is exact for plastic impacts without friction, and only for them.
// Momentum is conserved.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <memory_resource>
#include <optional>
#include <vector>

#include "contact/models/contact_rows.h"
#include "contact/models/qcqp.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

struct PositionQpRule : SemiImplicitFlight<0> {
  static constexpr ModelTraits kTraits = {.name = "position_qp",
                                          .summary = "positions projected by a quadratic program",
                                          .source = "Liang et al. 2019; Qiao et al. 2020",
                                          .friction = false,
                                          .double_engine = true,
                                          .chains = true,
                                          .rebound = Rebound::kPlastic,
                                          .projects = true,
                                          .allocates = true,
                                          .relative = true,
                                          .by_pair = true};
  template <typename T>
  using State = BodyState<T, 0>;

  bool restitution = false;
  bool normal_gradient = true;
  template <typename Visit>
  void VisitOptions(const Visit& visit) {
    visit(ModelOption{"restitution", "1: the restitution of the scene, by a quadratic program in velocities", 0, 1},
          restitution);
    visit(ModelOption{"normal_gradient", "0: normals are constants, as in the released program", 0, 1, true},
          normal_gradient);
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    FreeFlight(*this, in, x, next);
    const std::span<GapContact<T>> contacts = Contacts<T>(in, next);
    const std::span<const double> found = in.Solved([&] { return Multipliers<T>(in, contacts, next); });
    // The contacts whose multiplier is not zero, or not a number.
    ContactGroup<T> pushing(in, /*friction=*/false);
    std::vector<double> values;
    std::pmr::vector<T> gaps(in.scratch), approach(in.scratch);
    for (std::size_t i = 0; i < contacts.size(); ++i) {
      if (found[i] == 0) continue;
      in.Report(contacts[i].candidate);
      pushing.Add(contacts[i]);
      values.push_back(found[i]);
      gaps.push_back(contacts[i].gap);
      approach.push_back(pushing.RowVelocity(pushing.size() - 1, [&](int disc) { return TwistOf(next[disc]); }));
    }
    if (values.empty()) return;
    const Eigen::Map<const Eigen::VectorXd> multipliers(values.data(), values.size());
    const std::vector<LcpClass> classes(values.size(), LcpClass::kClamping);
    pushing.Push(ImpulsesInClasses<T>(in, pushing, gaps, multipliers, classes),
                 [&](int disc, const Twist<T, 0>& change) {
                   if (in.bodies[disc].fixed) return;
                   next[disc].p += change.v;
                   for (int j = 0; j < 2; ++j) next[disc].v[j] = Divide(T(next[disc].p[j] - x[disc].p[j]), in.h);
                 });
    if (restitution) Bounce<T>(in, pushing, approach, next);
  }

 private:
  // Returns all pairs, with gaps and normals at x*.
  template <typename T>
  std::span<GapContact<T>> Contacts(const StepInput<T>& in, std::span<const State<T>> predicted) const {
    const std::span<GapContact<T>> contacts = in.template Array<GapContact<T>>(in.candidates.size());
    for (std::size_t i = 0; i < contacts.size(); ++i) {
      const Candidate& c = in.candidates[i];
      const Separation<T> at = SeparationAt(in, c, [&](int disc) -> const Vec2<T>& { return predicted[disc].p; });
      contacts[i] = {c, at.normal, at.distance - in.ContactDistance(c)};
      if (normal_gradient) continue;
      for (int j = 0; j < 2; ++j) contacts[i].normal[j] = T(Value(at.normal[j]));
    }
    return contacts;
  }

  // Returns the multiplier l of every pair, zero for pairs that are not in A.
  template <typename T>
  static std::vector<double> Multipliers(const StepInput<T>& in, std::span<const GapContact<T>> contacts,
                                         std::span<const State<T>> predicted) {
    std::vector<double> all(contacts.size(), 0.0);
    std::vector<std::size_t> active;
    std::vector<char> is_active(contacts.size(), 0);
    std::vector<Vec2d> at(predicted.size());
    while (true) {
      for (std::size_t i = 0; i < at.size(); ++i) at[i] = {Value(predicted[i].p[0]), Value(predicted[i].p[1])};
      ContactGroup<T> group(in, /*friction=*/false);
      for (const std::size_t i : active) {
        group.Add(contacts[i]);
        ApplyValue(in, contacts[i], all[i], &at);
      }
      const std::size_t known = active.size();
      for (std::size_t i = 0; i < contacts.size(); ++i) {
        if (is_active[i] || !(GapValue(in, contacts[i].candidate, [&](int disc) { return at[disc]; }) < 0)) continue;
        is_active[i] = 1;
        active.push_back(i);
        group.Add(contacts[i]);
      }
      if (active.size() == known) return all;
      Eigen::VectorXd gaps(active.size());
      for (std::size_t k = 0; k < active.size(); ++k) gaps[k] = Value(contacts[active[k]].gap);
      const Eigen::VectorXd solution = SolveLcp(in, group, gaps);
      for (std::size_t k = 0; k < active.size(); ++k) all[active[k]] = solution[k];
      if (!solution.allFinite()) return all;
    }
  }

  // Solves x >= 0, A x + c >= 0 with x_i (A x + c)_i = 0 for each i.
  template <typename T>
  static Eigen::VectorXd SolveLcp(const StepInput<T>& in, const ContactGroup<T>& group, const Eigen::VectorXd& c) {
    const Eigen::VectorXd zero = Eigen::VectorXd::Zero(c.size());
    const Eigen::VectorXd unbounded = Eigen::VectorXd::Constant(c.size(), std::numeric_limits<double>::infinity());
    const std::optional<Eigen::VectorXd> x = SolveBoxQp(group.CouplingValues(), c, zero, unbounded, zero);
    if (x) return *x;
    in.Fail("the quadratic program of a projection is not solved");
    return Eigen::VectorXd::Constant(c.size(), std::numeric_limits<double>::quiet_NaN());
  }

  template <typename T>
  static void ApplyValue(const StepInput<T>& in, const GapContact<T>& contact, double multiplier,
                         std::vector<Vec2d>* at) {
    const Candidate& c = contact.candidate;
    const Vec2d push = multiplier * Vec2d(Value(contact.normal[0]), Value(contact.normal[1]));
    (*at)[c.a] += Value(in.InverseMassA(c)) * push;
    if (!c.plane) (*at)[c.b] -= Value(in.InverseMassB(c)) * push;
  }

  // Solves the program in velocities for restitution. `approach`: n . v_f,rel of each contact, m/s.
  template <typename T>
  static void Bounce(const StepInput<T>& in, const ContactGroup<T>& pushing, const std::pmr::vector<T>& approach,
                     std::span<State<T>> next) {
    ContactGroup<T> closing(in, /*friction=*/false);
    std::pmr::vector<T> c(in.scratch);
    std::vector<double> values;
    for (int i = 0; i < pushing.num_contacts(); ++i) {
      if (!(approach[i] < 0.0)) continue;
      closing.Add(pushing.contact(i));
      const T speed = pushing.RowVelocity(i, [&](int disc) { return TwistOf(next[disc]); });
      c.push_back(speed + in.ContactOf(pushing.contact(i).candidate).restitution * approach[i]);
      values.push_back(Value(c.back()));
    }
    if (values.empty()) return;
    const Eigen::Map<const Eigen::VectorXd> speeds(values.data(), values.size());
    const std::span<const double> found = in.Solved([&] { return SolveLcp(in, closing, speeds); });
    std::vector<LcpClass> classes;
    for (const double impulse : found) classes.push_back(impulse == 0 ? LcpClass::kFree : LcpClass::kClamping);
    const Eigen::VectorXd impulses = Eigen::Map<const Eigen::VectorXd>(found.data(), found.size());
    closing.Push(ImpulsesInClasses<T>(in, closing, c, impulses, classes),
                 [&](int disc, const Twist<T, 0>& change) { Kick(change, &next[disc]); });
  }
};

struct PositionQp : PositionQpRule {
  using Spinning = SpinsFreely<PositionQpRule>;
};

}  // namespace saltus
