// What a contact model is, what it sees of the world in one step, and what it promises.
//
// A contact model is a small class with one templated function, its step
//
//   x' = f(x, u)        x: positions and velocities of some discs,  u: the force on each, held over the step.
//
// It knows nothing of trajectories, problems or solvers, nor which part of a scene it is given: the same function steps
// a whole scene in double and, with T a Jet, just the discs of one contact to differentiate it. Branches are taken on
// values. All contacts of a step see the state at its start and their contributions add, in the order of the
// candidates, unless a model's header says otherwise.
//
// To add a model: one header here, one line in src/contact/models.cmake.
#pragma once

#include <algorithm>
#include <concepts>
#include <memory_resource>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "saltus/physics/geometry.h"
#include "saltus/physics/scene.h"

namespace saltus {

// How fast bodies separate after an impact.
enum class Rebound {
  kRestitution,  // closing speed * restitution^restitution_power
  kElasticOnly,  // so with restitution 1; more slowly than stated with less
  kEmergent,     // what the law of force or the correction of overlaps makes of it
  kPlastic,      // not at all: restitution is not read
};

// What a model says of itself. Tests, the audit and the programs take their exceptions from here, never from its name.
struct ModelTraits {
  std::string_view name;            // the value of --contact
  std::string_view summary;         // one line
  std::string_view source;          // paper or package, and section
  int grid_steps = 1;               // steps of the scene's time grid that one step of the model covers
  bool friction = true;             // knows friction; without, a scene with friction > 0 is not applicable
  bool compliant = false;           // bodies overlap while in contact; reads stiffness and damping
  bool double_engine = false;       // computes in double even when single precision is asked for
  bool published_jacobian = false;  // its linearization is defined by its source and is not the derivative of its step
  bool chains = false;              // one step can pass an impact on to a disc that the hit disc hits
  bool event_driven = false;        // free flight and impact times are exact, whatever the step
  Rebound rebound = Rebound::kRestitution;
  double restitution_power = 1;  // separates with restitution^power (2 where a package multiplies both bodies')
  bool projects = false;         // moves bodies apart that overlap, within a step
  bool averages = false;         // momentum is not conserved when a disc touches several things at once
  bool sequential = false;       // takes the contacts of a step one after the other, so their order matters
  bool compared = false;         // one of those that the published comparisons (2022, 2023) report
  double reach = 0;              // m, gap from which on bodies push each other
  bool allocates = false;        // solves with matrices of its own on the heap in steps with contact
  double accuracy = 0;           // relative error that the iterations of a step leave; 0: rounding
  // What discs do to each other depends on their relative motion only, and momentum is conserved: spares their
  // derivatives a pass. A model that claims it and is not so gets a wrong gradient.
  bool relative = false;
  bool spins = false;  // discs turn, and friction turns them: kRotation > 0
};

// A number of a model's own that users may set, as in --contact=ncp:kappa=1e-6.
struct ModelOption {
  std::string_view name;
  std::string_view meaning;  // with its unit
  double low, high;          // least and largest value
  bool biases = false;       // if set to another than its default, the derivative is not meant to be that of the step
};

// State of one disc. A model that spins discs keeps kRotation more numbers, whose meaning is its own.
template <typename T, int kRotation>
struct BodyState {
  static constexpr int kSize = 4 + kRotation;
  Vec2<T> p;  // position, m
  Vec2<T> v;  // velocity, m/s
  T rotation[kRotation];
};
template <typename T>
struct BodyState<T, 0> {
  static constexpr int kSize = 4;
  Vec2<T> p;
  Vec2<T> v;
};

template <typename T>
struct BodyConstants {
  T mass;          // kg; not used if fixed
  T inverse_mass;  // 1/kg; 0 if fixed
  Base<T> radius;  // m
  bool fixed = false;
};

template <typename T>
struct ContactConstants {
  T restitution, friction, stiffness, damping;  // as in ContactParameters
};

// Disc `a` and either disc `b` or half-plane `b`, which may touch in this step. Normals point towards `a`; a < b for
// two discs. Never two fixed discs, nor a fixed disc and a plane.
struct Candidate {
  int a = 0;
  int b = 0;
  bool plane = false;
  friend bool operator==(const Candidate&, const Candidate&) = default;
};

enum class ContactMode { kFrictionless, kSlip, kStick };
const char* ContactModeToString(ContactMode mode);

// An impact changes velocities at once; a sustained contact presses for a while; a grazing one is so slow that the
// model's rule for it decides, and the derivative is one-sided.
enum class ContactKind { kImpact, kSustained, kGrazing };

// A contact that took effect in a step.
struct Touch {
  Candidate candidate;
  ContactMode mode = ContactMode::kFrictionless;
  double time = -1;  // s, since the start of the step; -1 for models that resolve no times
  ContactKind kind = ContactKind::kImpact;
};

// A contact that takes part in a tie: impacts at the same time, connected through discs that move, of which the one
// that comes first decides what follows.
struct TiedContact {
  Candidate candidate;
  double time = 0;  // s, since the start of the step; of the first impact
  int tie = 0;      // number of the tie within the step
};

// Vectors that a step finds by iteration, in the order in which it needs them. A derivative depends only on where an
// iteration ends (implicit function theorem), so a step that is taken again with Jets recalls what was found in values.
class SolveRecord {
 public:
  void Clear() { Assign({}); }
  void Assign(std::span<const double> numbers) {
    numbers_.assign(numbers.begin(), numbers.end());
    next_ = 0;
  }
  // To be called before the step is taken again.
  void Rewind() { next_ = 0; }
  std::span<const double> numbers() const { return numbers_; }

  bool AtEnd() const { return next_ == numbers_.size(); }
  // The next vector, until the next call of Append(). Precondition: not at the end.
  std::span<const double> Next() {
    const auto size = static_cast<std::size_t>(numbers_[next_]);
    const std::span<const double> vector = numbers().subspan(next_ + 1, size);
    next_ += 1 + size;
    return vector;
  }
  // Precondition: at the end.
  void Append(std::span<const double> vector) {
    numbers_.push_back(static_cast<double>(vector.size()));
    numbers_.insert(numbers_.end(), vector.begin(), vector.end());
    next_ = numbers_.size();
  }

 private:
  std::vector<double> numbers_;  // each vector after its length
  std::size_t next_ = 0;
};

// One step of some discs. Index i means the same disc in `bodies`, `force` and the states.
template <typename T>
struct StepInput {
  using S = Base<T>;
  S h;              // s, length of the step
  Vec2<S> gravity;  // m/s^2
  ContactConstants<T> contact;
  std::span<const BodyConstants<T>> bodies;
  std::span<const HalfPlane<S>> planes;
  std::span<const Vec2<T>> force;         // N
  std::span<const Candidate> candidates;  // every pair that can touch; discs by index pairs, then discs against planes
  std::pmr::memory_resource* scratch;     // for temporaries; released after the step
  std::vector<Touch>* touches = nullptr;  // if given, the step appends the contacts that took effect
  SolveRecord* solved = nullptr;          // if given, the step recalls from it what it needs iterations for
  std::string_view* failure = nullptr;    // if given, the step says there why it has no result
  std::vector<TiedContact>* ties = nullptr;  // if given, the step appends ties; only event-driven models know them
  int tie_order = 0;                         // in which order they take tied impacts (event_ties.h); 0: their own

  // The numbers that solve() returns, or has returned when this step was taken before; until the end of the step. They
  // may depend on values only.
  template <typename Solve>
  std::span<const double> Solved(const Solve& solve) const {
    const auto keep = [&](std::span<const double> numbers) {
      const std::span<double> kept = Array<double>(numbers.size());
      std::copy(numbers.begin(), numbers.end(), kept.begin());
      return kept;
    };
    if (solved != nullptr && !solved->AtEnd()) return keep(solved->Next());
    const auto& found = solve();
    const std::span<const double> numbers(found.data(), static_cast<std::size_t>(found.size()));
    if (solved != nullptr) solved->Append(numbers);
    return keep(numbers);
  }

  // Uninitialized memory for n numbers, until the end of the step.
  template <typename U>
  std::span<U> Array(std::size_t n) const {
    return {static_cast<U*>(scratch->allocate(n * sizeof(U), alignof(U))), n};
  }

  void Report(const Candidate& candidate, ContactMode mode = ContactMode::kFrictionless, double time = -1,
              ContactKind kind = ContactKind::kImpact) const {
    if (touches != nullptr) touches->push_back({candidate, mode, time, kind});
  }

  // To be called by a step whose iterations do not arrive. The rollout then fails with this reason, which must be a
  // literal; what the step leaves should be not a number, so that derivatives taken there fail too.
  void Fail(std::string_view why) const {
    if (failure != nullptr && failure->empty()) *failure = why;
  }

  // Acceleration of disc i by force and gravity, m/s^2; zero if it is fixed.
  Vec2<T> Acceleration(int i) const {
    const BodyConstants<T>& body = bodies[i];
    if (body.fixed) return Vec2<T>(T(S(0)), T(S(0)));
    return {force[i][0] * body.inverse_mass + gravity[0], force[i][1] * body.inverse_mass + gravity[1]};
  }
  // Distance of the centres (or of centre and plane) at which the two touch, m.
  S ContactDistance(const Candidate& c) const { return bodies[c.a].radius + (c.plane ? S(0) : bodies[c.b].radius); }
  T InverseMassA(const Candidate& c) const { return bodies[c.a].inverse_mass; }
  T InverseMassB(const Candidate& c) const { return c.plane ? T(S(0)) : bodies[c.b].inverse_mass; }
  // 1 / (1/m_a + 1/m_b), kg.
  T EffectiveMass(const Candidate& c) const { return Divide(S(1), T(InverseMassA(c) + InverseMassB(c))); }
};

// Distance and normal of a candidate when the discs are where `position(i)` says.
template <typename T, typename PositionOf>
Separation<T> SeparationAt(const StepInput<T>& in, const Candidate& c, const PositionOf& position) {
  if (c.plane) return Separate<T>(position(c.a), in.planes[c.b]);
  return Separate<T>(position(c.a), position(c.b));
}

// Velocity of a relative to b when the discs have the velocities that `velocity(i)` says.
template <typename T, typename VelocityOf>
Vec2<T> RelativeVelocity(const Candidate& c, const VelocityOf& velocity) {
  if (c.plane) return velocity(c.a);
  return velocity(c.a) - velocity(c.b);
}

// Calls apply(i, change) with impulse / m_a for disc a and -impulse / m_b for disc b.
template <typename T, typename Apply>
void ApplyImpulse(const StepInput<T>& in, const Candidate& c, const Vec2<T>& impulse, const Apply& apply) {
  apply(c.a, Scale(in.InverseMassA(c), impulse));
  if (!c.plane) apply(c.b, Scale(T(-in.InverseMassB(c)), impulse));
}

// A contact model M has
//   static constexpr ModelTraits kTraits;
//   static constexpr int kRotation;                       numbers of rotation state per disc
//   template <typename T> BodyState<T, kRotation> Free(const StepInput<T>&, int i, const BodyState<T, kRotation>&)
//   const;
//       the step of disc i when it touches nothing. (p, v) -> (p', v') is affine and isotropic, with the same Jacobian
//       in every step, and force enters through Acceleration(i) only; the rotation depends on the rotation only.
//       Checked once, by derivatives at two states.
//   template <typename T> void Step(const StepInput<T>&, std::span<const BodyState<T, kRotation>> x,
//                                   std::span<BodyState<T, kRotation>> next) const;
//       the step of all discs. Contacts that take effect are reported (StepInput::Report): derivatives are taken of
//       what is reported, and all else is taken to fly. So
//         - a disc that no reported candidate has moves as by Free, bit by bit: checked in every step of every rollout,
//           which fails otherwise, and in Simulator::Step, whose result then is not a number;
//         - candidates that are not reported have no effect on discs that others have: what that does to the gradient,
//           the audit finds by differences;
//         - derivatives pass through the step: a value without them makes the gradient wrong, which the audit finds
//           too.
//       Iterations end, and a step that they do not bring to its result says so (StepInput::Fail).
// and may have
//   static std::string WhyNot(const Scene&)               a reason not to take a scene; empty if it does
//   static void InitialRotation(double* rotation)         kRotation numbers; zero by default
//   template <typename Visit> void VisitOptions(const Visit& visit)
//       calls visit(ModelOption, member) for each of its options; members are double, int or bool
//   void Linearize(const StepInput<double>&, std::span<const BodyState<double, kRotation>> x,
//                  Eigen::Ref<Eigen::MatrixXd> A, Eigen::Ref<Eigen::MatrixXd> B) const
//       if kTraits.published_jacobian: dense over the given discs, columns as in StepLinearization::Island; to
//       overwrite
//   bool complementarity_aware, an option, and
//   void PullBack(const StepInput<double>&, std::span<const BodyState<double, kRotation>> x,
//                 std::span<const double> after, std::span<double> before) const
//       with Linearize: if the option is set, PullBack takes the place of the transposed A and B in reverse sweeps, and
//       every contact that it looks at is reported as a touch (control/surrogate.h). From `after`, the cotangents of
//       the discs' next states, to `before`, those of their states and then of the forces on them.
template <typename M>
concept ContactModel = requires(const M& m, const StepInput<double>& in,
                                std::span<const BodyState<double, M::kRotation>> x,
                                std::span<BodyState<double, M::kRotation>> next) {
  { M::kTraits } -> std::convertible_to<ModelTraits>;
  { m.Free(in, 0, x[0]) } -> std::same_as<BodyState<double, M::kRotation>>;
  m.Step(in, x, next);
};

// A semi-implicit Euler step: the velocity first, the position with the new one.
template <typename T>
BodyState<T, 0> SemiImplicitEuler(Base<T> h, const Vec2<T>& acceleration, const BodyState<T, 0>& x) {
  BodyState<T, 0> next;
  next.v = x.v + Scale(h, acceleration);
  next.p = x.p + Scale(h, next.v);
  return next;
}
// Free flight of disc i by such a step.
template <typename T>
BodyState<T, 0> SemiImplicitEuler(const StepInput<T>& in, int i, const BodyState<T, 0>& x) {
  return SemiImplicitEuler<T>(in.h, in.Acceleration(i), x);
}

// Writes the free flight of every disc to `next`.
template <typename M, typename T>
void FreeFlight(const M& model, const StepInput<T>& in, std::span<const BodyState<T, M::kRotation>> x,
                std::span<BodyState<T, M::kRotation>> next) {
  for (int i = 0; i < static_cast<int>(x.size()); ++i) next[i] = model.Free(in, i, x[i]);
}

}  // namespace saltus
