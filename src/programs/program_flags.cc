#include <gflags/gflags.h>
#include <glog/logging.h>

#include <algorithm>
#include <filesystem>
#include <iterator>
#include <optional>
#include <sstream>

#include "base/suggestion.h"
#include "base/table.h"
#include "programs/program.h"

namespace saltus {
namespace {

constexpr char kProblems[] = "the problems' programs";
constexpr char kHybridProblems[] = "the programs of hybrid systems";
constexpr size_t kFlagColumns = 26;  // beside which a flag is explained

std::vector<std::string> Words(const std::string& text) {
  std::istringstream words(text);
  return {std::istream_iterator<std::string>(words), {}};
}

const FlagGroup kScene = {"Scene (these flags override the file)",
                          Words("scene=FILE steps=N restitution=E friction=MU stiffness=X damping=X")};
const FlagGroup kModels = {"Contact models", Words("contact=LIST precision=NAME")};
const FlagGroup kSimulators = {"Black-box simulators", Words("simulate=COMMAND simulate_seconds=S")};
const FlagGroup kModelsAndSimulators = {"Contact models",
                                        Words("contact=LIST precision=NAME simulate=COMMAND simulate_seconds=S")};
const FlagGroup kSolvers = {
    "Solvers",
    Words("solver=LIST iterations=N learning_rate=X rate_per_time sequence=LIST memory_limit=MIB search_work=N "
          "search_seconds=S search_memory=MIB search_starts=N search_seed=N")};
const FlagGroup kStart = {"Initial guess (these flags override the scene)", Words("control=FILE warm_start=FILE")};
const FlagGroup kSurrogate = {
    "Surrogate gradients",
    Words("surrogate=NAME surrogate_sigma=X surrogate_samples=N surrogate_segments=N surrogate_seed=N")};
const FlagGroup kFeedback = {"Feedback and uncertainty",
                             Words("feedback feedback_weights=LIST feedback_noise=LIST feedback_scale=X "
                                   "feedback_plant=MODEL feedback_samples=N feedback_seed=N")};
const FlagGroup kHybridFeedback = {
    "Feedback and uncertainty",
    Words("feedback feedback_weights=LIST feedback_noise=LIST feedback_scale=X feedback_samples=N feedback_seed=N")};
const FlagGroup kOutput = {"Output", Words("json output_dir=DIR progress=NAME threads=N")};

const std::vector<FlagGroup> kHybridGroups = {
    {"Problem (in place of the program's own)", Words("set=LIST steps=N")},
    {"Solvers",
     Words("solver=LIST iterations=N learning_rate=X rate_per_time search_work=N search_seconds=S search_memory=MIB "
           "search_starts=N search_seed=N")},
    kHybridFeedback,
    {"Audit of a time-stepping scheme", Words("audit width_sweep simulate=COMMAND simulate_seconds=S")},
    {"Output", Words("json states output_dir=DIR progress=NAME threads=N")}};
constexpr char kHybridNotes[] =
    "--steps is the number of control intervals, and with --audit that of the scheme's steps. The default solver is "
    "auto, or gd with a learning rate.";

std::vector<FlagGroup> AddSceneFlags(std::vector<FlagGroup> groups) {
  groups.front() = {"Problem (these flags override the file)", {"scene=FILE", "set=LIST", "steps=N"}};
  return groups;
}

// "scene" of "scene=FILE", "all_formulations" of "[no]all_formulations".
std::string NameOf(std::string_view flag) {
  if (flag.starts_with("[no]")) flag.remove_prefix(4);
  return std::string(flag.substr(0, flag.find('=')));
}

bool AcceptsFlag(const Program& program, std::string_view name) {
  const std::vector<std::string> names = FlagNames(program);
  return std::ranges::find(names, name) != names.end();
}

std::optional<gflags::CommandLineFlagInfo> InfoOf(const std::string& name) {
  gflags::CommandLineFlagInfo info;
  if (!gflags::GetCommandLineFlagInfo(name.c_str(), &info)) return std::nullopt;
  return info;
}

// "text (default: value)", unless the text states what happens without the flag.
std::string Explanation(const gflags::CommandLineFlagInfo& info) {
  const std::string& value = info.default_value;
  const bool says =
      info.description.find("default") != std::string::npos || value.empty() || value == "0" || info.type == "bool";
  return info.description + (says ? "" : " (default: " + value + ")");
}

// "a, b and c".
std::string Join(const std::vector<std::string>& words) {
  if (words.size() < 2) return Joined(words);
  return Joined({words.begin(), words.end() - 1}) + " and " + words.back();
}

std::vector<Program> MakePrograms() {
  return {
      {kProblems,
       "Computes the gradients of every contact model, and optimises, for a problem of the papers",
       {"[--contact=LIST] [--solver=LIST|none] [--json]"},
       {kScene,
        kModels,
        kSolvers,
        kStart,
        {"Audit", Words("attribution_seconds=S fail_on_wrong width_sweep")},
        kSurrogate,
        kFeedback,
        kOutput}},
      {kHybridProblems,
       "Motion, loss with gradient, optimisation and audit of a problem of a hybrid system",
       {"[--set=NAME=VALUE,...] [--solver=LIST|none] [--audit] [--json]"},
       kHybridGroups,
       kHybridNotes},
      {"saltus_bodies",
       "Motion, loss with gradient, optimisation and audit of a problem of planar bodies in a file",
       {"--scene=FILE [--set=NAME=VALUE,...] [--solver=LIST|none] [--simulate=\"[NAME=]COMMAND\"] [--json]"},
       AddSceneFlags(kHybridGroups),
       kHybridNotes},
      {"saltus_audit",
       "Audits the gradients of contact models: which are right, which are wrong, where and why",
       {"--scene=FILE [--contact=LIST] [--given=FILE] [--simulate=\"[NAME=]COMMAND\"] [--json]"},
       {kScene,
        kModels,
        {"Audit", Words("attribution_seconds=S audit_seconds=S fail_on_wrong given=FILE width_sweep")},
        kSimulators,
        kSurrogate,
        kOutput}},
      {"saltus_solve",
       "Optimises a scene with the chosen contact models and solvers",
       {"--scene=FILE [--contact=LIST] [--solver=LIST|none] [--json]"},
       {kScene, kModels, kSolvers, kStart, kSurrogate, kFeedback, {"States", Words("states")}, kOutput}},
      {"saltus_replay",
       "Writes a page that plays saved motions",
       {"FILE... [--scene=FILE] [--output=FILE.html]"},
       {{"Replay", Words("scene=FILE output=FILE")}},
       "A FILE is an NPZ file of a solution, the JSON output of saltus_solve --states, or a file of another simulator "
       "with the same keys (docs/how-to/replays.md lists them). Several files make one page of several motions.",
       true},
      {"saltus_sweep",
       "Computes many points of some options, and prints one row of CSV for each",
       {"--scene=FILE|--program=COMMAND --sweep=\"stiffness=1e2:1e5:log:7; steps=120,240\" [--contact=LIST] "
        "[--solver=LIST|none]"},
       {{"Points", Words("sweep=POINTS program=COMMAND point_seconds=S retry_failed shard=I/N")},
        kScene,
        kModelsAndSimulators,
        kSolvers,
        kSurrogate,
        kFeedback,
        kOutput},
       "With --output_dir, the row of every finished point is appended to DIR/sweep.csv immediately, and the same "
       "command continues after an interruption. At the end, DIR has sweep.npz and report.html, too.\n"
       "On many machines, run --shard=1/N to --shard=N/N with the same --output_dir, and join the files "
       "DIR/sweep.shard-*-of-N.csv with one header into DIR/sweep.csv."},
      {"saltus_identify",
       "Fits parameters of a scene to recordings of its motion, with confidence intervals",
       {"--scene=FILE --recording=FILE,... --unknown=restitution,mass.BALL [--contact=LIST] [--json]"},
       {{"Data", Words("recording=LIST segment=S")},
        {"Fit", Words("unknown=LIST law=NAME law_beside=FILE events=NAME known_start loss=NAME loss_scale=X starts=N")},
        kScene,
        {"Contact models (default: event)", Words("contact=LIST")},
        kOutput}},
      {"saltus_scene",
       "Writes a scene of many discs, or a control problem, to standard output",
       {"[--kind=NAME] [--discs=N] [--seed=N]"},
       {{"Scene", Words("kind=NAME discs=N seed=N steps=N restitution=E")}}},
      {"saltus_simulate",
       "Runs a contact model as a black box: reads requests from standard input and answers on standard output, one "
       "JSON object per line",
       {"--contact=NAME [--precision=NAME] [--offer=LIST]"},
       {kModels, {"Protocol", Words("offer=LIST")}}},
      {"saltus_reproduce",
       "Computes every table and figure of the paper, next to the published values",
       {"[--output_dir=DIR] [--simulate=\"[NAME=]COMMAND\"]"},
       {{"What", Words("[no]all_formulations every_solver")},
        kSimulators,
        {"Input", Words("problems_dir=DIR data_dir=DIR")},
        {"Output", Words("output_dir=DIR progress=NAME threads=N")}}}};
}

}  // namespace

const std::vector<Program>& AllPrograms() {
  static const std::vector<Program>& programs = *new std::vector<Program>(MakePrograms());
  return programs;
}

const Program& FindProgram(std::string_view name) {
  const std::vector<Program>& programs = AllPrograms();
  const auto found = std::ranges::find(programs, name, &Program::name);
  CHECK(found != programs.end()) << name;
  return *found;
}

Program ProblemProgram(const std::string& name) {
  Program program = FindProgram(kProblems);
  program.name = name;
  return program;
}

Program HybridProblemProgram(const std::string& path) {
  Program program = FindProgram(kHybridProblems);
  program.name = std::filesystem::path(path).filename().string();
  return program;
}

std::vector<std::string> FlagNames(const Program& program) {
  std::vector<std::string> names;
  for (const FlagGroup& group : program.groups) {
    for (const std::string& flag : group.flags) names.push_back(NameOf(flag));
  }
  return names;
}

std::string HelpText(const Program& program, size_t width) {
  std::string text = Paragraph(program.name + ": " + program.summary + ".", width) + "\n";
  for (const std::string& usage : program.usage)
    text += Paragraph(usage, width, program.name.size() + 3, "  " + program.name);
  for (const FlagGroup& group : program.groups) {
    text += "\n" + Paragraph(group.title, width);
    for (const std::string& flag : group.flags) {
      const std::optional<gflags::CommandLineFlagInfo> info = InfoOf(NameOf(flag));
      CHECK(info) << program.name << " has no flag " << flag;
      text += Paragraph(Explanation(*info), width, kFlagColumns, "  --" + flag);
    }
  }
  if (!program.notes.empty()) text += "\n" + Paragraph(program.notes, width);
  return text + "\n" +
         Paragraph(
             "Every program also takes --flagfile=FILE, --fromenv=FLAGS, --version, and --helpfull, which lists the "
             "flags of gflags and glog too. Exit codes: 0 success, 1 the computation failed, 2 the input is wrong.",
             width);
}

std::string ReasonFlagRefused(const Program& program, std::string_view name) {
  if (AcceptsFlag(program, name)) return "";
  std::vector<std::string> takers, flags;
  for (const Program& other : AllPrograms()) {
    if (AcceptsFlag(other, name)) takers.push_back(other.name);
  }
  const std::string flag = "--" + std::string(name);
  if (!takers.empty()) return flag + " is not a flag of " + program.name + ", but of " + Join(takers);
  if (InfoOf(std::string(name))) return "";
  for (const std::string& own : FlagNames(program)) flags.push_back("--" + own);
  const std::string meant = Suggestion(flag, flags);
  return flag + " is not a flag of " + program.name + (meant.empty() ? "; -h lists them" : meant);
}

}  // namespace saltus
