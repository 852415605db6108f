#include "output/figure_layout.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>

#include "output/gnuplot_style.h"

namespace saltus::internal {
namespace {

constexpr double kPanelTitle = 30;
constexpr double kLeftMargin = 46;  // without the tick labels
constexpr double kPixelsPerTickX = 65;
constexpr double kPixelsPerTickY = 34;
constexpr double kRightMargin = 22;
constexpr double kBottomMargin = 56;
constexpr double kLegendGap = 12;

std::vector<Tick> Ticks(const Axis& axis, const Range& range, double count) {
  return axis.log ? LogTicks(range) : LinearTicks(range, std::max(2, static_cast<int>(count)));
}

// On a logarithmic axis, whose ticks are not where there is room: keeps labels that do not touch, powers of ten first.
void DropLabelsThatTouch(const Range& range, const Box& box, std::vector<Tick>* ticks) {
  const double scale = (box.right - box.left) / std::log10(range.max / range.min);
  const auto place = [&](const Tick& tick) { return scale * std::log10(tick.value / range.min); };
  const auto half = [](const Tick& tick) { return 0.5 * kCharacter * static_cast<double>(LengthOf(tick.label) + 1); };
  const auto is_power = [](const Tick& tick) {
    const double power = std::log10(tick.value);
    return std::abs(power - std::round(power)) < 1e-9;
  };
  std::vector<const Tick*> kept;
  for (const bool powers : {true, false}) {
    for (Tick& tick : *ticks) {
      if (tick.label.empty() || is_power(tick) != powers) continue;
      const bool touches = std::any_of(kept.begin(), kept.end(), [&](const Tick* other) {
        return std::abs(place(tick) - place(*other)) < half(tick) + half(*other);
      });
      if (touches) {
        tick.label.clear();
      } else {
        kept.push_back(&tick);
      }
    }
  }
}

struct LegendSize {
  int columns = 0;
  double width = 0;
  double height = 0;
};

// Beside the panels as few columns as their height allows, below them as many as the width does.
LegendSize SizeOfLegend(const Figure& figure, double panels_height) {
  const std::vector<LegendEntry> entries = LegendEntries(figure, Terminal::kSvg);
  if (figure.legend == Legend::kNone || entries.empty()) return {};
  size_t longest = 0;
  for (const LegendEntry& entry : entries) longest = std::max(longest, LengthOf(entry.label));
  const double entry_width = kLegendText + static_cast<double>(longest) * kCharacter + kLegendGap;
  const double count = static_cast<double>(entries.size());
  double columns = 0;
  if (figure.legend == Legend::kRight) {
    columns = std::ceil(count / std::max(1.0, std::floor((panels_height - kTopMargin) / kLine)));
  } else {
    columns = std::clamp(std::floor((figure.width - kLeftMargin - kRightMargin) / entry_width), 1.0, count);
  }
  return {static_cast<int>(columns), columns * entry_width, std::ceil(count / columns) * kLine + kLegendGap};
}

// Panels above one another begin at the same place, right of the widest tick label.
void MakeRoomForTickLabels(const Figure& figure, size_t columns, std::vector<Box>* plots) {
  std::vector<double> width(columns, 0.0);
  for (size_t i = 0; i < plots->size(); ++i) {
    const Box& box = (*plots)[i];
    const Range y = AxisRanges(figure.panels[i], box).second;
    const size_t longest = LongestLabel(TicksY(figure.panels[i].y, y, box));
    width[i % columns] = std::max(width[i % columns], static_cast<double>(longest) * kCharacter);
  }
  for (size_t i = 0; i < plots->size(); ++i) (*plots)[i].left += width[i % columns];
}

}  // namespace

size_t LengthOf(std::string_view text) {
  return static_cast<size_t>(
      std::count_if(text.begin(), text.end(), [](char c) { return (static_cast<unsigned char>(c) & 0xc0) != 0x80; }));
}

size_t LongestLabel(const std::vector<Tick>& ticks) {
  size_t longest = 0;
  for (const Tick& tick : ticks) longest = std::max(longest, LengthOf(tick.label));
  return longest;
}

std::vector<Tick> TicksX(const Axis& axis, const Range& range, const Box& box) {
  std::vector<Tick> ticks = Ticks(axis, range, (box.right - box.left) / kPixelsPerTickX);
  if (axis.log) DropLabelsThatTouch(range, box, &ticks);
  return ticks;
}

std::vector<Tick> TicksY(const Axis& axis, const Range& range, const Box& box) {
  return Ticks(axis, range, (box.top - box.bottom) / kPixelsPerTickY);
}

Layout LayOut(const Figure& figure) {
  CHECK(!figure.panels.empty());
  CHECK_GT(figure.columns, 0);
  const size_t columns = std::min(static_cast<size_t>(figure.columns), figure.panels.size());
  const size_t rows = (figure.panels.size() + columns - 1) / columns;
  const double title = figure.title.empty() ? 0 : kFigureTitle;
  const double panels_height = static_cast<double>(rows) * figure.panel_height;

  Layout layout;
  layout.width = figure.width;
  const LegendSize legend = SizeOfLegend(figure, panels_height);
  const bool right = figure.legend == Legend::kRight;
  const double reserved = right ? legend.width : 0;
  layout.height = title + panels_height + (right ? 0 : legend.height);
  layout.legend_columns = legend.columns;
  layout.legend.left = right ? layout.width - legend.width : kLeftMargin;
  layout.legend.right = layout.legend.left + legend.width;
  layout.legend.top = right ? layout.height - title - kTopMargin : legend.height;
  layout.legend.bottom = layout.legend.top - legend.height;

  const double cell = (layout.width - reserved) / static_cast<double>(columns);
  for (size_t i = 0; i < figure.panels.size(); ++i) {
    const double left = static_cast<double>(i % columns) * cell;
    const double top = layout.height - title - static_cast<double>(i / columns) * figure.panel_height;
    const double above = figure.panels[i].title.empty() ? kTopMargin : kPanelTitle;
    layout.panels.push_back({left, left + cell, top - figure.panel_height, top});
    layout.plots.push_back(
        {left + kLeftMargin, left + cell - kRightMargin, top - figure.panel_height + kBottomMargin, top - above});
  }
  MakeRoomForTickLabels(figure, columns, &layout.plots);
  return layout;
}

}  // namespace saltus::internal
