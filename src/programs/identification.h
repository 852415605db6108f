// The input of identification, as text and files, and its results as tables, JSON and a page.
#pragma once

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "base/table.h"
#include "output/npz.h"
#include "output/page.h"
#include "programs/json_output.h"
#include "programs/program.h"
#include "saltus/identify/identify.h"
#include "saltus/identify/recording.h"

namespace saltus {

// "none", "huber" or "cauchy".
std::optional<RobustLoss> ParseRobustLoss(const std::string& name);

// "network" or "impulse", perhaps with ":N" hidden units: a network that begins as the scene's law. Else what was
// expected.
std::variant<ImpactLaw, std::string> ParseLaw(const std::string& text, const Scene& scene);

// "affine", or "profile", perhaps with ":N" hidden units: event functions that begin as the scene's planes. Else what
// was expected.
std::variant<EventFunctions, std::string> ParseEvents(const std::string& text, const Scene& scene);

// A recording from a CSV or an NPZ file.
std::variant<Recording, RecordingError> LoadAnyRecording(const std::string& path, const Scene& scene);

// Restitution by the speed of approach, m/s, which rises.
struct KnownLaw {
  std::vector<double> speed, restitution;

  // Interpolates linearly between the points; std::nullopt outside of them.
  std::optional<double> RestitutionAt(double at) const;
};

// Reads CSV with the columns speed and restitution. Throws InputError that names the line: numbers that are not finite,
// speeds that do not rise, restitution outside of [0, 1], fewer than two rows.
KnownLaw ReadKnownLaw(const std::string& path);

// Arrays time (n), body (n, names or indices of the scene) and position (n x 2); and if they are there velocity (n x
// 2), sigma and sigma_v (n, or one number). Refused: what CSV is refused for, with the row, from 0.
std::variant<Recording, RecordingError> RecordingFromArrays(const NpzArrays& arrays, const std::string& name,
                                                            const Scene& scene);

// Fits of the same recordings, by contact model.
struct Identified {
  std::vector<Recording> recordings;
  std::vector<std::string> contacts;
  std::vector<IdentifyReport> reports;  // of each contact model that was begun
  std::string by = "contact";           // what `contacts` are
  std::optional<KnownLaw> known_law = std::nullopt;
};

Json IdentifiedToJson(const Scene& scene, const Identified& identified);

// The tables of a document of fits, some of them empty: "fits", "parameters" of each, "beside_event" (every parameter
// under every contact model, beside what `event` has: bias is what a value is more), the "law" of impact that was
// learned, "events" (every impact with a plane by event functions that were learned) and the first "outliers".
std::vector<CaptionedTable> FitTables(const Json& document);
// Returns the remarks on fits, each behind its contact model.
std::vector<std::string> FitRemarks(const Identified& identified);
// The law of a report, with a band of 95 % confidence. Precondition: it has a curve.
Figure LawFigure(const LearnedLaw& learned, const std::optional<KnownLaw>& known);
// All residuals.
Table ResidualTable(const Identified& identified);

// The fit of a hybrid system, the only one of `identified`, as JSON and as a page. WriteHybridFitPage() throws
// OutputError.
Json HybridFitToJson(const Identified& identified);
void WriteHybridFitPage(const Identified& identified, const Json& document, const std::string& path);
// Writes the report of fits into the output folder, if there is one. Throws OutputError.
void WriteIdentifyReport(const Request& request, const Identified& identified, const Json& document);

}  // namespace saltus
