#include "solve/solve_units.h"

#include <algorithm>
#include <utility>

namespace saltus {
namespace {

void ConvertDecisions(const Scene& scene, std::vector<double>* z) {
  const UnitFactors to_si(scene.units, {});
  if (scene.optimize == Optimize::kControl && scene.objective.duration) {
    const double duration = z->back() * to_si.time;
    *z = Multiplied(std::move(*z), to_si.force);
    z->back() = duration;
    return;
  }
  if (scene.optimize == Optimize::kVelocity) {
    const size_t turning = z->size() - scene.free_spin.size();
    for (size_t i = 0; i < z->size(); ++i) (*z)[i] *= i < turning ? to_si.speed : to_si.rate;
    return;
  }
  if (scene.optimize != Optimize::kPosition) {
    *z = Multiplied(std::move(*z), to_si.force);
    return;
  }
  for (size_t i = 0; i + 1 < z->size(); i += 2) {
    const Vec2d position = ConvertPosition({(*z)[i], (*z)[i + 1]}, scene.units, {});
    std::copy_n(position.data(), 2, &(*z)[i]);
  }
}

}  // namespace

SolverOptions OptionsFor(const Scene& scene, const SolverOptions& options) {
  SolverOptions out = options;
  if (options.guess) {
    const UnitFactors from_si({}, scene.units);
    out.guess->control = Multiplied(options.guess->control, from_si.force);
    out.guess->durations = Multiplied(options.guess->durations, from_si.time);
  }
  if (options.callback) {
    out.callback = [&options, units = scene.units](int iteration, double loss) {
      return options.callback(iteration, ConvertLoss(loss, units, {}));
    };
  }
  return out;
}

SolveReport InSiUnits(const Scene& scene, SolveReport report) {
  const Units si;
  const UnitFactors to_si(scene.units, si);
  const auto convert_loss = [&](double* loss) { *loss = ConvertLoss(*loss, scene.units, si); };
  if (!report.losses.empty()) {
    convert_loss(&report.initial_loss);
    convert_loss(&report.final_loss);
  }
  for (double& loss : report.losses) convert_loss(&loss);
  if (report.best) {
    convert_loss(&report.best->loss);
    report.best->initial_state =
        ConvertInitial(std::move(report.best->initial_state), scene.num_bodies(), scene.units, si);
    report.best->control = Multiplied(std::move(report.best->control), to_si.force);
    report.best->durations = Multiplied(std::move(report.best->durations), to_si.time);
  }
  for (std::vector<double>& z : report.iterates) ConvertDecisions(scene, &z);
  report.initial_state = ConvertInitial(std::move(report.initial_state), scene.num_bodies(), scene.units, si);
  report.control = Multiplied(std::move(report.control), to_si.force);
  report.durations = Multiplied(std::move(report.durations), to_si.time);
  if (report.certificate) *report.certificate = InUnits(*report.certificate, scene.units, si);
  if (report.searched) convert_loss(&report.searched->lower_bound);
  for (LocalOptimum& optimum : report.optima) {
    convert_loss(&optimum.loss);
    optimum.times = Multiplied(std::move(optimum.times), to_si.time);
  }
  return report;
}

}  // namespace saltus
