#include "paper/law_example.h"

#include <algorithm>
#include <cmath>

#include "base/interrupt.h"
#include "programs/identify_output.h"
#include "programs/parallel.h"

namespace saltus {
namespace {

constexpr int kDrops = 4;
constexpr int kUnits = 3;       // of the network
constexpr double kFastest = 8;  // m/s, about

std::vector<Recording> ReadDrops(const std::string& folder, const Scene& scene) {
  std::vector<Recording> recordings;
  for (int i = 1; i <= kDrops; ++i) {
    auto loaded = LoadRecording(folder + "/drop_" + std::to_string(i) + ".csv", scene);
    if (const auto* error = std::get_if<RecordingError>(&loaded)) throw InputError(error->ToString());
    recordings.push_back(std::get<Recording>(std::move(loaded)));
  }
  return recordings;
}

// Between the slowest and the fastest impact.
double LargestError(const LearnedLaw& learned, const KnownLaw& truth) {
  double largest = 0;
  for (const LawPoint& at : learned.curve) {
    if (const auto known = truth.At(at.speed)) largest = std::max(largest, std::abs(at.restitution - *known));
  }
  return largest;
}

}  // namespace

std::optional<PaperFigure> LearnALaw() {
  const std::string folder = ShippedFile("problems/drops");
  const Scene scene = LoadScene(folder + "/drops.yaml");
  const KnownLaw truth = ReadKnownLaw(folder + "/law.csv");
  IdentifyOptions options;
  options.law = RestitutionNetwork(kUnits, kFastest, scene.contact.restitution);
  options.stop = AskedToStop;
  const IdentifyReport report = Identify("event", scene, ReadDrops(folder, scene), {}, options);
  if (!report.law || report.law->curve.empty()) return std::nullopt;
  Figure figure = LawFigure(*report.law, truth);
  figure.panels[0].reference_lines.push_back(
      {.value = scene.contact.restitution, .label = "the start", .colour = "#999999", .dash = Dash::kDotted});
  return PaperFigure{
      "learned_law",
      "Restitution by the speed of approach, learned by a network of " + std::to_string(kUnits) + " tanh units from " +
          std::to_string(report.law->impacts) +
          " impacts of a ball that was dropped from four heights and seen 60 times a second with 1 mm of noise; known "
          "is the law that made the recordings. It " +
          FitVerdictToString(report.verdict) + "; between the slowest and the fastest impact it is off by " +
          Format("%.2g", LargestError(*report.law, truth)) + " at most.",
      std::move(figure)};
}

}  // namespace saltus
