// Programs as a user runs them.
#pragma once

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <string>

#include "folders.h"

namespace saltus {

struct Outcome {
  int exit_code = -1;
  std::string output;  // stdout
  std::string errors;  // stderr
};

// Runs a shell command.
inline Outcome RunCommand(const std::string& command) {
  const std::string errors = testing::TempDir() + "/errors_" + std::to_string(getpid());
  Outcome outcome;
  FILE* pipe = popen((command + " 2>" + errors).c_str(), "r");
  std::array<char, 4096> buffer;
  for (size_t count; (count = fread(buffer.data(), 1, buffer.size(), pipe)) > 0;) {
    outcome.output.append(buffer.data(), count);
  }
  const int status = pclose(pipe);
  outcome.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  std::ifstream file(errors);
  outcome.errors.assign(std::istreambuf_iterator<char>(file), {});
  return outcome;
}

// Runs one of the programs, with arguments for a shell.
inline Outcome RunProgram(const std::string& command) { return RunCommand(BuildFolder() + "/bin/" + command); }

// The same on a terminal of so many columns.
inline Outcome RunProgramIn(int columns, const std::string& command) {
  return RunCommand("COLUMNS=" + std::to_string(columns) + " " + BuildFolder() + "/bin/" + command);
}

}  // namespace saltus
