#include "tools/identify.h"

#include <gflags/gflags.h>

#include <iostream>
#include <sstream>

#include "output/interrupt.h"
#include "output/table.h"
#include "tools/recording_npz.h"

DEFINE_string(recording, "", "comma-separated CSV (time, body, x, y, sigma) or NPZ files, each with its own start");
DEFINE_string(unknown, "restitution",
              "comma-separated: restitution, friction, stiffness, damping, gravity, mass.BODY, force.BODY; of vectors "
              "one component as gravity.y");
DEFINE_string(loss, "huber", "of a sample's residual: none (squares), huber or cauchy");
DEFINE_double(loss_scale, 2, "sigmas beyond which a sample counts less");
DEFINE_double(segment, 0, "s, > 0: recordings are cut into segments of this length, each with its own start");
DEFINE_bool(known_start, false, "the initial state is that of the scene (default: it is identified too)");
DEFINE_int32(starts, 12, "fits from different starts, at most");

namespace saltus {
namespace {

constexpr std::size_t kMostNamed = 20;  // outliers in the table

std::vector<std::string> SplitNames(const std::string& list) {
  std::vector<std::string> names;
  std::stringstream stream(list);
  for (std::string name; std::getline(stream, name, ',');) names.push_back(name);
  return names;
}

RobustLoss LossFromFlag() {
  if (FLAGS_loss == "none") return RobustLoss::kNone;
  if (FLAGS_loss == "huber") return RobustLoss::kHuber;
  if (FLAGS_loss == "cauchy") return RobustLoss::kCauchy;
  throw InputError("--loss=" + FLAGS_loss + "; expected none, huber or cauchy");
}

IdentifyOptions OptionsFromFlags(const Request& request) {
  IdentifyOptions options;
  options.loss = LossFromFlag();
  if (!(FLAGS_loss_scale > 0)) throw InputError("--loss_scale must be positive");
  if (!(FLAGS_segment >= 0)) throw InputError("--segment must not be negative");
  if (FLAGS_starts < 1) throw InputError("--starts must be at least 1");
  options.loss_scale = FLAGS_loss_scale;
  options.segment = FLAGS_segment;
  options.initial_states = !FLAGS_known_start;
  options.starts = FLAGS_starts;
  options.threads = request.threads;
  options.stop = InterruptGuard::Interrupted;
  return options;
}

std::vector<Recording> ReadRecordings(const Scene& scene) {
  if (FLAGS_recording.empty()) throw InputError("--recording=FILE is needed; -h lists all flags");
  std::vector<Recording> recordings;
  for (const std::string& path : SplitNames(FLAGS_recording)) {
    auto loaded = path.ends_with(".npz") ? LoadRecordingNpz(path, scene) : LoadRecording(path, scene);
    if (const auto* error = std::get_if<RecordingError>(&loaded)) throw InputError(error->ToString());
    recordings.push_back(std::get<Recording>(std::move(loaded)));
  }
  return recordings;
}

std::vector<Unknown> ReadUnknowns(const Scene& scene) {
  auto unknowns = ParseUnknowns(FLAGS_unknown, scene);
  if (const auto* wrong = std::get_if<std::string>(&unknowns)) throw InputError("--unknown: " + *wrong);
  return std::get<std::vector<Unknown>>(std::move(unknowns));
}

bool HasMinimum(const IdentifyReport& report) { return !report.residuals.empty(); }

Json EstimatesToJson(const IdentifyReport& report) {
  Json list = Json::array();
  for (const Estimate& estimate : report.estimates) {
    const bool determined = estimate.determination == Determination::kDetermined;
    Json item = {{"name", estimate.name}, {"start", NumberToJson(estimate.start)}};
    item["value"] = determined ? NumberToJson(estimate.value) : Json();
    item["standard_error"] = determined ? NumberToJson(estimate.standard_error) : Json();
    item["interval"] = determined ? NumbersToJson({estimate.low, estimate.high}) : Json();
    item["determination"] = DeterminationToString(estimate.determination);
    if (!estimate.with.empty()) item["with"] = estimate.with;
    list.push_back(std::move(item));
  }
  return list;
}

Json ResidualToJson(const Scene& scene, const std::vector<Recording>& recordings, const SampleResidual& at) {
  const Recording& recording = recordings[at.recording];
  const Sample& sample = recording.samples[at.sample];
  Json item = {{"recording", recording.name}};
  if (sample.line > 0) item["line"] = sample.line;
  item["time"] = NumberToJson(sample.time);
  item["body"] = scene.bodies[sample.body].name;
  item["residual"] = NumbersToJson({at.standardised[0], at.standardised[1]});
  return item;
}

Table EstimateTable(const Identified& identified) {
  Table table({{"contact"},
               {"parameter"},
               {"start", 5},
               {"value", 7},
               {"standard error", 3},
               {"from", 6},
               {"to", 6},
               {"remark"}},
              2);
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    for (const Estimate& estimate : identified.reports[i].estimates) {
      std::string remark;
      if (estimate.determination != Determination::kDetermined) {
        remark = DeterminationToString(estimate.determination);
        for (const std::string& other : estimate.with)
          remark += (&other == &estimate.with[0] ? " with " : ", ") + other;
      }
      const auto known = [&](double value) { return remark.empty() ? Cell(value) : Cell(); };
      table.AddRow({identified.contacts[i],
                    estimate.name,
                    estimate.start,
                    known(estimate.value),
                    known(estimate.standard_error),
                    known(estimate.low),
                    known(estimate.high),
                    remark});
    }
  }
  return table;
}

Table FitTable(const Identified& identified) {
  Table table({{"contact"},
               {"verdict"},
               {"samples"},
               {"outliers"},
               {"misfit", 4},
               {"sigma", 3},
               {"cost", 6},
               {"impacts"},
               {"starts"},
               {"sequences"},
               {"iterations"},
               {"seconds", 3},
               {"remark"}});
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    const IdentifyReport& report = identified.reports[i];
    std::size_t outliers = 0;
    for (const SampleResidual& at : report.residuals) outliers += at.outlier;
    const auto of_fit = [&](const auto& value) { return HasMinimum(report) ? Cell(value) : Cell(); };
    table.AddRow({identified.contacts[i],
                  FitVerdictToString(report.verdict),
                  of_fit(report.residuals.size()),
                  of_fit(outliers),
                  report.misfit > 0 ? Cell(report.misfit) : Cell(),
                  report.sigma > 0 ? Cell(report.sigma) : Cell(),
                  of_fit(report.cost),
                  of_fit(report.impacts),
                  report.starts,
                  report.sequences,
                  report.iterations,
                  report.seconds,
                  report.reason});
  }
  return table;
}

Table OutlierTable(const Scene& scene, const Identified& identified) {
  Table table({{"contact"}, {"recording"}, {"line"}, {"time", 6}, {"body"}, {"residual x", 3}, {"residual y", 3}}, 3);
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    for (const SampleResidual& at : identified.reports[i].residuals) {
      if (!at.outlier || table.rows().size() == kMostNamed) continue;
      const Recording& recording = identified.recordings[at.recording];
      const Sample& sample = recording.samples[at.sample];
      table.AddRow({identified.contacts[i],
                    recording.name,
                    sample.line > 0 ? Cell(sample.line) : Cell(),
                    sample.time,
                    scene.bodies[sample.body].name,
                    at.standardised[0],
                    at.standardised[1]});
    }
  }
  return table;
}

void PrintTables(const Scene& scene, const Identified& identified) {
  const TextLayout layout = LayoutOfStandardOutput();
  std::cout << scene.name << ": " << FLAGS_unknown << "\n\n" << FitTable(identified).ToText(layout) << std::endl;
  const Table estimates = EstimateTable(identified);
  if (!estimates.rows().empty()) {
    std::cout << "95 % confidence is from ... to\n\n" << estimates.ToText(layout) << std::endl;
  }
  const Table outliers = OutlierTable(scene, identified);
  if (outliers.rows().empty()) return;
  std::cout << "Outliers, at most " << kMostNamed << " of them, residuals in sigmas\n\n"
            << outliers.ToText(layout) << std::endl;
}

void WriteFiles(const std::string& directory, const Scene& scene, const Identified& identified) {
  if (directory.empty()) return;
  Table residuals({{"contact"},
                   {"recording"},
                   {"line"},
                   {"time"},
                   {"body"},
                   {"x"},
                   {"y"},
                   {"residual_x"},
                   {"residual_y"},
                   {"outlier"}});
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    for (const SampleResidual& at : identified.reports[i].residuals) {
      const Recording& recording = identified.recordings[at.recording];
      const Sample& sample = recording.samples[at.sample];
      residuals.AddRow({identified.contacts[i],
                        recording.name,
                        sample.line,
                        sample.time,
                        scene.bodies[sample.body].name,
                        at.predicted[0],
                        at.predicted[1],
                        at.standardised[0],
                        at.standardised[1],
                        int{at.outlier}});
    }
  }
  WriteTextFile(directory + "/" + scene.name + "_parameters.csv", EstimateTable(identified).ToCsv());
  WriteTextFile(directory + "/" + scene.name + "_residuals.csv", residuals.ToCsv());
}

int ExitCodeOf(const Identified& identified) {
  std::size_t not_applicable = 0, failed = 0;
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    const IdentifyReport& report = identified.reports[i];
    not_applicable += report.verdict == FitVerdict::kNotApplicable;
    failed += report.verdict != FitVerdict::kFits && report.verdict != FitVerdict::kNotApplicable;
    if (report.verdict == FitVerdict::kFits) continue;
    std::cerr << (report.verdict == FitVerdict::kNotApplicable ? "error: " : "") << identified.contacts[i] << ": "
              << FitVerdictToString(report.verdict) << (report.reason.empty() ? "" : ", ") << report.reason
              << std::endl;
  }
  if (not_applicable == identified.reports.size() && not_applicable > 0) return kWrongInput;
  return failed > 0 || identified.reports.size() < identified.contacts.size() ? kAnswerFailed : kDone;
}

Identified IdentifyAll(const Request& request) {
  Identified identified;
  identified.recordings = ReadRecordings(request.scene);
  identified.contacts = IsGiven("contact") ? request.contacts : std::vector<std::string>{"event"};
  const std::vector<Unknown> unknowns = ReadUnknowns(request.scene);
  IdentifyOptions options = OptionsFromFlags(request);
  Progress progress(
      request.progress, stderr, "identify " + request.scene.name, static_cast<int64_t>(identified.contacts.size()));
  for (const std::string& contact : identified.contacts) {
    if (InterruptGuard::Interrupted()) break;
    options.status = [&](const std::string& what) { progress.Advance(0, contact + " " + what); };
    identified.reports.push_back(Identify(contact, request.scene, identified.recordings, unknowns, options));
    progress.Advance(1, contact);
  }
  return identified;
}

}  // namespace

Json IdentifiedToJson(const Scene& scene, const Identified& identified) {
  Json list = Json::array();
  bool interrupted = identified.reports.size() < identified.contacts.size();
  for (std::size_t i = 0; i < identified.reports.size(); ++i) {
    const IdentifyReport& report = identified.reports[i];
    interrupted |= report.verdict == FitVerdict::kInterrupted;
    Json item = {{"contact", identified.contacts[i]}, {"verdict", FitVerdictToString(report.verdict)}};
    if (!report.reason.empty()) item["reason"] = report.reason;
    if (HasMinimum(report)) {
      item["cost"] = NumberToJson(report.cost);
      if (report.misfit > 0) item["misfit"] = NumberToJson(report.misfit);
      if (report.sigma > 0) item["sigma"] = NumberToJson(report.sigma);
      item["samples"] = report.residuals.size();
      item["impacts"] = report.impacts;
      item["parameters"] = EstimatesToJson(report);
      item["correlation"] = Json::array();
      for (const std::vector<double>& row : report.correlation) item["correlation"].push_back(NumbersToJson(row));
      item["outliers"] = Json::array();
      for (const SampleResidual& at : report.residuals) {
        if (at.outlier) item["outliers"].push_back(ResidualToJson(scene, identified.recordings, at));
      }
      item["segments"] = Json::array();
      for (std::size_t s = 0; s < report.initial.size(); ++s) {
        item["segments"].push_back({{"recording", identified.recordings[report.segment_recording[s]].name},
                                    {"begin", NumberToJson(report.segment_begin[s])},
                                    {"position", VectorsToJson(scene, report.initial[s], 0)},
                                    {"velocity", VectorsToJson(scene, report.initial[s], 2)}});
      }
    }
    item["starts"] = report.starts;
    item["sequences"] = report.sequences;
    item["iterations"] = report.iterations;
    item["evaluations"] = report.evaluations;
    item["seconds"] = report.seconds;
    list.push_back(std::move(item));
  }
  Json document = {{"scene", scene.name}, {"fits", std::move(list)}};
  if (interrupted) document["interrupted"] = true;
  return document;
}

int IdentifyMain(int argc, char** argv) {
  return RunMain(argc, argv, FindProgram("saltus_identify"), [] {
    Request request;
    if (!ReadRequest({}, &request)) return kDone;
    const InterruptGuard guard;
    const Identified identified = IdentifyAll(request);
    const auto print = [&] {
      if (request.json) {
        PrintJson(IdentifiedToJson(request.scene, identified), Precision::kDouble);
      } else {
        PrintTables(request.scene, identified);
      }
    };
    WriteAndPrint([&] { WriteFiles(request.output_dir, request.scene, identified); }, print);
    return ExitCodeOf(identified);
  });
}

}  // namespace saltus
