#include "sweep/figures.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>

#include "base/statistics.h"
#include "sweep/options.h"

namespace saltus {
namespace {

constexpr double kLogLossFrom = 100;
constexpr size_t kMostPanels = 9;
constexpr int kLevels = 7;  // in the legend of a map
constexpr double kLevelWidth = 14;

struct Unit {
  const char* option;
  const char* unit;
};
constexpr Unit kUnits[] = {{"stiffness", "N/m"},
                           {"damping", "N s/m"},
                           {"duration", "s"},
                           {"gravity_x", "m/s²"},
                           {"gravity_y", "m/s²"},
                           {"mass", "kg"},
                           {"radius", "m"},
                           {"position_x", "m"},
                           {"position_y", "m"},
                           {"velocity_x", "m/s"},
                           {"velocity_y", "m/s"},
                           {"force_x", "N"},
                           {"force_y", "N"}};

// With its unit; of "<body>.<field>", that of the field.
std::string AxisLabel(const std::string& option) {
  const std::string field = option.substr(option.rfind('.') + 1);
  for (const Unit& unit : kUnits) {
    if (field == unit.option) return option + " (" + unit.unit + ")";
  }
  return option;
}

// Whether a logarithmic scale shows values from `least` to `most` better.
bool WantsLog(double least, double most, double ratio) { return least > 0 && most >= ratio * least; }

// Whether ascending values of an option are spaced more evenly on a logarithmic scale; two values, if they are far
// apart.
bool WantsLog(const std::vector<double>& values) {
  constexpr double kFar = 20;
  if (values.size() < 3) return !values.empty() && WantsLog(values.front(), values.back(), kFar);
  if (values.front() <= 0) return false;
  // The widest gap by the narrowest.
  const auto unevenness = [&](const auto& scale) {
    double narrowest = HUGE_VAL, widest = 0;
    for (size_t i = 1; i < values.size(); ++i) {
      const double gap = scale(values[i]) - scale(values[i - 1]);
      narrowest = std::min(narrowest, gap);
      widest = std::max(widest, gap);
    }
    return widest / narrowest;
  };
  return unevenness([](double x) { return std::log(x); }) < unevenness([](double x) { return x; });
}

// The points that are done, with their columns by name.
class Results {
 public:
  Results(const SweepStudy& study, const std::vector<StoredPoint>& points) : study_(study) {
    for (const StoredPoint& point : points) {
      if (point.result.status == PointStatus::kComputed) rows_.push_back(&point.result.row);
    }
    for (size_t i = 0; i < study.options().size(); ++i) {
      const std::string& option = study.options()[i];
      if (FindSweepOption(option, study.request().scene) == SweepOptionKind::kWord) continue;
      if (Distinct(option).size() > 1) varied_.push_back(option);
    }
  }

  size_t size() const { return rows_.size(); }
  const SweepStudy& study() const { return study_; }
  // The numbers that have more than one value.
  const std::vector<std::string>& varied() const { return varied_; }

  bool Has(const std::string& column) const { return study_.FindColumn(column).has_value(); }

  // Returns a number, NaN where there is none. Precondition: the column exists.
  double Number(size_t row, const std::string& column) const {
    return ToNumber((*rows_[row])[*study_.FindColumn(column)]);
  }
  std::string Text(size_t row, const std::string& column) const {
    return Has(column) ? CellOf((*rows_[row])[*study_.FindColumn(column)]).Exact() : "";
  }

  std::vector<double> Distinct(const std::string& column) const {
    std::set<double> values;
    for (size_t row = 0; row < size(); ++row) values.insert(Number(row, column));
    return {values.begin(), values.end()};
  }

  // ", smallest over damping and steps": those varied beside `shown`.
  std::string Over(const std::string& which, const std::vector<std::string>& shown) const {
    std::string others;
    for (const std::string& option : varied_) {
      if (std::ranges::find(shown, option) != shown.end()) continue;
      others += (others.empty() ? "" : ", ") + option;
    }
    return others.empty() ? "" : ", " + which + " over " + others;
  }

 private:
  const SweepStudy& study_;
  std::vector<const SweepRow*> rows_;
  std::vector<std::string> varied_;
};

// The contact model and solver that a curve or a map belongs to.
struct Method {
  std::string contact, solver;
  auto operator<=>(const Method&) const = default;
};

Method MethodOf(const Results& results, size_t row) {
  return {results.Text(row, "contact"), results.Text(row, "solver")};
}

std::string Label(const Method& method) {
  return method.solver.empty() ? method.contact : method.contact + ", " + method.solver;
}

using Curve = std::map<double, double>;                   // by x
using Map = std::map<std::pair<size_t, size_t>, double>;  // by indices of x and y

// Returns curves or maps of every method: the smallest number (or the largest) over all rows at the same place.
template <typename Places, typename PlaceOf, typename Better>
std::map<Method, Places> BestOf(const Results& results, const PlaceOf& place_of, const std::string& column,
                                const Better& better) {
  std::map<Method, Places> all;
  for (size_t row = 0; row < results.size(); ++row) {
    const double number = results.Number(row, column);
    if (!std::isfinite(number)) continue;
    const auto [at, inserted] = all[MethodOf(results, row)].try_emplace(place_of(row), number);
    if (!inserted && better(number, at->second)) at->second = number;
  }
  return all;
}

struct Extent {
  double least = std::numeric_limits<double>::infinity();
  double most = -std::numeric_limits<double>::infinity();
  void Add(double value) {
    least = std::min(least, value);
    most = std::max(most, value);
  }
};

// The contact model gives colour and marker; solvers differ in the dash.
Series CurveSeries(const Method& method, const Curve& curve, const std::vector<std::string>& solvers) {
  std::vector<double> x, y;
  for (const auto& [at, value] : curve) {
    x.push_back(at);
    y.push_back(value);
  }
  Series series = Series::ForModel(method.contact, x, y);
  series.label = Label(method);
  const size_t solver = std::ranges::find(solvers, method.solver) - solvers.begin();
  if (solvers.size() > 1) series.dash = static_cast<Dash>(solver % kNumDashes);
  return series;
}

std::vector<std::string> Solvers(const std::map<Method, Curve>& curves) {
  std::vector<std::string> solvers;
  for (const auto& [method, curve] : curves) {
    if (std::ranges::find(solvers, method.solver) == solvers.end()) solvers.push_back(method.solver);
  }
  return solvers;
}

Panel CurvePanel(const std::map<Method, Curve>& curves, const std::string& x_label, const std::string& y_label) {
  Panel panel;
  std::set<double> x;
  Extent y;
  const std::vector<std::string> solvers = Solvers(curves);
  for (const auto& [method, curve] : curves) {
    for (const auto& [at, value] : curve) {
      x.insert(at);
      y.Add(value);
    }
    panel.series.push_back(CurveSeries(method, curve, solvers));
  }
  panel.x.label = x_label;
  panel.x.log = WantsLog({x.begin(), x.end()});
  panel.y.label = y_label;
  panel.y.log = WantsLog(y.least, y.most, kLogLossFrom);
  return panel;
}

struct LossColumn {
  std::string column, label;
};

std::vector<LossColumn> LossColumns(const SweepStudy& study) {
  if (study.solving()) return {{"final_loss", "loss under the model"}, {"exact_loss", "exact loss"}};
  return {{"loss", "loss at the initial guess"}};
}

SweepFigure LossFigure(const Results& results, const std::string& option) {
  Figure figure{.legend = Legend::kBelow};
  for (const LossColumn& loss : LossColumns(results.study())) {
    const auto curves = BestOf<Curve>(
        results, [&](size_t row) { return results.Number(row, option); }, loss.column, std::less<>());
    figure.panels.push_back(CurvePanel(curves, AxisLabel(option), loss.label));
  }
  figure.title = results.study().request().scene.name + ": loss against " + option + results.Over("smallest", {option});
  figure.columns = static_cast<int>(figure.panels.size());
  figure.width = figure.columns > 1 ? 1200 : 800;
  return {"loss_against_" + option, figure};
}

// The order in which an error goes to zero, of the finer half of the steps: coarse ones are not there yet. None where
// all errors are zero, NaN of too few steps.
std::optional<double> OrderOf(const Curve& errors) {
  std::vector<double> x, y;
  for (const auto& [dt, error] : errors) {
    if (!(error > 0)) continue;
    x.push_back(dt);
    y.push_back(error);
  }
  if (x.empty()) return std::nullopt;
  const size_t finer = std::max<size_t>(3, (x.size() + 1) / 2);
  x.resize(std::min(finer, x.size()));
  y.resize(x.size());
  return Order(x, y);
}

// The order of each refinement, in which nothing but the steps differs: the largest error over other options has no
// order of its own.
std::string OrderLabel(const std::vector<Curve>& refinements) {
  const auto text = [](double order) { return Format(order <= -0.005 ? "−%.2f" : "%.2f", std::abs(order)); };
  Extent orders;
  bool exact = true;
  for (const Curve& refinement : refinements) {
    const std::optional<double> order = OrderOf(refinement);
    exact = exact && !order;
    if (order && std::isfinite(*order)) orders.Add(*order);
  }
  if (exact) return "exact";
  if (orders.least > orders.most) return "too few steps";
  const std::string least = text(orders.least), most = text(orders.most);
  return "order " + (least == most ? least : least + " to " + most);
}

SweepFigure GradientErrorFigure(const Results& results) {
  const Scene& scene = results.study().request().scene;
  const auto dt = [&](size_t row) {
    const double steps = results.Has("steps") ? results.Number(row, "steps") : scene.steps;
    return (results.Has("duration") ? results.Number(row, "duration") : scene.duration) / steps;
  };
  const std::map<Method, Curve> curves = BestOf<Curve>(results, dt, "relative_error", std::greater<>());
  Panel panel = CurvePanel(curves, "time step (s)", "relative error of the gradient");
  panel.x.log = panel.y.log = true;
  // The curves of refinement, by the method and the other options of their rows.
  std::map<Method, std::map<std::vector<std::string>, Curve>> refinements;
  for (size_t row = 0; row < results.size(); ++row) {
    const double error = results.Number(row, "relative_error");
    if (!std::isfinite(error)) continue;
    std::vector<std::string> others;
    for (const std::string& option : results.study().options()) {
      if (option != "steps") others.push_back(results.Text(row, option));
    }
    refinements[MethodOf(results, row)][others][dt(row)] = error;
  }
  auto series = panel.series.begin();
  for (const auto& [method, by_others] : refinements) {
    std::vector<Curve> all;
    for (const auto& [others, curve] : by_others) all.push_back(curve);
    (series++)->label += ": " + OrderLabel(all);
  }
  Figure figure{.width = 900, .panel_height = 420};
  figure.title = scene.name + ": error of the gradient" + results.Over("largest", {"steps", "duration"});
  figure.panels = {panel};
  return {"gradient_error_against_dt", figure};
}

// The edges of cells around sorted values: halfway between neighbours.
std::vector<double> Edges(const std::vector<double>& values, bool log) {
  std::vector<double> centres = values;
  if (log) {
    for (double& value : centres) value = std::log(value);
  }
  const size_t n = centres.size();
  std::vector<double> edges = {centres[0] - (centres[1] - centres[0]) / 2};
  for (size_t i = 0; i + 1 < n; ++i) edges.push_back((centres[i] + centres[i + 1]) / 2);
  edges.push_back(centres[n - 1] + (centres[n - 1] - centres[n - 2]) / 2);
  if (log) {
    for (double& edge : edges) edge = std::exp(edge);
  }
  return edges;
}

// The colours of values, the same in all panels of a figure.
class ColourScale {
 public:
  explicit ColourScale(const Extent& extent)
      : extent_(extent), log_(WantsLog(extent.least, extent.most, kLogLossFrom)) {}

  std::string Colour(double value) const {
    const double span = At(extent_.most) - At(extent_.least);
    return RampColour(span > 0 ? (At(value) - At(extent_.least)) / span : 0.0);
  }

  // Returns the entries of the legend, from the largest value down.
  std::vector<Series> Levels() const {
    std::vector<Series> levels;
    for (int i = kLevels; i-- > 0;) {
      const double at = At(extent_.least) + (At(extent_.most) - At(extent_.least)) * i / (kLevels - 1);
      const double value = log_ ? std::exp(at) : at;
      levels.push_back({.label = Format("%.4g", value),
                        .colour = Colour(std::clamp(value, extent_.least, extent_.most)),
                        .width = kLevelWidth});
    }
    return levels;
  }

 private:
  double At(double value) const { return log_ ? std::log(value) : value; }

  Extent extent_;
  bool log_;
};

// One axis of a map.
struct MapAxis {
  std::string option;
  std::vector<double> values, edges;
  bool log = false;

  MapAxis(const Results& results, const std::string& name) : option(name), values(results.Distinct(name)) {
    log = WantsLog(values);
    edges = Edges(values, log);
  }
  Axis ToAxis() const { return {.label = AxisLabel(option), .log = log, .min = edges.front(), .max = edges.back()}; }
  size_t Index(double value) const {
    return static_cast<size_t>(std::ranges::lower_bound(values, value) - values.begin());
  }
};

Panel MapPanel(const Method& method, const Map& map, const MapAxis& x, const MapAxis& y, const ColourScale& scale) {
  Panel panel{.title = Label(method), .x = x.ToAxis(), .y = y.ToAxis()};
  for (const auto& [cell, loss] : map) {
    const auto& [i, j] = cell;
    panel.rectangles.push_back({{x.edges[i], y.edges[j]}, {x.edges[i + 1], y.edges[j + 1]}, scale.Colour(loss)});
  }
  return panel;
}

// Returns std::nullopt if the two were not varied independently (fewer than half of all pairs), or all points failed.
std::optional<SweepFigure> MapFigure(const Results& results, const std::string& option_x, const std::string& option_y) {
  const MapAxis x(results, option_x), y(results, option_y);
  const LossColumn loss = LossColumns(results.study()).back();
  const auto cell_of = [&](size_t row) {
    return std::pair(x.Index(results.Number(row, option_x)), y.Index(results.Number(row, option_y)));
  };
  const auto maps = BestOf<Map>(results, cell_of, loss.column, std::less<>());
  Extent extent;
  size_t most = 0;
  for (const auto& [method, map] : maps) {
    most = std::max(most, map.size());
    for (const auto& [cell, value] : map) extent.Add(value);
  }
  if (most == 0 || 2 * most < x.values.size() * y.values.size()) return std::nullopt;
  const ColourScale scale(extent);
  Figure figure{.panel_height = 380};
  for (const auto& [method, map] : maps) {
    if (figure.panels.size() < kMostPanels) figure.panels.push_back(MapPanel(method, map, x, y, scale));
  }
  figure.panels[0].series = scale.Levels();
  figure.title =
      results.study().request().scene.name + ": " + loss.label + results.Over("smallest", {option_x, option_y});
  figure.columns = static_cast<int>(std::ceil(std::sqrt(static_cast<double>(figure.panels.size()))));
  figure.width = 200 + 450 * figure.columns;
  return SweepFigure{"loss_map_" + option_x + "_" + option_y, figure};
}

}  // namespace

double Order(const std::vector<double>& x, const std::vector<double>& y) {
  std::vector<double> positive_x, positive_y;
  for (size_t i = 0; i < x.size(); ++i) {
    if (!(x[i] > 0) || !(y[i] > 0)) continue;
    positive_x.push_back(x[i]);
    positive_y.push_back(y[i]);
  }
  return positive_x.size() < 3 ? std::nan("") : FittedExponent(positive_x, positive_y);
}

std::vector<SweepFigure> MakeSweepFigures(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  const Results results(study, points);
  const std::vector<std::string>& varied = results.varied();
  std::vector<SweepFigure> figures;
  for (const std::string& option : varied) figures.push_back(LossFigure(results, option));
  const bool dt_varied =
      std::ranges::find(varied, "steps") != varied.end() || std::ranges::find(varied, "duration") != varied.end();
  if (dt_varied && results.Has("relative_error")) figures.push_back(GradientErrorFigure(results));
  for (size_t i = 0; i < varied.size(); ++i) {
    for (size_t j = i + 1; j < varied.size(); ++j) {
      if (std::optional<SweepFigure> map = MapFigure(results, varied[i], varied[j])) figures.push_back(std::move(*map));
    }
  }
  return figures;
}

}  // namespace saltus
