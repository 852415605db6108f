// The numbers behind a plot: ranges, ticks, and lines without the points that no one could see.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "output/figure.h"

namespace saltus::internal {

// A rectangle in pixels, from the lower left corner of the figure.
struct Box {
  double left = 0;
  double right = 0;
  double bottom = 0;
  double top = 0;
};

struct Range {
  double min = 0;
  double max = 1;
};

inline double Span(const Range& range) { return range.max - range.min; }

// The ranges of a panel's axes when drawn in `box`: data, shapes and reference lines with a margin, except where the
// panel states its own; widened to equal scales if the panel asks for that.
std::pair<Range, Range> AxisRanges(const Panel& panel, const Box& box);

// Indices of the points that a polyline through (x, y) (pixels) needs to stay within `tolerance` pixels of all of them;
// the first and the last included (Ramer 1972, Douglas and Peucker 1973). Precondition: all finite.
std::vector<size_t> SimplifyLine(const std::vector<double>& x, const std::vector<double>& y, double tolerance);

struct Tick {
  double value = 0;
  std::string label;  // empty for a minor tick
};

// Ticks of a logarithmic axis: powers of ten if there are enough, else 1-2-5 steps, else equal steps.
std::vector<Tick> LogTicks(const Range& range);

// Ticks at about `count` equal steps of 1, 2 or 5 times a power of ten, all labels with the same number of decimals.
std::vector<Tick> LinearTicks(const Range& range, int count);

}  // namespace saltus::internal
