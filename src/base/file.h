// Whole files, read and written in one go.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <functional>
#include <string>
#include <string_view>

#include "base/status.h"

namespace saltus {

// Writes `contents` to `path`; whatever the programs write goes through here. Symbolic links are followed, and stay.
//   nothing or a regular file: the new file takes its place in one go (a reader never sees half a file), with the
//                              permissions of the old one
//   a device or a FIFO:        is opened and written to
//   anything else:             is an error, as is a folder that does not exist
// A FIFO is written to as fast as somebody reads from it. `stop` is asked meanwhile; once it is true, the call ends
// with an error instead of a wait.
Status WriteFile(const std::string& path, std::string_view contents, const std::function<bool()>& stop = nullptr);

// Returns an error if `path` exists and is no regular file; for callers that open the file by themselves.
Status CheckRegularFile(const std::string& path);

// Returns an error that names the path if it cannot be read, is a directory, or has more than `most` bytes, which also
// stops at devices without an end, such as /dev/zero.
StatusOr<std::string> ReadFile(const std::string& path, std::size_t most = std::size_t{1} << 28);

// write(), without the signal that a pipe without a reader sends.
ssize_t WriteQuietly(int descriptor, const char* data, std::size_t size);

}  // namespace saltus
