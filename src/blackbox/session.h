// A command with the protocol that was told of one task: several copies of it, asked in parallel.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "blackbox/protocol.h"

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
  bool Ask(std::vector<Request> requests, const StopRequest& stop = nullptr);

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

}  // namespace saltus
