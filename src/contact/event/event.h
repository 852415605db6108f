// Event-driven simulation of discs: exact flight between impacts, whose times are found to machine precision.
//
// The acceleration a = u/m + g of a disc is constant within a step. The gap of a pair is then a polynomial in time, of
// degree 4 for two discs, and an impact is its first zero (event_roots.h), however many lie in one step. With n the
// normal towards disc a, t = Perpendicular(n), w = v_a - v_b and 1/m = 1/m_a + 1/m_b, the impulse on a is
//
//   P = p_n n + p_t t       p_n = -(1 + e) m n.w                         (Newton's restitution)
//                           p_t = -mu p_n sign(t.w), but at most -m t.w  (Coulomb: slip, stick)
//
// Discs turn only in scenes with discs that spin (EventSpinning; law/impact.h has their impulse). Derivatives: the
// time of each event gets one Newton correction in T (event_motion.h). Carried through the impulse, that is the
// saltation matrix (e.g. Kong, Payne, Zhu, Johnson, arXiv 2306.06862).
//
// The README of this folder has the states of a pair and their transitions; event_step.h the parts of which a step is
// composed; thresholds.h all thresholds. The rules:
//
// Order. Events are resolved one by one, the earliest first; of impacts at the same time, up to rounding, that of
//   the first candidate (discs by index pairs, then walls). The pairs whose motion has changed are predicted again,
//   until no event is left. A row of equal discs thus passes an impact on, and a disc in a right-angled corner bounces
//   off both walls. Derivatives are those of this order, even where another order of impacts at the same time leads to
//   the same velocities: there the loss may have a kink. A step fails if it has more than kMaxEvents, if the forces of
//   contacts at rest are not found, or if at its end energy has grown, or discs overlap, by more than kLargestGain and
//   kLargestOverlap: where many contacts are sustained, the thresholds may not suffice.
// Ties. Impacts at the same time that share discs are reported as tied if another order leads to other velocities
//   (event_ties.h).
// Head-on. The derivative by mu at mu = 0 is the one from above. It is zero for an impact whose sliding speed is less
//   than kHeadOn of its closing speed: any friction makes it stick.
// Grid nodes. An event in the last kNodeMargin of a step belongs to the next step, which starts with it: its
//   derivative is the one-sided one with the force of that step on both sides of the event. A disc that stops on a
//   node is at rest before anything else happens there.
// Overlap. Discs that overlap by more than kContactGap (in given states only) have no impact time; if they close, they
//   meet at the start, and no position is changed.
// Rest. A pair that touches (gap up to kContactGap, |n.w| up to kSlowSpeed) and is accelerated into each other is
//   closed: its normal velocity becomes zero, and contact forces (solvers/resting_forces.h) keep the gap at zero until
//   other forces or an impact open it. That ends the bounces of e < 1 after finitely many; those of a pair by itself
//   end with a plastic impact, whose impulse is the sum of all that would follow. The contact sticks or slides by
//   Coulomb's law with the same mu; sliding ends at the exact time, or at once where friction jams the discs.
//   Derivatives are those of motion that, after a small disturbance, comes to rest on the contact again;
//   one_sided_derivatives.h says where they are one-sided. Reported as kSustained, again in every step.
// Piles. Without friction each inelastic bounce within a pile causes others, ever smaller and in ever shorter times
// (Zeno
//   behaviour). After kManyImpacts in a step, a pair that touches others and has met kRepeatedImpacts times more, and
//   its discs others as often, does not bounce below a speed that doubles with every further time, up to
//   kLargestSlowSpeed.
// Fallback. A step of kFewestFallbackDiscs or more that would fail, and one with Zeno behaviour of kManyDiscs or more,
//   is taken by one implicit time-stepping step instead (event_fallback.h): to first order in its length, without
//   restitution. Not of discs that spin, on tables, among pockets, or by a learned law. Its active contacts are
//   reported as sustained, all pairs of its discs without a time.
// Sub-steps. Two discs that slide along each other turn their normal: they move in sub-steps (event_sub_steps.h), of
//   order 8 with friction. Without, and in large groups of discs that do not spin, they are exactly in contact at the
//   end of each, and no work was done, but the time at which they are there is of second order in the sub-step, 1e-6 of
//   it. Everything else is exact.
// Spin. Discs that stick roll: their points of contact do not move along each other, and a disc begins and ceases to
//   roll as any contact begins and ceases to stick. Discs that roll around each other, or on a curved wall, do so in
//   sub-steps.
// Edges. The sides and ends of segments, polygons and arcs (walls.h) are met where they count, to kSeam. A disc that
//   slides off the end of one leaves it there: onto the next, around the end, or freely.
// Tables. Each disc slows at a constant rate against its velocity and stops at the exact time; both are reported as
//   sustained, of the disc and the table. There are no forces then, and no sustained contact of other pairs.
// Pockets. A disc whose centre reaches the rim of a pocket, to kSeam, is out of play: its contacts end, and it rests
//   there and touches nothing, whatever forces there are. If it comes with velocity v, at a normal n, its position
//   varies by (1 - v n^T / (n.v)) dp, and its velocity not at all. Reported as sustained, in the mode kPocketed, again
//   in every step.
// Grazing. A pair that meets with |n.w| up to kSlowSpeed and is not accelerated into each other loses that speed (with
//   all that they touch), or passes if it separates before the gap is -kContactGap. kGrazing if alone; the derivative
//   is that of the side on which the two do not touch, without their shift in time if they meet slower than
//   kSharpSpeed.
#pragma once

#include <type_traits>

#include "contact/event/event_fallback.h"
#include "contact/event/event_step.h"

namespace saltus {
namespace internal {

// A step of `model` by the time-stepping fallback.
template <typename M, typename T, typename State>
void TakeTimeSteppingStep(const M& model, const StepInput<T>& in, std::span<const State> x, std::span<State> next) {
  TimeSteppingStep<T> step(in, x);
  const std::string_view why = step.Run();
  if (!why.empty()) in.Fail(why);
  const T none(std::numeric_limits<double>::quiet_NaN());
  for (int i = 0; i < static_cast<int>(x.size()); ++i) {
    next[i] = step.HasMoved(i) ? step.End(i) : model.Free(in, i, x[i]);
    if (!why.empty()) next[i] = {{none, none}, {none, none}};
  }
}

// A step of `model` with candidates, whose impacts obey `law` (event_step.h). It is not inlined even where its caller
// is flattened, as its own parts are: the whole would compile for minutes and be no faster.
template <typename M, typename T, typename Law, typename State>
[[gnu::noinline]] void TakeEventStep(const M& model, const StepInput<T>& in, const Law& law, std::span<const State> x,
                                     std::span<State> next) {
  if constexpr (M::kRotation == 0) {
    if (TimeSteppingStep<T>::IsRecorded(in)) return TakeTimeSteppingStep(model, in, x, next);
  }
  EventStep<T, M::kRotation, Law> step(in, law, x);
  // Derivatives are asked for only of steps in which something happens.
  if constexpr (std::is_same_v<T, double>) {
    if (!step.MayHaveContact()) return FreeFlight(model, in, x, next);
  }
  step.Run();
  if constexpr (step.kMayFallBack) {
    if (step.FallsBack()) return TakeTimeSteppingStep(model, in, x, next);
  }
  for (int i = 0; i < static_cast<int>(x.size()); ++i)
    next[i] = step.HasMoved(i) ? step.End(i) : model.Free(in, i, x[i]);
}

}  // namespace internal

template <int kTurn>
struct EventDrivenOf {
  static constexpr ModelTraits kTraits = {.name = "event",
                                          .summary = "event-driven: exact arcs, impacts and impact times",
                                          .source = "saltation matrix; Newton's restitution, Coulomb's friction",
                                          .double_engine = true,
                                          .chains = true,
                                          .event_driven = true,
                                          .sequential = true,
                                          .relative = true,
                                          .by_pair = true};
  static constexpr int kRotation = kTurn;
  static constexpr bool kLinearRotation = kTurn > 0;
  static constexpr int kTapedFrom = 5;  // discs
  static std::string ReasonNotApplicable(const Scene& scene) {
    if (!scene.table) return "";
    if (scene.Spins()) return "discs that spin on a table: how its friction slows their spin is not modelled";
    if (!scene.control.bodies.empty())
      return "forces on a table: its friction turns with the velocity, on no exact arc";
    return scene.gravity.isZero(0) ? ""
                                   : "gravity along a table: its friction turns with the velocity, on no exact arc";
  }
  template <typename T>
  using State = BodyState<T, kRotation>;

  template <typename T, typename H>
  State<T> Free(const StepInput<T, H>& in, int i, const State<T>& x) const {
    const Vec2<T> a = in.Acceleration(i);
    const Vec2<T> p = x.p + Scale(in.h, Vec2<T>(x.v + Scale(in.h * 0.5, a))), v = x.v + Scale(in.h, a);
    if constexpr (kRotation == kSpin) {
      const T turning = in.AngularAcceleration(i);
      return {p, v, {x.rotation[0] + in.h * (x.rotation[1] + (in.h * 0.5) * turning), x.rotation[1] + in.h * turning}};
    } else {
      return {p, v};
    }
  }

  template <typename T>
  void Step(const StepInput<T>& in, std::span<const State<T>> x, std::span<State<T>> next) const {
    if (in.candidates.empty()) return FreeFlight(*this, in, x, next);
    internal::TakeEventStep(*this, in, internal::SceneLaw<T>{in}, x, next);
  }
};

using EventSpinning = EventDrivenOf<kSpin>;
struct EventDriven : EventDrivenOf<0> {
  using Spinning = EventSpinning;
};

}  // namespace saltus
