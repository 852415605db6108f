#include "gradient_descent.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "control/smoothed_gradient.h"
#include "solve_run.h"

namespace saltus {
namespace {

bool AllFinite(const std::vector<double>& values) {
  return std::all_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
}

template <typename S>
void Update(double learning_rate, const std::vector<double>& gradient, std::vector<double>* z) {
  for (size_t i = 0; i < z->size(); ++i) {
    (*z)[i] = static_cast<S>((*z)[i]) - static_cast<S>(learning_rate) * static_cast<S>(gradient[i]);
  }
}

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

  SolveReport AddTo(SolveReport report, const SingleShooting& shooting) {
    if (last_ < 0) return report;
    if (best_.iteration < last_) {
      best_.initial_state = shooting.InitialStateAt(z_);
      best_.control = shooting.ControlAt(z_);
    }
    report.best = std::move(best_);
    return report;
  }

 private:
  BestIterate best_;
  std::vector<double> z_;
  int last_ = -1;
};

SolveReport Fail(SolveRun* run, const char* what, int iteration, const std::vector<double>& z) {
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

SolveReport Descend(SolveRun* descent, const SolveRequest& request, const SolverOptions& options, Best* best) {
  SolveRun& run = *descent;
  std::optional<SmoothedGradient> smoothed = MakeSmoothedGradient(request, options);
  const auto update = request.precision == Precision::kFloat ? Update<float> : Update<double>;
  std::vector<double> z = run.shooting().initial_guess();
  std::vector<double> last = z, gradient(z.size()), standard_error(z.size());
  for (int k = 0;; ++k) {
    const bool more = k < options.iterations;
    double loss = 0;
    if (!run.shooting().Evaluate(z, &loss, more && !smoothed ? gradient.data() : nullptr)) {
      return Fail(&run, "loss", k, last);
    }
    best->Meet(loss, k, last);
    if (!run.Record(loss, z)) return run.Finish(z, Termination::kInterrupted);
    if (!more) break;
    if (smoothed) {
      if (!smoothed->Evaluate(z, k, gradient, standard_error)) return Fail(&run, "loss of a sample", k, z);
      run.RecordEstimate(standard_error);
    }
    if (!AllFinite(gradient)) return Fail(&run, "gradient", k, z);
    last = z;
    update(options.learning_rate, gradient, &z);
  }
  const bool rests = options.iterations > 0 && z == last;
  return run.Finish(z, rests ? Termination::kConverged : Termination::kIterationLimit);
}

}  // namespace

SolveReport SolveByGradientDescent(const SolveRequest& request, const SolverOptions& options) {
  SolveRun run("gd", request, options);
  Best best;
  SolveReport report = Descend(&run, request, options, &best);
  return best.AddTo(std::move(report), run.shooting());
}

}  // namespace saltus
