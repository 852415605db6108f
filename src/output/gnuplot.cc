#include "output/gnuplot.h"

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <memory>
#include <thread>

#include "base/interrupt.h"

extern char** environ;

namespace saltus::internal {
namespace {

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

std::string ReadFromStart(std::FILE* file) {
  std::rewind(file);
  std::string text;
  std::array<char, 1 << 14> buffer;
  while (const size_t size = std::fread(buffer.data(), 1, buffer.size(), file)) text.append(buffer.data(), size);
  return text;
}

// Waits for the end of a child, which an interrupt whose grace is over kills.
int WaitFor(pid_t child, int* wait_status) {
  using namespace std::chrono_literals;
  auto pause = 100us;
  while (true) {
    const pid_t ended = waitpid(child, wait_status, WNOHANG);
    if (ended == child) return 0;
    if (ended < 0 && errno != EINTR) return errno;
    if (InterruptGuard::GraceIsOver()) kill(child, SIGKILL);
    std::this_thread::sleep_for(pause);
    pause = std::min<std::chrono::microseconds>(2 * pause, 10ms);
  }
}

// Runs the program on files as its standard streams. Returns errno of the start, or 0 and the wait status. It is in a
// process group of its own, so that Ctrl-C in the terminal does not end it before its figure is done.
int Spawn(const std::string& executable, std::FILE* in, std::FILE* out, std::FILE* err, int* wait_status) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, fileno(in), STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, fileno(out), STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, fileno(err), STDERR_FILENO);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
  posix_spawnattr_setpgroup(&attributes, 0);
  std::string name = executable;
  std::string no_user_settings = "-d";
  char* const arguments[] = {name.data(), no_user_settings.data(), nullptr};
  pid_t child = 0;
  const int error = posix_spawnp(&child, executable.c_str(), &actions, &attributes, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  posix_spawnattr_destroy(&attributes);
  return error != 0 ? error : WaitFor(child, wait_status);
}

}  // namespace

StatusOr<std::string> RunGnuplot(const std::string& executable, const std::string& script) {
  // Files rather than pipes: neither side ever waits for the other.
  const File in(std::tmpfile());
  const File out(std::tmpfile());
  const File err(std::tmpfile());
  if (!in || !out || !err) return Status::Error(std::string("cannot make a temporary file: ") + std::strerror(errno));
  if (std::fwrite(script.data(), 1, script.size(), in.get()) != script.size() || std::fflush(in.get()) != 0) {
    return Status::Error(std::string("cannot write a temporary file: ") + std::strerror(errno));
  }
  std::rewind(in.get());
  int wait_status = 0;
  const int error = Spawn(executable, in.get(), out.get(), err.get(), &wait_status);
  if (error == ENOENT) return Status::Error("figures need gnuplot, and '" + executable + "' was not found");
  if (error != 0) return Status::Error("cannot run '" + executable + "': " + std::strerror(error));
  if (WIFEXITED(wait_status) && WEXITSTATUS(wait_status) == 0) return ReadFromStart(out.get());
  if (InterruptGuard::GraceIsOver()) return Status::Error("interrupted");
  return Status::Error("gnuplot failed: " + ReadFromStart(err.get()));
}

}  // namespace saltus::internal
