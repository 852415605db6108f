// A black box that is a command with the protocol: several copies of it, asked in parallel.
#pragma once

#include <list>
#include <mutex>
#include <string>
#include <vector>

#include "blackbox/session.h"
#include "saltus/audit/black_box.h"

namespace saltus {

// A command that fails (does not start, ends, is silent, or answers with something else) is not started again: all
// further questions get that error, which names the command, the request and its output.
class CommandBox final : public BlackBox {
 public:
  explicit CommandBox(CommandOptions options);
  ~CommandBox() override;

  const std::string& name() const override { return options_.name; }
  BlackBoxTraits Describe(const Scene& scene) override;
  std::vector<Answer> Ask(const Scene& scene, const std::vector<Question>& questions, const StopRequest& stop) override;

 private:
  // Returns the session of a scene, or null if the command is broken.
  Session* SessionOf(const Scene& scene);

  const CommandOptions options_;
  std::mutex mutex_;  // guards what follows
  std::string broken_;
  std::list<std::pair<Scene, Session>> sessions_;  // a command is told of one scene; the last used is last
};

}  // namespace saltus
