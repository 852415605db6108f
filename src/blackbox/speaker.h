// The other side of the protocol: a contact model of this library, as a black box.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "blackbox/protocol.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// What a simulator gives besides final states.
struct Offer {
  bool gradient = true, step = true, states = true;
};

class Speaker {
 public:
  // Precondition: there is such a model.
  Speaker(const Contact& contact, Precision precision, const Offer& offer);

  // The line that answers a line, without its end. What is wrong with a line is an "error".
  std::string AnswerTo(const std::string& line);

 private:
  ProtocolJson Greet(const ProtocolJson& scene);
  ProtocolJson Simulate(const ProtocolJson& question, bool with_gradient);
  ProtocolJson TakeStep(const ProtocolJson& question);
  // The model over so many steps, made once.
  Simulator& SimulatorOf(int steps, double duration);
  // Of one of its own steps, the mean of the forces in those of the grid that it covers.
  std::vector<double> OwnControl(const ProtocolJson& question, int steps) const;

  Contact contact_;
  Precision precision_;
  Offer offer_;
  int grid_steps_;
  std::optional<Scene> scene_;
  std::pair<int, double> simulated_;  // steps and duration of
  std::unique_ptr<Simulator> simulator_;
};

}  // namespace saltus
