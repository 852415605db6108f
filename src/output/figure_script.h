// A figure as a gnuplot script: the commands that put everything in its place.
#pragma once

#include <string>

#include "figure_layout.h"
#include "gnuplot_style.h"
#include "output/figure.h"

namespace saltus::internal {

std::string GnuplotScript(const Figure& figure, Terminal terminal);

}  // namespace saltus::internal
