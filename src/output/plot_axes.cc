#include "output/plot_axes.h"

#include <glog/logging.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>
#include <string_view>

namespace saltus::internal {
namespace {

// ---- Ranges

// Beyond these an axis does not go: its margins and ticks stay numbers.
constexpr double kLargestShown = 1e270;

// Collects what an axis has to show.
class Extent {
 public:
  explicit Extent(const Axis& axis) : axis_(axis) {}

  void Add(double value) {
    if (!std::isfinite(value) || (axis_.log && value <= 0)) return;
    const double shown = std::clamp(value, axis_.log ? 1 / kLargestShown : -kLargestShown, kLargestShown);
    const double v = axis_.log ? std::log10(shown) : shown;
    min_ = std::min(min_, v);
    max_ = std::max(max_, v);
  }

  // With a margin of so large a share of the span.
  Range WithMargin(double share) const {
    double low = min_;
    double high = max_;
    if (low > high) low = 0, high = 1;
    // A constant still needs a span, wider than its own rounding.
    const double least = axis_.log ? 0.1 : std::max(1e-9 * std::max(std::abs(low), std::abs(high)), 1e-290);
    if (high - low < least) {
      const double half = axis_.log ? 0.5 : std::abs(low) < least ? 1 : 0.1 * std::abs(low);
      low -= half;
      high += half;
    }
    const double margin = share * (high - low);
    return Stated({low - margin, high + margin});
  }

 private:
  // Back from logarithms, and with the ends that the axis states.
  Range Stated(const Range& covered) const {
    Range range = covered;
    if (axis_.log) range = {std::pow(10, covered.min), std::pow(10, covered.max)};
    if (axis_.min) range.min = *axis_.min;
    if (axis_.max) range.max = *axis_.max;
    if (range.min < range.max) return range;
    // All data lie beyond the one end that is stated: an empty plot, but a plot.
    CHECK(!axis_.min || !axis_.max) << "axis from " << range.min << " to " << range.max;
    if (axis_.min) range.max = axis_.log ? 10 * range.min : range.min + 1;
    if (axis_.max) range.min = axis_.log ? range.max / 10 : range.max - 1;
    return range;
  }

  const Axis& axis_;
  double min_ = std::numeric_limits<double>::infinity();
  double max_ = -std::numeric_limits<double>::infinity();
};

void WidenTo(double span, Range* range) {
  const double extra = (span - Span(*range)) / 2;
  range->min -= extra;
  range->max += extra;
}

// ---- Ticks

std::string Superscript(int exponent) {
  static constexpr std::array<std::string_view, 10> kDigits = {"⁰", "¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"};
  std::string text;
  for (const char c : std::to_string(exponent)) text += c == '-' ? "⁻" : kDigits[static_cast<size_t>(c - '0')];
  return text;
}

std::string ReplaceHyphen(std::string text) {
  const size_t at = text.find('-');
  return at == std::string::npos ? text : text.replace(at, 1, "−");
}

std::string Format(double value, std::chars_format format, int precision) {
  std::array<char, 400> buffer;
  const auto [end, error] = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value, format, precision);
  CHECK(error == std::errc());
  return std::string(buffer.data(), end);
}

// `value` with decimals down to 10^last, as 0.25 or, far from one, as 2.5×10⁻⁷.
std::string TickLabel(double value, int first, int last) {
  if (-4 <= first && first < 6) return ReplaceHyphen(Format(value, std::chars_format::fixed, std::max(0, -last)));
  if (value == 0) return "0";
  const std::string digits = Format(value / std::pow(10, first), std::chars_format::fixed, std::max(0, first - last));
  return ReplaceHyphen(digits) + "×10" + Superscript(first);
}

int Exponent(double value) { return static_cast<int>(std::floor(std::log10(value) + 1e-9)); }

std::vector<Tick> DecadeTicks(const Range& range, int first, int last) {
  std::vector<Tick> ticks;
  const int step = (last - first) / 8 + 1;
  for (int exponent = first - 1; exponent <= last; ++exponent) {
    const double decade = std::pow(10, exponent);
    const bool labelled = exponent >= first && (exponent - first) % step == 0;
    if (exponent >= first) ticks.push_back({decade, labelled ? "10" + Superscript(exponent) : ""});
    for (int multiple = 2; step == 1 && multiple < 10; ++multiple) {
      const double value = multiple * decade;
      if (range.min <= value && value <= range.max) ticks.push_back({value, ""});
    }
  }
  return ticks;
}

std::vector<Tick> OneTwoFiveTicks(const Range& range) {
  std::vector<Tick> ticks;
  for (int exponent = Exponent(range.min); std::pow(10, exponent) <= range.max; ++exponent) {
    for (int multiple = 1; multiple < 10; ++multiple) {
      const double value = multiple * std::pow(10, exponent);
      if (value < range.min || value > range.max) continue;
      const bool labelled = multiple == 1 || multiple == 2 || multiple == 5;
      ticks.push_back({value, labelled ? TickLabel(value, exponent, exponent) : ""});
    }
  }
  return ticks;
}

}  // namespace

std::pair<Range, Range> AxisRanges(const Panel& panel, const Box& box) {
  Extent x(panel.x);
  Extent y(panel.y);
  for (const Series& series : panel.series) {
    for (const double value : series.x) x.Add(value);
    for (const double value : series.y) y.Add(value);
  }
  for (const ReferenceLine& line : panel.reference_lines) (line.vertical ? x : y).Add(line.value);
  for (const Rectangle& rectangle : panel.rectangles) {
    for (const auto& corner : {rectangle.from, rectangle.to}) {
      x.Add(corner[0]);
      y.Add(corner[1]);
    }
  }
  for (const Circle& circle : panel.circles) {
    for (const double side : {-1.0, 1.0}) {
      x.Add(circle.centre[0] + side * circle.radius);
      y.Add(circle.centre[1] + side * circle.radius);
    }
  }
  for (const LineSegment& segment : panel.segments) {
    for (const auto& end : {segment.from, segment.to}) {
      x.Add(end[0]);
      y.Add(end[1]);
    }
  }
  for (const Outline& outline : panel.outlines) {
    for (const auto& point : outline.points) {
      x.Add(point[0]);
      y.Add(point[1]);
    }
  }
  Range range_x = x.WithMargin(0.02);
  Range range_y = y.WithMargin(0.05);
  if (panel.equal_aspect) {
    const double units_per_pixel =
        std::max(Span(range_x) / (box.right - box.left), Span(range_y) / (box.top - box.bottom));
    WidenTo(units_per_pixel * (box.right - box.left), &range_x);
    WidenTo(units_per_pixel * (box.top - box.bottom), &range_y);
  }
  return {range_x, range_y};
}

std::vector<size_t> SimplifyLine(const std::vector<double>& x, const std::vector<double>& y, double tolerance) {
  if (x.empty()) return {};
  std::vector<bool> keep(x.size(), false);
  keep.front() = keep.back() = true;
  std::vector<std::pair<size_t, size_t>> pending = {{0, x.size() - 1}};
  while (!pending.empty()) {
    const auto [first, last] = pending.back();
    pending.pop_back();
    const double dx = x[last] - x[first];
    const double dy = y[last] - y[first];
    const double length = std::hypot(dx, dy);
    double farthest = tolerance;
    size_t split = first;
    for (size_t i = first + 1; i < last; ++i) {
      const double from_x = x[i] - x[first];
      const double from_y = y[i] - y[first];
      // Where a line returns to its start, or runs back along itself, the distance to the line says nothing.
      const double along = length > 0 ? (from_x * dx + from_y * dy) / length : -1;
      const double distance = along < 0        ? std::hypot(from_x, from_y)
                              : along > length ? std::hypot(x[i] - x[last], y[i] - y[last])
                                               : std::abs(from_x * dy - from_y * dx) / length;
      if (distance > farthest) farthest = distance, split = i;
    }
    if (split == first) continue;
    keep[split] = true;
    pending.push_back({first, split});
    pending.push_back({split, last});
  }
  std::vector<size_t> kept;
  for (size_t i = 0; i < keep.size(); ++i) {
    if (keep[i]) kept.push_back(i);
  }
  return kept;
}

std::vector<Tick> LogTicks(const Range& range) {
  CHECK(0 < range.min && range.min < range.max) << range.min << " to " << range.max;
  const int first = static_cast<int>(std::ceil(std::log10(range.min) - 1e-9));
  const int last = static_cast<int>(std::floor(std::log10(range.max) + 1e-9));
  if (last - first >= 2) return DecadeTicks(range, first, last);
  std::vector<Tick> ticks = OneTwoFiveTicks(range);
  const auto labelled = std::count_if(ticks.begin(), ticks.end(), [](const Tick& t) { return !t.label.empty(); });
  return labelled >= 3 ? ticks : LinearTicks(range, 5);
}

std::vector<Tick> LinearTicks(const Range& range, int count) {
  const double largest = std::max(std::abs(range.min), std::abs(range.max));
  CHECK_GT(Span(range), 1e-12 * largest) << range.min << " to " << range.max;
  const double rough = Span(range) / count;
  const int last = Exponent(rough);
  const double decade = std::pow(10, last);
  const double share = rough / decade - 1e-6;  // a step that fits exactly is taken
  const double multiple = share > 5 ? 10 : share > 2 ? 5 : share > 1 ? 2 : 1;
  const double step = multiple * decade;
  const int first = Exponent(largest);
  std::vector<Tick> ticks;
  const double rounding = 1e-9;  // ticks on the ends of the range belong to it
  for (double i = std::ceil(range.min / step - rounding); i <= range.max / step + rounding; ++i) {
    const double value = i * step + 0.0;  // no negative zero
    ticks.push_back({value, TickLabel(value, first, Exponent(step))});
  }
  return ticks;
}

}  // namespace saltus::internal
