// The results of an audit as tables, JSON, files and a page.
#pragma once

#include <vector>

#include "audit/audit_text.h"
#include "programs/program.h"
#include "saltus/audit/attribution.h"
#include "saltus/audit/audit.h"

namespace saltus {

// Writes <scene>_{gradients,refinement,contacts,classes}.csv and <scene>_refinement.{svg,png}, and with a width sweep
// <scene>_widths.{csv,svg,png}; of a surrogate <scene>_<surrogate>_biased_{gradients.csv,verdicts.md}. Throws
// OutputError if it cannot. Writes nothing without --output_dir, and no figures, which take long, after an interrupt.
void WriteAuditFiles(const Request& request, const AuditReport& report, const Json& document);

// A tangent of the flow over a few steps around a contact: it begins as a displacement of disc a by 1 along the
// contact's normal, and goes on by the linearizations of the steps.
struct PerturbedFlow {
  std::vector<double> times;          // s, nodes of the model's steps
  std::vector<double> first, second;  // displacements of disc a and of disc b along the normal; no second for a plane
};

struct PerturbedFlows {
  PerturbedFlow model, exact;  // from the same state, under the same forces
};

// Perturbs the scene's initial state under its control. Both flows are empty if the rollout, or that of `event`, fails.
PerturbedFlows PerturbAtContact(const Scene& scene, const Contact& contact, const ContactError& error);

class Page;

// Adds verdicts, gradients, errors against step and width, the motions under each model, and for each wrong model the
// first contact that makes it wrong.
void AddAuditSections(const Request& request, const AuditReport& audit, Page* page);

}  // namespace saltus
