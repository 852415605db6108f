#include "saltus/simulate/events.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <tuple>

#include "base/number_text.h"
#include "contact/event/event_ties.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/scene/walls.h"
#include "simulate/broad_phase.h"
#include "simulate/interval_gaps.h"

namespace saltus {
namespace {

constexpr double kSameGraze = 1e-6;  // of the duration: a pair that grazes on a node is found on both of its sides

// The discs of a scene, of which the pairs that come near each other in a step are sought, with those that touch.
BroadPhase NearPairs(const Simulator& simulator, std::span<const double> control, const std::vector<WallPart>& walls) {
  const Scene& scene = simulator.scene();
  std::vector<BroadPhase::Disc> discs;
  std::vector<double> push(scene.bodies.size()), force(simulator.force_size());
  double touching = 0;
  for (const Body& body : scene.bodies) {
    discs.push_back({body.radius, body.mass, body.fixed, body.Spins() ? body.MomentOfInertia() / body.mass : 0});
    touching = std::max(touching, IntervalGaps::kTouching * body.radius);
  }
  for (int k = 0; k < simulator.num_steps(); ++k) {
    simulator.ExpandForce(control, k, force);
    for (int i = 0; i < scene.num_bodies(); ++i) {
      push[i] = std::max(push[i], std::hypot(force[2 * i], force[2 * i + 1]) / scene.bodies[i].mass);
    }
  }
  const double slowing = scene.table ? scene.table->friction * scene.table->gravity : 0;
  for (double& most : push) most += scene.gravity.norm() + slowing;
  BroadPhase near(walls,
                  std::move(discs),
                  {.dt = simulator.step(),
                   .chains = true,
                   .push_gap = touching,
                   .rounding = std::numeric_limits<double>::epsilon(),
                   .all_parts = true});
  near.SetAccelerations(push);
  return near;
}

// Whether the gap of discs that have no contact in a step may be zero where it is least within the step, or at its
// beginning or end. Relative motion differs by at most a part of its change of velocity from a straight one.
bool MayGraze(const Simulator& simulator, const Candidate& pair, std::span<const WallPart> walls,
              const std::vector<double>& begin, const std::vector<double>& end) {
  constexpr double kMoreThanReach = 1e-3;  // of the radii
  const std::vector<Body>& bodies = simulator.scene().bodies;
  const int a = simulator.body_size() * pair.a, b = simulator.body_size() * pair.b;
  const double radius = bodies[pair.a].radius;
  const auto of_a = [&](const std::vector<double>& x, int from) { return Vec2d(x[a + from], x[a + from + 1]); };
  if (pair.plane) {
    const WallPart& part = walls[pair.b];
    const double reach = part.pocket ? kMoreThanReach * radius : (1 + kMoreThanReach) * radius;
    const auto from = Separate<double>(of_a(begin, 0), part.wall), to = Separate<double>(of_a(end, 0), part.wall);
    if (from.distance <= reach || to.distance <= reach) return true;
    return Dot(from.normal, of_a(begin, 2)) < 0 && Dot(to.normal, of_a(end, 2)) >= 0;
  }
  const auto offset = [&](const std::vector<double>& x, int from) {
    return Vec2d(of_a(x, from) - Vec2d(x[b + from], x[b + from + 1]));
  };
  const Vec2d from = offset(begin, 0), to = offset(end, 0), v = offset(begin, 2), after = offset(end, 2);
  const double reach = (1 + kMoreThanReach) * (radius + bodies[pair.b].radius);
  if (from.squaredNorm() <= reach * reach || to.squaredNorm() <= reach * reach) return true;
  if (Dot(from, v) >= 0 || Dot(to, after) < 0) return false;
  const double along = Dot(from, v), off = 0.5 * (after - v).norm() * simulator.step();
  return from.squaredNorm() - along * along / v.squaredNorm() <= (reach + off) * (reach + off);
}

// Calls add(k, pair, time in step k) for the pairs that come within rounding of each other and do not touch.
template <typename Add>
void AddLeastGaps(const Simulator& simulator, std::span<const double> control, const std::vector<WallPart>& walls,
                  const Add& add) {
  const double h = simulator.step();
  BroadPhase near = NearPairs(simulator, control, walls);
  std::vector<double> force(simulator.force_size());
  std::vector<Candidate> candidates, falling, falling_before;
  std::vector<Touch> now;
  std::vector<char> meets(simulator.scene().bodies.size());
  std::vector<IntervalGaps::Stretch> stretches;
  auto touch = simulator.touches().begin();
  FlightState begin{0, std::vector<double>(simulator.state_size())}, end{h, begin.x};
  for (int k = 0, next = 0, last = -1; k < simulator.num_steps(); k = next) {  // last: the node of the state `end`
    if (k == last) {
      begin.x.swap(end.x);
    } else {
      simulator.GetState(k, begin.x);
    }
    next = k + near.Find(begin.x.data(), simulator.body_size(), &candidates);
    falling_before.swap(falling);
    falling.clear();
    if (candidates.empty()) continue;
    simulator.GetState(k + 1, end.x);
    last = k + 1;
    now.clear();
    std::fill(meets.begin(), meets.end(), 0);
    while (touch != simulator.touches().end() && touch->step < k) ++touch;
    for (; touch != simulator.touches().end() && touch->step == k; ++touch) {
      now.push_back(touch->touch);
      const Candidate& c = touch->touch.candidate;
      meets[c.a] = meets[c.plane ? c.a : c.b] = 1;
    }
    std::erase_if(candidates, [&](const Candidate& c) {
      if (c.plane && walls[c.b].table) return true;
      return meets[c.a] == 0 && (c.plane || meets[c.b] == 0) && !MayGraze(simulator, c, walls, begin.x, end.x);
    });
    if (candidates.empty()) continue;
    simulator.ExpandForce(control, k, force);
    const IntervalGaps gaps(simulator.scene(), walls, now, force, begin, end);
    for (const Candidate& candidate : candidates) {
      const GapPair pair = gaps.PairOf(candidate);
      if (IntervalGaps::Touches(now, pair)) continue;
      const double touching = gaps.Touching(pair);
      gaps.FindStretches(pair, &stretches);
      const auto look = [&](const IntervalGaps::Stretch& stretch, std::optional<double> t) {
        if (!t || std::abs(gaps.At(stretch, pair, *t).value) > touching) return;
        if (pair.wall != nullptr && !pair.wall->extent.Covers(gaps.PositionOfA(stretch, pair, *t), touching)) return;
        add(k, pair, *t);
      };
      // The gap of a pair that is least on a node falls until there, and rises from there on.
      const Gap at_node = gaps.At(begin, pair, 0);
      const bool may_graze = at_node.rate >= 0 && at_node.value <= touching;
      const bool fell = std::ranges::find(falling_before, candidate) != falling_before.end();
      if (may_graze && fell && !stretches.empty() && stretches.front().from == 0) look(stretches.front(), 0.0);
      for (const IntervalGaps::Stretch& stretch : stretches) look(stretch, gaps.LeastIn(stretch, pair));
      if (gaps.At(end, pair, h).rate < 0) falling.push_back(candidate);
    }
  }
}

}  // namespace

std::vector<StepTouch> EventTouches(const Simulator& simulator) {
  std::vector<StepTouch> events;
  std::map<std::tuple<bool, int, int, ContactMode>, int> pressed_in;  // the last step of a pair's sustained contact
  for (const StepTouch& at : simulator.touches()) {
    if (at.touch.time < 0) continue;
    if (at.touch.kind == ContactKind::kSustained) {
      const Candidate& c = at.touch.candidate;
      const auto [last, first_time] = pressed_in.try_emplace({c.plane, c.a, c.b, at.touch.mode}, at.step);
      const bool goes_on = !first_time && at.step <= last->second + 1;
      last->second = at.step;
      if (goes_on) continue;
    }
    events.push_back(at);
  }
  return events;
}

std::vector<Event> EventsOf(const Simulator& simulator) {
  const Scene& scene = simulator.scene();
  std::vector<Event> events;
  const std::vector<StepTouch> touches = EventTouches(simulator);
  if (touches.empty()) return events;
  const std::vector<std::string> walls = WallNamesOf(scene);
  for (const StepTouch& at : touches) {
    const Candidate& c = at.touch.candidate;
    events.push_back({at.step * simulator.step() + at.touch.time,
                      scene.bodies[c.a].name,
                      c.plane ? walls[c.b] : scene.bodies[c.b].name,
                      at.touch.mode});
  }
  return events;
}

std::vector<Event> GrazesOf(const Simulator& simulator, std::span<const double> control) {
  if (!simulator.traits().event_driven) return {};
  const Scene& scene = simulator.scene();
  const std::vector<WallPart> walls = WallPartsOf(scene);
  std::vector<Event> grazes;
  const auto add = [&](int k, const GapPair& pair, double t) {
    Event event{k * simulator.step() + t,
                scene.bodies[pair.a].name,
                pair.wall != nullptr ? pair.wall->name : scene.bodies[pair.b].name};
    grazes.push_back(std::move(event));
  };
  const std::vector<StepTouch>& touches = simulator.touches();
  for (const StepTouch& at : touches) {
    const Candidate& c = at.touch.candidate;
    if (at.touch.kind == ContactKind::kGrazing)
      add(at.step, {c.a, c.b, c.plane ? &walls[c.b] : nullptr}, at.touch.time);
  }
  if (NonBallisticForces(scene).empty()) AddLeastGaps(simulator, control, walls, add);
  std::ranges::stable_sort(grazes, {}, &Event::time);
  const auto is_same = [&](const Event& one, const Event& other) {
    return one.a == other.a && one.b == other.b && other.time - one.time <= kSameGraze * scene.duration;
  };
  const auto repeated = std::ranges::unique(grazes, is_same);
  grazes.erase(repeated.begin(), repeated.end());
  return grazes;
}

int NumUnresolvedSteps(const Simulator& simulator) {
  if (!simulator.traits().event_driven) return 0;
  int steps = 0, last = -1;
  for (const StepTouch& at : simulator.touches()) {
    if (at.touch.time >= 0 || at.step == last) continue;
    last = at.step;
    ++steps;
  }
  return steps;
}

std::string DescribeUnresolved(int unresolved_steps, int num_steps) {
  if (unresolved_steps == 0) return "";
  return std::to_string(unresolved_steps) + " of " + std::to_string(num_steps) +
         " steps use the time-stepping fallback, as impacts of many discs accumulate in them";
}

std::vector<Tie> TiesOf(const Simulator& simulator) {
  struct Group {
    double time;
    std::set<std::tuple<bool, int, int>> contacts;
    std::set<std::pair<bool, int>> bodies;  // planes last
  };
  const Scene& scene = simulator.scene();
  const std::vector<StepTie>& tied = simulator.ties();
  std::vector<Group> groups;
  for (size_t begin = 0, end = 0; begin < tied.size(); begin = end) {
    Group group{tied[begin].step * simulator.step() + tied[begin].contact.time, {}, {}};
    for (; end < tied.size() && tied[end].step == tied[begin].step && tied[end].contact.tie == tied[begin].contact.tie;
         ++end) {
      const Candidate& c = tied[end].contact.candidate;
      group.contacts.insert({c.plane, c.a, c.b});
      group.bodies.insert({{false, c.a}, {c.plane, c.b}});
    }
    // A tie on a node of the time grid is found in the steps on both of its sides.
    const auto meets = [&](const Group& other) {
      if (group.time - other.time > internal::kTieTime * simulator.step()) return false;
      return std::any_of(group.bodies.begin(), group.bodies.end(), [&](const std::pair<bool, int>& body) {
        return !body.first && !scene.bodies[body.second].fixed && other.bodies.count(body) > 0;
      });
    };
    const auto same = std::find_if(groups.begin(), groups.end(), meets);
    if (same == groups.end()) {
      groups.push_back(std::move(group));
    } else {
      same->contacts.merge(group.contacts);
      same->bodies.merge(group.bodies);
    }
  }
  if (groups.empty()) return {};
  const std::vector<std::string> walls = WallNamesOf(scene);
  std::vector<Tie> ties;
  for (const Group& group : groups) {
    Tie& tie = ties.emplace_back(Tie{group.time, {}, static_cast<int>(group.contacts.size())});
    for (const auto& [plane, i] : group.bodies) {
      tie.bodies.push_back(plane ? walls[i] : scene.bodies[i].name);
    }
  }
  std::stable_sort(ties.begin(), ties.end(), [](const Tie& l, const Tie& r) { return l.time < r.time; });
  return ties;
}

std::string TiesToString(const std::vector<Tie>& ties) {
  if (ties.empty()) return "";
  const std::vector<std::string>& bodies = ties[0].bodies;
  std::string text = "the order of the impacts of ";
  for (size_t i = 0; i < bodies.size(); ++i) {
    text += (i == 0 ? "" : i + 1 < bodies.size() ? ", " : " and ") + bodies[i];
  }
  text += " at " + ToText(ties[0].time, 6) + " s decides";
  if (ties.size() > 1) text += ", and " + std::to_string(ties.size() - 1) + " more";
  return text;
}

}  // namespace saltus
