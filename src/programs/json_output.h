// Results as JSON, under the keys that the reference documents. No flags.
#pragma once

#include <optional>
#include <vector>

#include "audit/remarks.h"
#include "base/table.h"
#include "output/json.h"
#include "saltus/audit/refinement.h"
#include "saltus/audit/width_sweep.h"
#include "saltus/control/surrogate.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/solve/solver.h"

namespace saltus {

// [x, y] of each disc, from B x 4 numbers; offset 0 for positions, 2 for velocities.
Json VectorsToJson(const Scene& scene, const std::vector<double>& initial, int offset);
// The angles (entry 0) or angular velocities (entry 1) of all discs in it. Precondition: the scene has discs that spin.
Json RotationsToJson(const Scene& scene, const std::vector<double>& initial, int entry);
// [[ [x, y] per controlled disc ] per control interval]; [] without control. Of discs that are turned [x, y, torque].
Json ControlToJson(const Scene& scene, const std::vector<double>& control);
// Converts derivatives by a control, in its layout.
Json ControlGradientToJson(const Scene& scene, const std::vector<double>& gradient);
Json EventsToJson(const std::vector<Event>& events);
// Reserves room for so many further keys. An object that grows copies its values, as its keys are constant: for a long
// horizon gradients and states of millions of numbers. A copy that is destroyed where memory runs out ends the program.
void Reserve(size_t keys, Json* object);
// Adds "ambiguous": [{ "time", "bodies" }, ...] and "loss_spread": [lowest, highest], where there are ambiguous ties.
void AddTies(const std::vector<Tie>& ambiguous, const std::optional<LossSpread>& spread, Json* item);
// Without masses there are no derivatives by parameters: null.
Json GradientToJson(const Scene& scene, const Sensitivity& gradient);
// The values of the scene's design parameters, by their names.
Json DesignToJson(const Scene& scene, const std::vector<double>& values);
// Converts the entries of a gradient that are one-sided.
Json OneSidedToJson(const Scene& scene, const std::vector<OneSided>& entries);

// The verdict on a part of a gradient and its entries, without the name of the part and the errors by number of steps.
Json JudgementToJson(const QuantityStudy& study);
// Adds the keys condition, rounding and digits_lost if they were measured.
void AddConditioning(const RefinementStudy& study, Json* item);
Json WidthsToJson(const WidthSweepStudy& study);

// Adds kind and smallest value of the curvature, if it was looked at.
void AddCurvature(const Certificate& certificate, Json* item);
// Adds the residuals at an impact or event, without its time and what it is.
void AddResiduals(const ImpactCertificate& impact, Json* item);
// The conditions of the minimum principle, see saltus/optimality/certificate.h.
Json CertificateToJson(const Scene& scene, const Certificate& certificate, const char* of = "exact_loss");
// [{ "sequence": [{ "a", "b" }, ...], "loss", "times" }], as they come.
Json OptimaToJson(const Scene& scene, const std::vector<LocalOptimum>& optima);
Json SearchStatisticsToJson(const SearchStatistics& searched);

// Returns the part of a file name for a surrogate's results: "", or "_smoothed_zeroth_biased".
std::string FileSuffix(const std::optional<Surrogate>& surrogate);

// Adds the keys surrogate, biased and, of a smoothed one, smoothing; none without a surrogate.
void AddSurrogate(const std::optional<Surrogate>& surrogate, Json* item);
// Adds these keys, and the key biased for a model whose options bias the derivative.
void AddBias(const std::string& contact, const std::optional<Surrogate>& surrogate, Json* item);

// A boolean as "yes" or "no", finite numbers and text as they are, of a list or an object its size; else empty.
Cell CellOf(const Json& value);

// The numbers of nested lists and objects, in their order.
std::vector<double> NumbersIn(const Json& json);

// A table of JSON objects: of all those in `list` (a JSON pointer, "" for itself) of each of `parents`. The columns are
// those of ColumnsOf(), each header with a path behind it, after "=", from the object, or with ^ from the parent
// (default: the header, its spaces as underscores). A path that ends in [] makes a row of each element, and # stands
// for the number of the row, from 1. At most `most_rows` rows. Such as "contact=^contact; wrong in=block;
// x=position/0:5".
Table TableOf(const Json& parents, const std::string& list, const std::string& columns, size_t keys = 1,
              size_t most_rows = static_cast<size_t>(-1));

// [{"kind", "text"}, ...]
Json RemarksToJson(const Remarks& remarks);

// Returns the document as text, whose numbers are read back with the same bits: null in place of NaN and infinity,
// which JSON does not have, and U+FFFD in place of bytes that are not UTF-8.
std::string JsonText(const Json& document);
void PrintJson(const Json& document);

}  // namespace saltus
