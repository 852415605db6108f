#include "gnuplot.h"

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <memory>

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

// Runs the program on files as its standard streams. Returns errno of the start, or 0 and the wait status.
int Spawn(const std::string& executable, std::FILE* in, std::FILE* out, std::FILE* err, int* wait_status) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, fileno(in), STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, fileno(out), STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, fileno(err), STDERR_FILENO);
  std::string name = executable;
  std::string no_user_settings = "-d";
  char* const arguments[] = {name.data(), no_user_settings.data(), nullptr};
  pid_t child = 0;
  const int error = posix_spawnp(&child, executable.c_str(), &actions, nullptr, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) return error;
  while (waitpid(child, wait_status, 0) < 0) {
    if (errno != EINTR) return errno;
  }
  return 0;
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
  return Status::Error("gnuplot failed: " + ReadFromStart(err.get()));
}

}  // namespace saltus::internal
