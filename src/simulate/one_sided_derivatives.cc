#include "saltus/simulate/one_sided_derivatives.h"

#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <numeric>

#include "contact/event/event_group.h"
#include "simulate/typed_scene.h"

namespace saltus {
namespace {

using internal::Approach;
template <int kRotation>
using Group = internal::EventGroup<double, kRotation>;
template <int kRotation>
using ContactOf = typename Group<kRotation>::Contact;

// The magnitude up to which a component of a unit vector counts as rounding.
constexpr double kNoComponent = 1e-9;

// The discs of a scene at its initial time, as a step of the model represents them.
template <int kRotation>
struct Start {
  explicit Start(const Scene& scene)
      : typed(scene, scene.dt()), in(typed.Input()), force(typed.bodies.size(), Vec2d(0, 0)) {
    for (int i = 0; i < scene.num_controlled(); ++i) force[scene.control.bodies[i]] = scene.control.initial[i];
    in.force = force;
    in.scratch = &scratch;
    for (int i = 0; i < scene.num_bodies(); ++i) {
      const Body& body = scene.bodies[i];
      discs.push_back({0, body.position, body.fixed ? Vec2d(0, 0) : body.velocity, in.Acceleration(i)});
      if constexpr (kRotation == kSpin) discs.back().turn = {body.angle, body.angular_velocity, 0};
    }
    FindTouching();
    in.candidates = touching;
  }

  Approach Measure(const Candidate& c) const {
    const auto motion = [&](int i) { return internal::Motion{discs[i].p, discs[i].v, discs[i].a}; };
    if (c.plane) return MeasureApproach(motion(c.a), in.planes[c.b], in.ContactDistance(c));
    return MeasureApproach(motion(c.a), motion(c.b), in.ContactDistance(c));
  }
  // Whether the normal turns as the two move along each other.
  bool Bends(const Candidate& c) const { return !c.plane || in.planes[c.b].curved(); }
  Vec2d Normal(const Candidate& c) const {
    return SeparationAt(in, c, [&](int i) { return discs[i].p; }).normal;
  }

  const TypedScene<double> typed;
  StepInput<double> in;
  std::pmr::monotonic_buffer_resource scratch;  // what a step keeps until its end
  std::vector<Vec2d> force;
  std::vector<internal::EventDisc<double, kRotation>> discs;
  std::vector<Candidate> touching;

 private:
  // Finds touching pairs by a sweep over the left ends of the discs, which compares only discs whose widths overlap.
  void FindTouching() {
    const std::span<const BodyConstants<double>> bodies = in.bodies;
    const int n = static_cast<int>(bodies.size());
    const auto add = [&](const Candidate& c) {
      if (in.IsPocket(c)) return;
      if (c.plane && !in.extents[c.b].Covers(discs[c.a].p, internal::kSeam)) return;
      const double gap = Measure(c).gap;
      const bool behind = c.plane && !in.extents[c.b].endless && gap <= -bodies[c.a].radius;
      if (gap <= internal::kContactGap && !behind) touching.push_back(c);
    };
    const auto left = [&](int i) { return discs[i].p[0] - bodies[i].radius; };
    std::vector<int> order(n);
    std::iota(order.begin(), order.end(), 0);
    std::sort(order.begin(), order.end(), [&](int i, int j) { return left(i) < left(j); });
    for (int k = 0; k < n; ++k) {
      const int i = order[k];
      const double right = discs[i].p[0] + bodies[i].radius + internal::kContactGap;
      for (int l = k + 1; l < n && left(order[l]) <= right; ++l) {
        const int j = order[l];
        if (!bodies[i].fixed || !bodies[j].fixed) add({std::min(i, j), std::max(i, j)});
      }
      for (int plane = 0; plane < static_cast<int>(in.planes.size()) && !bodies[i].fixed; ++plane)
        add({i, plane, true});
    }
  }
};

// Collects the directions in which derivatives do not exist.
template <int kRotation>
class Sides {
 public:
  explicit Sides(const Start<kRotation>& start) : start_(start), missing_(start.in.bodies.size()) {}

  // Notes that the loss has no derivative for changes of `quantity` that move a against b along -direction.
  void AddOneSided(const Candidate& c, OneSided::Quantity quantity, const Vec2d& direction) {
    const Vec2d unit = direction.normalized();
    Add(c.a, quantity, unit);
    if (!c.plane) Add(c.b, quantity, -unit);
  }
  // Notes that the loss has no derivative along -direction, nor along direction.
  void AddNone(const Candidate& c, OneSided::Quantity quantity, const Vec2d& direction) {
    AddOneSided(c, quantity, direction);
    AddOneSided(c, quantity, -direction);
  }

  std::vector<OneSided> ListOneSided() const {
    std::vector<OneSided> all;
    for (int i = 0; i < static_cast<int>(missing_.size()); ++i) {
      if (start_.in.bodies[i].fixed) continue;
      for (const auto quantity : {OneSided::Quantity::kPosition, OneSided::Quantity::kVelocity}) {
        for (int k = 0; k < 2; ++k) {
          const auto& [below, above] = missing_[i].at[static_cast<int>(quantity)][k];
          if (!below && !above) continue;
          const auto side = !above ? OneSided::Side::kAbove : !below ? OneSided::Side::kBelow : OneSided::Side::kNone;
          all.push_back({i, quantity, k, side});
        }
      }
    }
    return all;
  }

 private:
  struct Missing {
    bool at[2][2][2] = {};  // by quantity and component: for a smaller value, for a larger one
  };
  void Add(int i, OneSided::Quantity quantity, const Vec2d& direction) {
    for (int k = 0; k < 2; ++k) {
      bool(&missing)[2] = missing_[i].at[static_cast<int>(quantity)][k];
      if (direction[k] > kNoComponent) missing[0] = true;
      if (direction[k] < -kNoComponent) missing[1] = true;
    }
  }

  const Start<kRotation>& start_;
  std::vector<Missing> missing_;
};

bool LossHasVelocities(const Scene& scene) {
  const std::vector<TerminalTerm>& terms = scene.objective.terminal;
  return std::ranges::any_of(
      terms, [](const TerminalTerm& term) { return term.quantity == TerminalTerm::Quantity::kVelocity; });
}

// Whether the group has several contacts, of which a sticking one has a tangential force.
template <int kRotation>
bool IsHeldByFriction(const Group<kRotation>& group) {
  return group.contacts().size() > 1 && std::ranges::any_of(group.contacts(), [](const auto& contact) {
           return contact.closed && contact.mode == ContactMode::kStick &&
                  std::abs(contact.force.tangential_force) > kNoComponent * contact.force.normal_force;
         });
}

// Returns by how much the force of a contact accelerates another along its normal, through the discs they share.
template <int kRotation>
bool Couples(const Start<kRotation>& start, const Group<kRotation>& group, const ContactOf<kRotation>& measured,
             const ContactOf<kRotation>& pushing) {
  const Candidate &m = start.touching[measured.pair], &p = start.touching[pushing.pair];
  double shared = 0;
  const auto meet = [&](int i, int j, double sign) { shared += i == j ? sign * start.in.bodies[i].inverse_mass : 0; };
  meet(m.a, p.a, 1);
  if (!p.plane) meet(m.a, p.b, -1);
  if (!m.plane) meet(m.b, p.a, -1);
  if (!m.plane && !p.plane) meet(m.b, p.b, 1);
  if (shared == 0) return false;
  const Vec2d normal = start.Normal(m), pushed = start.Normal(p), tangent = Perpendicular(pushed);
  const auto along = [&](const Vec2d& direction) { return std::abs(Dot(normal, direction)) > kNoComponent; };
  if (pushing.mode == ContactMode::kStick) return along(pushed) || along(tangent);
  return along(pushed + group.TangentialShare(pushing) * tangent);
}

// Returns the active contacts whose forces reach, from one to the next, a contact without force: bounces strike it.
template <int kRotation>
std::vector<const ContactOf<kRotation>*> FindRattling(const Start<kRotation>& start, const Group<kRotation>& group) {
  std::vector<const ContactOf<kRotation>*> reached;
  for (const auto& contact : group.contacts()) {
    if (!contact.closed) reached.push_back(&contact);
  }
  const std::size_t open = reached.size();
  for (std::size_t k = 0; k < reached.size(); ++k) {
    for (const auto& contact : group.contacts()) {
      const bool known = std::find(reached.begin(), reached.end(), &contact) != reached.end();
      if (!known && Couples<kRotation>(start, group, *reached[k], contact)) reached.push_back(&contact);
    }
  }
  reached.erase(reached.begin(), reached.begin() + static_cast<std::ptrdiff_t>(open));
  return reached;
}

template <int kRotation>
void AddPressed(const Scene& scene, const Start<kRotation>& start, const Group<kRotation>& group,
                Sides<kRotation>* sides) {
  using Quantity = OneSided::Quantity;
  const bool undecided = IsHeldByFriction<kRotation>(group);
  for (const auto* contact : FindRattling<kRotation>(start, group)) {
    const Candidate& c = start.touching[contact->pair];
    const Vec2d normal = start.Normal(c);
    for (const auto quantity : {Quantity::kPosition, Quantity::kVelocity}) sides->AddNone(c, quantity, normal);
    if (start.Bends(c)) sides->AddNone(c, Quantity::kPosition, Perpendicular(normal));  // see below
  }
  for (const auto& contact : group.contacts()) {
    const Candidate& c = start.touching[contact.pair];
    const auto& [restitution, friction] = start.in.ContactOf(c);
    const Vec2d normal = start.Normal(c), tangent = Perpendicular(normal);
    if (!contact.closed) {
      sides->AddOneSided(c, Quantity::kVelocity, normal);
      // Before the point where the two slide past each other they would meet there.
      const double sliding = group.SlidingSpeed(contact);
      if (start.Bends(c) && std::abs(sliding) > internal::kStickSpeed) {
        sides->AddOneSided(c, Quantity::kPosition, std::copysign(1.0, sliding) * tangent);
      }
      continue;
    }
    if (restitution >= 1) {
      sides->AddNone(c, Quantity::kPosition, normal);
      if (LossHasVelocities(scene)) {
        sides->AddNone(c, Quantity::kVelocity, normal);
        if (start.Bends(c)) sides->AddNone(c, Quantity::kPosition, tangent);  // see below
      }
    }
    if (undecided) sides->AddNone(c, Quantity::kPosition, normal);
    const bool starts =
        contact.mode == ContactMode::kSlip && std::abs(group.SlidingSpeed(contact)) <= internal::kStickSpeed;
    if (!starts) continue;
    // While it slides to that side, every impact of a bounce has friction; otherwise one impact stops the sliding.
    const Vec2d slides = -std::copysign(1.0, contact.force.tangential_force) * tangent;
    sides->AddOneSided(c, Quantity::kVelocity, slides);
    const RestingContact& force = contact.force;
    const double give = force.tangential_mass > 0 ? force.mass / force.tangential_mass : 1;  // as discs that spin turn
    const double stopped = friction * (1 + restitution) * give;  // along the tangent, of the speed of an impact
    sides->AddOneSided(c, Quantity::kVelocity, slides + stopped * normal);
    const Vec2d a = start.discs[c.a].a - (c.plane ? Vec2d(0, 0) : start.discs[c.b].a);
    const bool alone = group.contacts().size() == 1;
    const bool slips = restitution == 0 || Dot(slides, a) >= -stopped * Dot(normal, a);
    if (alone && slips) continue;
    sides->AddNone(c, Quantity::kPosition, normal);
    // A disc that is moved along another one by h is h^2 / (2 R) off it, and falls back at a speed proportional to h.
    if (start.Bends(c)) sides->AddNone(c, Quantity::kPosition, tangent);
  }
}

template <int kRotation>
std::vector<OneSided> FindOneSided(const Scene& scene) {
  const Start<kRotation> start(scene);
  Sides<kRotation> sides(start);
  std::vector<char> settled(start.touching.size(), 0);
  Group<kRotation> group(start.in);
  std::vector<internal::EventDisc<double, kRotation>> discs = start.discs;
  group.SetDiscs(discs);
  const int n = static_cast<int>(start.touching.size());
  // Only a pair that neither separates nor closes at speed can have a contact force.
  const auto rests = [&](int q) { return start.Measure(start.touching[q]).Touching(); };
  for (int q = 0; q < n; ++q) {
    sides.AddOneSided(start.touching[q], OneSided::Quantity::kPosition, start.Normal(start.touching[q]));
    if (settled[q] || !rests(q)) continue;
    group.Clear();
    for (bool grows = true; grows;) {
      grows = false;
      for (int other = q; other < n; ++other) {
        const Candidate& c = start.touching[other];
        const bool joins = other == q || group.HasDisc(c.a) || (!c.plane && group.HasDisc(c.b));
        if (settled[other] || !joins || !rests(other)) continue;
        group.Add(other);
        settled[other] = grows = true;
      }
    }
    if (group.SolveForces()) AddPressed<kRotation>(scene, start, group, &sides);
  }
  return sides.ListOneSided();
}

}  // namespace

const char* QuantityToString(OneSided::Quantity quantity) {
  return quantity == OneSided::Quantity::kPosition ? "position" : "velocity";
}

const char* SideToString(OneSided::Side side) {
  if (side == OneSided::Side::kNone) return "none";
  return side == OneSided::Side::kAbove ? "+" : "-";
}

std::vector<OneSided> OneSidedDerivatives(const Scene& scene) {
  return scene.Spins() ? FindOneSided<kSpin>(scene) : FindOneSided<0>(scene);
}

}  // namespace saltus
