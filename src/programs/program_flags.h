// Which program takes which flags: for --help, and for flags that a program would ignore.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace saltus {

// The flags under one heading, as "scene=FILE" or, for a switch, "json".
struct FlagGroup {
  std::string title;
  std::vector<std::string> flags;
};

struct Program {
  std::string name;
  std::string summary;             // a sentence, without its full stop
  std::vector<std::string> usage;  // what may follow the name on the command line
  std::vector<FlagGroup> groups;
  std::string notes = "";  // paragraphs after the flags
  bool files = false;      // takes arguments that are no flags
};

// Every program but those of the problems, which share one entry, "the problems' programs".
const std::vector<Program>& AllPrograms();
// Precondition: there is one of that name.
const Program& FindProgram(std::string_view name);
// The program of the problem of that name.
Program ProblemProgram(const std::string& name);
// Returns the program of a hybrid system, of whose main `path` is the first argument.
Program HybridProblemProgram(const std::string& path);

// Returns the names of the flags, without values: "scene", "json".
std::vector<std::string> FlagNames(const Program& program);

// Returns the text of -h and --help, in lines of at most `width` columns: the program's flags, with their types and
// defaults from gflags.
std::string HelpText(const Program& program, size_t width);

// Returns the error of a flag on the command line, whether gflags has it or not: no program has it, or only others than
// this one. Empty if the program takes it, and for flags of glog and gflags. `name` is without dashes.
std::string WhyNoFlagOf(const Program& program, std::string_view name);

}  // namespace saltus
