// Rows of contact groups, for models that solve for the impulses of all contacts of a group together.
//
// A group is a set of contacts connected by moving discs. Its rows are directions in which contacts push: first the
// normals of all contacts, then, if one has friction, the tangents, in the same order. An impulse along a row acts on
// disc a, and its opposite on disc b. With J the matrix of all rows, A = J M^-1 J^T is how impulses change velocities.
// A scene without friction has no tangents, so these models' derivative by friction is zero there. Of discs that spin
// (kTurn), rows and velocities are those of the points of contact.
#pragma once

#include <Eigen/Core>
#include <memory_resource>
#include <numeric>
#include <type_traits>
#include <utility>
#include <vector>

#include "base/linear_algebra.h"
#include "contact/models/disc_rotation.h"
#include "contact/solvers/lcp_solver.h"
#include "saltus/contact/contact_model.h"

namespace saltus {

template <typename T>
struct GapContact {
  Candidate candidate;
  Vec2<T> normal;
  T gap;  // m
};

template <typename T, int kTurn = 0>
class ContactGroup {
 public:
  using S = Base<T>;
  using Matrix = Eigen::Matrix<S, Eigen::Dynamic, Eigen::Dynamic>;
  using Vector = Eigen::Matrix<S, Eigen::Dynamic, 1>;

  ContactGroup(const StepInput<T>& in, bool friction)
      : in_(&in), friction_(friction), contacts_(in.scratch), tangents_(in.scratch) {}

  // Adds a contact, to which the group then refers: it must outlive the group.
  void Add(const GapContact<T>& contact) {
    contacts_.push_back(&contact);
    if (friction_) tangents_.push_back(Perpendicular(contact.normal));
  }

  int num_contacts() const { return static_cast<int>(contacts_.size()); }
  int size() const { return friction_ ? 2 * num_contacts() : num_contacts(); }
  bool friction() const { return friction_; }
  // The coefficient of a contact.
  const T& friction(int i) const { return in_->ContactOf(contact(i).candidate).friction; }
  const GapContact<T>& contact(int i) const { return *contacts_[i]; }
  bool IsNormal(int row) const { return row < num_contacts(); }
  int NormalOf(int row) const { return IsNormal(row) ? row : row - num_contacts(); }
  const Candidate& candidate(int row) const { return contact(NormalOf(row)).candidate; }
  const Vec2<T>& Direction(int row) const { return IsNormal(row) ? contact(row).normal : tangents_[NormalOf(row)]; }

  // Returns the relative velocity along a row when disc i has the twist twist(i).
  template <typename TwistOfDisc>
  T RowVelocity(int row, const TwistOfDisc& twist) const {
    const T along =
        Dot(Direction(row), RelativeVelocity<T>(candidate(row), [&](int i) -> Vec2<T> { return twist(i).v; }));
    if constexpr (kTurn == kSpin) {
      if (!IsNormal(row)) return along + AlongByTurning(*in_, candidate(row), [&](int i) -> T { return twist(i).w; });
    }
    return along;
  }

  // Returns an entry of A, 1/kg.
  T Coupling(int row, int column) const {
    const auto [by_a, by_b] = Signs(row, column);
    T mobility = in_->InverseMassA(candidate(row)) * by_a;
    if (by_b != S(0)) mobility += in_->InverseMassB(candidate(row)) * by_b;
    const T coupling = row == column ? mobility : T(mobility * Dot(Direction(row), Direction(column)));
    if constexpr (kTurn == kSpin) return coupling + CouplingByTurning(row, column);
    return coupling;
  }
  S CouplingValue(int row, int column) const {
    const auto [by_a, by_b] = Signs(row, column);
    S mobility = Value(in_->InverseMassA(candidate(row))) * by_a;
    if (by_b != S(0)) mobility += Value(in_->InverseMassB(candidate(row))) * by_b;
    const Vec2<T>&n = Direction(row), &m = Direction(column);
    const S aligned = row == column ? S(1) : Value(n[0]) * Value(m[0]) + Value(n[1]) * Value(m[1]);
    if constexpr (kTurn == kSpin) return mobility * aligned + Value(CouplingByTurning(row, column));
    return mobility * aligned;
  }
  Matrix CouplingValues() const {
    Matrix values(size(), size());
    for (int i = 0; i < size(); ++i) {
      for (int j = 0; j < size(); ++j) values(i, j) = CouplingValue(i, j);
    }
    return values;
  }

  // Adds M^-1 J^T impulse to velocities: calls apply(disc, change of its twist).
  template <typename Apply>
  void Push(std::span<const T> impulse, const Apply& apply) const {
    for (int row = 0; row < size(); ++row) {
      PushContact<kTurn>(
          *in_, candidate(row), contact(NormalOf(row)).normal, Scale(impulse[row], Direction(row)), apply);
    }
  }

  // Reports the contacts whose normal impulse is not zero. `class_of(row)` is the LcpClass of a row.
  template <typename ClassOf>
  void Report(const ClassOf& class_of) const {
    for (int i = 0; i < num_contacts(); ++i) {
      if (class_of(i) == LcpClass::kFree) continue;
      const bool sticks = friction_ && class_of(i + num_contacts()) == LcpClass::kClamping;
      in_->Report(contact(i).candidate, ModeOf(friction_ && friction(i) > S(0), sticks));
    }
  }

 private:
  // Returns the signs with which a unit impulse along `column` changes the velocities of discs a and b of `row`.
  std::pair<S, S> Signs(int row, int column) const {
    const Candidate &i = candidate(row), &j = candidate(column);
    const auto sign = [&](int disc) { return j.a == disc ? S(1) : !j.plane && j.b == disc ? S(-1) : S(0); };
    return {sign(i.a), i.plane ? S(0) : -sign(i.b)};
  }

  // Returns the coupling of two tangents through the rotation of discs that both have. An impulse turns both of its
  // discs the same way, whichever of them it acts on.
  T CouplingByTurning(int row, int column) const {
    T coupling = T(S(0));
    if (IsNormal(row) || IsNormal(column)) return coupling;
    const Candidate &i = candidate(row), &j = candidate(column);
    const auto add = [&](int disc) {
      if (disc != j.a && (j.plane || disc != j.b)) return;
      const auto& body = in_->bodies[disc];
      coupling += body.radius * body.radius * body.inverse_inertia;
    };
    add(i.a);
    if (!i.plane) add(i.b);
    return coupling;
  }

  const StepInput<T>* in_;
  bool friction_;
  std::pmr::vector<const GapContact<T>*> contacts_;
  std::pmr::vector<Vec2<T>> tangents_;
};

// Returns the number of the group of each contact (a struct with a Candidate). Groups are numbered in the order of
// their first contacts.
template <typename T, typename Contacts>
std::pmr::vector<std::size_t> NumbersOfGroups(const StepInput<T>& in, std::size_t num_discs, const Contacts& contacts) {
  if (contacts.size() <= 1) return std::pmr::vector<std::size_t>(contacts.size(), 0, in.scratch);
  std::pmr::vector<int> parent(num_discs, in.scratch), group_of(num_discs, -1, in.scratch);
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
  };
  for (const auto& contact : contacts) {
    const Candidate& c = contact.candidate;
    if (!c.plane && !in.bodies[c.a].fixed && !in.bodies[c.b].fixed) parent[root(c.a)] = root(c.b);
  }
  std::pmr::vector<std::size_t> numbers(in.scratch);
  int count = 0;
  for (const auto& contact : contacts) {
    const Candidate& c = contact.candidate;
    int& group = group_of[root(in.bodies[c.a].fixed ? c.b : c.a)];
    if (group < 0) group = count++;
    numbers.push_back(group);
  }
  return numbers;
}

// Returns the pairs whose gap is `active`, by group, for discs in the states `x`.
template <typename T, int kTurn, typename Active>
std::pmr::vector<ContactGroup<T, kTurn>> FindContactGroups(const StepInput<T>& in,
                                                           std::span<const BodyState<T, kTurn>> x,
                                                           const Active& active) {
  std::span<GapContact<T>> contacts = in.template Array<GapContact<T>>(in.candidates.size());
  std::size_t num_contacts = 0;
  for (const Candidate& c : in.candidates) {
    const Separation<T> at = SeparationAt(in, c, [&](int i) -> const Vec2<T>& { return x[i].p; });
    const T gap = at.distance - in.ContactDistance(c);
    if (active(gap)) contacts[num_contacts++] = {c, at.normal, gap};
  }
  contacts = contacts.first(num_contacts);
  std::pmr::vector<ContactGroup<T, kTurn>> groups(in.scratch);
  groups.reserve(num_contacts);
  const bool friction = in.HasFriction();
  const std::pmr::vector<std::size_t> numbers = NumbersOfGroups(in, x.size(), contacts);
  for (std::size_t i = 0; i < num_contacts; ++i) {
    if (numbers[i] == groups.size()) groups.emplace_back(in, friction);
    groups[numbers[i]].Add(contacts[i]);
  }
  return groups;
}

// The discs of a group, each once, in the order of its contacts.
struct GroupDiscs {
  template <typename Group>
  GroupDiscs(const Group& group, std::size_t num_discs, std::pmr::memory_resource* scratch)
      : discs(scratch), place(num_discs, -1, scratch) {
    for (int i = 0; i < group.num_contacts(); ++i) {
      const Candidate& c = group.contact(i).candidate;
      for (const int disc : {c.a, c.plane ? c.a : c.b}) {
        if (place[disc] >= 0) continue;
        place[disc] = static_cast<int>(discs.size());
        discs.push_back(disc);
      }
    }
  }
  std::pmr::vector<int> discs;
  std::pmr::vector<int> place;  // of each disc in `discs`; -1 if it is not there
};

// Returns the gap of a candidate for discs at position(i), as a value, m.
template <typename T, typename PositionOf>
double GapValue(const StepInput<T>& in, const Candidate& c, const PositionOf& position) {
  const Separation<double> at =
      c.plane ? Separate<double>(position(c.a), in.planes[c.b]) : Separate<double>(position(c.a), position(c.b));
  return at.distance - in.ContactDistance(c);
}

// Lets the discs of a group that no reported contact has fly freely. Needed by models that step groups in several
// substeps or iterate to a tolerance, which leave rounding errors in such discs.
template <typename M, typename T>
void FlyUnlessReported(const M& model, const StepInput<T>& in, const ContactGroup<T, M::kRotation>& group,
                       std::span<const char> reported, std::span<const BodyState<T, M::kRotation>> x,
                       std::span<BodyState<T, M::kRotation>> next) {
  std::pmr::vector<char> pushed(x.size(), 0, in.scratch);
  const auto for_each_disc = [&](const Candidate& c, const auto& visit) {
    visit(c.a);
    if (!c.plane) visit(c.b);
  };
  for (int i = 0; i < group.num_contacts(); ++i) {
    if (reported[i]) for_each_disc(group.contact(i).candidate, [&](int disc) { pushed[disc] = 1; });
  }
  for (int i = 0; i < group.num_contacts(); ++i) {
    for_each_disc(group.contact(i).candidate, [&](int disc) {
      if (!pushed[disc]) next[disc] = model.Free(in, disc, x[disc]);
    });
  }
}

// Returns the impulses x with A x + c = 0 in clamping rows and x = +-mu x_n in tangents at a bound; one Newton
// correction of the given values within the given classes has the derivatives. `c` has one entry for each row.
template <typename T, int kTurn>
std::pmr::vector<T> ImpulsesInClasses(const StepInput<T>& in, const ContactGroup<T, kTurn>& group,
                                      std::type_identity_t<std::span<const T>> c,
                                      const typename ContactGroup<T, kTurn>::Vector& values,
                                      std::span<const LcpClass> classes) {
  using S = Base<T>;
  const int n = group.size();
  std::pmr::vector<T> x(n, T(S(0)), in.scratch);
  for (int i = 0; i < n; ++i) x[i] = T(values[i]);
  if constexpr (!std::is_same_v<T, S>) {
    const auto sign = [&](int row) { return classes[row] == LcpClass::kUpperBound ? S(1) : S(-1); };
    const auto at_bound = [&](int row) {
      return classes[row] == LcpClass::kUpperBound || classes[row] == LcpClass::kLowerBound;
    };
    const auto follow_normals = [&] {
      for (int i = 0; i < n; ++i) {
        if (!at_bound(i)) continue;
        const T followed = sign(i) * (group.friction(group.NormalOf(i)) * x[group.NormalOf(i)]);
        x[i] = T(values[i]) + (followed - Value(followed));
      }
    };
    follow_normals();
    std::vector<int> clamping;
    for (int i = 0; i < n; ++i) {
      if (classes[i] == LcpClass::kClamping) clamping.push_back(i);
    }
    const int m = static_cast<int>(clamping.size());
    typename ContactGroup<T, kTurn>::Matrix Q(m, m);
    std::pmr::vector<T> residual(in.scratch);
    for (int i = 0; i < m; ++i) {
      T velocity = c[clamping[i]];
      for (int j = 0; j < n; ++j) velocity += group.Coupling(clamping[i], j) * x[j];
      residual.push_back(velocity - Value(velocity));
      for (int j = 0; j < m; ++j) {
        Q(i, j) = Value(group.Coupling(clamping[i], clamping[j]));
        const int tangent = clamping[j] + group.num_contacts();
        if (!group.IsNormal(clamping[j]) || tangent >= n || !at_bound(tangent)) continue;
        Q(i, j) += sign(tangent) * Value(group.friction(clamping[j])) * Value(group.Coupling(clamping[i], tangent));
      }
    }
    if (m > 0) {
      const typename ContactGroup<T, kTurn>::Matrix inverse = PseudoInverse(Q);
      for (int i = 0; i < m; ++i) {
        for (int j = 0; j < m; ++j) x[clamping[i]] -= inverse(i, j) * residual[j];
      }
    }
    follow_normals();
  }
  return x;
}

}  // namespace saltus
