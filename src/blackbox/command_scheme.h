// A time-stepping scheme for a hybrid system that is a command: it is asked for steps, one JSON object a line.
//
//   -> {"saltus": 1, "hybrid": {"modes": [{"name": "flight", "states": ["y", "v"]}], "controls": [...],
//                               "parameters": [...]}, "scene": {...}}     "scene" if the system is made of one
//   <- {"name": "mine 1.0", "can": ["jacobian"]}      both optional; "not_applicable": "why"
//   -> {"id": 1, "step": {"mode": "flight", "t": 0, "h": 0.01, "state": [...], "control": [...], "parameters": [...],
//                         "jacobian": true}}
//   <- {"id": 1, "mode": "flight", "state": [...], "jacobian": [[...], ...]}
//   <- {"id": 1, "error": "what went wrong"}          instead of an answer
//
// A Jacobian has a row for each component of the new state and a column for each of [state control parameters]. Without
// one, steps are differentiated by differences, which are wider if all that is answered are numbers of float32.
#pragma once

#include <cstdint>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "blackbox/command_box.h"
#include "saltus/audit/hybrid_audit.h"

namespace saltus {

class Conversation;

// The names of a system as JSON: {"modes": [{"name", "states"}], "controls", "parameters"}.
nlohmann::ordered_json NamesToJson(const HybridSystem& system);

class CommandScheme final : public HybridScheme {
 public:
  // Starts the command; of the options `copies` has no meaning. `scene`: what the command is told beside the names of
  // the system; null if there is nothing.
  CommandScheme(const HybridSystem& system, CommandOptions options, const nlohmann::ordered_json& scene = nullptr);
  ~CommandScheme() override;

  std::string name() const override { return options_.name; }
  int Step(const SchemeStep& step, double* next, double* jacobian, std::string* error) override;
  bool HasJacobian() const override { return has_jacobian_; }

 private:
  int Ask(const SchemeStep& step, double* next, double* jacobian, std::string* error);
  // Sends a line and waits for the one that answers it. An error is kept in broken_.
  std::string Answer(const std::string& line, const std::string& what);

  const HybridSystem system_;
  const CommandOptions options_;
  std::unique_ptr<Conversation> conversation_;
  std::string broken_;  // why it is of no use
  bool has_jacobian_ = false;
  bool is_float32_ = true;  // so far
  std::int64_t next_id_ = 1;
};

}  // namespace saltus
