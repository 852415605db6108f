// A figure that was drawn once, for several pages and files.
#pragma once

#include <string>
#include <string_view>

#include "output/figure.h"

namespace saltus {

class DrawnFigure {
 public:
  // Runs gnuplot, as RenderSvg does.
  static StatusOr<DrawnFigure> Draw(const Figure& figure, const std::string& gnuplot = "gnuplot");

  const Figure& figure() const { return figure_; }
  // As RenderSvg returns it.
  std::string Svg(std::string_view id_prefix) const;
  // As WriteFigure writes it.
  Status WriteSvg(const std::string& path) const;

 private:
  Figure figure_;
  std::string svg_;  // gnuplot's own
};

}  // namespace saltus
