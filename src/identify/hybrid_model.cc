// Motions of hybrid problems, as a fit of their parameters sees them.
#include <ceres/cost_function.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <numeric>
#include <utility>

#include "base/number_text.h"
#include "control/hybrid_shooting.h"
#include "identify/fit.h"
#include "saltus/identify/hybrid_fit.h"

namespace saltus {
namespace {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

class HybridModel final : public FitModel {
 public:
  HybridModel(const std::vector<HybridExperiment>& experiments, std::vector<HybridUnknown> unknowns,
              IdentifyOptions options)
      : unknowns_(std::move(unknowns)), options_(std::move(options)) {
    for (const HybridExperiment& experiment : experiments) {
      HybridProblem& problem = experiments_.emplace_back(Experiment{experiment, {}}).given.problem;
      problem.free = {};
      problem.integration.stop = options_.stop;
      for (const HybridUnknown& unknown : unknowns_) {
        if (Has(std::ssize(experiments_) - 1, unknown)) FreeOf(unknown, &problem.free).push_back(unknown.index);
      }
    }
  }

  std::string Prepare(FitRequest* request) override {
    if (std::string wrong = ValidateRequest(); !wrong.empty()) return wrong;
    request->problem.options = options_;
    states_sigma_ = request->problem.states_sigma = experiments_[0].given.data[0].states_sigma;
    for (const HybridUnknown& unknown : unknowns_) request->problem.unknowns.push_back(UnknownOf(unknown));
    FindUnits();
    for (const Quantity& quantity : quantities_) request->problem.quantities.push_back(quantity.name);
    for (Experiment& at : experiments_) {
      const std::vector<HybridDatum>& data = at.given.data;
      at.order.resize(data.size());
      std::iota(at.order.begin(), at.order.end(), 0);
      std::ranges::stable_sort(at.order, {}, [&](int row) { return data[row].time; });
      const int recording = static_cast<int>(request->segments.size());
      request->segments.push_back({recording, 0, 0, static_cast<int>(data.size()), {}});
      auto& [name, samples] = request->problem.recordings.emplace_back();
      name = at.given.name;
      const auto number = [](double value) { return Eigen::VectorXd::Constant(1, value); };
      for (const int row : at.order) {
        const HybridDatum& datum = data[row];
        const auto quantity = std::ranges::find(quantities_, datum.quantity, &Quantity::name);
        samples.push_back({datum.time,
                           static_cast<int>(quantity - quantities_.begin()),
                           number(datum.value),
                           number(states_sigma_ ? datum.sigma : 0),
                           number(quantity->unit)});
      }
    }
    return "";
  }

  FitMotion Move(const std::vector<double>& values, const Segment& segment, bool with_derivatives) const override {
    const Experiment& at = experiments_[segment.recording];
    HybridInput input = at.given.problem.guess;
    std::vector<std::size_t> used[2];  // parameters, and components of the initial state
    for (std::size_t u = 0; u < unknowns_.size(); ++u) {
      if (!Has(segment.recording, unknowns_[u])) continue;
      NumberIn(unknowns_[u], &input) = values[u];
      used[unknowns_[u].is_initial].push_back(u);
    }
    FitMotion motion;
    if (at.given.begin) motion.reason = at.given.begin(&input);
    if (!motion.reason.empty()) return motion;
    std::vector<std::size_t>& columns = used[1];  // of the variables: first the initial state
    columns.insert(columns.end(), used[0].begin(), used[0].end());
    std::vector<double> z;
    for (const std::size_t u : columns) z.push_back(values[u]);
    Part& part = PartOf(at, segment.last, input.mode);
    HybridShooting& shooting = part.shooting;
    std::vector<double> found(shooting.num_residuals());
    Matrix jacobian(with_derivatives ? shooting.num_residuals() : 0, std::ssize(z));
    motion.ok = shooting.EvaluateResiduals(z, found.data(), with_derivatives ? jacobian.data() : nullptr);
    if (!motion.ok) {
      motion.reason = at.given.name + ": " + shooting.FailureReason();
      return motion;
    }
    for (int i = 0; i < segment.last; ++i) {
      const int row = part.rows[i];
      const double sigma = at.given.data[at.order[i]].sigma;
      motion.miss.push_back(Eigen::VectorXd::Constant(1, sigma * found[row]));
      if (!with_derivatives) continue;
      Eigen::MatrixXd& derivative = motion.derivative.emplace_back(Eigen::MatrixXd::Zero(1, std::ssize(unknowns_)));
      for (std::size_t c = 0; c < columns.size(); ++c) derivative(0, columns[c]) = sigma * jacobian(row, c);
    }
    for (const HybridEvent& event : shooting.simulator().events()) {
      if (!event.is_switch) motion.events.push_back({event.mode, event.guard, false});
    }
    return motion;
  }

  // Returns the estimated sigma of each quantity.
  std::vector<double> SigmasOf(double sigma) const {
    std::vector<double> sigmas;
    for (const Quantity& quantity : quantities_) sigmas.push_back(sigma * quantity.unit);
    return sigmas;
  }
  std::string SigmaToText(double sigma) const override {
    std::string text;
    for (const Quantity& quantity : quantities_) {
      text += (text.empty() ? "" : ", ") + ToText(sigma * quantity.unit, 3) + " of " + quantity.name;
    }
    return text;
  }
  std::string Subject() const override { return "system"; }
  std::string SuggestChecks() const override {
    return "the flow, guards and resets of the system, and the numbers that are not fitted";
  }

 private:
  struct Quantity {
    std::string name;
    double low = 0, high = 0, unit = 1;
  };
  // The motion up to some of the samples: terms that later ones need may not apply to it.
  struct Part {
    explicit Part(const HybridProblem& problem) : shooting(problem) { shooting.set_accurate(true); }
    HybridShooting shooting;
    std::vector<int> rows = {};  // the residual of each sample
  };
  struct Experiment {
    HybridExperiment given;
    std::vector<int> order;                                  // the data in the order of time
    mutable std::map<std::pair<int, int>, Part> parts = {};  // by the number of samples and the first mode
  };

  static bool Has(std::ptrdiff_t experiment, const HybridUnknown& unknown) {
    return unknown.experiment < 0 || unknown.experiment == experiment;
  }
  static std::vector<int>& FreeOf(const HybridUnknown& unknown, HybridFree* free) {
    return unknown.is_initial ? free->initial : free->parameters;
  }
  static double& NumberIn(const HybridUnknown& unknown, HybridInput* input) {
    return (unknown.is_initial ? input->initial : input->parameters)[unknown.index];
  }

  std::string ValidateRequest() const {
    if (experiments_.empty()) return "found no experiments, expected at least one";
    if (unknowns_.empty()) return "found nothing that is unknown, expected names of parameters or initial states";
    for (const HybridUnknown& unknown : unknowns_) {
      if (unknown.experiment < std::ssize(experiments_)) continue;
      return unknown.name + ": found experiment " + std::to_string(unknown.experiment) + ", expected one of " +
             std::to_string(experiments_.size());
    }
    const bool states_sigma = !experiments_[0].given.data.empty() && experiments_[0].given.data[0].states_sigma;
    for (const Experiment& at : experiments_) {
      if (std::string wrong = Validate(at.given, states_sigma); !wrong.empty()) {
        return at.given.name + ": " + wrong;
      }
    }
    for (const HybridUnknown& unknown : unknowns_) {
      const double start = StartOf(unknown);
      if (unknown.min < unknown.max && unknown.min <= start && start <= unknown.max) continue;
      return unknown.name + ": found the start " + ToText(start, 6) + " with the bounds " + ToText(unknown.min, 6) +
             " and " + ToText(unknown.max, 6) + ", expected one between them";
    }
    return saltus::Validate(options_);
  }

  static std::string Validate(const HybridExperiment& given, bool states_sigma) {
    if (std::string wrong = saltus::Validate(given.problem); !wrong.empty()) return wrong;
    if (given.data.empty()) return "found no data, expected at least one number that was measured";
    std::ptrdiff_t rows = 0;
    for (const HybridTerm& term : given.problem.terms) {
      const bool at_one_place = term.at == HybridTerm::Timing::kEnd ||
                                (term.at == HybridTerm::Timing::kEvent ? term.occurrence : term.interval) >= 0;
      if (!term.IsCost() || !at_one_place) {
        return term.name + ": found a term that is a constraint or counts at several places, expected measured numbers";
      }
      const bool in_interval = term.at == HybridTerm::Timing::kEachInterval;
      bool in_all_modes = !in_interval || term.mode < 0;
      for (int mode = 0; in_interval && term.with_state && mode < given.problem.system.num_modes(); ++mode) {
        in_all_modes &= given.problem.system.state_size(mode) == term.function->parameter_block_sizes()[0];
      }
      if (!in_all_modes) return term.name + ": found a term that counts in some modes only, expected one for all modes";
      rows += term.function->num_residuals();
    }
    if (rows != std::ssize(given.data)) {
      return "found " + std::to_string(given.data.size()) + " numbers, expected " + std::to_string(rows) +
             ", as many as the terms have residuals";
    }
    for (const HybridDatum& datum : given.data) {
      if (!std::isfinite(datum.value) || !std::isfinite(datum.time) || !(datum.sigma > 0) || std::isinf(datum.sigma)) {
        return datum.quantity + ": found a number that is not finite or a sigma that is not positive";
      }
      if (datum.states_sigma != states_sigma) return "found sigma of some numbers only, expected it of all or of none";
    }
    return "";
  }

  double StartOf(const HybridUnknown& unknown) const {
    HybridInput guess = experiments_[std::max(unknown.experiment, 0)].given.problem.guess;
    return NumberIn(unknown, &guess);
  }

  FitUnknown UnknownOf(const HybridUnknown& unknown) const {
    const double start = StartOf(unknown);
    FitUnknown fit{.name = unknown.name, .start = start, .low = unknown.min, .high = unknown.max};
    if (fit.IsBoundedBelow() && fit.IsBoundedAbove()) {
      constexpr double kMargin = 0.05;  // of the range, without starts
      fit.scale = fit.high - fit.low;
      fit.first = fit.low + kMargin * fit.scale;
      fit.last = fit.high - kMargin * fit.scale;
      return fit;
    }
    const double from = fit.IsBoundedBelow() ? fit.low : fit.IsBoundedAbove() ? fit.high : 0;
    fit.is_relative = true;
    fit.scale = std::max(std::abs(start - from), unknown.is_initial ? RangeOf(unknown) : 0.0);
    if (fit.scale == 0) fit.scale = 1;
    if (unknown.is_initial) {
      fit.first = fit.last = start;
    } else if (fit.HasBounds()) {
      const double distance = std::copysign(fit.scale, fit.IsBoundedBelow() ? 1 : -1);
      fit.first = from + distance / std::exp(1);
      fit.last = from + distance * std::exp(1);
    } else {
      fit.first = start - 0.5 * fit.scale;
      fit.last = start + 0.5 * fit.scale;
    }
    return fit;
  }

  // Returns the range of a component of the state over the motion of the guess, in modes that have it.
  double RangeOf(const HybridUnknown& unknown) const {
    const HybridProblem& problem = experiments_[std::max(unknown.experiment, 0)].given.problem;
    HybridSimulator simulator(problem.system, problem.integration);
    simulator.Rollout(problem.guess);
    double low = StartOf(unknown), high = low;
    for (int step = 0; step < simulator.num_steps(); ++step) {
      const std::span<const double> state = simulator.StepState(step);
      if (unknown.index >= std::ssize(state)) continue;
      low = std::min(low, state[unknown.index]);
      high = std::max(high, state[unknown.index]);
    }
    return high - low;
  }

  // Finds the quantities, with the ranges of their data as units of sigma.
  void FindUnits() {
    for (const Experiment& at : experiments_) {
      for (const HybridDatum& datum : at.given.data) {
        auto known = std::ranges::find(quantities_, datum.quantity, &Quantity::name);
        if (known == quantities_.end()) {
          known = quantities_.insert(known, {datum.quantity, datum.value, datum.value});
        }
        known->low = std::min(known->low, datum.value);
        known->high = std::max(known->high, datum.value);
      }
    }
    for (Quantity& quantity : quantities_) {
      const double size = std::max(std::abs(quantity.low), std::abs(quantity.high));
      quantity.unit = quantity.high > quantity.low ? quantity.high - quantity.low : size > 0 ? size : 1;
    }
  }

  Part& PartOf(const Experiment& at, int count, int mode) const {
    const auto known = at.parts.find({count, mode});
    if (known != at.parts.end()) return known->second;
    std::vector<bool> used(at.given.data.size(), false);
    for (int i = 0; i < count; ++i) used[at.order[i]] = true;
    HybridProblem problem = at.given.problem;
    problem.guess.mode = mode;
    problem.terms.clear();
    std::vector<int> row_of(used.size(), -1);
    int first = 0, rows = 0;
    for (const HybridTerm& term : at.given.problem.terms) {
      const int past = first + term.function->num_residuals();
      if (std::find(used.begin() + first, used.begin() + past, true) != used.begin() + past) {
        problem.terms.push_back(term);
        for (int row = first; row < past; ++row) row_of[row] = rows++;
      }
      first = past;
    }
    Part& part = at.parts.try_emplace({count, mode}, problem).first->second;
    for (int i = 0; i < count; ++i) part.rows.push_back(row_of[at.order[i]]);
    return part;
  }

  const std::vector<HybridUnknown> unknowns_;
  const IdentifyOptions options_;
  std::vector<Experiment> experiments_;
  std::vector<Quantity> quantities_;
  bool states_sigma_ = false;
};

}  // namespace

IdentifyReport Identify(const std::vector<HybridExperiment>& experiments, const std::vector<HybridUnknown>& unknowns,
                        const IdentifyOptions& options) {
  const auto model = std::make_shared<HybridModel>(experiments, unknowns, options);
  IdentifyReport report = IdentifyBy(model, 1);
  if (report.sigma > 0) report.sigmas = model->SigmasOf(report.sigma);
  return report;
}

}  // namespace saltus
