// Figures for those who do not see them, or see little of them at a time.
#pragma once

#include <string>

#include "output/figure.h"

namespace saltus::internal {

// In words: what each panel shows, and from where to where its lines go.
std::string DescribeFigure(const Figure& figure);

// The panels and the columns of the legend one by one, for narrow screens: views of the figure that stands in the same
// page with ids that begin with `id_prefix`. Empty if the figure has one part only.
std::string FigureParts(const Figure& figure, const std::string& id_prefix);

}  // namespace saltus::internal
