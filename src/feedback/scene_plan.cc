// Plan and linearization of the exact motion of a scene.
#include <algorithm>
#include <numeric>
#include <string>
#include <vector>

#include "base/number_text.h"
#include "feedback/scene_intervals.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/feedback/closed_loop.h"
#include "saltus/scene/walls.h"
#include "saltus/simulate/events.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/one_sided_derivatives.h"
#include "scene/units.h"
#include "solve/control_guess.h"

namespace saltus {
namespace {

std::string NamesOf(const Scene& scene, const Candidate& c) {
  return scene.bodies[c.a].name + " and " + (c.plane ? WallNamesOf(scene)[c.b] : scene.bodies[c.b].name);
}

// "a and b, a and c" of what touches in an interval.
std::string TouchesOf(const SceneIntervals& motion, int k) {
  std::string names;
  std::vector<Candidate> named;
  for (const Touch& touch : motion.touches(k)) {
    if (std::ranges::find(named, touch.candidate) != named.end()) continue;
    named.push_back(touch.candidate);
    names += (names.empty() ? "" : ", ") + NamesOf(motion.simulator().scene(), touch.candidate);
  }
  return names;
}

// The first contact that comes to rest while another contact of one of its discs does, as text, and how many more there
// are: their bounces accumulate together, in an order that every disturbance changes. Empty if there is none.
std::string ContactsThatRestTogether(const SceneIntervals& motion) {
  constexpr int kLast = 3;  // impacts of a contact before it rests that are the end of its bounces
  const Scene& scene = motion.simulator().scene();
  struct Impact {
    Candidate pair;
    double time = 0;    // s
    bool ends = false;  // the contact lasts from then on
  };
  std::vector<Impact> impacts;
  const auto moves_in = [&](int body, const Candidate& pair) {
    return !scene.bodies[body].fixed && (body == pair.a || (!pair.plane && body == pair.b));
  };
  std::string first;
  int count = 0;
  for (int k = 0; k < motion.size(); ++k) {
    for (const Touch& touch : motion.touches(k)) {
      const Candidate& pair = touch.candidate;
      const double time = motion[k].begin + touch.time;
      if (touch.time >= 0 && touch.kind == ContactKind::kImpact) impacts.push_back({pair, time});
      if (touch.time < 0 || touch.kind != ContactKind::kSustained) continue;
      int own = 0;
      const Impact* other = nullptr;
      for (auto at = impacts.rbegin(); at != impacts.rend() && own < kLast && !(at->ends && at->pair == pair); ++at) {
        own += at->pair == pair;
        if (at->pair == pair || at->ends) continue;
        if (moves_in(pair.a, at->pair) || (!pair.plane && moves_in(pair.b, at->pair))) other = &*at;
      }
      if (own == kLast && other != nullptr && ++count == 1) {
        first = "the contacts of " + NamesOf(scene, pair) + " and of " + NamesOf(scene, other->pair) +
                " come to rest together at t = " + ToText(time, 6) + " s";
      }
      impacts.push_back({pair, time, true});
    }
  }
  if (count > 1) first += ", and " + std::to_string(count - 1) + " more do so";
  return first;
}

// Where derivatives do not describe small disturbances, or from one side only.
std::string RemarkOn(const SceneIntervals& motion, const Scene& at_start) {
  std::vector<Tie> ties;
  int unresolved = 0;
  double start = 0;
  for (const std::unique_ptr<Simulator>& part : motion.simulators()) {
    for (Tie& tie : TiesOf(*part)) {
      tie.time += start;
      ties.push_back(std::move(tie));
    }
    unresolved += NumUnresolvedSteps(*part);
    start += part->scene().duration;
  }
  std::string remark;
  const auto add = [&](const std::string& text) {
    if (!text.empty()) remark += (remark.empty() ? "" : "; ") + text;
  };
  add(TiesToString(ties));
  if (unresolved > 0) {
    add(DescribeUnresolved(unresolved, motion.size()) + ": probabilities ignore the impacts in them");
  }
  if (const std::string together = ContactsThatRestTogether(motion); !together.empty()) {
    add(together +
        ": disturbances change the order of their last impacts, and derivatives do not describe what follows");
  }
  for (const SceneEvent& event : PlannedEvents(motion)) {
    const Touch& touch = motion.touches(event.label.interval)[event.touch];
    if (touch.kind != ContactKind::kGrazing) continue;
    add(NamesOf(at_start, touch.candidate) + " graze each other at t = " +
        ToText(motion[event.label.interval].begin + touch.time, 6) + " s: derivatives are one-sided");
    break;
  }
  std::string discs;
  int last = -1;
  for (const OneSided& one : OneSidedDerivatives(ToNaturalUnits(at_start))) {
    if (one.body != last) discs += (discs.empty() ? "" : ", ") + at_start.bodies[one.body].name;
    last = one.body;
  }
  if (!discs.empty()) {
    add("discs touch at the start: derivatives by the initial state of " + discs + " are one-sided");
  }
  return remark;
}

}  // namespace

ScenePlan PlanScene(Scene scene, const std::vector<double>& initial, const std::vector<double>& control,
                    const std::vector<double>& durations) {
  const auto width = static_cast<std::size_t>(scene.control_width());
  if (!durations.empty()) scene.duration = std::accumulate(durations.begin(), durations.end(), 0.0);
  if (width > 0) scene.steps = static_cast<int>(control.size() / width);
  ScenePlan planned;
  const Contact event(ExactModel()->name);
  planned.reason = ReasonNotApplicable(event, scene);
  if (const std::string beyond = NonBallisticForces(scene); planned.reason.empty() && !beyond.empty()) {
    planned.reason = "the scene has " + beyond +
                     "; feedback is planned along flights of constant acceleration: use the scene as a hybrid system "
                     "(saltus.hybrid_problem), whose regulators take it";
  }
  if (planned.reason.empty() && width > 0) planned.reason = Validate(ControlGuess{control, durations}, scene);
  if (!planned.reason.empty()) return planned;
  planned.lengths = durations;
  if (width == 0 || durations.empty()) planned.lengths.assign(scene.steps, scene.dt());
  SceneIntervals motion(event, scene, planned.lengths);
  planned.reason = motion.Rollout(initial, control);
  if (!planned.reason.empty()) return planned;
  planned.linear = Linearize(motion, control);
  for (int k = 0; k < motion.size(); ++k) {
    const LinearInterval& interval = planned.linear.intervals[k];
    if (interval.A.allFinite() && interval.B.allFinite()) continue;
    planned.reason = "the motion has no derivative: in the interval from t = " + ToText(motion[k].begin, 6) +
                     " s on, in which " + TouchesOf(motion, k) + " touch";
    return planned;
  }
  planned.plan = MakePlan(motion, control);
  for (int i = 0; i < scene.num_bodies(); ++i) {
    scene.bodies[i].position = Vec2d(initial[4 * i], initial[4 * i + 1]);
    scene.bodies[i].velocity = Vec2d(initial[4 * i + 2], initial[4 * i + 3]);
    if (scene.Spins()) scene.bodies[i].angular_velocity = initial[4 * scene.num_bodies() + kSpin * i + 1];
  }
  for (int c = 0; c < scene.num_controlled(); ++c) scene.control.initial[c] = Vec2d(control[2 * c], control[2 * c + 1]);
  planned.remark = RemarkOn(motion, scene);
  return planned;
}

}  // namespace saltus
