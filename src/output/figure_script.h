// A figure as a gnuplot script: the commands that put everything in its place.
#pragma once

#include <string>

#include "output/figure.h"
#include "output/figure_layout.h"
#include "output/gnuplot_style.h"

namespace saltus::internal {

std::string GnuplotScript(const Figure& figure, Terminal terminal);

}  // namespace saltus::internal
