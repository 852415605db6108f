// The styles of contact models in every figure: one colour, dash and marker for each name.
//
// The colours were chosen by maximising the smallest OKLab distance between any two, as seen with normal vision and
// with full protanopia and deuteranopia (Machado, Oliveira and Fernandes 2009, "A physiologically-based model for
// simulation of color vision deficiency").
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace saltus {

enum class Dash { kSolid, kDashed, kDotted, kDashDotted };
inline constexpr int kNumDashes = 4;

// Returns "solid", "dashed", "dotted" or "dashdotted".
std::string_view DashName(Dash dash);

enum class Marker { kNone, kCircle, kSquare, kTriangle, kTriangleDown, kDiamond, kOpenCircle, kOpenSquare, kCross };

// Returns "none", "circle", "square", "triangle", "triangledown", "diamond", "opencircle", "opensquare" or "cross".
std::string_view MarkerName(Marker marker);

struct ModelStyle {
  std::string_view model;
  std::string_view colour;  // "#rrggbb"
  Dash dash = Dash::kSolid;
  Marker marker = Marker::kNone;
};

// Returns every name that has a style: "analytic" (black), then the contact models.
const std::vector<ModelStyle>& ModelStyles();

// Returns the style of a contact model. A name that is not in the table always gets the same one of its styles.
const ModelStyle& StyleOf(std::string_view model);

std::string ColourOf(std::string_view model);

// Returns a colour for a swept quantity, from dark blue (0) to light orange (1), with lightness growing throughout.
std::string RampColour(double fraction);

}  // namespace saltus
