// A time-stepping scheme for a hybrid system that is a command, asked for its steps.
#pragma once

#include <string>

#include "blackbox/session.h"
#include "saltus/audit/hybrid_audit.h"

namespace saltus {

class CommandScheme final : public HybridScheme {
 public:
  // Starts the command; of the options `copies` has no meaning. `scene`: what the command is told beside the names of
  // the system; null if there is nothing.
  CommandScheme(const HybridSystem& system, CommandOptions options, const ProtocolJson& scene = nullptr);

  std::string name() const override { return name_; }
  int Step(const SchemeStep& step, double* next, double* jacobian, std::string* error) override;
  bool HasJacobian() const override { return session_.traits().jacobian; }

 private:
  int Ask(const SchemeStep& step, double* next, double* jacobian, std::string* error);

  const HybridSystem system_;
  const std::string name_;
  Session session_;
  bool knows_precision_ = false, is_float32_ = true;  // so far
};

}  // namespace saltus
