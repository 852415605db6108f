// The exchange of lines with one copy of a command.
#pragma once

#include <poll.h>
#include <sys/types.h>

#include <chrono>
#include <deque>
#include <functional>
#include <string>
#include <vector>

namespace saltus {

// A command that runs beside this program, with its three standard streams as pipes. It runs in a process group of its
// own, so that Ctrl-C at the terminal does not reach it. A keeper process, which waits for nothing else, kills the
// whole group as soon as this object goes, or this program ends, however that happens.
class ChildProcess {
 public:
  // Starts `command` by /bin/sh. If that fails, `error` is the reason and no descriptor is valid.
  ChildProcess(const std::string& command, std::string* error);
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  // The descriptors of its streams, which do not block; -1 if closed.
  int input() const { return input_; }    // to be written to
  int output() const { return output_; }  // to be read from, as is
  int errors() const { return errors_; }

  // Closes its input, gives it a moment to end by itself, kills it if it does not, and waits for it. Returns how it
  // ended, in words: "ended with exit code 3", "was killed by signal 9".
  std::string End();

 private:
  pid_t keeper_ = -1;
  int input_ = -1, output_ = -1, errors_ = -1;
  int lifeline_ = -1;  // when it is closed, the keeper ends the command
};

inline constexpr int kLook = 20;  // ms, how often time and interrupts are looked at while an answer is awaited

// An expected answer: one line in return for one that was sent.
struct Expected {
  int index = -1;        // of the question; -1: the greeting
  std::string what;      // for messages: "request 7 (simulate of 480 steps)"
  std::size_t most = 0;  // characters of the answer
};

// No member blocks. After a failure nothing more is sent or read.
class Conversation {
 public:
  using Clock = std::chrono::steady_clock;
  using OnLine = std::function<void(const Expected& expected, const std::string& line)>;

  Conversation(const std::string& command, std::function<void(const std::string&)> on_error_line);

  void Send(std::string line, Expected expected);
  // Writes as much as the pipe takes.
  void Write();
  // Writes and reads as much as the pipes allow, and calls on_line for each line that has arrived. A ProtocolError
  // thrown by on_line is a failure.
  void Exchange(const OnLine& on_line);
  // Fails if nothing has arrived for this long.
  void CheckTime(double seconds);

  const std::string& failure() const { return failure_; }
  const std::deque<Expected>& expected() const { return expected_; }
  bool has_unwritten() const { return written_ < unwritten_.size(); }
  // Adds the descriptors to wait for.
  void AddTo(std::vector<pollfd>* waited) const;

 private:
  void Fail(const std::string& why);
  void Read(const OnLine& on_line);
  void TakeLines(const OnLine& on_line);
  void ReadErrors();

  std::string failure_;
  ChildProcess process_;
  std::function<void(const std::string&)> on_error_line_;
  std::string unwritten_, unread_, unread_errors_;
  std::size_t written_ = 0;
  bool errors_open_ = true;
  std::deque<Expected> expected_;
  Clock::time_point last_ = Clock::now();  // when something was asked of an idle copy, or came back
};

}  // namespace saltus
