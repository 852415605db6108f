// A figure as a gnuplot script: where everything goes on the page, and the commands that put it there.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "output/figure.h"
#include "plot_axes.h"

namespace saltus::internal {

// Colours that are not data.
inline constexpr char kInk[] = "#24292f";
inline constexpr char kFaintInk[] = "#6e7781";
inline constexpr char kGrid[] = "#e6e8eb";
inline constexpr char kGround[] = "#d0d4d9";
inline constexpr char kPaper[] = "#ffffff";
inline constexpr char kFont[] = "Liberation Sans";

// Where everything goes, pixels.
struct Layout {
  double width = 0;
  double height = 0;
  std::vector<Box> plots;  // the area inside the axes, per panel
  Box legend;
  int legend_columns = 0;  // 0 without a legend
};

Layout LayOut(const Figure& figure);

enum class Terminal { kSvg, kPng };

std::string GnuplotScript(const Figure& figure, Terminal terminal);

}  // namespace saltus::internal
