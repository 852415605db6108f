#include "io/file.h"

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>

namespace saltus {
namespace {

Status SystemError(const std::string& path, const std::string& what) {
  return Status::Error(path + ": " + what + ": " + std::strerror(errno));
}

// Opens a new file next to `path`, so that the rename stays within one file system. open() rather than mkstemp(),
// because it respects the umask.
int OpenTemporary(const std::string& path, std::string* temporary) {
  for (int attempt = 0; attempt < 1000; ++attempt) {
    *temporary = path + ".partial." + std::to_string(getpid()) + "." + std::to_string(attempt);
    const int file = open(temporary->c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (file >= 0 || errno != EEXIST) return file;
  }
  return -1;
}

bool WriteAll(int file, std::string_view contents) {
  while (!contents.empty()) {
    const ssize_t written = write(file, contents.data(), contents.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) return false;
    contents.remove_prefix(static_cast<size_t>(written));
  }
  return true;
}

}  // namespace

Status WriteFileAtomically(const std::string& path, std::string_view contents) {
  std::string temporary;
  const int file = OpenTemporary(path, &temporary);
  if (file < 0) return SystemError(path, "cannot write");
  const bool written = WriteAll(file, contents);
  const bool closed = close(file) == 0;
  if (written && closed && std::rename(temporary.c_str(), path.c_str()) == 0) return Status();
  const Status error = SystemError(path, "cannot write");
  unlink(temporary.c_str());
  return error;
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

}  // namespace saltus
