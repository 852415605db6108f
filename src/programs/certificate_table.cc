#include "programs/certificate_table.h"

#include <algorithm>
#include <cmath>

#include "programs/surrogate_flags.h"

namespace saltus {
namespace {

using enum Certificate::Verdict;

// Of a control at which the loss does not change to first order.
std::string MeaningOfStationary(const Certificate& certificate) {
  const std::string which = certificate.verdict == kStationaryOnGrid ? "forces on these intervals" : "the control";
  if (!certificate.curvature) {
    return "to first order no change of " + which + " lowers the loss; its curvature was not looked at";
  }
  switch (certificate.curvature->kind) {
    case Curvature::Kind::kMinimum:
      return "no small change of " + which + " lowers the loss";
    case Curvature::Kind::kSaddle:
      return "no minimum: along one change of " + which + " the loss falls, both ways";
    case Curvature::Kind::kFlat:
      return "perhaps no minimum: along one change of " + which + " the loss hardly changes";
  }
  return "";
}

}  // namespace

std::optional<double> ResidualOf(const Certificate& certificate) {
  switch (certificate.verdict) {
    case kStationaryOnGrid:
      return certificate.gradient;
    case kStationary:
    case kGlobal:
    case kNotStationary:
      return std::max({certificate.stationarity,
                       certificate.costate_jump,
                       std::abs(certificate.hamiltonian),
                       certificate.transversality});
    case kAmbiguous:
    case kNotApplicable:
      return std::nullopt;
  }
  return std::nullopt;
}

std::string MeaningOf(const Certificate& certificate) {
  switch (certificate.verdict) {
    case kNotStationary:
      return "small changes of the control lower the loss: " + certificate.reason;
    case kAmbiguous:
    case kNotApplicable:
      return certificate.reason;
    case kGlobal:
      return "a lower bound proves that no control on as many intervals has a lower loss";
    case kStationary:
    case kStationaryOnGrid:
      break;
  }
  const std::string searched =
      certificate.scope == Certificate::Scope::kBestOfSearched
          ? "it is the best of " + std::to_string(certificate.sequences_searched) +
                (certificate.sequences_searched == 1 ? " sequence of impacts" : " sequences of impacts")
          : "other sequences of impacts may be better";
  return MeaningOfStationary(certificate) + "; " + searched;
}

Table CertificateTable(const SolvedRuns& solved) {
  Table table(
      {{"contact"}, {"solver"}, {"exact loss is at"}, {"residual", 2}, {"smallest curvature", 3}, {"what it means"}},
      2);
  for (const SolvedRun& run : solved.runs) {
    if (!run.certificate) continue;
    const Certificate& certificate = *run.certificate;
    const std::string verdict = VerdictInWords(certificate);
    const bool looked_at = certificate.IsStationary() && certificate.curvature;
    table.AddRow({LabelOf(run.report.contact, run.report.surrogate),
                  run.report.solver,
                  verdict.empty() ? "not certified" : verdict,
                  ResidualOf(certificate),
                  looked_at ? std::optional(certificate.curvature->smallest) : std::nullopt,
                  MeaningOf(certificate)});
  }
  return table;
}

}  // namespace saltus
