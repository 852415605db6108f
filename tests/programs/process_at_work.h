// A program at work in a process of its own, which a test interrupts.
#pragma once

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <filesystem>
#include <string>
#include <thread>

#include "programs/run_program.h"

namespace saltus {

class ProcessAtWork {
 public:
  struct End {
    bool by_itself = false;  // within the time that was given
    int exit_code = -1;      // -1: a signal has ended it
    int signal = 0;
  };

  // `command` is one of the programs with arguments for a shell. What it prints goes to files in `folder`.
  ProcessAtWork(const std::string& command, const std::filesystem::path& folder)
      : output_(folder / "output"), errors_(folder / "errors") {
    process_ = fork();
    if (process_ != 0) return;
    // The process that runs the tests may have made its children ignore interrupts.
    std::signal(SIGINT, SIG_DFL);
    const std::string line =
        "exec " + BuildFolder() + "/bin/" + command + " >" + output_.string() + " 2>" + errors_.string();
    execl("/bin/sh", "sh", "-c", line.c_str(), nullptr);
    _exit(127);
  }
  ProcessAtWork(const ProcessAtWork&) = delete;
  ~ProcessAtWork() {
    if (ended_) return;
    kill(process_, SIGKILL);
    waitpid(process_, nullptr, 0);
  }

  std::string output() const { return ContentsOf(output_); }
  std::string errors() const { return ContentsOf(errors_); }
  bool has_ended() {
    siginfo_t end = {};
    if (ended_ || waitid(P_PID, static_cast<id_t>(process_), &end, WEXITED | WNOHANG | WNOWAIT) != 0) return ended_;
    if (end.si_pid != process_) return false;
    waitpid(process_, &status_, 0);
    return ended_ = true;
  }

  // Until the condition holds or the program ends.
  template <typename Condition>
  void WaitUntil(const Condition& holds) {
    while (!has_ended() && !holds()) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }

  void Interrupt() {
    if (!has_ended()) kill(process_, SIGINT);
  }

  End WaitForEnd(std::chrono::seconds most) {
    const auto give_up = std::chrono::steady_clock::now() + most;
    WaitUntil([&] { return std::chrono::steady_clock::now() > give_up; });
    End end;
    if (!ended_) return end;
    end.by_itself = true;
    if (WIFEXITED(status_)) end.exit_code = WEXITSTATUS(status_);
    if (WIFSIGNALED(status_)) end.signal = WTERMSIG(status_);
    return end;
  }

 private:
  std::filesystem::path output_, errors_;
  pid_t process_ = -1;
  bool ended_ = false;
  int status_ = 0;
};

}  // namespace saltus
