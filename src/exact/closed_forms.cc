#include "exact/closed_forms.h"

#include <algorithm>

#include "exact/flow.h"
#include "saltus/control/objective.h"
#include "scene/units.h"

namespace saltus {
namespace {

using namespace exact_internal;  // NOLINT: the parts of the closed forms

// A phase between two collisions, with the derivatives of the loss by a change of the motion at its start.
struct Phase {
  double start = 0;
  double end = 0;
  std::vector<Motion<double>> costate;  // per body: by position, by velocity
};

// A force du on body i during [a, b] inside a phase changes everything that follows as a change of the motion at the
// start of the phase does: du (b - a)/m in velocity and minus that, times the mean time passed, in position.
Vec2d ForceGradient(const Phase& phase, int i, double mass, double a, double b) {
  const Motion<double>& costate = phase.costate[i];
  return (b - a) / mass * (costate.velocity - (0.5 * (a + b) - phase.start) * costate.position);
}

std::vector<std::vector<Vec2d>> ControlGradient(const Scene& scene, const std::vector<Phase>& phases) {
  std::vector<std::vector<Vec2d>> gradient;
  if (scene.num_controlled() == 0) return gradient;
  for (int k = 0; k < scene.steps; ++k) {
    std::vector<Vec2d> step;
    for (int c = 0; c < scene.num_controlled(); ++c) {
      const int i = scene.control.bodies[c];
      Vec2d g = 2 * scene.objective.effort * scene.dt() * scene.control.initial[c];
      for (const Phase& phase : phases) {
        const double a = std::max(k * scene.dt(), phase.start);
        const double b = std::min((k + 1) * scene.dt(), phase.end);
        if (a < b) g += ForceGradient(phase, i, scene.bodies[i].mass, a, b);
      }
      step.push_back(g);
    }
    gradient.push_back(step);
  }
  return gradient;
}

// Returns `motion` with unit derivatives of its four numbers, from dual part `first` on.
template <typename T>
Motion<T> Seed(const Motion<double>& motion, int first) {
  Motion<T> seeded;
  for (int c = 0; c < 2; ++c) {
    seeded.position[c] = T(motion.position[c], first + c);
    seeded.velocity[c] = T(motion.velocity[c], first + 2 + c);
  }
  return seeded;
}

template <typename T>
Motion<double> Costate(const T& loss, int first) {
  return {Vec2d(loss.v[first], loss.v[first + 1]), Vec2d(loss.v[first + 2], loss.v[first + 3])};
}

// Sets all of `form` but family and events. Precondition: phases[0] starts at time 0.
void Complete(const Scene& scene, double terminal, const std::vector<Motion<double>>& final,
              const std::vector<Phase>& phases, ClosedForm* form) {
  form->terminal = terminal;
  for (const Vec2d& u : scene.control.initial) {
    form->running += scene.objective.effort * u.squaredNorm() * scene.duration;
  }
  form->loss = form->terminal + form->running;
  for (int i = 0; i < scene.num_bodies(); ++i) {
    form->position.push_back(final[i].position);
    form->velocity.push_back(final[i].velocity);
    form->gradient.position.push_back(phases[0].costate[i].position);
    form->gradient.velocity.push_back(phases[0].costate[i].velocity);
  }
  form->gradient.control = ControlGradient(scene, phases);
}

// --- One disc among planes. Jets: position, velocity, restitution, friction. ---

using DiscJet = ceres::Jet<double, 6>;

std::optional<ClosedForm> DiscAmongPlanes(const Scene& scene, std::string* reason_not_applicable) {
  const std::optional<DiscPath> path = FollowDisc(scene, reason_not_applicable);
  if (!path) return std::nullopt;
  const ContactLaw<DiscJet> law = {DiscJet(scene.contact.restitution, 4), DiscJet(scene.contact.friction, 5)};
  ClosedForm form;
  form.family = "disc among planes";
  form.events = path->events;
  std::vector<Phase> phases;
  std::vector<Motion<double>> final;
  DiscJet whole;
  for (size_t j = 0; j < path->phase_start.size(); ++j) {
    const double start = j == 0 ? 0 : path->events[j - 1].time;
    const double end = j < path->hits.size() ? path->events[j].time : scene.duration;
    const PlaneSequence left(path->hits.begin() + static_cast<long>(j), path->hits.end());
    const auto end_motion = FlyAlong(scene, law, left, Seed<DiscJet>(path->phase_start[j], 0), start);
    if (!end_motion) return Refuse(reason_not_applicable, "the disc grazes a plane");
    const DiscJet loss = TerminalLoss<DiscJet>(scene.objective, {*end_motion});
    phases.push_back({start, end, {Costate(loss, 0)}});
    if (j > 0) continue;
    whole = loss;
    final.push_back({Vec2d(end_motion->position[0].a, end_motion->position[1].a),
                     Vec2d(end_motion->velocity[0].a, end_motion->velocity[1].a)});
  }
  Complete(scene, whole.a, final, phases, &form);
  form.gradient.restitution = whole.v[4];
  form.gradient.friction = whole.v[5];
  return form;
}

// --- Two discs. Jets: position and velocity of either, restitution, friction. ---

using PairJet = ceres::Jet<double, 10>;

PairParameters MakePair(const Scene& scene) {
  return {scene.bodies[0].radius + scene.bodies[1].radius,
          scene.bodies[0].mass,
          scene.bodies[1].mass,
          InitialAcceleration(scene, 0),
          InitialAcceleration(scene, 1)};
}

// Returns |first - second|^2 - (contact distance)^2 as a polynomial in the time from now. It is exactly 0 at time 0 if
// the discs touch.
Polynomial SquaredGap(const PairParameters& pair, const DiscPair<double>& discs) {
  const Vec2d d = discs.first.position - discs.second.position;
  const Vec2d w = discs.first.velocity - discs.second.velocity;
  const Vec2d a = pair.acceleration_first - pair.acceleration_second;
  const double gap = d.squaredNorm() - pair.contact_distance * pair.contact_distance;
  const bool touching = gap < 4 * pair.contact_distance * kTouching;
  return {touching ? 0 : gap, 2 * d.dot(w), w.squaredNorm() + d.dot(a), w.dot(a), a.squaredNorm() / 4};
}

enum class Meeting { kNone, kImpact, kResting };

// Finds whether and when the discs collide within `remaining`, s; a contact at time 0 counts if they approach.
Meeting FindMeeting(const PairParameters& pair, const DiscPair<double>& discs, double remaining, double* when) {
  Polynomial gap = SquaredGap(pair, discs);
  *when = 0;
  if (gap[0] == 0) {
    const double speed = gap[1] / (2 * pair.contact_distance);
    if (speed < -kGrazing) return Meeting::kImpact;
    if (speed < kGrazing && gap[2] < 0) return Meeting::kResting;
    gap.erase(gap.begin());  // the root at time 0
    if (speed < kGrazing) gap.erase(gap.begin());
  }
  const std::vector<double> roots = RootsBetween(gap, 0, remaining);
  if (roots.empty()) return Meeting::kNone;
  *when = roots.front();
  return Meeting::kImpact;
}

bool Approaches(const DiscPair<double>& discs) {
  const Vec2d d = discs.first.position - discs.second.position;
  return d.dot(discs.first.velocity - discs.second.velocity) < -kGrazing * d.norm();
}

Phase PairPhase(const PairJet& loss, double start, double end) {
  return {start, end, {Costate(loss, 0), Costate(loss, 4)}};
}

DiscPair<PairJet> SeedPair(const DiscPair<double>& discs) {
  return {Seed<PairJet>(discs.first, 0), Seed<PairJet>(discs.second, 4)};
}

// Returns the last phase, which has no collision, from `discs` at `start` to the end of the scene.
Phase LastPhase(const Scene& scene, const PairParameters& pair, const DiscPair<double>& discs, double start) {
  const DiscPair<PairJet> end = FlyBoth(pair, SeedPair(discs), PairJet(scene.duration - start));
  const PairJet loss = TerminalLoss<PairJet>(scene.objective, {end.first, end.second});
  return PairPhase(loss, start, scene.duration);
}

std::optional<ClosedForm> TwoDiscs(const Scene& scene, std::string* reason_not_applicable) {
  const PairParameters pair = MakePair(scene);
  const DiscPair<double> start = {InitialMotion(scene, 0), InitialMotion(scene, 1)};
  ClosedForm form;
  form.family = "two discs";
  double impact = 0;
  const Meeting meeting = FindMeeting(pair, start, scene.duration, &impact);
  if (meeting == Meeting::kResting) return Refuse(reason_not_applicable, "the discs rest on each other");
  if (meeting == Meeting::kNone) {
    const DiscPair<double> end = FlyBoth(pair, start, scene.duration);
    const std::vector<Motion<double>> final = {end.first, end.second};
    Complete(scene, TerminalLoss(scene.objective, final), final, {LastPhase(scene, pair, start, 0)}, &form);
    return form;
  }
  if (!Approaches(FlyBoth(pair, start, impact))) return Refuse(reason_not_applicable, "the discs graze each other");
  const ContactLaw<double> law = {scene.contact.restitution, scene.contact.friction};
  ExactEvent event = {impact, scene.bodies[0].name, scene.bodies[1].name, {}};
  const DiscPair<double> after = CollideOnce(pair, law, start, impact, impact, &event.mode);
  double again = 0;
  if (FindMeeting(pair, after, scene.duration - impact, &again) != Meeting::kNone) {
    return Refuse(reason_not_applicable, "the discs collide twice, or stay in contact");
  }
  const ContactLaw<PairJet> seeded_law = {PairJet(scene.contact.restitution, 8), PairJet(scene.contact.friction, 9)};
  const DiscPair<PairJet> end = CollideOnce(pair, seeded_law, SeedPair(start), impact, scene.duration);
  const PairJet loss = TerminalLoss<PairJet>(scene.objective, {end.first, end.second});
  const DiscPair<double> final = FlyBoth(pair, after, scene.duration - impact);
  Complete(scene,
           loss.a,
           {final.first, final.second},
           {PairPhase(loss, 0, impact), LastPhase(scene, pair, after, impact)},
           &form);
  form.gradient.restitution = loss.v[8];
  form.gradient.friction = loss.v[9];
  form.events.push_back(event);
  return form;
}

ClosedForm Convert(ClosedForm form, const Units& from, const Units& to) {
  const UnitFactors by(from, to);
  form.terminal = ConvertLoss(form.terminal, from, to);
  form.running *= by.loss;
  form.loss = ConvertLoss(form.loss, from, to);
  for (Vec2d& position : form.position) position = ConvertPosition(position, from, to);
  for (Vec2d& velocity : form.velocity) velocity *= by.speed;
  ExactGradient& gradient = form.gradient;
  for (Vec2d& entry : gradient.position) entry *= by.loss / by.length;
  for (Vec2d& entry : gradient.velocity) entry *= by.loss / by.speed;
  for (std::vector<Vec2d>& step : gradient.control) {
    for (Vec2d& entry : step) entry *= by.loss / by.force;
  }
  gradient.restitution *= by.loss;
  gradient.friction *= by.loss;
  for (ExactEvent& event : form.events) event.time *= by.time;
  return form;
}

}  // namespace

std::optional<ClosedForm> EvaluateClosedForm(const Scene& scene, std::string* reason_not_applicable) {
  if (std::string wrong = ValidateForClosedForm(scene); !wrong.empty()) return Refuse(reason_not_applicable, wrong);
  if (const std::string beyond = NonTerminalTerms(scene.objective); !beyond.empty()) {
    return Refuse(reason_not_applicable,
                  "the scene has " + beyond + "; the closed forms are of terminal costs and effort");
  }
  if (!scene.units.natural) {
    const Scene natural = ToNaturalUnits(scene);
    const std::optional<ClosedForm> form = EvaluateClosedForm(natural, reason_not_applicable);
    return form ? std::optional(Convert(*form, natural.units, scene.units)) : std::nullopt;
  }
  for (const Body& body : scene.bodies) {
    if (body.fixed) return Refuse(reason_not_applicable, "a disc is fixed");
  }
  if (scene.num_bodies() == 1) return DiscAmongPlanes(scene, reason_not_applicable);
  if (scene.num_bodies() == 2 && scene.planes.empty()) return TwoDiscs(scene, reason_not_applicable);
  return Refuse(reason_not_applicable, "neither one disc among planes nor two discs alone");
}

}  // namespace saltus
