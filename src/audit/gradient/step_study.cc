#include "audit/gradient/step_study.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <utility>

#include "base/number_text.h"
#include "base/parallel_for.h"
#include "base/statistics.h"
#include "saltus/simulate/exact_run.h"

namespace saltus {
namespace {

// Entries smaller than this, relative to the largest of their quantity, may have any sign.
constexpr double kNegligible = 1e-3;

constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
constexpr int kSamples = 4;  // of the conditioning

// Returns the entries, with 0 for those that are not judged.
std::vector<double> Judged(const QuantityStudy& study, std::vector<double> entries) {
  for (size_t i = 0; i < entries.size(); ++i) {
    if (std::ranges::find(study.one_sided, study.entries[i]) != study.one_sided.end()) entries[i] = 0;
  }
  return entries;
}

// Returns -d log(error) / d log(steps) over the levels from `first` on, by least squares.
double FitOrder(const std::vector<RefinementLevel>& levels, size_t first, double rounding) {
  std::vector<double> steps, errors;
  for (size_t i = first; i < levels.size(); ++i) {
    steps.push_back(levels[i].steps);
    errors.push_back(std::max(levels[i].error, rounding));
  }
  return -FittedExponent(steps, errors);
}

// Returns the entries that contradict the exact ones in sign; neither value may be negligible.
std::vector<std::string> FindWrongSigns(const std::vector<std::string>& names, const std::vector<double>& exact,
                                        const std::vector<double>& own, const std::vector<double>& finest) {
  const double negligible = kNegligible * Largest(exact);
  std::vector<std::string> wrong;
  for (size_t i = 0; i < exact.size(); ++i) {
    if (std::abs(exact[i]) <= negligible) continue;
    const auto contradicts = [&](double value) { return value * exact[i] < 0 && std::abs(value) > negligible; };
    if (contradicts(own[i]) || contradicts(finest[i])) wrong.push_back(names[i]);
  }
  return wrong;
}

// The error above which a floor cannot be distinguished from slow convergence.
constexpr double kSettled = 0.01;
// The number of measured roundings of the exact gradient by which a model may miss it.
constexpr double kRoundings = 10;
// Roundings are measured at all levels if the error is at most this many of those at the scene's own steps.
constexpr double kRoundingsOfLevels = 1e4;
constexpr int kSamplesOfLevels = 3;
// A gradient whose relative change by rounding is larger has no correct digit, and cannot be a reference.
constexpr double kNoDigit = 0.1;
// The number of finest levels over which orders are fitted.
constexpr size_t kTail = 4;

void Judge(const RefinementOptions& options, QuantityStudy* study) {
  const std::vector<RefinementLevel>& levels = study->levels;
  double largest = 0;
  for (const RefinementLevel& level : levels) largest = std::max(largest, level.largest);
  const auto order_from = [&](size_t first) { return FitOrder(levels, first, options.rounding); };
  study->order = largest > options.rounding ? order_from(levels.size() - kTail) : 0;
  if (largest <= options.tolerance) {
    study->verdict = Verdict::kRight;
  } else if (std::min(study->order, order_from(0)) >= options.smallest_order) {
    study->verdict = Verdict::kConsistent;
  } else {
    study->verdict = study->wrong_signs.empty() ? Verdict::kWrong : Verdict::kWrongSign;
  }
}

// Whether an error that falls may converge to a positive limit, as that of a stiff spring does.
bool MayHaveAFloor(const QuantityStudy& study) {
  return study.verdict == Verdict::kConsistent && study.levels.back().error > kSettled;
}

// Whether verdicts on the quantity enter that of the study, at least if they are bad.
bool CountsForVerdict(Quantity quantity) {
  return quantity == Quantity::kPosition || quantity == Quantity::kVelocity || quantity == Quantity::kControl ||
         IsHybridQuantity(quantity);
}

// Orders verdicts from good to bad; a wrong gradient outweighs an unknown one.
int VerdictRank(Verdict verdict) {
  constexpr int kBadness[] = {0, 1, 5, 6, 2, 4, 3, 3, 7, 2};  // in the order of the enum
  return kBadness[static_cast<int>(verdict)];
}

Verdict Overall(const RefinementStudy& study) {
  Verdict worst = Verdict::kRight;
  bool judged = false;
  const auto worsen = [&](Verdict verdict) {
    judged = true;
    if (VerdictRank(verdict) > VerdictRank(worst)) worst = verdict;
  };
  for (const QuantityStudy& quantity : study.quantities) {
    if (!quantity.IsJudged() || !CountsForVerdict(quantity.quantity)) continue;
    if (quantity.quantity != Quantity::kControl) {
      worsen(quantity.verdict);
    } else if (IsWrong(quantity.verdict)) {
      worsen(Verdict::kWrong);
    }
  }
  return judged ? worst : Verdict::kOneSided;
}

// Adds one level after the other to a study.
class Levels {
 public:
  Levels(const SteppedGradient& gradient, double loss, const RefinementOptions& options, const StopRequest& stop,
         RefinementStudy* out)
      : gradient_(gradient), options_(options), stop_(stop), out_(*out) {
    // Where the exact gradient is zero, errors are absolute, on the scale of the loss.
    const double least = 1e-6 * std::max(1.0, std::abs(loss));
    for (const QuantityStudy& study : out_.quantities) {
      scales_.push_back(std::max(Norm(Judged(study, study.exact)), least));
    }
    coarsest_.resize(scales_.size());
  }

  // Returns the work of a level, in the unit of RefinementOptions::budget.
  double CostOf(int level) const { return std::ldexp(gradient_.work(contacts_), level) * options_.samples; }

  // Whether the time is up: a level takes about as long as all before it.
  bool IsOutOfTime() const {
    const std::chrono::duration<double> passed = std::chrono::steady_clock::now() - begin_;
    return options_.seconds > 0 && 2 * passed.count() > options_.seconds;
  }

  bool HasUnknownVerdict() const {
    return std::any_of(out_.quantities.begin(), out_.quantities.end(), [](const QuantityStudy& study) {
      return CountsForVerdict(study.quantity) && MayHaveAFloor(study);
    });
  }

  // Adds a level. Returns false, with the reason in the study, if there is a number of steps without a gradient.
  bool AddLevel(int level) {
    std::vector<SteppedGradient::Parts> gradients(options_.samples);
    const int threads = options_.threads_now ? options_.threads_now() : options_.threads;
    ParallelFor(threads, options_.samples, [&](int, int sample) {
      // With many steps even the allocation of the arrays takes long, so this asks before.
      if (gradients[sample].reason = stop_ && stop_() ? kStopped : ""; !gradients[sample].reason.empty()) return;
      gradients[sample] = gradient_.at(StepsOf(level, sample));
    });
    double log_steps = 0;
    for (int sample = 0; sample < options_.samples; ++sample) {
      const int steps = StepsOf(level, sample);
      if (!gradients[sample].reason.empty()) {
        out_.reason = "with " + std::to_string(steps) + " steps, " + gradients[sample].reason;
        return false;
      }
      log_steps += std::log(steps) / options_.samples;
      if (level == 0) contacts_ = std::max(contacts_, gradients[sample].contacts);
    }
    for (size_t q = 0; q < scales_.size(); ++q) {
      std::vector<std::vector<double>> entries;
      for (SteppedGradient::Parts& gradient : gradients) entries.push_back(std::move(gradient.entries[q]));
      AddTo(q, std::exp(log_steps), entries);
    }
    return true;
  }

  // Errors no larger than the effect of rounding on the exact gradient do not count against the model.
  void AcceptRounding() {
    std::vector<double> of_levels;  // by quantity
    for (size_t q = 0; q < out_.quantities.size(); ++q) {
      QuantityStudy& quantity = out_.quantities[q];
      if (!IsWrong(quantity.verdict) && quantity.verdict != Verdict::kUnknown) continue;
      if (!out_.conditioning) out_.conditioning = gradient_.condition();
      if (!out_.conditioning) return;
      double& rounding = out_.conditioning->rounding;
      const auto excused = [&] { return rounding >= kNoDigit || quantity.decisive <= kRoundings * rounding; };
      if (!excused() && quantity.decisive <= kRoundingsOfLevels * rounding) {
        if (of_levels.empty()) of_levels = RoundingOfLevels();
        rounding = std::max(rounding, of_levels[q]);
      }
      if (excused()) quantity.verdict = Verdict::kIllConditioned;
    }
  }

 private:
  int StepsOf(int level, int sample) const { return gradient_.unit * ((gradient_.coarsest << level) + sample); }

  // Returns the distance of the judged entries from the exact ones, relative to the scale.
  double ErrorOf(size_t q, const std::vector<double>& entries) const {
    const QuantityStudy& study = out_.quantities[q];
    return Distance(Judged(study, entries), Judged(study, study.exact)) / scales_[q];
  }

  // Adds a level of so many steps (the mean) to a quantity, given the entries at each of its samples, and judges what
  // there is.
  void AddTo(size_t q, double steps, const std::vector<std::vector<double>>& samples) {
    QuantityStudy& study = out_.quantities[q];
    std::vector<double> errors;
    for (const std::vector<double>& entries : samples) errors.push_back(ErrorOf(q, entries));
    const auto [smallest, largest] = std::ranges::minmax(errors);
    study.levels.push_back({steps, Median(errors), smallest, largest});
    study.finest.clear();
    for (size_t entry = 0; entry < study.exact.size(); ++entry) {
      std::vector<double> values;
      for (const std::vector<double>& entries : samples) values.push_back(entries[entry]);
      study.finest.push_back(Median(values));
    }
    if (study.levels.size() == 1) coarsest_[q] = samples.front();
    study.wrong_signs = FindWrongSigns(
        study.entries, Judged(study, study.exact), Judged(study, coarsest_[q]), Judged(study, study.finest));
    const double median = study.levels.back().error;
    double largest_of_all = 0;
    for (const RefinementLevel& level : study.levels) largest_of_all = std::max(largest_of_all, level.largest);
    study.decisive = median > options_.tolerance ? median : largest_of_all;
    if (study.levels.size() >= kTail) Judge(options_, &study);
  }

  // Returns the largest relative distance of exact gradients with the step counts of the levels from the exact one, by
  // quantity.
  std::vector<double> RoundingOfLevels() const {
    std::vector<double> largest(scales_.size(), 0.0);
    for (size_t level = 0; level < out_.quantities.front().levels.size(); ++level) {
      for (int sample = 0; sample < std::min(options_.samples, kSamplesOfLevels); ++sample) {
        const SteppedGradient::Parts exact = gradient_.exact_at(StepsOf(static_cast<int>(level), sample));
        for (size_t q = 0; q < largest.size(); ++q) {
          const double error = exact.reason.empty() ? ErrorOf(q, exact.entries[q]) : 1.0;
          largest[q] = std::max(largest[q], error);
        }
      }
    }
    return largest;
  }

  const SteppedGradient& gradient_;
  const RefinementOptions& options_;
  const StopRequest& stop_;
  RefinementStudy& out_;
  const std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
  int contacts_ = 0;  // at the first level
  // The scale of errors and the entries by the fewest steps, of each quantity.
  std::vector<double> scales_;
  std::vector<std::vector<double>> coarsest_;
};

constexpr int kDirections = 2;                    // of each quantity
constexpr double kWidest = 0.1, kNarrower = 0.1;  // widths in grid widths, each so much less than the last
constexpr int kWidths = 8;
constexpr double kOfSlope = 1e-3;  // relative, by which a gradient may miss its differences
constexpr double kSteady = 0.1;    // of the miss, by which slopes of neighbouring widths may differ
constexpr double kJumps = 0.5;     // of the change of loss over a width, that over the next: it does not vanish
constexpr int kMostJumps = 3;      // widths in a row
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

constexpr size_t kFewest = 4;              // slopes that make a plateau
constexpr double kOwnTolerance = 1e-3;     // by which a gradient may miss narrow differences
constexpr double kScatter = 3;             // spreads by which levels may differ by chance
constexpr double kMostScatter = 0.25;      // spread beyond which there is no plateau, of the largest entry
constexpr double kNegligibleSlope = 1e-2;  // entries smaller than this, of the largest, may have any sign

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

WidthFinding FindingOf(const WidthSweep& sweep, double scale, double tolerance) {
  if (sweep.wide_spread > kMostScatter * scale) return WidthFinding::kUndecided;
  if (std::abs(sweep.gradient - sweep.wide) <= tolerance * scale + kScatter * sweep.wide_spread) {
    return WidthFinding::kNothing;
  }
  const bool own = std::abs(sweep.gradient - sweep.narrow) <= kOwnTolerance * scale + kScatter * sweep.narrow_spread;
  return own ? WidthFinding::kOnlyOfItsSteps : WidthFinding::kOfNeither;
}

bool ShowsError(const WidthSweep& sweep) {
  return sweep.finding == WidthFinding::kOnlyOfItsSteps || sweep.finding == WidthFinding::kOfNeither;
}

// Whether the slopes of two sweeps have one unit. Each variable of a hybrid system has a unit of its own.
bool HaveOneUnit(const WidthSweep& a, const WidthSweep& b) {
  return &a == &b || (a.quantity == b.quantity && !IsHybridQuantity(a.quantity));
}

// Returns the loss at a distance along a direction from the initial guess; NaN if there is none.
double LossAlong(ShootingFunction* function, const std::vector<double>& direction, double distance) {
  std::vector<double> z = function->initial_guess();
  for (std::size_t i = 0; i < z.size(); ++i) z[i] += distance * direction[i];
  double loss = 0;
  return function->Evaluate(z, &loss, nullptr) ? loss : kNan;
}

// The variables of a function as a direction, with their values `by`.
void AddTo(std::vector<double>* direction, const SweptVariable& variable, double by) {
  for (int i = 0; i < variable.count; ++i) (*direction)[variable.first + i * variable.stride] = by;
}

// Finds plateaus and findings of the sweeps, given the widths and slopes. `loss` is that of the guess.
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
      if (HaveOneUnit(other, sweep)) scale = std::max({scale, std::abs(other.wide), std::abs(other.gradient)});
    }
    sweep.finding = FindingOf(sweep, scale, options.tolerance);
    if (!ShowsError(sweep)) continue;
    const double negligible = kNegligibleSlope * scale;
    const bool flips =
        sweep.gradient * sweep.wide < 0 && std::abs(sweep.gradient) > negligible && std::abs(sweep.wide) > negligible;
    if (verdict == Verdict::kUnknown || flips) verdict = flips ? Verdict::kWrongSign : Verdict::kWrong;
  }
  return verdict;
}

// Returns the worse of the two.
GradientCheck Worse(const GradientCheck& a, const GradientCheck& b) {
  const auto badness = [](const GradientCheck& found) {
    return found.agreement == Agreement::kDiffers ? 2 : found.agreement == Agreement::kUndecided ? 1 : 0;
  };
  return badness(b) > badness(a) ? b : a;
}

}  // namespace

void StudyErrors(const SteppedGradient& gradient, double loss, const RefinementOptions& options,
                 const StopRequest& stop, RefinementStudy* study) {
  Levels run(gradient, loss, options, stop, study);
  const int levels = std::max<int>(options.levels, kTail);
  for (int level = 0; level < levels || (level < options.most_levels && run.HasUnknownVerdict()); ++level) {
    if (level >= static_cast<int>(kTail) && (run.CostOf(level) > options.budget || run.IsOutOfTime())) break;
    if (!run.AddLevel(level)) return;
  }
  for (QuantityStudy& quantity : study->quantities) {
    if (MayHaveAFloor(quantity)) quantity.verdict = Verdict::kUnknown;
  }
  run.AcceptRounding();
  study->verdict = Overall(*study);
}

std::optional<Conditioning> MeasureConditioning(
    const std::function<std::vector<double>(const Change& change, int more)>& compute, const StopRequest& stop) {
  std::mt19937 random(1);
  const Change none = [] { return 1.0; };
  const Change last_bit = [&random] { return random() % 2 == 0 ? 1 + kEpsilon : 1 - kEpsilon; };
  const std::vector<double> gradient = compute(none, 0);
  if (gradient.empty()) return std::nullopt;
  const auto compare = [&](const std::vector<double>& changed) {
    if (changed.empty()) return 1.0;
    const double scale = Norm(gradient);
    return scale > 0 ? Distance(changed, gradient) / scale : 0.0;
  };
  Conditioning found;
  for (int sample = 1; sample <= kSamples; ++sample) {
    const double change = compare(compute(last_bit, 0));
    found.condition = std::max(found.condition, change / kEpsilon);
    found.rounding = std::max({found.rounding, change, compare(compute(none, sample))});
    if (stop && stop()) return std::nullopt;
  }
  return found;
}

double SweptVariable::SumOf(const std::vector<double>& entries) const {
  double sum = 0;
  for (int i = 0; i < count; ++i) sum += entries[first + i * stride];
  return sum;
}

void Sweep(const std::vector<SweptVariable>& variables, double loss, const WidthSweepOptions& options,
           WidthSweepStudy* study) {
  for (const SweptVariable& variable : variables) {
    WidthSweep& sweep = study->sweeps.emplace_back();
    sweep.quantity = variable.quantity;
    sweep.entry = variable.entry;
    sweep.grid_width = variable.grid_width;
    sweep.gradient = variable.gradient;
    sweep.exact = variable.exact;
    std::vector<double> along(variable.function->num_variables());
    AddTo(&along, variable, 1);
    for (int i = 0; i < options.NumWidths(); ++i) {
      const double width = sweep.grid_width * options.smallest * std::pow(10.0, double(i) / options.per_decade);
      if (width > variable.most) break;
      if (variable.function->stopped()) return;
      sweep.widths.push_back(width);
      const auto at = [&](double by) { return LossAlong(variable.function, along, by); };
      sweep.slopes.push_back((at(width) - at(-width)) / (2 * width));
    }
  }
  study->verdict = JudgeSweeps(loss, options, &study->sweeps);
  JudgeByExact(study);
}

void JudgeByExact(WidthSweepStudy* study) {
  for (WidthSweep& sweep : study->sweeps) {
    const auto miss = [&](double value) { return std::abs(value - *sweep.exact); };
    if (sweep.exact && ShowsError(sweep) && miss(sweep.wide) >= miss(sweep.gradient)) {
      sweep.finding = WidthFinding::kFarther;
    }
  }
  if (study->Worst() == nullptr) study->verdict = Verdict::kUnknown;
}

double Distance(const std::vector<double>& a, const std::vector<double>& b) {
  std::vector<double> difference(a.size());
  std::transform(a.begin(), a.end(), b.begin(), difference.begin(), std::minus<>());
  return Norm(difference);
}

LossAtGuess::LossAtGuess(ShootingFunction* of) : function(of), gradient(of->num_variables()) {
  ok = function->Evaluate(function->initial_guess(), &value, gradient.data());
}

GradientCheck CompareAlong(const LossAtGuess& loss, const std::vector<double>& direction, double widest) {
  GradientCheck found;
  double scale = 0;  // so that entries that happen to cancel do not ask for more than there is
  for (std::size_t i = 0; i < direction.size(); ++i) {
    found.gradient += loss.gradient[i] * direction[i];
    scale += std::pow(loss.gradient[i] * direction[i], 2);
  }
  scale = std::max(std::sqrt(scale), std::abs(found.gradient));
  std::array<double, 2> before = {kNan, kNan};
  std::array<std::optional<double>, 2> settled;  // on another slope, on either side
  std::array<double, 2> change_before = {kNan, kNan};
  std::array<bool, 2> exists = {false, false};  // the loss, on either side: a parameter may be at a bound
  int jumps = 0;                                // widths on end at which the loss jumps on both sides
  double width = widest;
  for (int i = 0; i < kWidths && jumps < kMostJumps && !loss.function->stopped(); ++i, width *= kNarrower) {
    bool jumps_here = true;
    for (int side = 0; side < 2; ++side) {
      const double signed_width = side == 0 ? width : -width;
      const double change = LossAlong(loss.function, direction, signed_width) - loss.value;
      exists[side] = exists[side] || !std::isnan(change);
      jumps_here = jumps_here && std::abs(change) >= kJumps * std::abs(change_before[side]);
      change_before[side] = change;
      const double slope = change / signed_width;
      const double miss = std::abs(slope - found.gradient);
      if (miss <= kOfSlope * std::max(scale, std::abs(slope))) {
        found.agreement = Agreement::kAgrees;
        found.difference = slope;
        return found;
      }
      if (std::abs(slope - before[side]) <= kSteady * miss) settled[side] = slope;
      before[side] = slope;
    }
    jumps = jumps_here ? jumps + 1 : 0;
  }
  if ((settled[0] || !exists[0]) && (settled[1] || !exists[1]) && (settled[0] || settled[1])) {
    found.agreement = Agreement::kDiffers;
    found.difference = 0.5 * (settled[0].value_or(*settled[1]) + settled[1].value_or(*settled[0]));
  }
  return found;
}

GradientCheck CompareAlongSums(const std::vector<SweptVariable>& variables, int threads,
                               const std::function<const LossAtGuess&(int thread, Quantity quantity)>& loss) {
  std::vector<Quantity> quantities;
  for (const SweptVariable& variable : variables) {
    if (std::ranges::find(quantities, variable.quantity) == quantities.end()) quantities.push_back(variable.quantity);
  }
  std::mt19937 random(1);
  std::vector<std::vector<double>> signs;  // of the variables, by direction
  for (int i = 0; i < kDirections; ++i) {
    std::vector<double>& row = signs.emplace_back();
    for (std::size_t j = 0; j < variables.size(); ++j) row.push_back(random() % 2 == 0 ? 1.0 : -1.0);
  }
  const int count = kDirections * static_cast<int>(quantities.size());
  std::vector<std::optional<GradientCheck>> found(count);
  std::atomic<int> differs = count;  // none is worse, so what follows it is not needed
  ParallelFor(threads, count, [&](int thread, int i) {
    if (i > differs) return;
    const Quantity quantity = quantities[i % quantities.size()];
    const LossAtGuess& of_thread = loss(thread, quantity);
    if (!of_thread.ok) return;
    std::vector<double> along(of_thread.gradient.size());
    for (std::size_t j = 0; j < variables.size(); ++j) {
      if (variables[j].quantity != quantity) continue;
      AddTo(&along, variables[j], signs[i / quantities.size()][j] * variables[j].grid_width);
    }
    found[i] = CompareAlong(of_thread, along, kWidest);
    found[i]->quantity = quantity;
    if (found[i]->agreement != Agreement::kDiffers) return;
    for (int other = differs; i < other && !differs.compare_exchange_weak(other, i);) continue;
  });
  GradientCheck worst{.agreement = Agreement::kAgrees};
  for (int i = 0; i <= std::min<int>(differs, count - 1); ++i) {
    if (found[i]) worst = Worse(worst, *found[i]);
  }
  return worst;
}

double Conditioning::DigitsLost() const { return std::log10(std::clamp(rounding, kEpsilon, 1.0) / kEpsilon); }

std::string Conditioning::Describe() const {
  return "rounding alone changes the exact gradient by " + ToText(rounding, 2) + " of it (condition " +
         ToText(condition, 2) + "): " + ToText(std::ceil(DigitsLost()), 2) + " of 16 digits are lost";
}

const char* VerdictToString(Verdict verdict) {
  constexpr const char* kNames[] = {"right",
                                    "consistent",
                                    "wrong",
                                    "wrong sign",
                                    "unknown",
                                    "biased",
                                    "ill-conditioned",
                                    "not applicable",
                                    "ambiguous",
                                    "one-sided"};
  return kNames[static_cast<int>(verdict)];
}

bool IsWrong(Verdict verdict) { return verdict == Verdict::kWrong || verdict == Verdict::kWrongSign; }

const QuantityStudy* RefinementStudy::Find(Quantity quantity) const {
  const auto found = std::ranges::find(quantities, quantity, &QuantityStudy::quantity);
  return found == quantities.end() ? nullptr : &*found;
}

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
    if (!ShowsError(sweep)) continue;
    // Only entries of one unit can be compared.
    if (worst != nullptr && (!HaveOneUnit(sweep, *worst) || miss(sweep) <= miss(*worst))) continue;
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

}  // namespace saltus
