// What scenes and objectives say of themselves (saltus/scene/scene.h).
#include <algorithm>

#include "saltus/scene/scene.h"

namespace saltus {

bool Objective::HasConstraints() const {
  const auto hard = [](const auto& term) { return term.hard; };
  return std::any_of(terminal.begin(), terminal.end(), hard) || std::any_of(via.begin(), via.end(), hard);
}

bool Objective::IsSumOfSquares() const {
  return std::none_of(terminal.begin(), terminal.end(), [](const TerminalTerm& term) { return term.component; });
}

bool Scene::Spins() const {
  return std::any_of(bodies.begin(), bodies.end(), [](const Body& body) { return body.Spins(); });
}

const char* OptimizeToString(Optimize optimize) {
  constexpr const char* kNames[] = {"control", "velocity", "position", "none"};
  return kNames[static_cast<int>(optimize)];
}

}  // namespace saltus
