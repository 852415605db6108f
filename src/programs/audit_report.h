// What an audit found, as a page.
#pragma once

#include "programs/program.h"
#include "saltus/audit/audit.h"

namespace saltus {

class HtmlReport;

// Verdicts, gradients, errors against step and width, the motions under each model, and of each wrong model the first
// contact that makes it so.
void AddAuditSections(const Request& request, const AuditReport& audit, HtmlReport* report);

// report.html in --output_dir, if there is one. Throws OutputError.
void WriteAuditReport(const Request& request, const AuditReport& audit);

}  // namespace saltus
