#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>

#include "blackbox/conversation.h"

namespace saltus {
namespace {

constexpr int kGrace = 50;                 // looks whether the command has ended by itself, before it is killed
constexpr long kBetweenLooks = 2'000'000;  // ns between two of them
constexpr int kSignalled = 128;  // exit codes of the keeper above this are signals, as of a shell; this: it ran
constexpr int kNothing = 127;    // exit code of a shell that finds no such command
enum End : int { kRead = 0, kWrite = 1 };  // of a pipe
using Pipe = std::array<int, 2>;

bool Open(Pipe* pipe) { return pipe2(pipe->data(), O_CLOEXEC) == 0; }

void Close(int* descriptor) {
  if (*descriptor >= 0) close(*descriptor);
  *descriptor = -1;
}

// The functions below run between fork and exec, or in the keeper. Other threads may have held any lock at the fork, so
// they use system calls only.

void Default(int signal_number) {
  struct sigaction action = {};
  action.sa_handler = SIG_DFL;
  sigaction(signal_number, &action, nullptr);
}

[[noreturn]] void Execute(const char* command, const Pipe& in, const Pipe& out, const Pipe& errors) {
  setpgid(0, 0);
  for (const int signal_number : {SIGINT, SIGTERM, SIGPIPE, SIGXFSZ}) Default(signal_number);
  dup2(in[kRead], STDIN_FILENO);
  dup2(out[kWrite], STDOUT_FILENO);
  dup2(errors[kWrite], STDERR_FILENO);
  execl("/bin/sh", "sh", "-c", command, static_cast<char*>(nullptr));
  _exit(kNothing);
}

// Waits a moment at most; returns 0 if the child still runs.
pid_t WaitFor(pid_t child, int* status) {
  pid_t ended = 0;
  for (int i = 0; i < kGrace && (ended = waitpid(child, status, WNOHANG)) == 0; ++i) {
    const timespec look{0, kBetweenLooks};
    nanosleep(&look, nullptr);
  }
  return ended;
}

[[noreturn]] void Keep(pid_t child, int lifeline) {
  dup2(lifeline, STDIN_FILENO);
  close_range(STDIN_FILENO + 1, ~0U, 0);
  char unused;
  while (read(STDIN_FILENO, &unused, 1) < 0 && errno == EINTR) {
  }
  int status = 0;
  const pid_t ended = WaitFor(child, &status);
  kill(-child, SIGKILL);  // and what it has started
  while (WaitFor(-1, nullptr) > 0) {
  }
  if (ended == 0) _exit(kSignalled);  // what it would have done, nobody knows
  _exit(WIFSIGNALED(status) ? kSignalled + WTERMSIG(status) : WEXITSTATUS(status));
}

[[noreturn]] void StartAndKeep(const char* command, const Pipe& in, const Pipe& out, const Pipe& errors,
                               const Pipe& lifeline) {
  setpgid(0, 0);
  prctl(PR_SET_CHILD_SUBREAPER, 1);  // to wait for what the command has started, too
  const pid_t child = fork();
  if (child < 0) _exit(kNothing);
  if (child == 0) Execute(command, in, out, errors);
  setpgid(child, child);  // whoever is first
  Keep(child, lifeline[kRead]);
}

}  // namespace

ChildProcess::ChildProcess(const std::string& command, std::string* error) {
  Pipe in = {-1, -1}, out = {-1, -1}, errors = {-1, -1}, lifeline = {-1, -1};
  const bool opened = Open(&in) && Open(&out) && Open(&errors) && Open(&lifeline);
  keeper_ = opened ? fork() : -1;
  if (keeper_ == 0) StartAndKeep(command.c_str(), in, out, errors, lifeline);
  if (keeper_ < 0) *error = std::strerror(errno);
  for (int* unused : {&in[kRead], &out[kWrite], &errors[kWrite], &lifeline[kRead]}) Close(unused);
  if (keeper_ < 0) {
    for (int* unused : {&in[kWrite], &out[kRead], &errors[kRead], &lifeline[kWrite]}) Close(unused);
    return;
  }
  input_ = in[kWrite];
  output_ = out[kRead];
  errors_ = errors[kRead];
  lifeline_ = lifeline[kWrite];
  for (const int descriptor : {input_, output_, errors_}) fcntl(descriptor, F_SETFL, O_NONBLOCK);
}

ChildProcess::~ChildProcess() { End(); }

std::string ChildProcess::End() {
  for (int* descriptor : {&input_, &output_, &errors_, &lifeline_}) Close(descriptor);
  if (keeper_ < 0) return "was not started";
  int status = 0;
  while (waitpid(keeper_, &status, 0) < 0 && errno == EINTR) {
  }
  keeper_ = -1;
  const int code = WIFEXITED(status) ? WEXITSTATUS(status) : kSignalled;
  if (code == kSignalled) return "closed its standard output";
  if (code > kSignalled) return "was killed by signal " + std::to_string(code - kSignalled);
  return "ended with exit code " + std::to_string(code);
}

}  // namespace saltus
