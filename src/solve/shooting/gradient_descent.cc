#include "solve/shooting/gradient_descent.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>

#include "control/control_bounds.h"
#include "control/smoothed_gradient.h"
#include "solve/solve_run.h"

namespace saltus {
namespace {

bool AllFinite(const std::vector<double>& values) {
  return std::all_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
}

// Of `count` variables from number `first` on.
template <typename S>
void Update(double learning_rate, const std::vector<double>& gradient, size_t first, size_t count,
            std::vector<double>* z) {
  for (size_t i = first; i < first + count; ++i) {
    (*z)[i] = static_cast<S>((*z)[i]) - static_cast<S>(learning_rate) * static_cast<S>(gradient[i]);
  }
}

// The step of one iteration: along the gradient, and back to the bounds. A final time that is free takes the rate of
// forces times the length of a step, so that its unit is that of the rate per unit of time.
class Step {
 public:
  Step(const SingleShooting& shooting, const SolverOptions& options)
      : scene_(shooting.scene()),
        forces_(shooting.num_variables() - shooting.has_duration()),
        rate_(options.learning_rate),
        rate_of_time_(options.learning_rate) {
    const double length = shooting.simulator().step();
    if (options.rate_per_time) {
      rate_ /= length;
    } else {
      rate_of_time_ *= length;
    }
    update_ = shooting.simulator().precision() == Precision::kFloat ? Update<float> : Update<double>;
  }

  void operator()(const std::vector<double>& gradient, std::vector<double>* z) const {
    update_(rate_, gradient, 0, forces_, z);
    if (forces_ < z->size()) update_(rate_of_time_, gradient, forces_, 1, z);
    MoveWithin(z);
  }

  void MoveWithin(std::vector<double>* z) const {
    if (scene_.optimize == Optimize::kControl) MoveWithinBounds(scene_, std::span(*z).first(forces_));
    if (forces_ == z->size()) return;
    z->back() = std::clamp(z->back(), scene_.objective.duration->min, scene_.objective.duration->max);
  }

 private:
  Scene scene_;
  size_t forces_;
  double rate_, rate_of_time_;
  void (*update_)(double, const std::vector<double>&, size_t, size_t, std::vector<double>*);
};

// The best iterate so far; copied only when the descent leaves it.
class Best {
 public:
  // `last` is the iterate before.
  void Meet(double loss, int iteration, const std::vector<double>& last) {
    if (iteration == 0 || loss < best_.loss) {
      best_.loss = loss;
      best_.iteration = iteration;
    } else if (best_.iteration == iteration - 1) {
      z_ = last;
    }
    last_ = iteration;
  }

  SolveReport AddTo(SolveReport report, const ShootingFunction& shooting) {
    if (last_ < 0) return report;
    if (best_.iteration < last_) {
      best_.initial_state = shooting.InitialStateAt(z_);
      best_.control = shooting.ControlAt(z_);
      best_.durations = shooting.DurationsAt(z_);
      best_.parameters = shooting.ParametersAt(z_);
    }
    report.best = std::move(best_);
    return report;
  }

 private:
  BestIterate best_;
  std::vector<double> z_;
  int last_ = -1;
};

SolveReport Fail(ShootingRun* run, const char* what, int iteration, const std::vector<double>& z) {
  return run->Finish(
      z, Termination::kFailed, std::string(what) + " not finite at iteration " + std::to_string(iteration));
}

// What estimates the gradient in the place of the model's adjoint, if asked for.
std::optional<SmoothedGradient> MakeSmoothedGradient(const SolveRequest& request, const SolverOptions& options) {
  if (!options.surrogate || !options.surrogate->smooths()) return std::nullopt;
  std::optional<SmoothedGradient> smoothed;
  smoothed.emplace(request.contact, request.scene, request.precision, *options.surrogate, options.threads);
  smoothed->set_memory_limit(options.memory_limit);
  smoothed->set_stop(options.stop);
  return smoothed;
}

SolveReport Descend(ShootingRun* run, const DescentRule& rule, Best* best) {
  ShootingFunction& function = run->function();
  const int iterations = run->options().iterations;
  std::vector<double> z = run->initial_guess();
  rule.move_within(&z);
  std::vector<double> last = z, gradient(z.size()), standard_error(z.size());
  for (int k = 0;; ++k) {
    const bool more = k < iterations;
    double loss = 0;
    if (!function.Evaluate(z, &loss, more && !rule.estimate ? gradient.data() : nullptr)) {
      return Fail(run, "loss", k, last);
    }
    best->Meet(loss, k, last);
    if (!run->Record(loss, z)) return run->Finish(z, Termination::kInterrupted);
    if (!more) break;
    if (rule.estimate) {
      if (!rule.estimate(z, k, &gradient, &standard_error)) return Fail(run, "loss of a sample", k, z);
      run->RecordEstimate(standard_error);
    }
    if (!AllFinite(gradient)) return Fail(run, "gradient", k, z);
    last = z;
    rule.step(gradient, &z);
  }
  const bool rests = iterations > 0 && z == last;
  return run->Finish(z, rests ? Termination::kConverged : Termination::kIterationLimit);
}

}  // namespace

SolveReport DescendGradient(ShootingRun* run, const DescentRule& rule) {
  Best best;
  SolveReport report = Descend(run, rule, &best);
  return best.AddTo(std::move(report), run->function());
}

SolveReport SolveByGradientDescent(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("gd", request, options);
  std::optional<SmoothedGradient> smoothed = MakeSmoothedGradient(request, options);
  const Step step(run.shooting(), options);
  DescentRule rule;
  rule.step = step;
  rule.move_within = [&](std::vector<double>* z) { step.MoveWithin(z); };
  if (smoothed) {
    rule.estimate =
        [&](const std::vector<double>& z, int k, std::vector<double>* gradient, std::vector<double>* standard_error) {
          return smoothed->Evaluate(z, k, *gradient, *standard_error);
        };
  }
  return DescendGradient(&run, rule);
}

}  // namespace saltus
