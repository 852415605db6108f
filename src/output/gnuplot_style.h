// How numbers, text and lines are written in gnuplot's language.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "output/figure.h"

namespace saltus::internal {

// Colours that are not data.
inline constexpr char kInk[] = "#24292f";
inline constexpr char kFaintInk[] = "#6e7781";
inline constexpr char kGrid[] = "#e6e8eb";
inline constexpr char kGround[] = "#d0d4d9";
inline constexpr char kPaper[] = "#ffffff";
inline constexpr char kFont[] = "Liberation Sans";
inline constexpr double kReferenceWidth = 1.5;  // of reference lines, pixels

enum class Terminal { kSvg, kPng };

std::string Number(double value);

// Text as a gnuplot string.
std::string Quote(std::string_view text);

// Options of a command.
std::string Colour(std::string_view colour);
std::string Font(double size, bool bold = false);
std::string LineStyle(double width, Dash dash, std::string_view colour);
std::string MarkStyle(Marker marker, std::string_view colour, Terminal terminal);

// How a line, a row of marks or both look. Copied from a series or a reference line.
struct LegendEntry {
  std::string label;
  std::string line;   // options of "with lines"; empty without a line
  std::string marks;  // options of "with points"; empty without marks
};

// One for each label of the figure.
std::vector<LegendEntry> LegendEntries(const Figure& figure, Terminal terminal);

}  // namespace saltus::internal
