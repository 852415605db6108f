// The programs as a user runs them, on the problems' scenes and on files of a test.
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

inline std::string ContentsOf(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// The path of a temporary file with that text.
inline std::string TempFileWith(const std::string& name, const std::string& text) {
  std::ofstream(TempFile(name)) << text;
  return TempFile(name);
}

struct Outcome {
  int exit_code = -1;
  std::string output;  // stdout
  std::string errors;  // stderr
};

// Runs a shell command.
inline Outcome RunCommand(const std::string& command) {
  const std::string errors = TempFile("errors");
  Outcome outcome;
  FILE* pipe = popen((command + " 2>" + errors).c_str(), "r");
  std::array<char, 4096> buffer;
  for (size_t count; (count = fread(buffer.data(), 1, buffer.size(), pipe)) > 0;) {
    outcome.output.append(buffer.data(), count);
  }
  const int status = pclose(pipe);
  outcome.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  outcome.errors = ContentsOf(errors);
  return outcome;
}

// Runs one of the programs, with arguments for a shell.
inline Outcome RunProgram(const std::string& command) { return RunCommand(BuildFolder() + "/bin/" + command); }

// Runs a program on a terminal of so many columns.
inline Outcome RunProgramIn(int columns, const std::string& command) {
  return RunCommand("COLUMNS=" + std::to_string(columns) + " " + BuildFolder() + "/bin/" + command);
}

inline std::string SceneFlag(const std::string& name) {
  return " --scene=" + SourceFolder() + "/problems/" + name + ".yaml ";
}

}  // namespace saltus
