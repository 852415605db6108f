#include "programs/launches.h"

namespace saltus {
namespace {

constexpr const char* kModes[] = {"frictionless", "slip", "stick"};

std::string Sequence(const LaunchSolution& launch) {
  std::string sequence;
  for (const ExactEvent& event : launch.events) sequence += (sequence.empty() ? "" : ", ") + event.b;
  return sequence.empty() ? "none" : sequence;
}

}  // namespace

std::vector<LaunchSolution> FindLaunches(const Scene& scene) {
  if (scene.optimize != Optimize::kVelocity) return {};
  return FindLaunchSolutions(scene);
}

Json LaunchesToJson(const std::vector<LaunchSolution>& launches) {
  Json list = Json::array();
  for (const LaunchSolution& launch : launches) {
    Json events = Json::array();
    for (const ExactEvent& event : launch.events) {
      events.push_back(
          {{"time", event.time}, {"a", event.a}, {"b", event.b}, {"mode", kModes[static_cast<int>(event.mode)]}});
    }
    list.push_back({{"velocity", {launch.velocity[0], launch.velocity[1]}},
                    {"speed_squared", launch.velocity.squaredNorm()},
                    {"events", std::move(events)},
                    {"minimum_effort", list.empty()}});
  }
  return list;
}

Table LaunchTable(const std::vector<LaunchSolution>& launches) {
  Table table({{"strikes"}, {"velocity x", 12}, {"velocity y", 12}, {"speed²", 12}, {"remark"}});
  for (const LaunchSolution& launch : launches) {
    table.AddRow({Sequence(launch),
                  launch.velocity[0],
                  launch.velocity[1],
                  launch.velocity.squaredNorm(),
                  &launch == &launches.front() ? "minimum effort" : ""});
  }
  return table;
}

}  // namespace saltus
