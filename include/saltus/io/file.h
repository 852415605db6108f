// Whole files, read and written in one go.
#pragma once

#include <string>
#include <string_view>

#include "saltus/io/status.h"

namespace saltus {

// Replaces `path` by `contents`, or leaves it as it was: a reader never sees half a file. Creates no directories.
Status WriteFileAtomically(const std::string& path, std::string_view contents);

StatusOr<std::string> ReadFile(const std::string& path);

}  // namespace saltus
