// Where everything of a figure goes on the page.
#pragma once

#include <string_view>
#include <vector>

#include "output/figure.h"
#include "output/plot_axes.h"

namespace saltus::internal {

inline constexpr double kFontSize = 13;                 // pixels, as all that follows
inline constexpr double kCharacter = 0.56 * kFontSize;  // average width
inline constexpr double kLine = 1.5 * kFontSize;
inline constexpr double kFigureTitle = 34;
inline constexpr double kTopMargin = 14;
inline constexpr double kLegendText = 44;

// Where everything goes, pixels.
struct Layout {
  double width = 0;
  double height = 0;
  std::vector<Box> panels;  // with title and labels
  std::vector<Box> plots;   // the area inside the axes, per panel
  Box legend;
  int legend_columns = 0;  // 0 without a legend
};

Layout LayOut(const Figure& figure);

// Characters, not bytes.
size_t LengthOf(std::string_view text);
size_t LongestLabel(const std::vector<Tick>& ticks);

// The ticks of an axis, as many as the box has room for.
std::vector<Tick> TicksX(const Axis& axis, const Range& range, const Box& box);
std::vector<Tick> TicksY(const Axis& axis, const Range& range, const Box& box);

}  // namespace saltus::internal
