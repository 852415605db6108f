#include "saltus/audit/width_sweep.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "audit/gradient/judgement.h"
#include "audit/gradient/own_differences.h"
#include "base/number_text.h"
#include "base/statistics.h"
#include "saltus/control/objective.h"
#include "saltus/scene/walls.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"

namespace saltus {
namespace {

constexpr size_t kFewest = 4;           // slopes that make a plateau
constexpr double kOwnTolerance = 1e-3;  // by which a gradient may miss narrow differences
constexpr double kScatter = 3;          // spreads by which levels may differ by chance
constexpr double kMostScatter = 0.25;   // spread beyond which there is no plateau, of the largest entry
constexpr double kNegligible = 1e-2;    // entries smaller than this, of the largest, may have any sign
constexpr double kMostSteps = 20000;    // of the refined simulation

// A direction of differences: one entry of the initial state, or a constant force.
struct Direction {
  Quantity quantity;
  std::string entry;
  int index;  // into the initial state (B x 4), or into the control of one step
  double grid_width;
  double most = std::numeric_limits<double>::infinity();  // width at which discs may overlap at the start
};

// The loss of a model as a function of one variable.
class Line {
 public:
  Line(std::unique_ptr<Simulator> simulator, const StopRequest& stop)
      : simulator_(std::move(simulator)),
        initial_(InitialState(simulator_->scene())),
        control_(InitialControl(simulator_->scene(), simulator_->num_steps())),
        final_(simulator_->state_size()) {
    simulator_->set_stop(stop);
  }

  const Simulator& simulator() const { return *simulator_; }

  // Returns the loss with one variable moved by `offset`, NaN if the rollout is not finite.
  double LossAt(const Direction& direction, double offset) {
    std::vector<double> initial = initial_, control = control_;
    if (direction.quantity == Quantity::kControl) {
      const size_t width = simulator_->control_width();
      for (size_t i = direction.index; i < control.size(); i += width) control[i] += offset;
    } else {
      initial[direction.index] += offset;
    }
    if (!simulator_->Rollout(initial, control)) return std::numeric_limits<double>::quiet_NaN();
    simulator_->GetState(simulator_->num_steps(), final_);
    const Objective& objective = simulator_->scene().objective;
    return TerminalLoss(objective, final_, simulator_->body_size()) +
           EffortLoss(objective, control, simulator_->step());
  }

  // Returns the largest speed in the rollout from the scene's initial state, m/s; 0 if it fails.
  double LargestSpeed(int most_states) {
    return simulator_->Rollout(initial_, control_) ? saltus::LargestSpeed(*simulator_, most_states) : 0.0;
  }

 private:
  std::unique_ptr<Simulator> simulator_;
  std::vector<double> initial_, control_, final_;
};

// Returns half the smallest gap of a disc at the initial time, m.
double Room(const Scene& scene, int body) {
  const Body& a = scene.bodies[body];
  double gap = std::numeric_limits<double>::infinity();
  for (int i = 0; i < scene.num_bodies(); ++i) {
    const Body& b = scene.bodies[i];
    if (i != body) gap = std::min(gap, (a.position - b.position).norm() - a.radius - b.radius);
  }
  for (const WallPart& part : WallPartsOf(scene)) {
    if (part.extent.Covers(a.position)) gap = std::min(gap, part.LeastDistance(a.position) - a.radius);
  }
  return gap / 2;
}

std::vector<Direction> DirectionsOf(const Scene& scene, double speed, double step) {
  std::vector<Direction> directions;
  const double length = speed * step, T = scene.duration;
  for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity}) {
    const std::vector<std::string> names = EntryNames(scene, quantity, 0);
    const bool position = quantity == Quantity::kPosition;
    size_t name = 0;
    for (int i = 0; i < scene.num_bodies(); ++i) {
      if (scene.bodies[i].fixed) continue;
      for (int j = 0; j < 2; ++j) {
        Direction direction{quantity, names[name++], 4 * i + j + (position ? 0 : 2), position ? length : length / T};
        if (position) direction.most = Room(scene, i);
        directions.push_back(direction);
      }
    }
  }
  for (int c = 0; c < scene.num_controlled(); ++c) {
    const Body& body = scene.bodies[scene.control.bodies[c]];
    for (int j = 0; j < 2; ++j) {
      directions.push_back({Quantity::kControl,
                            std::string(j == 0 ? "ux " : "uy ") + body.name,
                            2 * c + j,
                            2 * length * body.mass / (T * T)});
    }
  }
  for (int t = 0; t < scene.num_turned(); ++t) {
    const Body& body = scene.bodies[scene.control.turned[t]];
    const double mass = body.MomentOfInertia() / (body.radius * body.radius);  // of the rim
    directions.push_back({Quantity::kControl,
                          "torque/radius " + body.name,
                          static_cast<int>(scene.TurnIndex(0, t)),
                          2 * length * mass / (T * T)});
  }
  return directions;
}

// Finds the level and the spread of the slopes of widths in [from, to] grid widths. Returns false without a plateau.
bool FindPlateau(const WidthSweep& sweep, double from, double to, double* level, double* spread) {
  std::vector<double> slopes;
  for (size_t i = 0; i < sweep.widths.size(); ++i) {
    const double width = sweep.widths[i] / sweep.grid_width;
    if (width >= from && width <= to && std::isfinite(sweep.slopes[i])) slopes.push_back(sweep.slopes[i]);
  }
  if (slopes.size() < kFewest) return false;
  *level = Median(slopes);
  for (double& slope : slopes) slope = std::abs(slope - *level);
  *spread = Median(slopes);
  return true;
}

WidthFinding Judge(const WidthSweep& sweep, double scale, double tolerance) {
  if (sweep.wide_spread > kMostScatter * scale) return WidthFinding::kUndecided;
  if (std::abs(sweep.gradient - sweep.wide) <= tolerance * scale + kScatter * sweep.wide_spread) {
    return WidthFinding::kNothing;
  }
  const bool own = std::abs(sweep.gradient - sweep.narrow) <= kOwnTolerance * scale + kScatter * sweep.narrow_spread;
  return own ? WidthFinding::kOnlyOfItsSteps : WidthFinding::kOfNeither;
}

bool IsAgainst(const WidthSweep& sweep) {
  return sweep.finding == WidthFinding::kOnlyOfItsSteps || sweep.finding == WidthFinding::kOfNeither;
}

// Returns the model's gradient along a direction.
double GradientAlong(const Direction& direction, const ModelGradient& gradient, size_t controls_per_step) {
  if (direction.quantity != Quantity::kControl) return gradient.gradient.initial[direction.index];
  double sum = 0;
  for (size_t i = direction.index; i < gradient.gradient.control.size(); i += controls_per_step) {
    sum += gradient.gradient.control[i];
  }
  return sum;
}

// Returns the exact derivative along the direction of a sweep; std::nullopt for a torque.
std::optional<double> ExactAlong(const Scene& scene, const ModelGradient& exact, const WidthSweep& sweep) {
  std::vector<std::string> names = EntryNames(scene, sweep.quantity, 1);
  if (sweep.quantity == Quantity::kControl) {
    // "ux[0] striker" is the only interval of "ux striker".
    for (std::string& name : names) name = name.substr(0, 2) + name.substr(5);
  }
  const auto at = std::ranges::find(names, sweep.entry);
  if (at == names.end()) return std::nullopt;
  return EntriesOf(scene, exact, sweep.quantity, 1)[at - names.begin()];
}

void Convert(const Units& from, const Units& to, WidthSweep* sweep) {
  const double by = GradientFactor(sweep->quantity, from, to);
  for (double* slope : {&sweep->gradient, &sweep->narrow, &sweep->wide, &sweep->narrow_spread, &sweep->wide_spread}) {
    *slope *= by;
  }
  sweep->slopes = Multiplied(std::move(sweep->slopes), by);
  const double width = UnitFactors(from, to).loss / by;
  sweep->grid_width *= width;
  sweep->widths = Multiplied(std::move(sweep->widths), width);
}

}  // namespace

const char* WidthFindingToString(WidthFinding finding) {
  constexpr const char* kNames[] = {"nothing found",
                                    "agrees with narrow differences, not with wide ones",
                                    "agrees with no differences",
                                    "undecided",
                                    "wide differences are farther from the exact value"};
  return kNames[static_cast<int>(finding)];
}

const WidthSweep* WidthSweepStudy::Worst() const {
  const WidthSweep* worst = nullptr;
  const auto miss = [](const WidthSweep& sweep) { return std::abs(sweep.gradient - sweep.wide); };
  for (const WidthSweep& sweep : sweeps) {
    if (!IsAgainst(sweep)) continue;
    // Only entries of one unit can be compared.
    if (worst != nullptr && (sweep.quantity != worst->quantity || miss(sweep) <= miss(*worst))) continue;
    worst = &sweep;
  }
  return worst;
}

std::string WidthSweepStudy::Summary() const {
  if (!ok()) return reason;
  const WidthSweep* worst = Worst();
  if (worst == nullptr) {
    const auto any = [&](WidthFinding finding) {
      return std::ranges::count(sweeps, finding, &WidthSweep::finding) > 0;
    };
    if (any(WidthFinding::kFarther)) return "wide differences are farther from the exact gradient than it is";
    return any(WidthFinding::kUndecided) ? "differences of some entries scatter too much to tell"
                                         : "differences of all widths agree with it";
  }
  // A difference that is rounding is shown as 0.
  const auto shown = [&](double value) { return std::abs(value) < 1e-7 * std::abs(worst->wide) ? 0.0 : value; };
  return "d/d" + worst->entry + " is " + ToText(shown(worst->gradient), 4) +
         "; differences narrower than a step give " + ToText(shown(worst->narrow), 4) + ", wider ones " +
         ToText(worst->wide, 4);
}

std::vector<double> WidthsOf(const WidthSweepOptions& options, double grid_width) {
  const int count = options.NumWidths();
  std::vector<double> widths;
  for (int i = 0; i < count; ++i) {
    widths.push_back(grid_width * options.smallest * std::pow(10.0, double(i) / options.per_decade));
  }
  return widths;
}

Verdict JudgeSweeps(double loss, const WidthSweepOptions& options, std::vector<WidthSweep>* sweeps) {
  Verdict verdict = Verdict::kUnknown;
  for (WidthSweep& sweep : *sweeps) {
    const bool narrow = FindPlateau(sweep, options.narrow_from, options.narrow_to, &sweep.narrow, &sweep.narrow_spread);
    const bool wide = FindPlateau(sweep, options.wide_from, options.wide_to, &sweep.wide, &sweep.wide_spread);
    sweep.finding = narrow && wide ? WidthFinding::kNothing : WidthFinding::kUndecided;
  }
  for (WidthSweep& sweep : *sweeps) {
    if (sweep.finding == WidthFinding::kUndecided) continue;
    double scale = 1e-9 * std::max(1.0, std::abs(loss));
    for (const WidthSweep& other : *sweeps) {
      if (other.quantity == sweep.quantity) scale = std::max({scale, std::abs(other.wide), std::abs(other.gradient)});
    }
    sweep.finding = Judge(sweep, scale, options.tolerance);
    if (!IsAgainst(sweep)) continue;
    const double negligible = kNegligible * scale;
    const bool flips =
        sweep.gradient * sweep.wide < 0 && std::abs(sweep.gradient) > negligible && std::abs(sweep.wide) > negligible;
    if (verdict == Verdict::kUnknown || flips) verdict = flips ? Verdict::kWrongSign : Verdict::kWrong;
  }
  return verdict;
}

void CompareWithExact(const Scene& scene, const ModelGradient& exact, WidthSweepStudy* study) {
  for (WidthSweep& sweep : study->sweeps) {
    sweep.exact = ExactAlong(scene, exact, sweep);
    const auto miss = [&](double value) { return std::abs(value - *sweep.exact); };
    if (sweep.exact && IsAgainst(sweep) && miss(sweep.wide) >= miss(sweep.gradient)) {
      sweep.finding = WidthFinding::kFarther;
    }
  }
  if (study->Worst() == nullptr) study->verdict = Verdict::kUnknown;
}

WidthSweepStudy SweepWidths(const Contact& contact, const Scene& scene, const WidthSweepOptions& options,
                            const StopRequest& stop) {
  WidthSweepStudy refused;
  refused.reason = WhyNotApplicable(contact, scene);
  if (!refused.ok()) return refused;
  if (!scene.units.natural) {
    const Scene natural = InNaturalUnits(scene);
    WidthSweepStudy study = SweepWidths(contact, natural, options, stop);
    for (WidthSweep& sweep : study.sweeps) Convert(natural.units, scene.units, &sweep);
    return study;
  }
  WidthSweepStudy study;
  Scene refined = scene;
  // The number of steps is no exact multiple, so that an impact on a grid node is not on a node of the refined grid.
  refined.steps = scene.steps * std::clamp<int>(kMostSteps / scene.steps, 1, options.refine) +
                  CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
  const ModelGradient own = ComputeGradient(contact, refined, Precision::kDouble, stop);
  if (!own.ok()) {
    study.reason = own.reason;
    return study;
  }
  Line line(MakeSimulator(contact, refined, Precision::kDouble), stop);
  const double speed = std::max(line.LargestSpeed(options.most_states), 1e-9);
  for (const Direction& direction : DirectionsOf(scene, speed, line.simulator().step())) {
    WidthSweep& sweep = study.sweeps.emplace_back();
    sweep.quantity = direction.quantity;
    sweep.entry = direction.entry;
    sweep.grid_width = direction.grid_width;
    sweep.gradient = GradientAlong(direction, own, scene.control_width());
    for (const double width : WidthsOf(options, direction.grid_width)) {
      if (width > direction.most) break;
      if (line.simulator().stopped()) return study;
      sweep.widths.push_back(width);
      sweep.slopes.push_back((line.LossAt(direction, width) - line.LossAt(direction, -width)) / (2 * width));
    }
  }
  study.verdict = JudgeSweeps(own.loss, options, &study.sweeps);
  return study;
}

}  // namespace saltus
