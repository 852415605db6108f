// `saltus_sweep`: many points of some options, on all cores and many machines, with every finished point kept.
#include <gflags/gflags.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <memory>
#include <regex>
#include <string_view>
#include <utility>

#include "base/interrupt.h"
#include "base/number_text.h"
#include "output/table.h"
#include "programs/program.h"
#include "programs/simulators.h"
#include "saltus/scene/scene_file.h"
#include "scene/control_problems.h"
#include "sweep/executor.h"
#include "sweep/figures.h"
#include "sweep/options.h"
#include "sweep/output.h"

DEFINE_string(
    sweep, "",
    "points of the sweep: 'stiffness=1e2:1e5:log:7; steps=120,240' is every combination, 'stiffness=1,2 & "
    "damping=3,4' changes two options together, '(contact,solver)=(lcp,gd),(event,ceres_lm)' and '@points.csv' are "
    "explicit points");
DEFINE_string(program, "",
              "program of a hybrid system, with or without flags of its own, in place of --scene; its options are its "
              "parameters, initial states, duration, steps, iterations, learning_rate and solver");
DEFINE_double(point_seconds, 0, "time limit of each point, s; a point that takes longer fails (default: no limit)");
DEFINE_string(shard, "", "compute only the I-th of N parts, I = 1..N; --merge joins the parts");
DEFINE_bool(merge, false, "merge the shards in --output_dir instead of computing");
DEFINE_bool(retry_failed, false, "compute the failed points of --output_dir again");

DECLARE_int32(threads);

namespace saltus {
namespace {

constexpr size_t kMostRowsInReport = 500;

Shard ReadShard(const std::string& text) {
  if (text.empty()) return {};
  const size_t slash = std::min(text.find('/'), text.size() - 1);  // without one nothing is left for the count
  const std::optional<int> index = FromText<int>(text.substr(0, slash)), count = FromText<int>(text.substr(slash + 1));
  if (!index || !count || *index < 1 || *index > *count) {
    throw InputError("--shard=" + text + "; expected i/n with i in 1..n, such as 2/8");
  }
  return {*index, *count};
}

void CheckFlags() {
  if (!(FLAGS_point_seconds >= 0) || std::isinf(FLAGS_point_seconds)) {
    throw InputError("--point_seconds must be a number >= 0");
  }
  const bool parts = !FLAGS_shard.empty() || FLAGS_merge || FLAGS_retry_failed;
  if (parts && OutputDirFromFlags().empty()) {
    throw InputError("--shard, --merge and --retry_failed need --output_dir, where the points are kept");
  }
  if (FLAGS_merge && !FLAGS_shard.empty()) throw InputError("--merge takes all shards, expected no --shard with it");
}

// Throws InputError if the store cannot be used: the user has to correct the reason before the sweep can go on.
template <typename T>
T OrInputError(StatusOr<T> result) {
  if (!result.ok()) throw InputError(result.status().message());
  return std::move(*result);
}

std::string ShardName(Shard shard) {
  return "shard-" + std::to_string(shard.index) + "-of-" + std::to_string(shard.count);
}

// Returns the base name of output files, which differs for shards, so that these do not replace those of the whole.
std::string BaseName(Shard shard) { return shard.count == 1 ? "sweep" : "sweep." + ShardName(shard); }

std::string ReportPath(const SweepStudy& study, const std::string& base) {
  return study.request().output_dir + "/" + (base == "sweep" ? "" : base + ".") + "report.html";
}

std::vector<std::string> ShardStores(const std::string& directory) {
  static const std::regex name("sweep\\.shard-[0-9]+-of-[0-9]+\\.sqlite");
  std::vector<std::string> paths;
  for (const auto& entry : std::filesystem::directory_iterator(directory)) {
    if (std::regex_match(entry.path().filename().string(), name)) paths.push_back(entry.path().string());
  }
  std::ranges::sort(paths);
  return paths;
}

void MergeShards(const SweepStudy& study, SweepStore* store) {
  const std::vector<std::string> paths = ShardStores(study.request().output_dir);
  if (paths.empty()) {
    throw InputError("--merge: no shards in '" + study.request().output_dir + "'; expected sweep.shard-*.sqlite there");
  }
  for (const std::string& path : paths) {
    const SweepStore shard = OrInputError(SweepStore::Open(path, study));
    const int64_t added = OrInputError(store->Merge(shard));
    if (study.request().progress == ProgressMode::kNone) continue;
    std::cerr << path << ": " << shard.size() << " points, " << added << " of them new" << std::endl;
  }
}

bool HasSolvedTable(const SweepStudy& study) { return study.generates() && study.solving(); }

// One page of what failed, the figures and the first rows.
void WriteReport(const SweepStudy& study, const std::vector<StoredPoint>& points,
                 const std::vector<SweepFigure>& figures, const std::string& base) {
  const Request& request = study.request();
  Page page = StartPage(request.scene);
  page.AddHeading("Points");
  page.AddPreformatted(Summary(study, points));
  if (HasSolvedTable(study)) page.AddTable(SolvedTable(study, points), "The problems that each solver solves.");
  if (!figures.empty()) page.AddHeading("Figures");
  for (const SweepFigure& figure : figures) {
    std::string caption = figure.name;
    std::ranges::replace(caption, '_', ' ');
    page.AddFigure(figure.figure, caption);
  }
  const std::vector<StoredPoint> first(points.begin(), points.begin() + std::min(points.size(), kMostRowsInReport));
  page.SetResults(SweepJson(study, first));
  page.AddHeading("Rows");
  page.AddTable(SweepTable(study, first),
                first.size() < points.size() ? "The first rows; `" + base + ".csv` has all."
                                             : "All rows, as in `" + base + ".csv`.");
  if (study.generates() || KeptProgram() != nullptr) return OrOutputError(page.Write(ReportPath(study, base)));
  page.AddHeading("Scene");
  page.AddPreformatted(WriteScene(request.scene));
  OrOutputError(page.Write(ReportPath(study, base)));
}

void WriteFiles(const SweepStudy& study, const std::vector<StoredPoint>& points, const Table& table,
                const std::string& base) {
  const std::string& directory = study.request().output_dir;
  if (directory.empty()) return;
  WriteTextFile(directory + "/" + base + ".csv", table.ToCsv());
  if (HasSolvedTable(study)) WriteTextFile(directory + "/" + base + ".solved.csv", SolvedTable(study, points).ToCsv());
  OrOutputError(WriteNpz(directory + "/" + base + ".npz", SweepArrays(study, points)));
  if (InterruptGuard::Interrupted()) return;  // figures take seconds
  const std::vector<SweepFigure> figures = MakeSweepFigures(study, points);
  for (const SweepFigure& figure : figures) {
    const std::string path = directory + "/" + base + "." + figure.name;
    const Status status = WriteFigure(figure.figure, path);
    // The results stand without figures: gnuplot may be missing.
    if (!status.ok()) std::cerr << "no figure " << path << ": " << status.message() << std::endl;
  }
  WriteReport(study, points, figures, base);
}

void WriteResults(const SweepStudy& study, const std::vector<StoredPoint>& points, const std::string& base) {
  const Table table = SweepTable(study, points);
  DoAll({[&] { WriteFiles(study, points, table, base); },
         [&] {
           if (study.request().json) {
             PrintJson(SweepJson(study, points), study.request().precision);
           } else {
             std::cout << table.ToCsv() << std::flush;
           }
           if (HasSolvedTable(study)) std::cerr << SolvedTable(study, points).ToText(LayoutOfStandardOutput());
         }});
  // Standard output is data.
  const bool silent = study.request().progress == ProgressMode::kNone || InterruptGuard::Interrupted();
  if (!silent && !study.request().output_dir.empty()) std::cerr << ReportPath(study, base) << std::endl;
}

// Writes what there is and says how it went.
int Report(const SweepStudy& study, const SweepStore& store, Shard shard) {
  const std::vector<StoredPoint> points = AllPoints(store);
  WriteResults(study, points, BaseName(shard));
  const int64_t wanted = (study.size() - shard.index + shard.count) / shard.count;
  const int64_t missing = wanted - static_cast<int64_t>(points.size());
  const bool some_done =
      std::ranges::any_of(points, [](const StoredPoint& p) { return p.result.status == PointStatus::kComputed; });
  if (missing > 0 ||
      std::ranges::any_of(points, [](const StoredPoint& p) { return p.result.status != PointStatus::kComputed; })) {
    std::cerr << Summary(study, points);
  }
  if (missing > 0 && InterruptGuard::Interrupted()) std::cerr << "interrupted; ";
  if (missing > 0) std::cerr << missing << " points are missing; the same command goes on with them" << std::endl;
  return missing == 0 && some_done ? kDone : kAnswerFailed;
}

int Workers(const SweepCluster* cluster) {
  const int threads = ThreadsFromFlags();
  if (cluster == nullptr || FLAGS_threads > 0) return threads;
  return std::max(1, threads / cluster->ranks_here());
}

int RunSweep(const SweepStudy& study, SweepCluster* cluster) {
  const Shard shard = ReadShard(FLAGS_shard);
  const std::string& directory = study.request().output_dir;
  SweepStore store = OrInputError(
      SweepStore::Open(directory.empty() ? ":memory:" : directory + "/" + BaseName(shard) + ".sqlite", study));
  if (FLAGS_merge) {
    MergeShards(study, &store);
    return Report(study, store, shard);
  }
  if (FLAGS_retry_failed) OrInputError(store.ForgetFailed());
  const std::vector<int64_t> points = PendingPoints(study, shard, store, [&] {
    if (cluster != nullptr) cluster->Tick();
  });
  if (!points.empty()) {
    LocalExecutor local(study, Workers(cluster), FLAGS_point_seconds);
    const std::unique_ptr<SweepExecutor> shared = cluster == nullptr ? nullptr : cluster->Share(study, &local);
    SweepExecutor* executor = shared == nullptr ? &local : shared.get();
    Progress progress(
        study.request().progress, stderr, "sweep " + study.request().scene.name, static_cast<int64_t>(points.size()));
    OrOutputError(RunPoints(study, points, executor, &store, &progress));
  }
  return Report(study, store, shard);
}

// Adds simulators; they are swept alone unless contact models are asked for too.
void AddSimulators(const std::vector<std::string>& arguments, Request* request) {
  const std::vector<std::string> names = KeepSimulators(ReadSimulators(arguments));
  if (!names.empty() && !IsGiven("contact")) request->contacts.clear();
  request->contacts.insert(request->contacts.end(), names.begin(), names.end());
}

// Whether each point is to have a scene of its own, which is asked before there is any.
bool SweepsSeeds(const std::string& text) {
  // The parser is written by hand, because std::regex needs stack for every character.
  constexpr std::string_view kSpace = " \t\n\v\f\r", kBefore = ";&(, \t\n\v\f\r", kAfter = "=,)";
  const std::string_view seed = kSeedOption;
  for (size_t at = text.find(seed); at != std::string::npos; at = text.find(seed, at + 1)) {
    const size_t next = text.find_first_not_of(kSpace, at + seed.size());
    const bool begins = at == 0 || kBefore.find(text[at - 1]) != std::string_view::npos;
    if (begins && next != std::string::npos && kAfter.find(text[next]) != std::string_view::npos) return true;
  }
  return false;
}

// Asks the program of --program for the names of the numbers that can be set.
void AskProgram() {
  KeepProgram({.command = FLAGS_program, .name = FLAGS_program, .names = {}});
  const Json document = RunProgram("--solver=none", FLAGS_point_seconds);
  SweepProgram program{.command = FLAGS_program, .name = "", .names = {"duration", "tolerance"}};
  try {
    program.name = document.at("program");
    for (const Json& name : document.at("system").at("parameters")) program.names.push_back(name);
    for (const Json& mode : document.at("system").at("modes")) {
      if (mode.at("name") != document.at("guess").at("mode")) continue;
      for (const Json& name : mode.at("states")) program.names.push_back(name);
    }
    program.feedback = document.contains("feedback");
  } catch (const Json::exception&) {
    throw InputError("--program=" + FLAGS_program + ": is no program of a hybrid system");
  }
  KeepProgram(std::move(program));
}

int RunRank(const std::vector<std::string>& arguments, SweepCluster* cluster) {
  Request request;
  ProgramDefaults defaults;
  const auto generate = [&defaults](const std::string& name) {
    Scene scene = ControlProblem(0);
    scene.name = name;
    defaults.generated = std::make_shared<const Scene>(std::move(scene));
  };
  if (!FLAGS_program.empty()) {
    if (IsGiven("feedback")) throw InputError("--feedback: expected it in the command of --program");
    AskProgram();
    generate(KeptProgram()->name);
  }
  if (SweepsSeeds(FLAGS_sweep)) generate("control_problems");
  if (!ReadRequest(defaults, &request)) return kDone;
  CheckFlags();
  AddSimulators(arguments, &request);
  const SweepStudy study(request, ParseSweep(FLAGS_sweep, request.scene));
  if (cluster == nullptr || cluster->rank() == 0) return RunSweep(study, cluster);
  LocalExecutor local(study, Workers(cluster), FLAGS_point_seconds);
  return cluster->Serve(study, &local) ? kDone : kAnswerFailed;
}

}  // namespace

int SweepMain(int argc, char** argv) {
  const std::vector<std::string> arguments(argv, argv + argc);
  return RunMain(argc, argv, FindProgram("saltus_sweep"), [&arguments] {
    const InterruptGuard guard;
    const std::unique_ptr<SweepCluster> cluster = JoinCluster();
    if (cluster == nullptr || cluster->rank() == 0) return RunRank(arguments, cluster.get());
    try {
      return RunRank(arguments, cluster.get());
    } catch (const InputError& error) {
      // Rank 0 reports it. An exit code that is not 0 would make mpirun end rank 0, perhaps before it has.
      cluster->Decline(error.what());
      return kDone;
    }
  });
}

}  // namespace saltus
