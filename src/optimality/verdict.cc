// What the numbers of a certificate amount to, and its words (certificate.h).
#include <algorithm>
#include <array>
#include <string>

#include "saltus/optimality/certificate.h"

namespace saltus {

void Judge(Certificate* certificate) {
  const std::array<std::pair<double, const char*>, 4> residuals = {{{certificate->stationarity, "stationarity"},
                                                                    {certificate->costate_jump, "the costate jump"},
                                                                    {certificate->transversality, "transversality"},
                                                                    {certificate->hamiltonian, "the Hamiltonian"}}};
  using enum Certificate::Verdict;
  certificate->verdict = kStationary;
  certificate->reason.clear();
  double worst = kCertificateTolerance;
  for (const auto& [residual, name] : residuals) {
    if (residual <= worst) continue;
    certificate->verdict = kNotStationary;
    certificate->reason = std::string(name) + " is off most";
    worst = residual;
  }
  if (certificate->verdict == kNotStationary && certificate->gradient &&
      *certificate->gradient <= kCertificateTolerance) {
    const auto between = [](const ImpactCertificate& impact) {  // the two one-sided gradients
      return !impact.theta || (*impact.theta >= 0 && *impact.theta <= 1);
    };
    if (std::all_of(certificate->impacts.begin(), certificate->impacts.end(), between)) {
      certificate->verdict = kStationaryOnGrid;
      certificate->reason.clear();
    }
  }
  if (!certificate->IsStationary() || !certificate->curvature) return;
  if (certificate->IsSaddle()) {
    certificate->reason = "a saddle: the loss falls along the direction of the smallest curvature, both ways";
  } else if (certificate->curvature->kind == Curvature::Kind::kFlat) {
    certificate->reason = "the curvature is nearly zero along one direction: perhaps no minimum";
  }
}

void JudgeTies(const std::vector<Tie>& ambiguous, Certificate* certificate) {
  if (ambiguous.empty()) return;
  certificate->verdict = Certificate::Verdict::kAmbiguous;
  certificate->reason = TiesToString(ambiguous);
  certificate->ambiguous = ambiguous;
}

const char* VerdictToString(Certificate::Verdict verdict) {
  switch (verdict) {
    case Certificate::Verdict::kStationary:
      return "stationary";
    case Certificate::Verdict::kStationaryOnGrid:
      return "stationary_on_grid";
    case Certificate::Verdict::kNotStationary:
      return "not_stationary";
    case Certificate::Verdict::kAmbiguous:
      return "ambiguous";
    case Certificate::Verdict::kNotApplicable:
      return "not_applicable";
    case Certificate::Verdict::kGlobal:
      return "global";
  }
  return "";
}

const char* CurvatureToString(Curvature::Kind kind) {
  switch (kind) {
    case Curvature::Kind::kMinimum:
      return "minimum";
    case Curvature::Kind::kSaddle:
      return "saddle";
    case Curvature::Kind::kFlat:
      return "flat";
  }
  return "";
}

std::string VerdictInWords(const Certificate& certificate) {
  const bool decided = certificate.curvature && certificate.curvature->kind != Curvature::Kind::kFlat;
  const std::string what = decided ? CurvatureToString(certificate.curvature->kind) : "stationary";
  switch (certificate.verdict) {
    case Certificate::Verdict::kStationary:
      return what;
    case Certificate::Verdict::kStationaryOnGrid:
      return what + " on the grid";
    case Certificate::Verdict::kNotStationary:
      return "not stationary";
    case Certificate::Verdict::kAmbiguous:
      return "ambiguous";
    case Certificate::Verdict::kNotApplicable:
      return "";
    case Certificate::Verdict::kGlobal:
      return "global minimum";
  }
  return "";
}

const char* ScopeToString(Certificate::Scope scope) {
  return scope == Certificate::Scope::kBestOfSearched ? "best_of_searched" : "local";
}

}  // namespace saltus
