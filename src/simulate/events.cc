#include "saltus/simulate/events.h"

#include <algorithm>
#include <map>
#include <set>
#include <tuple>

#include "base/number_text.h"
#include "contact/event/event_ties.h"
#include "saltus/scene/walls.h"

namespace saltus {

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
                      at.touch.mode,
                      at.touch.kind == ContactKind::kGrazing});
  }
  return events;
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
