#include "optimality/impact_jump.h"

#include "optimality/terminal_costate.h"

namespace saltus {

double ImpactJump::MultiplierAt(const Flight::Piece& piece, double speed, double gain) const {
  double power = gain;
  for (int side = 0; side < 2; ++side) {
    if (body[side] < 0) continue;
    const Vec2d& a = piece.acceleration[body[side]];
    power += after[side].position.dot(velocity_after[side]) + after[side].velocity.dot(a) -
             before[side].position.dot(velocity_before[side]) - before[side].velocity.dot(a);
    if (spin_gain[side] != 0) power += after[side].angle * spin_gain[side];
    if (!piece.turning.empty()) {
      power += (after[side].angular_velocity - before[side].angular_velocity) * piece.turning[body[side]];
    }
  }
  return power / speed;
}

Costate<double> FinalCostate(const Scene& scene, const DiscStates& end, int body) {
  const double angle = end.angle.empty() ? 0.0 : end.angle[body], spin = end.spin.empty() ? 0.0 : end.spin[body];
  const DiscCostate<double> last =
      TerminalCostate<double>(scene.objective, body, end.p[body], end.v[body], angle, spin);
  return {scene.duration, last.position, last.velocity, last.angle, last.angular_velocity};
}

ImpactJump MakeImpactJump(const Scene& scene, const Flight::Hit& hit, const std::array<Costate<double>, 2>& after) {
  const Candidate& c = hit.contact;
  const ImpactConstants law = MakeImpactConstants(scene, c);
  const std::array<double, 2> inverse_mass = {law.inverse_mass_a, law.inverse_mass_b};
  ImpactJump jump;
  jump.after = after;
  Vec2d y(0, 0);
  for (int side = 0; side < 2; ++side) {
    const int body = side == 0 ? c.a : c.plane ? -1 : c.b;
    if (inverse_mass[side] == 0) continue;
    const double sign = side == 0 ? 1 : -1;
    jump.body[side] = body;
    jump.velocity_before[side] = hit.before.v[body];
    jump.velocity_after[side] = hit.before.v[body] + sign * inverse_mass[side] * hit.impact.impulse;
    y += sign * inverse_mass[side] * after[side].velocity;
  }
  const CostateGain<double> gain =
      ImpactAdjoint(law, hit.impact, y, hit.before.SpinsOf(c), {after[0].angular_velocity, after[1].angular_velocity});
  for (int side = 0; side < 2; ++side) {
    const double sign = side == 0 ? 1 : -1;
    jump.before[side] = {hit.time,
                         after[side].position + sign * gain.position,
                         after[side].velocity + sign * gain.velocity,
                         after[side].angle,
                         after[side].angular_velocity + law.radius[side] * gain.spin};
    if (law.inverse_inertia[side] > 0) jump.spin_gain[side] = SpinGain(law, side, hit.impact);
  }
  return jump;
}

}  // namespace saltus
