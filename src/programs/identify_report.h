// report.html of an identification: the recordings beside the fitted motions, what the data say, and how well they fit.
#pragma once

#include "programs/identify.h"

namespace saltus {

// Into --output_dir, if there is one. Throws OutputError.
void WriteIdentifyReport(const Request& request, const Identified& identified);

}  // namespace saltus
