// Whole files, read and written in one go.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include "io/status.h"

namespace saltus {

// Replaces `path` by `contents`, or leaves it as it was: a reader never sees half a file. Creates no directories.
Status WriteFileAtomically(const std::string& path, std::string_view contents);

// An error that names the path if it cannot be read, is a directory, or has more than `most` bytes, as endless devices
// have.
StatusOr<std::string> ReadFile(const std::string& path, std::size_t most = std::size_t{1} << 28);

}  // namespace saltus
