// `saltus_sweep`: many points of some options, on all cores or as a job array, with every finished point kept.
#include <gflags/gflags.h>

#include <algorithm>
#include <cmath>
#include <iostream>
#include <iterator>
#include <memory>
#include <mutex>
#include <sstream>
#include <string_view>
#include <utility>

#include "base/interrupt.h"
#include "base/number_text.h"
#include "base/table.h"
#include "programs/parallel.h"
#include "programs/program.h"
#include "programs/simulators.h"
#include "saltus/scene/scene_file.h"
#include "scene/control_problems.h"
#include "sweep/results.h"
#include "sweep/study.h"

DEFINE_string(
    sweep, "",
    "points of the sweep: 'stiffness=1e2:1e5:log:7; steps=120,240' is every combination, 'stiffness=1,2 & "
    "damping=3,4' changes two options together, '(contact,solver)=(lcp,gd),(event,ceres_lm)' and '@points.csv' are "
    "explicit points");
DEFINE_string(program, "",
              "program of a hybrid system, with or without flags of its own, in place of --scene; its options are its "
              "parameters, initial states, duration, steps, iterations, learning_rate and solver");
DEFINE_double(point_seconds, 0, "time limit of each point, s; a point that takes longer fails (default: no limit)");
DEFINE_string(shard, "", "compute only the I-th of N parts, I = 1..N, into DIR/sweep.shard-I-of-N.csv");
DEFINE_bool(retry_failed, false, "compute the failed points of --output_dir again");

namespace saltus {
namespace {

constexpr size_t kMostRowsInReport = 500;

// One of several parts of a study.
struct Shard {
  int index = 1;
  int count = 1;

  // Parts are contiguous, so that their files in the order of their names are the file of the whole.
  PointRange Points(int64_t size) const { return {size * (index - 1) / count, size * index / count}; }
  // Results of a part do not stand in the way of those of the whole.
  std::string BaseName() const {
    if (count == 1) return "sweep";
    const std::string last = std::to_string(count), number = std::to_string(index);
    return "sweep.shard-" + std::string(last.size() - number.size(), '0') + number + "-of-" + last;
  }
};

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
  if ((!FLAGS_shard.empty() || FLAGS_retry_failed) && OutputDirFromFlags().empty()) {
    throw InputError("--shard and --retry_failed need --output_dir, where the points are kept");
  }
}

std::string ReportPath(const SweepStudy& study, const std::string& base) {
  return study.request().output_dir + "/" + (base == "sweep" ? "" : base + ".") + "report.html";
}

bool HasSolvedTable(const SweepStudy& study) { return study.generates() && study.solving(); }

// One page of what failed and the first rows.
void WriteReport(const SweepStudy& study, const std::vector<StoredPoint>& points, const std::string& base) {
  const Request& request = study.request();
  Page page = StartPage(request.scene);
  page.AddHeading("Points");
  page.AddPreformatted(Summary(study, points));
  if (HasSolvedTable(study)) page.AddTable(SolvedTable(study, points), "The problems that each solver solves.");
  const std::vector<StoredPoint> first(points.begin(), points.begin() + std::min(points.size(), kMostRowsInReport));
  page.SetResults(SweepJson(study, first));
  page.AddHeading("Rows");
  page.AddTable(SweepTable(study, first),
                first.size() < points.size() ? "The first rows; `" + base + ".csv` has all."
                                             : "All rows, as in `" + base + ".csv`.");
  if (study.generates() || KeptProgram() != nullptr) return ThrowIfFailed(page.Write(ReportPath(study, base)));
  page.AddHeading("Scene");
  page.AddPreformatted(WriteScene(request.scene));
  ThrowIfFailed(page.Write(ReportPath(study, base)));
}

void WriteFiles(const SweepStudy& study, const std::vector<StoredPoint>& points, const Table& table,
                const std::string& base) {
  const std::string& directory = study.request().output_dir;
  if (directory.empty()) return;
  WriteTextFile(directory + "/" + base + ".csv", table.ToCsv());
  if (HasSolvedTable(study)) WriteTextFile(directory + "/" + base + ".solved.csv", SolvedTable(study, points).ToCsv());
  ThrowIfFailed(WriteNpz(directory + "/" + base + ".npz", SweepArrays(study, points)));
  WriteReport(study, points, base);
}

void WriteResults(const SweepStudy& study, const std::vector<StoredPoint>& points, const std::string& base) {
  const Table table = SweepTable(study, points);
  DoAll({[&] { WriteFiles(study, points, table, base); },
         [&] {
           if (study.request().json) {
             PrintJson(SweepJson(study, points));
           } else {
             std::cout << table.ToCsv() << std::flush;
           }
           if (HasSolvedTable(study)) std::cerr << SolvedTable(study, points).ToText(LayoutOfStandardOutput());
         }});
  // Standard output is data.
  const bool silent = study.request().progress == ProgressMode::kNone || InterruptGuard::Interrupted();
  if (!silent && !study.request().output_dir.empty()) std::cerr << ReportPath(study, base) << std::endl;
}

// Writes the results so far and reports how the sweep ended.
int Report(const SweepStudy& study, const std::vector<StoredPoint>& points, Shard shard) {
  WriteResults(study, points, shard.BaseName());
  const PointRange range = shard.Points(study.size());
  const int64_t missing = range.end - range.begin - static_cast<int64_t>(points.size());
  const auto is_done = [](const StoredPoint& point) { return point.result.status == PointStatus::kComputed; };
  if (missing > 0 || !std::ranges::all_of(points, is_done)) std::cerr << Summary(study, points);
  if (missing > 0) std::cerr << missing << " points are missing; the same command goes on with them" << std::endl;
  return missing == 0 && std::ranges::any_of(points, is_done) ? kDone : kAnswerFailed;
}

// The state that threads share. After an interrupt they may go on until the process ends.
struct Sweep {
  Sweep(const SweepStudy& swept, Shard shard)
      : study(swept), store(study.request().output_dir, shard.BaseName(), study) {}

  const SweepStudy study;
  std::mutex mutex;  // guards what follows
  SweepStore store;
};

int RunSweep(const SweepStudy& study) {
  const Shard shard = ReadShard(FLAGS_shard);
  const PointRange range = shard.Points(study.size());
  const auto sweep = std::make_shared<Sweep>(study, shard);
  if (FLAGS_retry_failed) sweep->store.ForgetFailed();
  std::vector<int64_t> points;
  for (int64_t point = range.begin; point < range.end; ++point) {
    if (sweep->store.Find(point) == nullptr) points.push_back(point);
  }
  if (!points.empty()) {
    Progress progress(study.request().progress, stderr, "sweep " + study.request().scene.name, std::ssize(points));
    const int threads = ThreadsFromFlags();
    const JobsEnd end = RunJobsOrAbandon(
        static_cast<int>(points.size()),
        [sweep, points](int i) { return PlaceOf(sweep->study, points[i]); },
        threads,
        &progress,
        [sweep, points, alone = threads == 1](int i, const SayNote&) {
          PointResult result = ComputePoint(sweep->study, points[i], FLAGS_point_seconds, IsStopRequested, alone);
          const std::lock_guard lock(sweep->mutex);
          // An interrupt may have cut it short.
          if (!IsStopRequested()) sweep->store.Add(points[i], std::move(result));
        });
    if (end.thrown) std::rethrow_exception(end.thrown);
  }
  std::unique_lock lock(sweep->mutex);
  const std::vector<StoredPoint> stored = StoredPoints(sweep->store, range);
  lock.unlock();
  return Report(study, stored, shard);
}

// Adds simulators; they are swept alone unless contact models are asked for too.
void AddSimulators(Request* request) {
  const std::vector<std::string> names = KeepSimulators(ReadSimulators());
  if (!names.empty() && !IsGiven("contact")) request->contacts.clear();
  request->contacts.insert(request->contacts.end(), names.begin(), names.end());
}

// Whether each point is to have a scene of its own, which is asked before there is any: some option is the seed.
bool SweepsSeeds(std::string text) {
  std::ranges::replace_if(
      text, [](char c) { return std::string_view(";&(,=)").find(c) != std::string_view::npos; }, ' ');
  std::istringstream words(text);
  return std::find(std::istream_iterator<std::string>(words), {}, kSeedOption) != std::istream_iterator<std::string>();
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

int Run() {
  const InterruptGuard guard;
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
  AddSimulators(&request);
  return RunSweep(SweepStudy(request, ParseSweep(FLAGS_sweep, request.scene)));
}

}  // namespace

int SweepMain(int argc, char** argv) { return RunMain(argc, argv, FindProgram("saltus_sweep"), Run); }

}  // namespace saltus
