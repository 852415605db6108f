#include "base/file.h"

#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <ctime>

namespace saltus {
namespace {

constexpr int kMostLinks = 40;         // that are followed, as the kernel does
constexpr int kLookMilliseconds = 50;  // how often it is asked whether to stop

using Stop = std::function<bool()>;

Status SystemError(const std::string& path, const std::string& what) {
  return Status::Error(path + ": " + what + ": " + std::strerror(errno));
}

std::string FolderOf(const std::string& path) {
  const std::size_t slash = path.rfind('/');
  return slash == std::string::npos ? "" : path.substr(0, slash + 1);
}

// Returns the path at the end of the chain of symbolic links that begins at `path`; no file need exist there. Returns
// an empty text and sets errno if the chain has no end.
std::string ResolveLinks(std::string path) {
  for (int links = 0; links <= kMostLinks; ++links) {
    std::array<char, 4096> target;
    const ssize_t size = readlink(path.c_str(), target.data(), target.size());
    if (size < 0) return path;
    const std::string to(target.data(), static_cast<std::size_t>(size));
    path = to.starts_with('/') ? to : FolderOf(path) + to;
  }
  errno = ELOOP;
  return "";
}

bool IsSame(const struct stat& one, const struct stat& other) {
  return one.st_dev == other.st_dev && one.st_ino == other.st_ino;
}

// Says what a file is that can be neither written in place nor replaced by a new file, for messages.
const char* DescribeFileType(mode_t mode) {
  if (S_ISDIR(mode)) return "is a directory";
  if (S_ISSOCK(mode)) return "is a socket";
  if (S_ISFIFO(mode)) return "is a FIFO";
  if (S_ISCHR(mode) || S_ISBLK(mode)) return "is a device";
  return "is no regular file";
}

// Opens a new file in a folder ("" or with a slash at its end). open() rather than mkstemp(), because it respects the
// umask.
int OpenTemporary(const std::string& folder, std::string* temporary) {
  for (int attempt = 0; attempt < 1000; ++attempt) {
    *temporary = folder + ".partial." + std::to_string(getpid()) + "." + std::to_string(attempt);
    const int file = open(temporary->c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (file >= 0 || errno != EEXIST) return file;
  }
  return -1;
}

// Waits for a while until `file` accepts data, or just waits if `file` is negative. Returns false and sets errno if the
// waiting has to end.
bool Wait(int file, const Stop& stop) {
  pollfd writable{file, POLLOUT, 0};
  const int ready = poll(&writable, file < 0 ? 0 : 1, kLookMilliseconds);
  if (ready < 0) return errno == EINTR;
  if (ready > 0 || !stop || !stop()) return true;
  errno = EINTR;
  return false;
}

bool WriteAll(int file, std::string_view contents, const Stop& stop) {
  while (!contents.empty()) {
    const ssize_t written = WriteQuietly(file, contents.data(), contents.size());
    if (written >= 0) {
      contents.remove_prefix(static_cast<std::size_t>(written));
    } else if (errno == EAGAIN) {
      if (!Wait(file, stop)) return false;
    } else if (errno != EINTR) {
      return false;
    }
  }
  return true;
}

// Closes the file. Returns whether this and the writing before succeeded; if not, errno is that of the first failure.
bool CloseWritten(int file, bool written) {
  const int error = errno;
  const bool closed = close(file) == 0;
  if (!written) errno = error;
  return written && closed;
}

Status Replace(const std::string& path, const std::string& target, const struct stat* old, std::string_view contents) {
  std::string temporary;
  const int file = OpenTemporary(FolderOf(target), &temporary);
  if (file < 0) return SystemError(path, "cannot write");
  const bool written = WriteAll(file, contents, nullptr) && (old == nullptr || fchmod(file, old->st_mode & 0777) == 0);
  if (CloseWritten(file, written) && std::rename(temporary.c_str(), target.c_str()) == 0) return Status();
  const Status failed = SystemError(path, "cannot write");
  unlink(temporary.c_str());
  return failed;
}

// Without O_NONBLOCK a FIFO that nobody reads would hold the program up, whatever signals come.
int OpenToWrite(const std::string& path, const Stop& stop) {
  for (;;) {
    const int file = open(path.c_str(), O_WRONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC);
    if (file >= 0 || (errno != ENXIO && errno != EINTR)) return file;
    struct stat now;
    if (errno == ENXIO && (stat(path.c_str(), &now) != 0 || !S_ISFIFO(now.st_mode))) return -1;
    if (!Wait(-1, stop)) return -1;
  }
}

Status WriteThrough(const std::string& path, std::string_view contents, const Stop& stop) {
  const int file = OpenToWrite(path, stop);
  if (file < 0) return SystemError(path, "cannot write");
  return CloseWritten(file, WriteAll(file, contents, stop)) ? Status() : SystemError(path, "cannot write");
}

}  // namespace

Status WriteFile(const std::string& path, std::string_view contents, const Stop& stop) {
  struct stat what, target_is;
  const bool exists = stat(path.c_str(), &what) == 0;
  if (!exists && errno != ENOENT) return SystemError(path, "cannot write");
  if (exists && (S_ISFIFO(what.st_mode) || S_ISCHR(what.st_mode) || S_ISBLK(what.st_mode))) {
    return WriteThrough(path, contents, stop);
  }
  if (exists && !S_ISREG(what.st_mode))
    return Status::Error(path + ": cannot write: it " + DescribeFileType(what.st_mode));
  const std::string target = ResolveLinks(path);
  if (target.empty()) return SystemError(path, "cannot write");
  // Links in /proc need not lead where they say.
  const bool found = lstat(target.c_str(), &target_is) == 0;
  if (found != exists || (exists && !IsSame(what, target_is))) {
    return Status::Error(path + ": cannot write: it is a link to a file that has no name");
  }
  return Replace(path, target, exists ? &what : nullptr, contents);
}

Status CheckRegularFile(const std::string& path) {
  struct stat what;
  if (stat(path.c_str(), &what) != 0 || S_ISREG(what.st_mode)) return Status();
  return Status::Error(path + ": it " + DescribeFileType(what.st_mode) + ", expected a regular file or none");
}

StatusOr<std::string> ReadFile(const std::string& path, std::size_t most) {
  const int file = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return SystemError(path, "cannot read");
  std::string contents;
  std::array<char, 1 << 16> buffer;
  for (;;) {
    const ssize_t size = read(file, buffer.data(), buffer.size());
    if (size < 0 && errno == EINTR) continue;
    if (size > 0) contents.append(buffer.data(), static_cast<std::size_t>(size));
    if (size > 0 && contents.size() <= most) continue;
    const Status error = size < 0 ? SystemError(path, "cannot read") : Status();
    close(file);
    if (!error.ok()) return error;
    if (contents.size() > most) {
      return Status::Error(path + ": has more than " + std::to_string(most) + " bytes");
    }
    return contents;
  }
}

ssize_t WriteQuietly(int descriptor, const char* data, std::size_t size) {
  sigset_t pipe, previous, pending;
  sigemptyset(&pipe);
  sigaddset(&pipe, SIGPIPE);
  sigpending(&pending);
  pthread_sigmask(SIG_BLOCK, &pipe, &previous);
  const ssize_t written = write(descriptor, data, size);
  const int error = errno;
  if (written < 0 && error == EPIPE && sigismember(&pending, SIGPIPE) == 0) {
    const timespec now{0, 0};
    sigtimedwait(&pipe, nullptr, &now);
  }
  pthread_sigmask(SIG_SETMASK, &previous, nullptr);
  errno = error;
  return written;
}

}  // namespace saltus
