#include <gflags/gflags.h>

#include <algorithm>
#include <iostream>
#include <optional>

#include "base/interrupt.h"
#include "programs/identification.h"
#include "programs/program.h"

DEFINE_string(recording, "",
              "comma-separated CSV (time, body, x, y, sigma) or NPZ files, each with its own initial state");
DEFINE_string(unknown, "restitution",
              "comma-separated parameters to fit: restitution, friction, stiffness, damping, gravity, mass.BODY, "
              "force.BODY, radius.BODY, position.BODY of a fixed disc, offset.WALL, angle.WALL, or one component of a "
              "vector, such as gravity.y");
DEFINE_string(
    law, "",
    "fit an impact law: network (restitution as a function of the approach speed) or impulse (friction too, as a "
    "function of approach and sliding speeds), each with :N hidden units (default :4)");
DEFINE_string(
    events, "",
    "fit event functions of the scene's planes: affine (angle, distance and a linear update of the velocity for each "
    "plane) or profile (a surface that is not flat, restitution and friction), with :N units (default :3)");
DEFINE_string(law_beside, "", "CSV file (speed, restitution) of a known law to compare the fitted one with");
DEFINE_string(loss, "huber", "robust loss of the residual of a sample: none (squares), huber or cauchy");
DEFINE_double(loss_scale, 2,
              "residual, in standard deviations, beyond which the robust loss reduces the weight of a sample");
DEFINE_double(
    segment, 0,
    "length, s, of the segments into which recordings are cut, each with its own initial state (default: not cut)");
DEFINE_bool(known_start, false, "take the initial state from the scene (default: it is fitted too)");
DEFINE_int32(starts, 12, "largest number of starts of the fit");

namespace saltus {
namespace {

// Whether something is learned that is more than numbers of a scene.
bool Learns() { return !FLAGS_law.empty() || !FLAGS_events.empty(); }

IdentifyOptions OptionsFromFlags(const Request& request) {
  IdentifyOptions options;
  if (!FLAGS_law.empty()) {
    auto law = ParseLaw(FLAGS_law, request.scene);
    if (const auto* wrong = std::get_if<std::string>(&law)) throw InputError("--law=" + FLAGS_law + "; " + *wrong);
    options.law = std::get<ImpactLaw>(std::move(law));
  }
  if (!FLAGS_events.empty()) {
    auto events = ParseEvents(FLAGS_events, request.scene);
    if (const auto* wrong = std::get_if<std::string>(&events)) {
      throw InputError("--events=" + FLAGS_events + "; " + *wrong);
    }
    options.events = std::get<EventFunctions>(std::move(events));
  }
  const std::optional<RobustLoss> loss = ParseRobustLoss(FLAGS_loss);
  if (!loss) throw InputError("--loss=" + FLAGS_loss + "; expected none, huber or cauchy");
  options.loss = *loss;
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
  const std::vector<std::string> paths = Split(FLAGS_recording);
  for (const std::string& path : paths) {
    if (std::ranges::count(paths, path) > 1) {
      throw InputError("--recording: found " + path + " twice, whose samples would count twice; expected it once");
    }
    auto loaded = LoadAnyRecording(path, scene);
    if (const auto* error = std::get_if<RecordingError>(&loaded)) throw InputError(error->ToString());
    recordings.push_back(std::get<Recording>(std::move(loaded)));
  }
  return recordings;
}

std::vector<Unknown> ReadUnknowns(const Scene& scene) {
  if (Learns() && !IsGiven("unknown")) return {};
  auto unknowns = ParseUnknowns(FLAGS_unknown, scene);
  if (const auto* wrong = std::get_if<std::string>(&unknowns)) throw InputError("--unknown: " + *wrong);
  return std::get<std::vector<Unknown>>(std::move(unknowns));
}

void PrintTables(const Scene& scene, const Identified& identified, const std::vector<CaptionedTable>& tables) {
  const std::string learned = FLAGS_events.empty() ? "the law of impact" : "event functions";
  const std::string title = scene.name + ": " + (Learns() && !IsGiven("unknown") ? learned : FLAGS_unknown);
  for (const auto& [name, caption, table] : tables) {
    PrintTableIfAny(name == "fits" ? title : caption, table);
    if (name != "fits") continue;
    const std::size_t width = LayoutOfStandardOutput().width;
    for (const std::string& remark : FitRemarks(identified)) std::cout << Paragraph(remark, width) << std::endl;
  }
}

void WriteFiles(const std::string& directory, const Scene& scene, const Identified& identified,
                const std::vector<CaptionedTable>& tables) {
  if (directory.empty()) return;
  const std::string path = directory + "/" + scene.name + "_";
  WriteTextFile(path + "residuals.csv", ResidualTable(identified).ToCsv());
  for (const auto& [name, caption, table] : tables) {
    if (name == "fits" || name == "outliers" || (name != "parameters" && table.rows().empty())) continue;
    WriteTextFile(path + name + ".csv", table.ToCsv());
  }
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

// Reads the recordings and the scene to be fitted, without fits.
Identified ReadAll(const Request& request) {
  Identified identified;
  identified.recordings = ReadRecordings(request.scene);
  identified.contacts = IsGiven("contact") ? request.contacts : std::vector<std::string>{"event"};
  if (!FLAGS_law_beside.empty() && FLAGS_law.empty()) throw InputError("--law_beside: expected --law with it");
  if (!FLAGS_law_beside.empty()) identified.known_law = ReadKnownLaw(FLAGS_law_beside);
  return identified;
}

void FitAll(const Request& request, Identified* out) {
  Identified& identified = *out;
  const std::vector<Unknown> unknowns = ReadUnknowns(request.scene);
  IdentifyOptions options = OptionsFromFlags(request);
  Progress progress(
      request.progress, stderr, "identify " + request.scene.name, static_cast<int64_t>(identified.contacts.size()));
  progress.UnitsDiffer();
  for (const std::string& contact : identified.contacts) {
    if (InterruptGuard::Interrupted()) break;
    options.status = [&](const std::string& what) { progress.Advance(0, contact + " " + what); };
    try {
      identified.reports.push_back(Identify(contact, request.scene, identified.recordings, unknowns, options));
    } catch (const std::bad_alloc&) {
      HoldMemoryBackAgain();
      IdentifyReport& failed = identified.reports.emplace_back();
      failed.verdict = FitVerdict::kFailed;
      failed.reason = kMemoryRanOut;
    }
    progress.Advance(1, contact);
  }
}

}  // namespace

int IdentifyMain(int argc, char** argv) {
  return RunMain(argc, argv, FindProgram("saltus_identify"), [] {
    Request request;
    if (!ReadRequest({}, &request)) return kDone;
    Identified identified = ReadAll(request);  // which a signal ends at once, as there is nothing to keep yet
    const InterruptGuard guard;
    FitAll(request, &identified);
    const Json document = IdentifiedToJson(request.scene, identified);
    const std::vector<CaptionedTable> tables = FitTables(document);
    DoAll({[&] { WriteFiles(request.output_dir, request.scene, identified, tables); },
           [&] { WriteIdentifyReport(request, identified, document); },
           [&] { request.json ? PrintJson(document) : PrintTables(request.scene, identified, tables); }});
    PrintReportPath(request);
    return ExitCodeOf(identified);
  });
}

}  // namespace saltus
