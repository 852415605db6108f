#include "output/cards.h"

#include <algorithm>
#include <cmath>

namespace saltus::internal {
namespace {

// All in rem, as the style sheet has them.
constexpr double kFont = 0.875, kPadding = 1.5;               // of a cell
constexpr double kNarrowFont = 0.8, kNarrowPadding = 0.8;     // the same on narrow screens,
constexpr double kNarrow = 45;                                // where surroundings are narrower than this
constexpr double kCharacter = 0.62;                           // width over height, of a wide font
constexpr int kFirst = 8, kStep = 4, kLast = 72, kAny = 999;  // widths with a class

std::string NameOf(int width) { return "below-" + std::to_string(width); }

double WidthOf(const std::vector<size_t>& characters, double font, double padding) {
  double width = 0;
  for (const size_t count : characters) width += kCharacter * font * static_cast<double>(count) + padding;
  return width;
}

std::string StyleBelow(int width) {
  const std::string table = "." + NameOf(width);
  std::string style;
  if (width != kAny) style += "@container (max-width: " + std::to_string(width) + "rem) {\n";
  style += table + " thead { display: none; } " + table + ", " + table + " tbody { display: block; }\n";
  style += table +
           " tr { display: grid; grid-template-columns: repeat(auto-fill, minmax(8.5rem, 1fr)); "
           "gap: .15rem .75rem; padding: .5rem .75rem; border-bottom: 1px solid var(--line); }\n";
  style += table +
           " td { border: 0; padding: 0 .3rem; text-align: left; min-width: 0; overflow-wrap: anywhere; "
           "white-space: normal; border-radius: 4px; }\n";
  style += table +
           " td::before { content: attr(data-label); display: block; color: var(--faint); font-weight: 400; "
           "font-size: .85em; }\n";
  style += table + " td:empty { display: none; } " + table + " td.long { grid-column: 1 / -1; } " + table +
           " td.key { font-weight: 600; }\n";
  return style + (width != kAny ? "}\n" : "");
}

}  // namespace

std::string CardsClass(const std::vector<size_t>& characters) {
  const double wide = WidthOf(characters, kFont, kPadding);
  const double least = wide > kNarrow ? wide : WidthOf(characters, kNarrowFont, kNarrowPadding);
  const int width = kFirst + kStep * static_cast<int>(std::ceil(std::max(least - kFirst, 0.0) / kStep));
  return NameOf(width > kLast ? kAny : width);
}

std::string CardsStyle() {
  std::string style = ".scroll { container-type: inline-size; }\n";
  for (int width = kFirst; width <= kLast; width += kStep) style += StyleBelow(width);
  return style + StyleBelow(kAny);
}

}  // namespace saltus::internal
