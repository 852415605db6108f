// The results of an identification as tables, JSON and a page.
#pragma once

#include <optional>

#include "output/figure.h"
#include "output/table.h"
#include "programs/identify.h"

namespace saltus {

inline constexpr std::size_t kMostOutliersNamed = 20;

// Parameters by contact model, and how each fit went.
Table EstimateTable(const Identified& identified);
Table FitTable(const Json& document);
// Every parameter under every contact model, beside what `event` has: bias is what a value is more. Empty without a fit
// by `event`, or without others.
Table ComparisonTable(const Identified& identified);
// The law of impact that was learned; null if none was.
const LearnedLaw* LawOf(const Identified& identified);
// With standard errors, beside the law that is known; empty if none was learned.
Table LawTable(const Identified& identified);
// With a band of 95 % confidence. Precondition: the law has a curve.
Figure LawFigure(const LearnedLaw& learned, const std::optional<KnownLaw>& known);
// Every impact with a plane by event functions that were learned; empty if none were.
Table EventTable(const Scene& scene, const Identified& identified);
// The first outliers, for a person; and all residuals.
Table OutlierTable(const Json& document);
Table ResidualTable(const Scene& scene, const Identified& identified);

// Into --output_dir, if there is one. Throws OutputError.
void WriteIdentifyReport(const Request& request, const Identified& identified, const Json& document);

}  // namespace saltus
