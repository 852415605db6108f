// What the reports of all programs share.
#pragma once

#include <string>

#include "output/html_report.h"
#include "programs/program.h"

namespace saltus {

HtmlReport StartReport(const Scene& scene);

// Adds the scene, and writes report.html into --output_dir. Throws OutputError.
void FinishReport(const Request& request, HtmlReport* report);

// A figure, or why there is none: gnuplot may be missing, or the program was interrupted.
void AddFigureOrReason(const Figure& figure, const std::string& caption, HtmlReport* report);

// The path of the report as the last line, if one was asked for: on stdout, or on stderr if that is JSON.
void PrintReportPath(const Request& request);

}  // namespace saltus
