#include "saltus/audit/refinement.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <utility>

#include "audit/gradient/judgement.h"
#include "base/parallel_for.h"
#include "base/statistics.h"
#include "saltus/audit/audit.h"
#include "saltus/scene/materials.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"
#include "scene/units.h"

namespace saltus {
namespace {

// Entries smaller than this, relative to the largest of their quantity, may have any sign.
constexpr double kNegligible = 1e-3;

std::vector<Quantity> QuantitiesOf(const Scene& scene, bool parameters) {
  std::vector<Quantity> quantities = {Quantity::kPosition, Quantity::kVelocity};
  if (scene.num_controlled() > 0) quantities.push_back(Quantity::kControl);
  if (!parameters) return quantities;
  quantities.push_back(Quantity::kRestitution);
  // At zero friction the loss has only a right derivative with respect to friction.
  if (HasFriction(scene)) quantities.push_back(Quantity::kFriction);
  quantities.push_back(Quantity::kMass);
  quantities.push_back(Quantity::kGravity);
  for (const Quantity design : {Quantity::kGeometry, Quantity::kWallAngle}) {
    if (!EntryNames(scene, design, 0).empty()) quantities.push_back(design);
  }
  return quantities;
}

double Distance(const std::vector<double>& a, const std::vector<double>& b) {
  std::vector<double> difference(a.size());
  std::transform(a.begin(), a.end(), b.begin(), difference.begin(), std::minus<>());
  return Norm(difference);
}

constexpr int kSamples = 4;
constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

double RelativeChange(std::vector<double> gradient, const std::vector<double>& from) {
  for (std::size_t i = 0; i < gradient.size(); ++i) gradient[i] -= from[i];
  const double scale = Norm(from);
  return scale > 0 ? Norm(gradient) / scale : 0.0;
}

// Returns the scene with every number of the initial state changed by a last bit, up or down.
Scene Jitter(Scene scene, std::mt19937* random) {
  for (Body& body : scene.bodies) {
    for (Vec2d* vector : {&body.position, &body.velocity}) {
      for (int j = 0; j < 2; ++j) (*vector)[j] *= (*random)() % 2 == 0 ? 1 + kEpsilon : 1 - kEpsilon;
    }
  }
  return scene;
}

// Returns the entries, with 0 for those whose names are in `left_out`.
std::vector<double> Without(const std::vector<std::string>& left_out, const std::vector<std::string>& names,
                            std::vector<double> entries) {
  for (size_t i = 0; i < entries.size(); ++i) {
    if (std::ranges::find(left_out, names[i]) != left_out.end()) entries[i] = 0;
  }
  return entries;
}

// Returns the names (EntryNames) of the entries of `exact` that are one-sided derivatives or none.
std::vector<std::string> OneSidedNames(const Scene& scene, const ModelGradient& exact, Quantity quantity) {
  std::vector<std::string> names;
  for (const OneSided& entry : exact.one_sided) {
    const bool position = entry.quantity == OneSided::Quantity::kPosition;
    if (quantity != (position ? Quantity::kPosition : Quantity::kVelocity)) continue;
    names.push_back((position ? "p" : "v") + std::string(entry.component == 0 ? "x " : "y ") +
                    scene.bodies[entry.body].name);
  }
  return names;
}

// Returns the number of parts of the horizon over which the control is compared, each of several steps.
int NumIntervals(const Scene& scene, int most) {
  int intervals = 1;
  while (2 * intervals <= most && scene.steps >= 32 * intervals) intervals *= 2;
  return intervals;
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

// The work of a touch, relative to a step of one disc in free flight.
constexpr double kWorkOfATouch = 24;

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

bool EntersTheVerdict(Quantity quantity) {
  return quantity == Quantity::kPosition || quantity == Quantity::kVelocity || quantity == Quantity::kControl;
}

// Orders verdicts from good to bad; a wrong gradient outweighs an unknown one.
int Badness(Verdict verdict) {
  constexpr int kBadness[] = {0, 1, 5, 6, 2, 4, 3, 3, 7, 2};  // in the order of the enum
  return kBadness[static_cast<int>(verdict)];
}

Verdict Overall(const RefinementStudy& study) {
  Verdict worst = Verdict::kRight;
  bool judged = false;
  const auto worsen = [&](Verdict verdict) {
    judged = true;
    if (Badness(verdict) > Badness(worst)) worst = verdict;
  };
  for (const QuantityStudy& quantity : study.quantities) {
    if (!quantity.IsJudged()) continue;
    if (quantity.quantity == Quantity::kPosition || quantity.quantity == Quantity::kVelocity) {
      worsen(quantity.verdict);
    } else if (quantity.quantity == Quantity::kControl && IsWrong(quantity.verdict)) {
      worsen(Verdict::kWrong);
    }
  }
  return judged ? worst : Verdict::kOneSided;
}

// Adds one level after the other to a study.
class Study {
 public:
  Study(const Contact& contact, const Scene& scene, const RefinementOptions& options, const StopRequest& stop,
        RefinementStudy* out)
      : contact_(contact), scene_(scene), options_(options), stop_(stop), out_(*out) {
    out_.intervals = NumIntervals(scene, options.most_intervals);
    unit_ = out_.intervals * CHECK_NOTNULL(FindContactModel(contact))->grid_steps;
    Scene coarse = scene;
    coarse.steps = out_.intervals;
    const std::optional<ModelGradient> exact = ExactGradientOf(coarse, stop);
    if (!exact) {
      out_.reason = "there is no exact gradient";
      return;
    }
    if (!exact->ambiguous.empty()) {
      out_.reason = TiesToString(exact->ambiguous);
      out_.verdict = Verdict::kAmbiguous;
      return;
    }
    for (Quantity quantity : QuantitiesOf(scene, options.parameters)) {
      QuantityStudy& added = out_.quantities.emplace_back();
      added.quantity = quantity;
      added.exact = EntriesOf(scene, *exact, quantity, out_.intervals);
      added.one_sided = OneSidedNames(scene, *exact, quantity);
      QuantityLevels& levels = levels_.emplace_back();
      levels.names = EntryNames(scene, quantity, out_.intervals);
      levels.scale = ScaleOf(added, levels.names, exact->loss);
    }
  }

  // Returns the work of a level, in the unit of RefinementOptions::budget.
  double CostOf(int level) const {
    const double work = std::max(double(scene_.steps) * scene_.num_bodies(), kWorkOfATouch * touches_);
    return std::ldexp(work, level) * options_.samples;
  }

  bool Undecided() const {
    return std::any_of(out_.quantities.begin(), out_.quantities.end(), [](const QuantityStudy& study) {
      return EntersTheVerdict(study.quantity) && MayHaveAFloor(study);
    });
  }

  // Adds a level. Returns false, with the reason in the study, if a rollout is not finite.
  bool AddLevel(int level) {
    std::vector<ModelGradient> gradients(options_.samples);
    const int threads = options_.threads_now ? options_.threads_now() : options_.threads;
    ParallelFor(threads, options_.samples, [&](int, int sample) {
      // With many steps even the allocation of the arrays takes long, so this asks before.
      if (gradients[sample].reason = stop_ && stop_() ? kStopped : ""; !gradients[sample].ok()) return;
      Scene refined = scene_;
      refined.steps = StepsOf(level, sample);
      gradients[sample] = ComputeGradient(contact_, refined, Precision::kDouble, stop_);
    });
    for (int sample = 0; sample < options_.samples; ++sample) {
      if (gradients[sample].ok()) continue;
      out_.reason = "with " + std::to_string(StepsOf(level, sample)) + " steps, " + gradients[sample].reason;
      return false;
    }
    std::vector<std::vector<std::vector<double>>> entries(out_.quantities.size());  // by quantity and sample
    double log_steps = 0;
    for (int sample = 0; sample < options_.samples; ++sample) {
      log_steps += std::log(StepsOf(level, sample)) / options_.samples;
      const ModelGradient& gradient = gradients[sample];
      if (level == 0) touches_ = std::max(touches_, gradient.num_touches);
      for (size_t q = 0; q < entries.size(); ++q) {
        entries[q].push_back(EntriesOf(scene_, gradient, out_.quantities[q].quantity, out_.intervals));
      }
    }
    for (size_t q = 0; q < entries.size(); ++q) {
      levels_[q].Add(std::exp(log_steps), entries[q], options_, &out_.quantities[q]);
    }
    return true;
  }

  // Errors no larger than the effect of rounding on the exact gradient do not count against the model.
  void ExcuseRounding() {
    std::vector<double> of_levels;  // by quantity
    for (size_t q = 0; q < out_.quantities.size(); ++q) {
      QuantityStudy& quantity = out_.quantities[q];
      if (!IsWrong(quantity.verdict) && quantity.verdict != Verdict::kUnknown) continue;
      if (!out_.conditioning) out_.conditioning = MeasureConditioning(scene_, stop_);
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
  int StepsOf(int level, int sample) const { return unit_ * ((std::max(1, scene_.steps / unit_) << level) + sample); }

  // Returns the largest relative distance of exact gradients with the step counts of the levels from the exact one, by
  // quantity.
  std::vector<double> RoundingOfLevels() const {
    std::vector<double> largest(out_.quantities.size(), 0.0);
    for (size_t level = 0; level < out_.quantities.front().levels.size(); ++level) {
      for (int sample = 0; sample < std::min(options_.samples, kSamplesOfLevels); ++sample) {
        Scene refined = scene_;
        refined.steps = StepsOf(static_cast<int>(level), sample);
        const ModelGradient exact = ComputeGradient(ExactModel()->name, refined, Precision::kDouble, stop_);
        for (size_t q = 0; q < largest.size(); ++q) {
          const QuantityStudy& study = out_.quantities[q];
          largest[q] = std::max(
              largest[q],
              exact.ok() ? levels_[q].ErrorOf(EntriesOf(scene_, exact, study.quantity, out_.intervals), study) : 1.0);
        }
      }
    }
    return largest;
  }

  Contact contact_;
  const Scene& scene_;
  const RefinementOptions& options_;
  const StopRequest& stop_;
  RefinementStudy& out_;
  int unit_ = 1;
  int touches_ = 0;                     // at the first level
  std::vector<QuantityLevels> levels_;  // by quantity
};

}  // namespace

double QuantityLevels::ErrorOf(const std::vector<double>& entries, const QuantityStudy& study) const {
  return Distance(Without(study.one_sided, names, entries), Without(study.one_sided, names, study.exact)) / scale;
}

void QuantityLevels::Add(double steps, const std::vector<std::vector<double>>& samples,
                         const RefinementOptions& options, QuantityStudy* study) {
  const auto judged = [&](const std::vector<double>& entries) { return Without(study->one_sided, names, entries); };
  std::vector<double> errors;
  for (const std::vector<double>& entries : samples) errors.push_back(ErrorOf(entries, *study));
  const auto [smallest, largest] = std::minmax_element(errors.begin(), errors.end());
  study->levels.push_back({steps, Median(errors), *smallest, *largest});
  study->finest.clear();
  for (size_t entry = 0; entry < study->exact.size(); ++entry) {
    std::vector<double> values;
    for (const std::vector<double>& entries : samples) values.push_back(entries[entry]);
    study->finest.push_back(Median(values));
  }
  if (study->levels.size() == 1) coarsest = samples.front();
  study->wrong_signs = FindWrongSigns(names, judged(study->exact), judged(coarsest), judged(study->finest));
  const double median = study->levels.back().error;
  double largest_of_all = 0;
  for (const RefinementLevel& level : study->levels) largest_of_all = std::max(largest_of_all, level.largest);
  study->decisive = median > options.tolerance ? median : largest_of_all;
  if (study->levels.size() >= kTail) Judge(options, study);
}

double ScaleOf(const QuantityStudy& study, const std::vector<std::string>& names, double loss) {
  return std::max(Norm(Without(study.one_sided, names, study.exact)), 1e-6 * std::max(1.0, std::abs(loss)));
}

bool MayHaveAFloor(const QuantityStudy& study) {
  return study.verdict == Verdict::kConsistent && study.levels.back().error > kSettled;
}

std::optional<Conditioning> MeasureConditioning(const Scene& scene, const StopRequest& stop) {
  const ModelTraits* exact = ExactModel();
  if (exact == nullptr) return std::nullopt;
  const ModelGradient gradient = ComputeGradient(exact->name, scene, Precision::kDouble, stop);
  if (!gradient.ok()) return std::nullopt;
  Conditioning found;
  const auto compare = [&](const Scene& other) {
    const ModelGradient changed = ComputeGradient(exact->name, other, Precision::kDouble, stop);
    return changed.ok() ? RelativeChange(changed.gradient.initial, gradient.gradient.initial) : 1.0;
  };
  std::mt19937 random(1);
  for (int sample = 1; sample <= kSamples; ++sample) {
    const double change = compare(Jitter(scene, &random));
    found.condition = std::max(found.condition, change / kEpsilon);
    Scene resampled = scene;
    resampled.steps += sample;
    found.rounding = std::max({found.rounding, change, compare(resampled)});
    if (stop && stop()) return std::nullopt;
  }
  return found;
}

double Conditioning::DigitsLost() const { return std::log10(std::clamp(rounding, kEpsilon, 1.0) / kEpsilon); }

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
  for (const QuantityStudy& study : quantities) {
    if (study.quantity == quantity) return &study;
  }
  return nullptr;
}

RefinementStudy StudyRefinement(const Contact& contact, const Scene& scene, const RefinementOptions& options,
                                const StopRequest& stop) {
  RefinementStudy refused;
  refused.reason = WhyNotApplicable(contact, scene);
  if (!refused.ok()) return refused;
  if (!scene.units.natural) {
    const Scene natural = InNaturalUnits(scene);
    RefinementStudy study = StudyRefinement(contact, natural, options, stop);
    for (QuantityStudy& quantity : study.quantities) {
      const double by = GradientFactor(quantity.quantity, natural.units, scene.units);
      quantity.exact = Multiplied(std::move(quantity.exact), by);
      quantity.finest = Multiplied(std::move(quantity.finest), by);
    }
    return study;
  }
  RefinementStudy study;
  Study run(contact, scene, options, stop, &study);
  if (!study.ok()) return study;
  const int levels = std::max<int>(options.levels, kTail);
  for (int level = 0; level < levels || (level < options.most_levels && run.Undecided()); ++level) {
    if (level >= static_cast<int>(kTail) && run.CostOf(level) > options.budget) break;
    if (!run.AddLevel(level)) return study;
  }
  for (QuantityStudy& quantity : study.quantities) {
    if (MayHaveAFloor(quantity)) quantity.verdict = Verdict::kUnknown;
  }
  run.ExcuseRounding();
  study.verdict = Overall(study);
  return study;
}

}  // namespace saltus
