// A command that runs beside this program, with its three standard streams as pipes.
#pragma once

#include <sys/types.h>

#include <string>

namespace saltus {

// Runs in a process group of its own, so that Ctrl-C at the terminal does not reach it. A keeper process, which waits
// for nothing else, kills the whole group as soon as this object goes, or this program ends, however that happens.
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

}  // namespace saltus
