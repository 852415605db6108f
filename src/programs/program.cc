#include "programs/program.h"

#include <fcntl.h>
#include <gflags/gflags.h>
#include <glog/logging.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <filesystem>
#include <iostream>
#include <new>
#include <sstream>

#include "base/file.h"
#include "base/freed_memory.h"
#include "base/interrupt.h"
#include "base/number_text.h"
#include "base/parallel_for.h"
#include "base/suggestion.h"
#include "base/table.h"
#include "programs/feedback_study.h"
#include "programs/input_files.h"
#include "saltus/scene/scene_file.h"
#include "saltus/simulate/registry.h"
#include "saltus/solve/solvers_by_name.h"
#include "solve/control_guess.h"

DEFINE_string(scene, "", "scene file in YAML");
DEFINE_string(
    contact, "all",
    "comma-separated contact models, each with its options if there are any (ncp:kappa=1e-6:kappa_grad=1e-4), "
    "'all', or 'list' to print them");
DEFINE_string(solver, "",
              "comma-separated solvers, 'all', 'none' to simulate only, or 'list' to print them (default: auto; of "
              "the problems and sweeps, and with a learning rate or a surrogate, gd)");
DEFINE_int32(steps, 0, "number of time steps");
DEFINE_string(precision, "double", "arithmetic of the contact model: double or float");
DEFINE_double(stiffness, 0, "contact stiffness, N/m; compliant models only");
DEFINE_double(damping, 0, "contact damping, N s/m; compliant models only");
DEFINE_double(friction, 0, "coefficient of friction, >= 0");
DEFINE_double(restitution, 0, "coefficient of restitution, in [0, 1]");
DEFINE_double(learning_rate, 0, "step size of gradient descent (default: that of the published experiment)");
DEFINE_bool(rate_per_time, false,
            "the learning rate is per unit of time and does not depend on the number of steps (default: per step)");
DEFINE_int32(iterations, 0, "largest number of iterations of each solver (default: 1000)");
DEFINE_string(
    sequence, "auto",
    "collision sequence of ceres_event, ceres_phases, hmp and mode_search: 'auto' (that of the initial guess, "
    "which they may change), 'fixed' (that of the initial guess), 'none' (no impacts), or pairs such "
    "as striker-target,target-ceiling");
DEFINE_double(search_work, saltus::SearchOptions().work,
              "work limit of mode_search, in computed gradients; 0 is no limit");
DEFINE_double(search_seconds, 0, "time limit of mode_search, s; the result then depends on the machine; 0 is no limit");
DEFINE_int32(search_memory, 200, "memory limit of mode_search, MiB");
DEFINE_int32(search_starts, 8, "number of random starts of mode_search, in addition to the initial guess");
DEFINE_uint64(search_seed, 1, "seed of the random starts of mode_search");
DEFINE_string(surrogate, "",
              "biased estimate that replaces the gradient, or 'list' to print the names (default: the model's own "
              "gradient)");
DEFINE_double(surrogate_sigma, 0.01, "standard deviation of the samples, m, m/s or N");
DEFINE_int32(surrogate_samples, 2000, "number of samples of a smoothed gradient, even");
DEFINE_uint64(surrogate_seed, 1, "seed of a smoothed gradient; iteration k uses the k-th seed after it");
DEFINE_int32(surrogate_segments, 0,
             "number of equal parts of the horizon over which a sample changes the control by a constant (default: "
             "steps)");
DEFINE_int32(threads, 0, "number of threads; 0 is one per core");
DEFINE_int32(memory_limit, 1024, "memory for the states of a rollout, MiB; states that do not fit are computed again");
DEFINE_string(output_dir, "", "directory in which to write result files");
DEFINE_string(control, "",
              "JSON or NPZ file with a control: the initial guess or, with --solver=none, the control to simulate");
DEFINE_string(warm_start, "",
              "JSON or NPZ file of a solution whose control, velocities or positions are the initial guess");
DEFINE_bool(states, false, "include the times and states of every solution in --json");
DEFINE_bool(json, false, "print one JSON document on standard output instead of tables");
DEFINE_string(progress, "auto", "progress on standard error: auto, plain (lines) or none");
DEFINE_bool(h, false, "same as --help");

DECLARE_bool(help);
DECLARE_bool(helpshort);

namespace google {
extern void (*gflags_exitfunc)(int);  // what gflags calls instead of exit(); not in its header
}

namespace saltus {

namespace {

constexpr std::size_t kReserve = std::size_t{32} << 20;  // of the address space; no page of it is ever touched

std::atomic<void*> reserve{nullptr};
std::atomic<bool> holds{false};

void OnNoMemory() {
  void* held = reserve.exchange(nullptr);
  std::free(held);
  // A destructor that runs during unwinding may use the memory held back, and must not throw.
  if (held != nullptr && std::uncaught_exceptions() > 0) return;
  throw std::bad_alloc();
}

[[noreturn]] void OnTerminate() {
  try {
    if (const std::exception_ptr thrown = std::current_exception()) std::rethrow_exception(thrown);
  } catch (const std::bad_alloc&) {
    std::cout.flush();
    std::fflush(stdout);
    for (const char* text : {"error: ", kMemoryRanOut, "\n"}) (void)!write(STDERR_FILENO, text, std::strlen(text));
    _exit(kAnswerFailed);
  } catch (...) {
  }
  std::abort();
}

// Where std::bad_alloc cannot get out, the program prints kMemoryRanOut and ends as if main had caught it.
void HoldMemoryBack() {
  holds = true;
  HoldMemoryBackAgain();
  std::set_new_handler(OnNoMemory);
  std::set_terminate(OnTerminate);
}

constexpr size_t kMostFlagBytes = 1 << 20;
constexpr int kDeepestFlagFile = 16;

// gflags reads flag files to their end, whatever they are, and files that name themselves until it crashes.
void CheckFlagFile(const std::string& argument, int depth) {
  static constexpr char kFlag[] = "-flagfile=";
  const size_t dash = argument.find_first_not_of(" \t");
  if (dash == std::string::npos) return;
  const size_t start = argument.compare(dash, 2, "--") == 0 ? dash + 1 : dash;
  if (argument.compare(start, sizeof kFlag - 1, kFlag) != 0) return;
  for (const std::string& path : Split(argument.substr(start + sizeof kFlag - 1))) {
    if (depth == kDeepestFlagFile) throw InputError("--flagfile=" + path + ": flag files that name each other?");
    std::error_code unknown;
    if (std::filesystem::is_fifo(path, unknown)) continue;  // can be read only once
    const StatusOr<std::string> text = ReadFile(path, kMostFlagBytes);
    if (!text.ok()) throw InputError("--flagfile=" + text.status().message());
    for (const std::string& line : Split(*text, '\n')) CheckFlagFile(line, depth + 1);
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

// gflags ends the program at the first unknown flag. This function reports which program has it. Those that
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
    std::ranges::replace(name, '-', '_');
    if (name == "undefok") return;
    gflags::CommandLineFlagInfo info;
    const bool known = gflags::GetCommandLineFlagInfo(name.c_str(), &info);
    const bool negated = name.starts_with("no") && gflags::GetCommandLineFlagInfo(name.c_str() + 2, &info);
    if (known && !has_value && info.type != "bool") ++i;  // the value stands apart
    if (!known && !negated) unknown.push_back(name);
  }
  if (!unknown.empty()) throw InputError(ReasonFlagRefused(program, unknown.front()));
}

// Whatever way a flag was given: one that the program would ignore, or a text that is empty, is an error. To be called
// once flags are read.
void RefuseFlagsOfOthers(const Program& program) {
  for (const Program& other : AllPrograms()) {
    for (const std::string& name : FlagNames(other)) {
      gflags::CommandLineFlagInfo info;
      if (!gflags::GetCommandLineFlagInfo(name.c_str(), &info) || info.is_default) continue;
      const std::string why = ReasonFlagRefused(program, name);
      if (!why.empty()) throw InputError(why);
      if (info.type == "string" && info.current_value.empty()) {
        throw InputError("--" + name + " is empty, expected a value");
      }
    }
  }
}

}  // namespace

void HoldMemoryBackAgain() {
  if (!holds || reserve != nullptr) return;
  std::free(reserve.exchange(std::malloc(kReserve)));
}

std::vector<std::string> Split(const std::string& list, char separator) {
  std::vector<std::string> items;
  std::stringstream stream(list);
  for (std::string item; std::getline(stream, item, separator);) items.push_back(item);
  return items;
}

std::vector<std::pair<std::string, double>> ReadAssignments(const std::string& flag, const std::string& list,
                                                            const std::vector<std::string>& names) {
  std::vector<std::pair<std::string, double>> pairs;
  for (const std::string& item : Split(list)) {
    const std::string place = "--" + flag + "=" + item + ": ";
    const size_t equals = item.find('=');
    if (equals == std::string::npos) throw InputError(place + "expected name=value");
    const std::string name = item.substr(0, equals), text = item.substr(equals + 1);
    if (std::ranges::find(names, name) == names.end()) {
      throw InputError(place + "'" + name + "' is unknown; expected some of " + Joined(names) +
                       Suggestion(name, names));
    }
    const std::optional<double> value = FromText<double>(text);
    if (!value) throw InputError(place + "found '" + text + "', expected a finite number");
    const auto same = [&](const auto& pair) { return pair.first == name; };
    if (std::ranges::any_of(pairs, same)) throw InputError(place + "found '" + name + "' twice, expected it once");
    pairs.emplace_back(name, *value);
  }
  return pairs;
}

std::vector<std::string> ReadNames(const std::string& flag, const std::string& list,
                                   const std::vector<std::string>& known, const std::string& expected) {
  if (list == "all") return known;
  std::vector<std::string> names;
  for (const std::string& name : Split(list)) {
    if (std::ranges::find(known, name) == known.end()) {
      throw InputError("--" + flag + "=" + list + ": '" + name + "' is unknown; expected " + expected + Joined(known) +
                       Suggestion(name, known));
    }
    if (std::ranges::find(names, name) == names.end()) names.push_back(name);
  }
  if (names.empty()) throw InputError("--" + flag + " is empty; expected some of " + Joined(known));
  return names;
}

namespace {

void PrintModels() {
  for (const ModelTraits& model : AllContactModels()) {
    std::printf("%-16s %s\n", std::string(model.name).c_str(), std::string(model.summary).c_str());
    for (const ListedOption& option : OptionsOf(model.name)) {
      std::printf(
          "  :%s=%g  %s\n", std::string(option.name).c_str(), option.initial, std::string(option.meaning).c_str());
    }
  }
}

// A comma-separated list of contact models with their options.
std::vector<std::string> ReadContacts(const std::string& value) {
  if (value == "all") return NameList(AllContactModels());
  std::vector<std::string> contacts;
  for (const std::string& contact : Split(value)) {
    const std::string wrong = Validate(contact);
    if (!wrong.empty()) {
      const std::string name = contact.substr(0, contact.find(':'));
      const bool known = FindContactModel(name) != nullptr;
      throw InputError("--contact=" + value + ": " + wrong +
                       (known ? "" : Suggestion(name, NameList(AllContactModels()))));
    }
    std::vector<std::string> set;
    for (const std::string& option : Split(contact, ':')) {
      set.push_back(option.substr(0, option.find('=')));
      if (std::ranges::count(set, set.back()) < 2) continue;
      throw InputError("--contact=" + value + ": found '" + set.back() + "' twice, expected it once");
    }
    if (std::ranges::find(contacts, contact) == contacts.end()) contacts.push_back(contact);
  }
  if (contacts.empty())
    throw InputError("--contact is empty; expected some of " + Joined(NameList(AllContactModels())));
  return contacts;
}

double Finite(const char* flag, double value) {
  if (!std::isfinite(value)) throw InputError("--" + std::string(flag) + " must be a finite number");
  return value;
}

constexpr const char* kSmoothingFlags[] = {
    "surrogate_sigma", "surrogate_samples", "surrogate_seed", "surrogate_segments"};

SurrogateKind KindFromFlag() {
  for (const SurrogateEntry& entry : AllSurrogates()) {
    if (entry.name == FLAGS_surrogate) return entry.kind;
  }
  throw InputError("--surrogate=" + FLAGS_surrogate + " is unknown; expected one of " +
                   Joined(NameList(AllSurrogates())));
}

std::optional<Surrogate> SurrogateFromFlags() {
  std::optional<Surrogate> surrogate;
  if (!FLAGS_surrogate.empty()) surrogate = Surrogate{.kind = KindFromFlag()};
  if (!surrogate || !surrogate->smooths()) {
    RefuseFlags(kSmoothingFlags, " needs --surrogate=smoothed_zeroth or --surrogate=smoothed_first");
    return surrogate;
  }
  surrogate->sigma = FLAGS_surrogate_sigma;
  surrogate->samples = FLAGS_surrogate_samples;
  surrogate->seed = FLAGS_surrogate_seed;
  surrogate->segments = FLAGS_surrogate_segments;
  if (const std::string why = Validate(*surrogate); !why.empty()) throw InputError("--surrogate_" + why);
  return surrogate;
}

// --control and --warm_start.
void ReadStart(Request* request) {
  if (!FLAGS_control.empty() && !FLAGS_warm_start.empty()) {
    throw InputError("--control and --warm_start both give the initial guess; expected one of them");
  }
  const bool warm = !FLAGS_warm_start.empty();
  const std::string flag = warm ? "--warm_start" : "--control", path = warm ? FLAGS_warm_start : FLAGS_control;
  if (path.empty()) return;
  Scene* scene = &request->scene;
  const SavedSolution solution = ReadSolution(flag, path, *scene);
  (warm ? StartFrom : TakeParameters)(flag, solution, scene);
  const bool needed = !warm || scene->optimize == Optimize::kControl;
  if (solution.control.empty()) {
    if (needed) throw InputError(flag + ": " + path + ": expected a control");
    return;
  }
  ControlGuess guess{solution.control, solution.durations};
  if (const std::string wrong = Validate(guess, *scene); !wrong.empty()) {
    throw InputError(flag + ": " + path + ": " + wrong);
  }
  if (scene->optimize == Optimize::kControl) request->options.guess = guess;
  if (!request->solvers.empty() && scene->optimize != Optimize::kControl && !warm) {
    throw InputError("--control: the scene optimizes no control; expected --solver=none with it");
  }
  request->start = std::move(guess);
}

std::atomic<bool> end_without_waiting{false};
std::vector<std::string> files_given;

// A program started with a standard stream closed would get its number for the first file it opens, and print into it.
void OccupyStandardStreams() {
  for (const int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    // The stream gets a descriptor that cannot be written to, so that lost output is noticed.
    if (fcntl(stream, F_GETFD) < 0 && errno == EBADF) (void)open("/dev/null", O_RDONLY);
  }
}

// The exit code once all has been printed.
int FinishOutput(int code) {
  errno = 0;
  std::cout.flush();
  const bool flushed = std::fflush(stdout) == 0;
  if (flushed && std::cout && std::ferror(stdout) == 0) return code;
  std::cerr << "error: standard output took not all that was printed"
            << (errno == 0 ? "" : std::string(": ") + std::strerror(errno)) << std::endl;
  return code == kDone ? kAnswerFailed : code;
}

int RunBody(const std::function<int()>& body) {
  const auto fail = [](const std::string& message, int code) {
    std::cerr << "error: " << message << std::endl;
    return code;
  };
  try {
    return body();
  } catch (const InputError& error) {
    return fail(error.what(), kWrongInput);
  } catch (const std::bad_alloc&) {
    return fail(kMemoryRanOut, kAnswerFailed);
  } catch (const std::exception& error) {
    return fail(error.what(), kAnswerFailed);
  }
}

std::string PathOfReport(const Request& request) { return request.output_dir + "/report.html"; }

}  // namespace

int RunMain(int argc, char** argv, const Program& program, const std::function<int()>& body) {
  OccupyStandardStreams();
  KeepFreedMemory();
  HoldMemoryBack();
  std::signal(SIGXFSZ, SIG_IGN);  // a file that becomes too large is an error like others of writing
  google::InitGoogleLogging(argv[0]);
  FLAGS_logtostderr = true;
  // Ceres says in its log what the solvers take note of and go on after. The programs say themselves what matters, and
  // a check that fails is always said.
  FLAGS_minloglevel = google::GLOG_FATAL;
  gflags::SetUsageMessage(program.summary);
  gflags::SetVersionString(SALTUS_VERSION);
  google::gflags_exitfunc = [](int code) { std::exit(code == 0 ? kDone : kWrongInput); };
  const int code = RunBody([&] {
    CheckFlagFiles(argc, argv);
    CheckFlagNames(argc, argv, program);
    gflags::ParseCommandLineNonHelpFlags(&argc, &argv, true);
    RefuseFlagsOfOthers(program);
    if (FLAGS_h || FLAGS_help || FLAGS_helpshort) {
      std::cout << HelpText(program, LayoutOfStandardOutput().width);
      return kDone;
    }
    google::gflags_exitfunc = [](int) { std::exit(FinishOutput(kDone)); };
    gflags::HandleCommandLineHelpFlags();
    if (program.files) {
      files_given.assign(argv + 1, argv + argc);
    } else if (argc > 1) {
      throw InputError("'" + std::string(argv[1]) + "' is not a flag; flags look like --name=value");
    }
    return body();
  });
  if (end_without_waiting) EndProgram(code);
  if (code != kDone || !InterruptGuard::Interrupted()) return FinishOutput(code);
  std::cerr << "interrupted; what takes long of the results may be missing" << std::endl;
  return FinishOutput(kAnswerFailed);
}

const std::vector<std::string>& FilesGiven() { return files_given; }

void EndWithoutWaiting() { end_without_waiting = true; }

void EndProgram(int code) { _exit(FinishOutput(code)); }

void DoAll(const std::vector<std::function<void()>>& parts) {
  std::exception_ptr first;
  for (const std::function<void()>& part : parts) {
    try {
      part();
    } catch (...) {
      if (!first) first = std::current_exception();
      HoldMemoryBackAgain();
    }
  }
  if (first) std::rethrow_exception(first);
}

bool IsGiven(const char* flag) { return !gflags::GetCommandLineFlagInfoOrDie(flag).is_default; }

void RefuseFlags(std::span<const char* const> flags, const std::string& why) {
  for (const char* flag : flags) {
    if (IsGiven(flag)) throw InputError("--" + std::string(flag) + why);
  }
}

std::string ShippedFile(const std::string& path) {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::filesystem::path installed = program.parent_path().parent_path() / SALTUS_DATA_FOLDER / path;
  if (!error && std::filesystem::exists(installed, error)) return installed;
  return SALTUS_SOURCE_DIR "/" + path;
}

Scene LoadScene(const std::string& path) {
  std::variant<Scene, SceneFileError> loaded = LoadSceneFile(path);
  if (const auto* error = std::get_if<SceneFileError>(&loaded)) {
    const std::string key = error->key.substr(error->key.rfind('.') + 1);
    const bool boxes = key == "box" || key == "polygon" || key == "joint";
    throw InputError(error->ToString() + (boxes ? "; saltus_bodies reads files of boxes" : ""));
  }
  return std::get<Scene>(std::move(loaded));
}

int ThreadsFromFlags() {
  if (FLAGS_threads < 0 || FLAGS_threads > 4096) throw InputError("--threads must lie in 0..4096");
  return NumThreads(FLAGS_threads);
}

ProgressMode ProgressFromFlags() {
  if (const std::optional<ProgressMode> mode = ParseProgressMode(FLAGS_progress)) return *mode;
  throw InputError("--progress=" + FLAGS_progress + "; expected auto, plain or none");
}

std::string OutputDirFromFlags() { return FLAGS_output_dir; }

void ApplySceneFlags(Scene* scene) {
  if (IsGiven("steps")) scene->steps = FLAGS_steps;
  if (IsGiven("stiffness")) scene->contact.stiffness = Finite("stiffness", FLAGS_stiffness);
  if (IsGiven("damping")) scene->contact.damping = Finite("damping", FLAGS_damping);
  for (const char* name : {"friction", "restitution"}) {
    if (!IsGiven(name) || scene->materials.empty()) continue;
    throw InputError(std::string("--") + name + ": the scene has materials; give its pairs in the scene file");
  }
  if (IsGiven("friction")) scene->contact.friction = Finite("friction", FLAGS_friction);
  if (IsGiven("restitution")) scene->contact.restitution = Finite("restitution", FLAGS_restitution);
  if (const std::optional<SceneError> error = Validate(*scene)) {
    throw InputError("with the flags given, " + error->key + ": " + error->message);
  }
}

std::vector<std::string> ReadSolvers(const std::string& list) {
  std::vector<std::string> known = NameList(AllSolvers());
  if (list == "all") return known;
  for (const SolverEntry& solver : SolversByName()) known.emplace_back(solver.name);
  return ReadNames("solver", list, known);
}

Precision PrecisionFromFlags() {
  if (FLAGS_precision != "double" && FLAGS_precision != "float") {
    throw InputError("--precision=" + FLAGS_precision + "; expected double or float");
  }
  return FLAGS_precision == "float" ? Precision::kFloat : Precision::kDouble;
}

void ReadSolveFlags(const ProgramDefaults& defaults, SolveFlags* flags) {
  SolverOptions& options = flags->options;
  options.limits.iterations = IsGiven("iterations") ? FLAGS_iterations : defaults.iterations;
  if (options.limits.iterations < 0) throw InputError("--iterations must not be negative");
  if (IsGiven("learning_rate")) {
    options.descent.learning_rate = Finite("learning_rate", FLAGS_learning_rate);
    if (FLAGS_learning_rate <= 0) throw InputError("--learning_rate must be positive");
  }
  options.descent.rate_per_time = FLAGS_rate_per_time;
  options.sequences.limits = {.work = FLAGS_search_work,
                              .seconds = FLAGS_search_seconds,
                              .memory = static_cast<std::size_t>(std::max(0, FLAGS_search_memory)) << 20,
                              .starts = FLAGS_search_starts,
                              .seed = FLAGS_search_seed};
  if (const std::string why = Validate(options.sequences.limits); !why.empty()) throw InputError("--" + why);
  flags->threads = ThreadsFromFlags();
  flags->json = FLAGS_json;
  flags->states = FLAGS_states;
  if (FLAGS_states && !FLAGS_json) throw InputError("--states: expected --json with it; files have states anyway");
  flags->progress = ProgressFromFlags();
  flags->output_dir = OutputDirFromFlags();
  if (!flags->output_dir.empty()) MakeDirectory(flags->output_dir);
}

bool ReadRequest(const ProgramDefaults& defaults, Request* request) {
  if (FLAGS_contact == "list") {
    PrintModels();
    return false;
  }
  if (FLAGS_solver == "list") {
    PrintList(AllSolvers());
    PrintList(SolversByName());
    return false;
  }
  if (FLAGS_surrogate == "list") {
    PrintList(AllSurrogates());
    return false;
  }
  const std::string path = FLAGS_scene.empty() ? defaults.scene : FLAGS_scene;
  constexpr const char* kOfOneScene[] = {"scene", "control", "warm_start"};
  if (defaults.generated) RefuseFlags(kOfOneScene, ": scenes are made from seeds");
  if (!defaults.generated && path.empty()) throw InputError("--scene=FILE is needed; -h lists all flags");
  request->contacts = ReadContacts(FLAGS_contact);
  const bool descends = IsGiven("learning_rate") || FLAGS_rate_per_time || IsGiven("surrogate");
  const std::string by_default = descends && defaults.solver == "auto" ? "gd" : defaults.solver;
  const std::string solver = FLAGS_solver.empty() ? by_default : FLAGS_solver;
  if (solver != kNoSolver) request->solvers = ReadSolvers(solver);
  request->precision = PrecisionFromFlags();
  request->scene = defaults.generated ? *defaults.generated : LoadScene(path);
  ApplySceneFlags(&request->scene);
  ReadStart(request);

  request->options.sequences.search = FLAGS_sequence == "auto";
  if (FLAGS_sequence != "auto" && FLAGS_sequence != "fixed") {
    const std::string wrong =
        ParseContactSequence(request->scene, FLAGS_sequence, &request->options.sequences.given.emplace());
    if (!wrong.empty()) throw InputError("--sequence=" + FLAGS_sequence + ": " + wrong);
  }
  if (!IsGiven("learning_rate")) {
    request->options.descent.learning_rate =
        defaults.learning_rate == 0 ? DefaultLearningRate(request->scene) : defaults.learning_rate;
    if (FLAGS_rate_per_time) request->options.descent.learning_rate *= request->scene.duration / kPublishedSteps;
  }
  if (FLAGS_rate_per_time && request->scene.optimize != Optimize::kControl) {
    throw InputError("--rate_per_time: the scene does not optimize a control");
  }
  request->options.surrogate = SurrogateFromFlags();
  request->feedback = SceneFeedbackFromFlags();
  if (FLAGS_memory_limit <= 0) throw InputError("--memory_limit must be positive");
  request->options.limits.memory = static_cast<std::size_t>(FLAGS_memory_limit) << 20;
  ReadSolveFlags(defaults, request);
  return true;
}

void MakeDirectory(const std::string& path) {
  std::error_code error;
  std::filesystem::create_directories(path, error);
  if (error) throw InputError("cannot create directory '" + path + "': " + error.message());
}

void ThrowIfFailed(const Status& status) {
  if (!status.ok()) throw OutputError(status.message());
}

void WriteTextFile(const std::string& path, const std::string& text) {
  ThrowIfFailed(WriteFile(path, text, InterruptGuard::Interrupted));
}

void PrintTable(const std::string& caption, const Table& table) {
  const TextLayout layout = LayoutOfStandardOutput();
  std::cout << Paragraph(caption, layout.width) << "\n" << table.ToText(layout) << std::endl;
}

void PrintTableIfAny(const std::string& caption, const Table& table) {
  if (!table.rows().empty()) PrintTable(caption, table);
}

std::string FirstOf(const std::vector<std::string>& names) {
  constexpr size_t kMost = 6;
  if (names.size() <= kMost) return Joined(names);
  return Joined({names.begin(), names.begin() + kMost}) + " and " + std::to_string(names.size() - kMost) + " more";
}

Page StartPage(const Scene& scene) {
  const bool free = scene.objective.duration.has_value();
  return Page(scene.name,
              std::to_string(scene.steps) + (free ? " steps over a free duration, given as " : " steps over ") +
                  Cell(scene.duration).Display(6) + " s");
}

void WriteReport(const Request& request, const std::function<void(Page*)>& add) {
  if (request.output_dir.empty()) return;
  Page page = StartPage(request.scene);
  add(&page);
  page.AddHeading("Scene");
  page.AddPreformatted(WriteScene(request.scene));
  ThrowIfFailed(page.Write(PathOfReport(request)));
}

void PrintReportPath(const Request& request) {
  if (request.output_dir.empty()) return;
  (request.json ? std::cerr : std::cout) << PathOfReport(request) << std::endl;
}

}  // namespace saltus
