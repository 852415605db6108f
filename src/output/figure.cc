#include "output/figure.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <utility>

namespace saltus {

void to_json(Json& json, const ModelStyle& style) { SALTUS_ADD_MEMBERS(&json, style, colour, dash, marker); }
void to_json(Json& json, const Axis& axis) { SALTUS_ADD_MEMBERS(&json, axis, label, log, min, max); }
void to_json(Json& json, const Series& series) {
  SALTUS_ADD_MEMBERS(&json, series, label, x, y, colour, dash, marker, line, width);
}
void to_json(Json& json, const ReferenceLine& line) {
  SALTUS_ADD_MEMBERS(&json, line, value, label, vertical, colour, dash);
}
void to_json(Json& json, const Panel& panel) {
  SALTUS_ADD_MEMBERS(&json, panel, title, x, y, equal_aspect, series, reference_lines, circles, half_planes, outlines);
}

Series Series::ForModel(std::string_view model, std::vector<double> x, std::vector<double> y) {
  const ModelStyle& style = StyleOf(model);
  return {.label = std::string(model),
          .x = std::move(x),
          .y = std::move(y),
          .colour = std::string(style.colour),
          .dash = style.dash,
          .marker = style.marker};
}

Json FigureToJson(const Figure& figure) {
  Json json;
  SALTUS_ADD_MEMBERS(&json, figure, title, panels);
  Round(6, &json);
  return json;
}

const std::vector<ModelStyle>& ModelStyles() {
  static const std::vector<ModelStyle> styles = {
      {"analytic", "#000000", Dash::kDashed, Marker::kNone},
      {"lcp", "#4671DB", Dash::kSolid, Marker::kCircle},
      {"convex", "#F49700", Dash::kDashed, Marker::kSquare},
      {"convex_toi", "#A35F0A", Dash::kSolid, Marker::kSquare},
      {"direct", "#05A98B", Dash::kDashed, Marker::kTriangle},
      {"direct_toi", "#04593F", Dash::kSolid, Marker::kTriangle},
      {"compliant_warp", "#FF76C8", Dash::kSolid, Marker::kDiamond},
      {"compliant_brax", "#7C117D", Dash::kDashDotted, Marker::kDiamond},
      {"pbd_warp", "#0ABAFF", Dash::kSolid, Marker::kTriangleDown},
      {"pbd_brax", "#3D2CBC", Dash::kDashDotted, Marker::kTriangleDown},
      {"toi_velocity", "#DB7549", Dash::kDotted, Marker::kOpenSquare},
      {"event", "#517886", Dash::kSolid, Marker::kOpenCircle},
      {"lcp_kkt", "#1AD165", Dash::kDotted, Marker::kCircle},
      {"lcp_pgs", "#266F55", Dash::kDotted, Marker::kSquare},
      {"lcp_pgs_adjoint", "#E705B9", Dash::kDotted, Marker::kTriangle},
      {"ncp", "#0F1BF0", Dash::kDashed, Marker::kCross},
      {"ncp_restitution", "#6D0055", Dash::kDashed, Marker::kOpenSquare},
      {"soft_convex", "#2181B6", Dash::kDashDotted, Marker::kSquare},
      {"qcqp", "#A61F05", Dash::kDashed, Marker::kCircle},
      {"smooth_compliant", "#8B3A94", Dash::kDotted, Marker::kTriangleDown},
      {"ipc_barrier", "#6D1E02", Dash::kDashDotted, Marker::kCross},
      {"xpbd", "#2DC08D", Dash::kDashDotted, Marker::kOpenCircle},
      {"position_qp", "#4890FC", Dash::kDashed, Marker::kDiamond},
      {"primal_descent", "#480C24", Dash::kSolid, Marker::kCross},
      {"dual_descent", "#000030", Dash::kDotted, Marker::kCross},
      {"static_lcp", "#30000C", Dash::kDashDotted, Marker::kOpenSquare},
  };
  return styles;
}

const ModelStyle& StyleOf(std::string_view model) {
  const std::vector<ModelStyle>& styles = ModelStyles();
  for (const ModelStyle& style : styles) {
    if (style.model == model) return style;
  }
  uint32_t hash = 2166136261u;  // FNV-1a: the same on every machine, unlike std::hash
  for (const char c : model) hash = (hash ^ static_cast<unsigned char>(c)) * 16777619u;
  return styles[1 + hash % (styles.size() - 1)];
}

std::string ColourOf(std::string_view model) { return std::string(StyleOf(model).colour); }

std::string RampColour(double fraction) {
  static constexpr std::array<std::array<double, 3>, 5> kStops = {
      {{43, 34, 118}, {107, 40, 141}, {178, 58, 118}, {226, 105, 76}, {242, 166, 50}}};
  const double position = std::clamp(fraction, 0.0, 1.0) * (kStops.size() - 1);
  const size_t below = std::min(static_cast<size_t>(position), kStops.size() - 2);
  const double share = position - static_cast<double>(below);
  std::array<int, 3> rgb;
  for (size_t i = 0; i < 3; ++i) {
    rgb[i] = static_cast<int>(std::lround((1 - share) * kStops[below][i] + share * kStops[below + 1][i]));
  }
  std::array<char, 8> text;
  std::snprintf(text.data(), text.size(), "#%02X%02X%02X", rgb[0] & 0xff, rgb[1] & 0xff, rgb[2] & 0xff);
  return text.data();
}

}  // namespace saltus
