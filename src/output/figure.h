// Line and scatter figures, maps and scenes to scale. The viewer of pages (page/plot.js) draws them, and saves them as
// SVG files.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "output/json.h"

namespace saltus {

// The styles of contact models in every figure: one colour, dash and marker for each name.
//
// The colours were chosen by maximising the smallest OKLab distance between any two, as seen with normal vision and
// with full protanopia and deuteranopia (Machado, Oliveira and Fernandes 2009, "A physiologically-based model for
// simulation of color vision deficiency").

enum class Dash { kSolid, kDashed, kDotted, kDashDotted };
inline constexpr int kNumDashes = 4;
NLOHMANN_JSON_SERIALIZE_ENUM(Dash, {{Dash::kSolid, "solid"},
                                    {Dash::kDashed, "dashed"},
                                    {Dash::kDotted, "dotted"},
                                    {Dash::kDashDotted, "dashdotted"}})

enum class Marker { kNone, kCircle, kSquare, kTriangle, kTriangleDown, kDiamond, kOpenCircle, kOpenSquare, kCross };
NLOHMANN_JSON_SERIALIZE_ENUM(Marker, {{Marker::kNone, "none"},
                                      {Marker::kCircle, "circle"},
                                      {Marker::kSquare, "square"},
                                      {Marker::kTriangle, "triangle"},
                                      {Marker::kTriangleDown, "triangledown"},
                                      {Marker::kDiamond, "diamond"},
                                      {Marker::kOpenCircle, "opencircle"},
                                      {Marker::kOpenSquare, "opensquare"},
                                      {Marker::kCross, "cross"}})

struct ModelStyle {
  std::string_view model;
  std::string_view colour;  // "#rrggbb"
  Dash dash = Dash::kSolid;
  Marker marker = Marker::kNone;
};

void to_json(Json& json, const ModelStyle& style);

// Returns every name that has a style: "analytic" (black), then the contact models.
const std::vector<ModelStyle>& ModelStyles();

// Returns the style of a contact model. A name that is not in the table always gets the same one of its styles.
const ModelStyle& StyleOf(std::string_view model);

std::string ColourOf(std::string_view model);

// Returns a colour for a swept quantity, from dark blue (0) to light orange (1), with lightness growing throughout.
std::string RampColour(double fraction);

// One axis. Its range covers the data unless given. Preconditions: min < max, and both positive on a logarithmic axis.
struct Axis {
  std::string label = {};  // with units, e.g. "time (s)"
  bool log = false;        // values that are not positive are then left out
  std::optional<double> min = {};
  std::optional<double> max = {};
};

// Points (x[i], y[i]), joined by a line or not. Points that are not finite interrupt the line.
struct Series {
  std::string label = {};  // in the legend; equal labels appear once, empty ones not at all
  std::vector<double> x = {};
  std::vector<double> y = {};
  std::string colour = "#000000";
  Dash dash = Dash::kSolid;
  Marker marker = Marker::kNone;  // on a line of more than 40 points a few are marked, else all
  bool line = true;
  double width = 2;  // of the line, pixels

  // A line in the style of a contact model, with the model's name as its label.
  static Series ForModel(std::string_view model, std::vector<double> x, std::vector<double> y);
};

// A line across the whole panel, at y = value (or x = value).
struct ReferenceLine {
  double value = 0;
  std::string label = {};
  bool vertical = false;
  std::string colour = "#000000";
  Dash dash = Dash::kDashed;
};

struct Panel {
  std::string title = {};
  Axis x = {};
  Axis y = {};
  bool equal_aspect = false;  // one unit is as long in x as in y; widens a range
  std::vector<Series> series = {};
  std::vector<ReferenceLine> reference_lines = {};
  // Shapes in data coordinates: {"centre", "radius", "colour", "opacity"} with the opacity of the inside; ground that
  // is solid on the side of a point that the normal points away from, {"point", "normal"}; and lines from point to
  // point, of which one side may be solid if they are closed, {"name", "points", "solid": "neither", "inside" or
  // "outside"}.
  Json circles = Json::array(), half_planes = Json::array(), outlines = Json::array();
};

// Panels, with one legend for all of them.
struct Figure {
  std::string title = {};
  std::vector<Panel> panels = {};
};

// Returns the figure for the viewer of pages (page/plot.js), with numbers of six significant digits.
Json FigureToJson(const Figure& figure);

}  // namespace saltus
