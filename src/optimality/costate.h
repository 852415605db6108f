// The conditions of the hybrid minimum principle on a path of EventPhases.
//
// Costates obey lambda_q' = 0, lambda_v' = -lambda_q between impacts. Of a pushed disc they are read off its arcs,
// since stationarity, 2 effort u + lambda_v / m = 0, makes them
//
//   lambda_v = -2 effort m^2 (a + b (t - S/2)),   lambda_q = 2 effort m^2 b;
//
// those of all other discs are carried backwards from the end, where lambda = d(terminal terms). What remains is a
// square system in the variables of the path and one multiplier nu an impact, with psi the gap, g its map of states:
//
//   lambda- = Dg^T lambda+ + nu grad psi    for every pushed disc that takes part
//   H- = H+                                  H = effort |u|^2 + sum lambda_q.v + lambda_v.(u/m + g)
//   psi = 0                                  where no pushed disc takes part
//   lambda(T) = d(terminal terms)            for every disc that is pushed to the end.
//
// For forces that are constant on intervals, H is its mean over a phase; with intervals of length h that adds
// effort m^2 |b|^2 h^2 / 4 for every arc that spans the phase.
//
// Hu, Long, Zang, E, Han, "Solving optimal control of rigid-body dynamics with collisions using the hybrid minimum
// principle" (arXiv 2205.08622); the running cost enters through H.
#pragma once

#include "control/event_phases.h"
#include "optimality/costate_shooting.h"
#include "simulate/costate_sweep.h"

namespace saltus {

// Residuals of each condition, in the order above.
struct HmpSystem {
  explicit HmpSystem(const EventPhases* problem);

  int num_variables() const { return phases->num_variables() + phases->num_impacts(); }
  int num_impacts() const { return phases->num_impacts(); }

  // Computes the residuals. `y`: the path's variables, then multipliers. Returns false if there is no such path.
  template <typename T>
  bool Evaluate(const T* y, Path<T>* path, T* residuals) const;

  const EventPhases* phases;
  ConditionSizes sizes;
};

// ---------------------------------------------------------------------------------------------------- implementation

namespace internal {

template <typename T>
Costate<T> ArcCostate(const Scene& scene, const Arc<T>& arc, bool at_end) {
  const double mass = scene.bodies[arc.body].mass, scale = 2 * scene.objective.effort * mass * mass;
  const T time = at_end ? T(arc.from.time + arc.length) : arc.from.time;
  return {time, Scale(scale, arc.slope), Scale(-scale, at_end ? arc.AccelerationAtEnd() : arc.AccelerationAtStart())};
}

}  // namespace internal

template <typename T>
bool HmpSystem::Evaluate(const T* y, Path<T>* path, T* residuals) const {
  const Scene& scene = phases->scene();
  if (!phases->Unroll(y, path)) return false;
  const T* multipliers = y + phases->num_variables();
  T* jump = residuals;
  T* hamiltonian = jump + sizes.jumps;
  T* gap = hamiltonian + sizes.hamiltonians;
  T* terminal = gap + sizes.gaps;

  std::vector<Costate<T>> now;  // of every disc; of pushed ones only while they fly freely
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Knot<T>& end = path->end[i];
    now.push_back(TerminalCostate<T>(scene.objective, i, end.time, end.p, end.v));
    if (path->last_arc[i] < 0) continue;
    const Costate<T> costate = internal::ArcCostate(scene, path->arcs[path->last_arc[i]], true);
    for (int d = 0; d < 2; ++d) *terminal++ = costate.position[d] - now[i].position[d];
    for (int d = 0; d < 2; ++d) *terminal++ = costate.velocity[d] - now[i].velocity[d];
  }
  const auto power = [&](const Costate<T>& costate, const Vec2<T>& v, int body, const Vec2<T>* push) {
    T h = Dot(costate.position, v) + Dot(costate.velocity, scene.gravity);
    if (push != nullptr)
      h -= scene.objective.effort * scene.bodies[body].mass * scene.bodies[body].mass * Dot(*push, *push);
    return h;
  };
  for (int k = num_impacts() - 1; k >= 0; --k) {
    const Candidate& c = phases->sequence()[k];
    const PhaseImpact<T>& event = path->impacts[k];
    const ImpactConstants& law = phases->law(k);
    const std::array<int, 2> body = {c.a, c.plane ? -1 : c.b};
    std::array<Costate<T>, 2> after;
    Vec2<T> y_gain(T(0.0), T(0.0));
    T jump_of_h(0.0);
    for (int side = 0; side < 2; ++side) {
      if (body[side] < 0 || scene.bodies[body[side]].fixed) continue;
      const int arc = event.arc_after[side];
      after[side] =
          arc >= 0 ? internal::ArcCostate(scene, path->arcs[arc], false) : now[body[side]].CostateAt(event.time);
      y_gain += Scale(side == 0 ? law.inverse_mass_a : -law.inverse_mass_b, after[side].velocity);
      Vec2<T> push;
      if (arc >= 0) push = path->arcs[arc].AccelerationAtStart();
      jump_of_h += power(after[side], event.after[side], body[side], arc >= 0 ? &push : nullptr);
    }
    const CostateGain<T> gain = ImpactAdjoint(law, event.impact, y_gain);
    for (int side = 0; side < 2; ++side) {
      if (body[side] < 0 || scene.bodies[body[side]].fixed) continue;
      const double sign = side == 0 ? 1 : -1;
      Costate<T> before = after[side];
      before.position += Scale(sign, Vec2<T>(gain.position + Scale(multipliers[k], event.impact.normal)));
      before.velocity += Scale(sign, gain.velocity);
      const int arc = event.arc_before[side];
      Vec2<T> push;
      if (arc >= 0) {
        push = path->arcs[arc].AccelerationAtEnd();
        const Costate<T> steered = internal::ArcCostate(scene, path->arcs[arc], true);
        for (int d = 0; d < 2; ++d) *jump++ = steered.position[d] - before.position[d];
        for (int d = 0; d < 2; ++d) *jump++ = steered.velocity[d] - before.velocity[d];
        before = steered;
      } else {
        now[body[side]] = before;
      }
      jump_of_h -= power(before, event.before[side], body[side], arc >= 0 ? &push : nullptr);
    }
    *hamiltonian++ = jump_of_h + phases->GridHamiltonian(*path, k + 1) - phases->GridHamiltonian(*path, k);
    if (!phases->IsSteered(k)) *gap++ = event.gap;
  }
  return true;
}

inline HmpSystem::HmpSystem(const EventPhases* problem) : phases(problem) {
  sizes.hamiltonians = num_impacts();
  sizes.gaps = phases->num_gaps();
  for (const Candidate& c : phases->sequence()) {
    sizes.jumps += 4 * (phases->IsPushed(c.a) + (!c.plane && phases->IsPushed(c.b)));
  }
  for (int i = 0; i < phases->scene().num_bodies(); ++i) sizes.terminal += 4 * phases->IsAimed(i);
}

}  // namespace saltus
