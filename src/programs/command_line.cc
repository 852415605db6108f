#include "programs/command_line.h"

#include <gflags/gflags.h>

#include <algorithm>
#include <filesystem>
#include <sstream>

#include "base/file.h"
#include "programs/program.h"

namespace saltus {
namespace {

constexpr size_t kMostFlagBytes = 1 << 20;
constexpr int kDeepestFlagFile = 16;

// gflags reads flag files to their end, whatever they are, and files that name themselves until it crashes.
void CheckFlagFile(const std::string& argument, int depth) {
  static constexpr char kFlag[] = "-flagfile=";
  const size_t dash = argument.find_first_not_of(" \t");
  if (dash == std::string::npos) return;
  const size_t start = argument.compare(dash, 2, "--") == 0 ? dash + 1 : dash;
  if (argument.compare(start, sizeof kFlag - 1, kFlag) != 0) return;
  for (const std::string& path : SplitAtCommas(argument.substr(start + sizeof kFlag - 1))) {
    if (depth == kDeepestFlagFile) throw InputError("--flagfile=" + path + ": flag files that name each other?");
    std::error_code unknown;
    if (std::filesystem::is_fifo(path, unknown)) continue;  // can be read only once
    const StatusOr<std::string> text = ReadFile(path, kMostFlagBytes);
    if (!text.ok()) throw InputError("--flagfile=" + text.status().message());
    std::stringstream lines(*text);
    for (std::string line; std::getline(lines, line);) CheckFlagFile(line, depth + 1);
  }
}

void CheckFlagFiles(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument == "--") return;
    const bool apart = (argument == "--flagfile" || argument == "-flagfile") && i + 1 < argc;
    CheckFlagFile(apart ? argument + "=" + argv[i + 1] : argument, 0);
  }
}

// gflags ends the program at the first flag that it does not know. Here it is said which program has it. Those that
// --undefok allows to be unknown are left to gflags.
void CheckFlagNames(int argc, char** argv, const Program& program) {
  std::vector<std::string> unknown;
  for (int i = 1; i < argc; ++i) {
    std::string name = argv[i];
    if (name == "--") break;
    if (name.size() < 2 || name[0] != '-') continue;
    name.erase(0, name[1] == '-' ? 2 : 1);
    const bool has_value = name.find('=') != std::string::npos;
    name = name.substr(0, name.find('='));
    std::replace(name.begin(), name.end(), '-', '_');
    if (name == "undefok") return;
    gflags::CommandLineFlagInfo info;
    const bool known = gflags::GetCommandLineFlagInfo(name.c_str(), &info);
    const bool negated = name.starts_with("no") && gflags::GetCommandLineFlagInfo(name.c_str() + 2, &info);
    if (known && !has_value && info.type != "bool") ++i;  // the value stands apart
    if (!known && !negated) unknown.push_back(name);
  }
  if (!unknown.empty()) throw InputError(WhyNoFlagOf(program, unknown.front()));
}

}  // namespace

std::vector<std::string> SplitAtCommas(const std::string& list) {
  std::vector<std::string> items;
  std::stringstream stream(list);
  for (std::string item; std::getline(stream, item, ',');) items.push_back(item);
  return items;
}

void CheckCommandLine(int argc, char** argv, const Program& program) {
  CheckFlagFiles(argc, argv);
  CheckFlagNames(argc, argv, program);
}

void RefuseFlagsOfOthers(const Program& program) {
  for (const Program& other : AllPrograms()) {
    for (const std::string& name : FlagNames(other)) {
      gflags::CommandLineFlagInfo info;
      if (!gflags::GetCommandLineFlagInfo(name.c_str(), &info) || info.is_default) continue;
      const std::string why = WhyNoFlagOf(program, name);
      if (!why.empty()) throw InputError(why);
    }
  }
}

}  // namespace saltus
