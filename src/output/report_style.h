// How reports look.
#pragma once

#include <string>

namespace saltus::internal {

// The style sheet, for light and dark screens and for paper.
std::string ReportStyle();

}  // namespace saltus::internal
