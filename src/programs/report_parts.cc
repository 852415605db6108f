#include "programs/report_parts.h"

#include <iostream>

#include "base/interrupt.h"
#include "saltus/scene/scene_file.h"
#include "saltus/simulate/exact_run.h"

namespace saltus {
namespace {

std::string PathOfReport(const Request& request) { return request.output_dir + "/report.html"; }

}  // namespace

HtmlReport StartReport(const Scene& scene) {
  return HtmlReport(scene.name, std::to_string(scene.steps) + " steps over " + Cell(scene.duration).Display(6) + " s");
}

void FinishReport(const Request& request, HtmlReport* report) {
  report->AddHeading(1, "Scene");
  report->AddPreformatted(WriteScene(request.scene));
  const Status status = report->Write(PathOfReport(request));
  if (!status.ok()) throw OutputError(status.message());
}

void AddFigureOrReason(const Figure& figure, const std::string& caption, HtmlReport* report) {
  const Status status = InterruptGuard::GraceIsOver() ? Status::Error(kStopped) : report->AddFigure(figure, caption);
  if (!status.ok()) report->AddParagraph("A figure is missing: " + status.message());
}

void PrintReportPath(const Request& request) {
  if (request.output_dir.empty()) return;
  (request.json ? std::cerr : std::cout) << PathOfReport(request) << std::endl;
}

}  // namespace saltus
