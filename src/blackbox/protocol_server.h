// A contact model of this library as a black box: the simulator's side of the protocol.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "blackbox/protocol.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// The answers that a simulator offers besides final states.
struct ServerCapabilities {
  bool gradient = true, step = true, states = true;
};

class ProtocolServer {
 public:
  // Precondition: there is a model of that name.
  ProtocolServer(const Contact& contact, Precision precision, const ServerCapabilities& offer);

  // Returns the line that answers a line, without its end; for an invalid line it is an "error".
  std::string ComputeAnswer(const std::string& line);

 private:
  ProtocolJson Greet(const ProtocolJson& scene);
  ProtocolJson Simulate(const ProtocolJson& question, bool with_gradient);
  ProtocolJson TakeStep(const ProtocolJson& question);
  // Returns the simulator with this many steps; it is made once.
  Simulator& SimulatorOf(int steps, double duration);
  // Returns the control of the model's steps: the mean of the forces in the steps of the grid that each covers.
  std::vector<double> OwnControl(const ProtocolJson& question, int steps) const;

  Contact contact_;
  Precision precision_;
  ServerCapabilities offer_;
  int grid_steps_;
  std::optional<Scene> scene_;
  std::pair<int, double> simulated_;  // steps and duration of
  std::unique_ptr<Simulator> simulator_;
};

}  // namespace saltus
