// A black box that is a command with the protocol: several copies of it, asked in parallel.
#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "saltus/audit/black_box.h"

namespace saltus {

struct CommandOptions {
  std::string name;     // of the row
  std::string command;  // for /bin/sh
  int copies = 1;       // that run at a time, at most
  double seconds = 30;  // after which silence is an error; > 0
  // Called with each line that the command prints on standard error.
  std::function<void(const std::string& line)> on_error_line = nullptr;
};

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
  class Session;
  Session& SessionOf(const Scene& scene);

  CommandOptions options_;
  std::mutex mutex_;  // guards what follows
  std::string broken_;
  std::vector<std::unique_ptr<Session>> sessions_;  // a command is told of one scene; the last used is last
};

}  // namespace saltus
