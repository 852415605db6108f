// A command with the protocol that was told of one task: several copies of it, asked in parallel.
#pragma once

#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "blackbox/protocol.h"
#include "saltus/audit/black_box.h"
#include "saltus/audit/hybrid_audit.h"

namespace saltus {

class Conversation;

struct CommandOptions {
  std::string name;     // of the row
  std::string command;  // for /bin/sh
  int copies = 1;       // that run at a time, at most
  double seconds = 30;  // after which silence is an error; > 0
  // Called with each line that the command prints on standard error.
  std::function<void(const std::string& line)> on_error_line = nullptr;
};

// After a failure nothing more is asked.
class Session {
 public:
  // A request to a command, and the use of its answer.
  struct Request {
    std::string what;    // for messages: "simulate of 480 steps"
    ProtocolJson asked;  // without "id"
    std::size_t most;    // characters of the answer
    // Takes the answer, or throws ProtocolError. Returns whether `asked` is a further request, which follows from it.
    std::function<bool(const ProtocolJson& answer, ProtocolJson* asked)> take;
  };

  // Starts a copy, and waits for its greeting.
  Session(ProtocolJson hello, const CommandOptions& options);
  ~Session();

  // Returns the reason why the command can no longer be used, which names it; empty if it can.
  const std::string& broken() const { return broken_; }
  const BlackBoxTraits& traits() const { return traits_; }
  // Asks all. Returns whether it was done; if not, the command is broken or it was stopped.
  bool Evaluate(std::vector<Request> requests, const StopRequest& stop = nullptr);

 private:
  void AddCopy();
  // Waits until something happens, or a moment has passed, and takes the lines that have arrived.
  void Exchange(const std::function<void(int index, const std::string& line)>& on_line);

  const std::string hello_;
  const CommandOptions options_;
  std::string broken_;
  BlackBoxTraits traits_;
  std::int64_t next_id_ = 1;
  std::vector<std::unique_ptr<Conversation>> copies_;
};

// A black box that is a command with the protocol: several copies of it, asked in parallel. A command that fails (does
// not start, ends, is silent, or answers with something else) is not started again: all further questions get that
// error, which names the command, the request and its output.
class CommandBox final : public BlackBox {
 public:
  explicit CommandBox(CommandOptions options);
  ~CommandBox() override;

  const std::string& name() const override { return options_.name; }
  BlackBoxTraits Describe(const Scene& scene) override;
  std::vector<BlackBoxAnswer> Evaluate(const Scene& scene, const std::vector<BlackBoxRequest>& requests,
                                       const StopRequest& stop) override;

 private:
  // Returns the session of a scene, or null if the command is broken.
  Session* SessionOf(const Scene& scene);

  const CommandOptions options_;
  std::mutex mutex_;  // guards what follows
  std::string broken_;
  std::list<std::pair<Scene, Session>> sessions_;  // a command is told of one scene; the last used is last
};

// A time-stepping scheme for a hybrid system that is a command, asked for its steps.
class CommandScheme final : public HybridScheme {
 public:
  // Starts the command; of the options `copies` has no meaning. `scene`: what the command is told beside the names of
  // the system; null if there is nothing.
  CommandScheme(const HybridSystem& system, CommandOptions options, const ProtocolJson& scene = nullptr);

  std::string name() const override { return name_; }
  int Step(const SchemeStep& step, double* next, double* jacobian, std::string* error) override;
  bool HasJacobian() const override { return session_.traits().jacobian; }

 private:
  int Evaluate(const SchemeStep& step, double* next, double* jacobian, std::string* error);

  const HybridSystem system_;
  const std::string name_;
  Session session_;
  bool knows_precision_ = false, is_float32_ = true;  // so far
};

}  // namespace saltus
