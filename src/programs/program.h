// The common parts of all programs: flags, the scene they describe, exit codes, memory, pages.
#pragma once

#include <cstdio>
#include <functional>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "feedback/feedback_study.h"
#include "output/page.h"
#include "output/progress.h"
#include "programs/json_output.h"
#include "programs/problem.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/simulator.h"
#include "saltus/solve/solver.h"
#include "solve/checked_run.h"

namespace saltus {

// Which program takes which flags: for --help, and for flags that a program would ignore.

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
std::string ReasonFlagRefused(const Program& program, std::string_view name);

// The message when memory runs out.
inline constexpr char kMemoryRanOut[] = "memory ran out";

// RunMain holds some memory back. The first allocation that fails gives it back and throws std::bad_alloc, so that
// there is memory to take down what was built: destructors of JSON documents allocate. Holds memory back again after it
// ran out, if there is any by now.
void HoldMemoryBackAgain();

// The items of a list, between separators; none of an empty one.
std::vector<std::string> Split(const std::string& list, char separator = ',');

// The names of contact models, solvers or the like.
template <typename Entries>
std::vector<std::string> NameList(const Entries& entries) {
  std::vector<std::string> names;
  for (const auto& entry : entries) names.emplace_back(entry.name);
  return names;
}

// Prints names and summaries on standard output, one entry a line.
template <typename Entries>
void PrintList(const Entries& entries) {
  for (const auto& entry : entries) {
    std::printf("%-21s %s\n", std::string(entry.name).c_str(), std::string(entry.summary).c_str());
  }
}

// The pairs of a flag's comma-separated list of name=value. Throws InputError for a name that is not one of `names`,
// and for a value that is no finite number.
std::vector<std::pair<std::string, double>> ReadAssignments(const std::string& flag, const std::string& list,
                                                            const std::vector<std::string>& names);

// The items of a flag's comma-separated list, each once, or all `known` of "all". Throws InputError for one that is not
// known, with `expected`, and for an empty list.
std::vector<std::string> ReadNames(const std::string& flag, const std::string& list,
                                   const std::vector<std::string>& known,
                                   const std::string& expected = "'all' or some of ");

// The exit codes, which scripts rely on.
inline constexpr int kDone = 0;
inline constexpr int kAnswerFailed = 1;  // it ran, but did not converge or a row did not match
inline constexpr int kWrongInput = 2;

// The input was wrong; the message names the place and what was expected. RunMain turns it into exit code 2.
struct InputError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// The options of the flags that programs of scenes and of hybrid systems share.
struct SolveFlags {
  std::vector<std::string> solvers;
  SolverOptions options;
  int threads = 1;
  std::optional<FeedbackOptions> feedback = {};
  bool states = false;     // --states
  std::string output_dir;  // empty: write no files
  bool json = false;
  ProgressMode progress = ProgressMode::kAuto;
};

// The options of the programs of scenes.
struct Request : SolveFlags {
  Scene scene;
  std::vector<std::string> contacts;
  Precision precision = Precision::kDouble;
  std::optional<ControlGuess> start;  // the control that a flag gives, also where none is optimized
};

// For documents that are not to have --states.
inline Request OmitStates(Request request) {
  request.states = false;
  return request;
}

// Thrown if results could not be written. RunMain turns it into exit code 1.
struct OutputError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// Parses flags, runs `body` and turns what it throws into exit codes. Flags that are not the program's are wrong input.
// If standard output did not take all that was printed, that is an error too.
int RunMain(int argc, char** argv, const Program& program, const std::function<int()>& body);

// The arguments that are no flags, of a program that takes files.
const std::vector<std::string>& FilesGiven();

// Makes RunMain end the process without waiting for threads that are at work still.
void EndWithoutWaiting();

// Ends the process so, at once.
[[noreturn]] void EndProgram(int code);

// Calls all, also after one that throws, and then throws what the first threw: where one file cannot be written, or
// memory runs out in making it, the others still are, and the tables are printed.
void DoAll(const std::vector<std::function<void()>>& parts);

// Reads the common flags. Throws InputError. If --contact=list, --solver=list or --surrogate=list is given, prints the
// list and returns false: the program is done.
bool ReadRequest(const ProgramDefaults& defaults, Request* request);

// Replaces parts of the scene by the values of flags. Throws InputError if that is impossible.
void ApplySceneFlags(Scene* scene);

// The parts of ReadRequest, for programs without a scene.
int ThreadsFromFlags();
ProgressMode ProgressFromFlags();
std::string OutputDirFromFlags();
Precision PrecisionFromFlags();

// Reads the flags of SolveFlags but --solver and --feedback, and makes the directory for files. Throws InputError.
void ReadSolveFlags(const ProgramDefaults& defaults, SolveFlags* flags);

// Loads a scene file. Throws InputError.
Scene LoadScene(const std::string& path);

// Whether a flag was given on the command line, in a flag file or in the environment. Precondition: there is such a
// flag.
bool IsGiven(const char* flag);

// Throws InputError that begins with the flag, if one of these is given.
void RefuseFlags(std::span<const char* const> flags, const std::string& why);

// The learning rate of the published experiments for this kind of problem, per N for controls.
inline double DefaultLearningRate(const Scene& scene) { return scene.optimize == Optimize::kControl ? 10 : 0.01; }
inline constexpr int kPublishedSteps = 480;  // for which that of a control is

// Creates the directory and its parents if need be. Throws InputError.
void MakeDirectory(const std::string& path);

void ThrowIfFailed(const Status& status);

// Writes a whole file. Throws OutputError if it cannot.
void WriteTextFile(const std::string& path, const std::string& text);

// Prints a table under its caption on standard output. PrintTableIfAny() prints nothing for a table without rows.
void PrintTable(const std::string& caption, const Table& table);
void PrintTableIfAny(const std::string& caption, const Table& table);

// The first few of some names in one line: "lcp, ncp and 12 more".
std::string FirstOf(const std::vector<std::string>& names);

Page StartPage(const Scene& scene);

// Writes report.html into --output_dir, if there is one: what `add` adds, and the scene. Throws OutputError.
void WriteReport(const Request& request, const std::function<void(Page*)>& add);

// The path of the report as the last line, if one was asked for: on stdout, or on stderr if that is JSON.
void PrintReportPath(const Request& request);

}  // namespace saltus
